"""The interface of sensors, their inputs, and their registration by name."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.detection.ranging.estimators import RangeLoop, Ranges
from sionna_radar.flight.pulses import Bursts, Pose, Pulses, PulseSchedule, rows_of
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.parts import SENSORS
from sionna_radar.scenario.registry import Facts, require
from sionna_radar.scenario.table import Table
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.signal.receiver import Receiver
from sionna_radar.survey.sensors.sweeps import Beats, ChirpRecord, SweepDetector
from sionna_radar.tracing.build import EngineInputs, build_engine, build_steered_tracer, build_tracer
from sionna_radar.tracing.paths import Engine, Paths
from sionna_radar.tracing.tracer import SteeredTracer, Tracer

Builder = TypeVar("Builder", bound=Callable[..., "Sensor"])


@dataclass(frozen=True, kw_only=True)
class Observation:
    """Observations of a sensor over a block of pulses; the measured pose is used only to separate rain from ground.

    paths: what was lit; none for a recording.
    echoes: sorted by pulse; their ranges are as the sensor reads them, Doppler shift included.
    profiles: range profiles around the echoes, for maps that model whole echoes; None where the sensor has none.
    through_volume: whether the echoes are those of ground behind a volume of rain that the sensor knows of.
    beats: beat signals of each sweep, for whoever records them; None for a sensor without.
    frames: those of an array, chirp by chirp and receiver by receiver; None for a single receiver.
    saturated: samples of each pulse that the converter clipped; None for a sensor without a full scale.
    """

    paths: Paths
    echoes: Echoes
    profiles: Profiles | None = None
    through_volume: bool = False
    beats: Beats | None = None
    frames: Inexact[np.ndarray, "pulse chirp rx sample"] | None = None
    saturated: Int[np.ndarray, " pulse"] | None = None


@runtime_checkable
class Sensor(Protocol):
    """A sensor: it observes from the true pose, and corrects echoes with the measured one."""

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes of some pulses, sorted, with their ranges corrected for motion."""

    def record_chirp(self, pulses: Pulses) -> ChirpRecord | None:
        """Return the chirp of one pulse on its way through the processing; None for a sensor without chirps."""


@runtime_checkable
class SensorWithLookahead(Sensor, Protocol):
    """A sensor that can begin with a block of pulses while another is observed."""

    def expect(self, pulses: Pulses) -> None:
        """Begin with the block that is to be observed after those expected before it."""


@runtime_checkable
class SensorWithChirps(Sensor, Protocol):
    """A sensor that records the chirps of several pulses at once."""

    def record_chirps(self, pulses: Pulses) -> list[ChirpRecord]:
        """Return the chirp of each of some pulses, as `record_chirp` does of one."""


@runtime_checkable
class SensorWithSweeps(Sensor, Protocol):
    """A sensor that finds its echoes in sweeps."""

    sweeps: SweepDetector


def corrected(sensor: Sensor, echoes: Echoes, pulses: Pulses, loop: RangeLoop | None) -> Echoes:
    """Return the echoes of some pulses, corrected for motion, then smoothed by a loop that followed those before."""
    echoes = sensor.correct(echoes, pulses.index, pulses.measured)
    if loop is None:
        return echoes
    time_s = pulses.time_s[rows_of(pulses.index, echoes.pulse)]
    ranges = loop.follow(time_s, Ranges(range_m=echoes.range_m, sigma_m=echoes.range_sigma_m))
    return replace(echoes, range_m=ranges.range_m, range_sigma_m=ranges.sigma_m)


def loop_of(sensor: Sensor) -> RangeLoop | None:
    """Return a new loop over the ranges of a sensor; None for one without."""
    return sensor.sweeps.detector.range_loop() if isinstance(sensor, SensorWithSweeps) else None


@dataclass(frozen=True, kw_only=True)
class SensorInputs:
    """Inputs of a sensor; each takes those it needs.

    engine: what tracing engines are built from; its `caster` casts rays against the scene.
    receiver, detector: of the radar.
    schedule: all pulses of the survey, for a sensor that looks about before it starts.
    expected_ground: what is known of the ground beforehand; None for nothing.
    weather, lidar: tables of the scenario.
    angle: finds directions by the receivers of an array; None for echoes on the beam's axis.
    module: the array with its true errors; None for a radar of which one receiver is used.
    bursts: the chirps of each pulse, or frame; None for one.
    custom_engine: builds an engine in place of the one that the scenario names.
    """

    engine: EngineInputs
    receiver: Receiver
    detector: Detector
    schedule: PulseSchedule
    expected_ground: ExpectedGround | None
    weather: WeatherTable
    lidar: LidarTable
    angle: AngleEstimator | ArrayEstimator | None = None
    module: MimoArray | None = None
    bursts: Bursts | None = None
    custom_engine: Callable[[EngineInputs], Engine] | None = None

    def tracer(self) -> Tracer | SteeredTracer:
        """Return a new tracer of all that a radar sees."""
        inputs = self.engine
        engine = self.custom_engine(inputs) if self.custom_engine else build_engine(inputs.tracing, inputs)
        require(engine, Engine, "engine")
        if inputs.beams:
            return build_steered_tracer(engine, inputs, self.weather)
        return build_tracer(engine, inputs, self.weather)


def register_sensor(
    name: str, parameters: type[Table] | None = None, *, provides_profiles: bool = False
) -> Callable[[Builder], Builder]:
    """Register a sensor, for `sensor` in a scenario.

    Parameters
    ----------
    name:
        What scenarios call it.
    parameters:
        Its table of parameters, `[sensor_parameters]`; without it there are none.
    provides_profiles:
        Whether its observations have range profiles, which some DEM methods require.

    Returns
    -------
    A decorator of what builds a `Sensor`: a class or a function, called with the parameters if there are any, and with
    `SensorInputs`.

    Raises
    ------
    PluginError
        The name is taken, or the parameters are not a `Table`.

    Examples
    --------
    >>> import dataclasses
    >>> from sionna_radar.survey import Lidar
    >>> @register_sensor("biased_lidar")
    ... class BiasedLidar(Lidar):
    ...     def __init__(self, inputs):
    ...         super().__init__(inputs.engine.caster, range_noise_m=0.02, seed=inputs.engine.seed)
    ...     def correct(self, echoes, pulse, measured):
    ...         return dataclasses.replace(echoes, range_m=echoes.range_m + 1.0)
    >>> overrides = {"sensor": "biased_lidar", "platform.length_m": 10.0}
    >>> run(load_scenario("hills", overrides)).lit_error.mean_m < -0.5
    True
    """
    return SENSORS.register(name, parameters, Facts(provides_profiles=provides_profiles))


def build_sensor(scenario: Scenario, inputs: SensorInputs) -> Sensor:
    """Return the sensor of a scenario."""
    return SENSORS.build(scenario.sensor, Sensor, scenario.sensor_parameters, inputs)
