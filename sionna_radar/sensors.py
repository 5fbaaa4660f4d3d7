"""The sensors that a survey can carry: from pulses to echoes.

A sensor of one's own is any object with the methods of `Sensor`; pass what builds it from the prepared survey to
`sionna_radar.run(sensor=...)`.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Inexact, Int
from scipy.constants import speed_of_light
from scipy.special import ndtri

from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles
from sionna_radar.detection.triangular import PairedEchoes, pair_sweeps
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.preparation import Preparation, region_in_reach_m
from sionna_radar.radar.chirp import Chirp, build_sweeps
from sionna_radar.randomness import Stream, pulse_uniforms
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.noise import add_noise
from sionna_radar.stopwatch import Stopwatch
from sionna_radar.tracing.atmosphere import build_atmosphere
from sionna_radar.tracing.boresight import trace_boresights
from sionna_radar.tracing.engine import Engine, EngineInputs, Tracer, build_engine
from sionna_radar.tracing.paths import Paths


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a sensor makes of a block of pulses, before anything is known of the measured pose.

    paths: what was lit.
    echoes: sorted by pulse; their ranges are as the sensor reads them, Doppler shift included.
    profiles: range profiles around the echoes, for maps that model whole echoes; None where the sensor has none.
    """

    paths: Paths
    echoes: Echoes
    profiles: Profiles | None = None


@runtime_checkable
class Sensor(Protocol):
    """A sensor: it observes from the true pose, and corrects what it saw by the measured one."""

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        ...

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes of some pulses, sorted, with their ranges corrected for motion."""
        ...


class SawtoothRadar:
    """One sweep a pulse; the measured velocity takes the Doppler shift out."""

    def __init__(
        self, ready: Preparation, watch: Stopwatch | None = None, tracer: Tracer | None = None
    ) -> None:
        self._ready, self._watch = ready, watch or Stopwatch()
        self.tracer = tracer or build_tracer(ready)

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        with self._watch("synthesise"):
            beat = received(paths, pulses, self._ready)
        with self._watch("detect"):
            found = self._ready.detector.find(beat, pulses.index)
        return Observation(paths=paths, echoes=found.echoes, profiles=found.profiles)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground."""
        return self._ready.detector.correct(echoes, pulse, measured)


class TriangularRadar:
    """An up- and a down-sweep a pulse, which tell range and velocity between them.

    The beam stands still during the pair, as it does during a sawtooth.
    """

    def __init__(
        self, ready: Preparation, watch: Stopwatch | None = None, tracer: Tracer | None = None
    ) -> None:
        self._ready, self._watch = ready, watch or Stopwatch()
        self.tracer = tracer or build_tracer(ready)
        self._sweeps = build_sweeps(ready.scenario.radar)

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        return Observation(paths=paths, echoes=self.detect(paths, pulses).echoes)

    def detect(self, paths: Paths, pulses: Pulses) -> PairedEchoes:
        """Return the echoes of paths with their range rates."""
        with self._watch("synthesise"):
            beats = received_sweeps(paths, pulses, self._ready, self._sweeps)
        with self._watch("detect"):
            detector = self._ready.detector
            up, down = (detector.uncorrected(detector.spectra(beat), pulses.index) for beat in beats)
            return pair_sweeps(up, down, self._sweeps[0])

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes as they are: the pair has taken the Doppler shift out."""
        return echoes


class Lidar:
    """An ideal range sensor: the range along the beam axis, exact but for white noise."""

    def __init__(self, caster: RayCaster, range_noise_m: float, seed: int, watch: Stopwatch | None = None) -> None:
        self._caster, self._range_noise_m, self._seed = caster, range_noise_m, seed
        self._watch = watch or Stopwatch()

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses; their power is one, and they have no noise to stand against."""
        with self._watch("trace"):
            paths = trace_boresights(pulses, self._caster)
        range_m = paths.delay_s * speed_of_light / 2
        if self._range_noise_m:
            uniform = pulse_uniforms(self._seed, Stream.LIDAR, paths.pulse, 1)[:, 0]
            range_m = range_m + self._range_noise_m * ndtri(np.maximum(uniform, 2.0**-54))
        echoes = Echoes(
            pulse=paths.pulse,
            number=np.zeros(len(paths), dtype=np.int64),
            range_m=range_m,
            range_sigma_m=np.full(len(paths), self._range_noise_m),
            power=np.ones(len(paths)),
            snr_db=np.full(len(paths), np.nan),
        )
        return Observation(paths=paths, echoes=echoes)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes as they are: light has no Doppler shift to speak of."""
        return echoes


def build_sensor(ready: Preparation, watch: Stopwatch | None = None) -> Sensor:
    """Return the sensor of a prepared survey."""
    scenario = ready.scenario
    if scenario.sensor == "lidar":
        return Lidar(ready.built.caster, scenario.lidar.range_noise_m, scenario.seed, watch)
    if scenario.radar.sweep == "triangular":
        return TriangularRadar(ready, watch)
    return SawtoothRadar(ready, watch)


def build_tracer(ready: Preparation) -> Tracer:
    """Return the tracer of a prepared survey."""
    return tracer_with(build_engine(ready.scenario.tracing, engine_inputs(ready)), ready)


def engine_inputs(ready: Preparation) -> EngineInputs:
    """Return what an engine is made from."""
    return EngineInputs(
        scene=ready.built.scene,
        antenna=ready.antenna,
        chirp=ready.chirp,
        seed=ready.scenario.seed,
        caster=ready.built.caster,
        region_m=region_in_reach_m(ready.schedule, ready.chirp),
    )


def tracer_with(engine: Engine, ready: Preparation) -> Tracer:
    """Return a tracer of a prepared survey with an engine of one's own."""
    scenario = ready.scenario
    return Tracer(
        engine,
        ready.built.scene,
        ready.antenna,
        ready.chirp,
        ready.built.caster,
        atmosphere=build_atmosphere(scenario.weather, ready.antenna, ready.chirp, scenario.seed),
        seed=scenario.seed,
    )


def received(paths: Paths, pulses: Pulses, ready: Preparation) -> Inexact[np.ndarray, "pulse sample"]:
    """Return the beat signals of a block as the receiver samples them: scaled to the sent power, with noise."""
    return received_sweeps(paths, pulses, ready, (ready.chirp,))[0]


def received_sweeps(
    paths: Paths, pulses: Pulses, ready: Preparation, sweeps: tuple[Chirp, ...]
) -> list[Inexact[np.ndarray, "pulse sample"]]:
    """Return the beat signals of each sweep of a block's pulses."""
    clean = [np.sqrt(ready.transmit_power_w) * synthesise(paths, pulses, sweep) for sweep in sweeps]
    beat = add_noise(np.concatenate(clean, axis=1), ready.noise_power_w, ready.scenario.seed, pulses.index)
    return np.split(beat, len(sweeps), axis=1)
