"""The sensors that a survey can carry: from pulses to echoes.

A custom sensor is any object with the methods of `Sensor`; pass what builds it from the prepared survey to
`sionna_radar.run(sensor=...)`.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Inexact, Int
from scipy.constants import speed_of_light
from scipy.special import ndtri

from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles
from sionna_radar.detection.triangular import PairedEchoes, pair_sweeps
from sionna_radar.detection.volume.detector import ThroughVolume, shows_volume, volume_in_front
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.foundation.stopwatch import Stopwatch
from sionna_radar.radar.chirp import Chirp, build_sweeps
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.lidar import LidarReceiver, lidar_receiver
from sionna_radar.signal.noise import add_noise
from sionna_radar.survey.preparation import Preparation, region_in_reach_m
from sionna_radar.tracing.boresight import trace_boresights
from sionna_radar.tracing.effects.atmosphere import build_atmosphere
from sionna_radar.tracing.engine import Engine, EngineInputs, Tracer, build_engine
from sionna_radar.tracing.paths import VOLUME, Paths

# A glance at so many pulses tells whether rain fills the beam; if it does, so many tell its mean echo.
GLANCE_PULSES, VOLUME_PULSES = 48, 256


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a sensor makes of a block of pulses; of the measured pose it knows no more than rain asks for.

    paths: what was lit.
    echoes: sorted by pulse; their ranges are as the sensor reads them, Doppler shift included.
    profiles: range profiles around the echoes, for maps that model whole echoes; None where the sensor has none.
    through_volume: whether the echoes are those of ground behind a volume of rain that the sensor knows of.
    """

    paths: Paths
    echoes: Echoes
    profiles: Profiles | None = None
    through_volume: bool = False


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

    def __init__(self, ready: Preparation, watch: Stopwatch | None = None, tracer: Tracer | None = None) -> None:
        self._ready, self._watch = ready, watch or Stopwatch()
        self.tracer = tracer or build_tracer(ready)

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        with self._watch("synthesise"):
            beat = received(paths, pulses, self._ready)
        with self._watch("detect"):
            detector, through = self._ready.detector, self.through[0]
            window_m = self._ready.window_m(pulses, self._ready.chirp)
            if through is None:
                found = detector.find(beat, pulses.index, window_m)
            else:
                found = through.find(detector.analyser.power(beat), pulses, self._ready.chirp, window_m)
        return Observation(
            paths=paths, echoes=found.echoes, profiles=found.profiles, through_volume=through is not None
        )

    @cached_property
    def through(self) -> list[ThroughVolume | None]:
        """The detector, of the one sweep, through the volume that the survey shows; None in clear air."""
        return _volume_in_front(self._ready, self.tracer, (self._ready.chirp,))

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground."""
        return self._ready.detector.correct(echoes, pulse, measured)


class TriangularRadar:
    """An up- and a down-sweep a pulse, which tell range and velocity between them.

    The beam stands still during the pair, as it does during a sawtooth.
    """

    def __init__(self, ready: Preparation, watch: Stopwatch | None = None, tracer: Tracer | None = None) -> None:
        self._ready, self._watch = ready, watch or Stopwatch()
        self.tracer = tracer or build_tracer(ready)
        self._sweeps = build_sweeps(ready.scenario.radar)

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        echoes = self.detect(paths, pulses).echoes
        return Observation(paths=paths, echoes=echoes, through_volume=self.through[0] is not None)

    def detect(self, paths: Paths, pulses: Pulses) -> PairedEchoes:
        """Return the echoes of paths with their range rates."""
        with self._watch("synthesise"):
            beats = received_sweeps(paths, pulses, self._ready, self._sweeps)
        with self._watch("detect"):
            detector = self._ready.detector
            up, down = (
                detector.uncorrected(detector.spectra(beat), pulses.index, self._ready.window_m(pulses, sweep))
                if through is None
                else through.find(
                    detector.analyser.power(beat), pulses, sweep, self._ready.window_m(pulses, sweep)
                ).echoes
                for beat, through, sweep in zip(beats, self.through, self._sweeps, strict=True)
            )
            return pair_sweeps(up, down, self._sweeps[0])

    @cached_property
    def through(self) -> list[ThroughVolume | None]:
        """The detector of each sweep through the volume that the survey shows; None in clear air."""
        return _volume_in_front(self._ready, self.tracer, self._sweeps)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes as they are: the pair has taken the Doppler shift out."""
        return echoes


class Lidar:
    """An ideal range sensor: the range along the beam axis, exact but for white noise and for what fills the air."""

    def __init__(
        self,
        caster: RayCaster,
        range_noise_m: float,
        seed: int,
        watch: Stopwatch | None = None,
        receiver: LidarReceiver | None = None,
    ) -> None:
        self._caster, self._range_noise_m, self._seed = caster, range_noise_m, seed
        self._watch, self._receiver = watch or Stopwatch(), receiver

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses; their power is one, and they have no noise to stand against."""
        with self._watch("trace"):
            paths = read = trace_boresights(pulses, self._caster)
        if self._receiver is not None:
            read = self._receiver.received(paths, pulses)
            # What the beam lights is not what the lidar hears of it.
            paths = Paths.concatenate([paths, read.only(read.surface == VOLUME)])
        range_m = read.delay_s * speed_of_light / 2
        if self._range_noise_m:
            uniform = pulse_uniforms(self._seed, Stream.LIDAR, read.pulse, 1)[:, 0]
            range_m = range_m + self._range_noise_m * ndtri(np.maximum(uniform, 2.0**-54))
        echoes = Echoes(
            pulse=read.pulse,
            number=np.zeros(len(read), dtype=np.int64),
            range_m=range_m,
            range_sigma_m=np.full(len(read), self._range_noise_m),
            power=np.ones(len(read)),
            snr_db=np.full(len(read), np.nan),
        )
        return Observation(paths=paths, echoes=echoes)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes as they are: light has no Doppler shift to speak of."""
        return echoes


def _volume_in_front(ready: Preparation, tracer: Tracer, sweeps: tuple[Chirp, ...]) -> list[ThroughVolume | None]:
    """Return a detector through the volume for each sweep, from pulses spread over the survey; None in clear air."""
    if ready.scenario.processing.volume_clutter == "off":
        return [None] * len(sweeps)
    for count in (GLANCE_PULSES, VOLUME_PULSES):
        pulses = ready.schedule.sample(count)
        beats = received_sweeps(tracer.trace(pulses), pulses, ready, sweeps)
        found = []
        for beat, sweep in zip(beats, sweeps, strict=True):
            power = ready.detector.analyser.power(beat)
            if not shows_volume(ready.detector, power):
                return [None] * len(sweeps)
            if count == VOLUME_PULSES:
                found.append(volume_in_front(ready.detector, power, pulses, sweep))
    return found


def build_sensor(ready: Preparation, watch: Stopwatch | None = None) -> Sensor:
    """Return the sensor of a prepared survey."""
    scenario = ready.scenario
    if scenario.sensor == "lidar":
        receiver = lidar_receiver(scenario.lidar, scenario.weather, scenario.seed)
        return Lidar(ready.built.caster, scenario.lidar.range_noise_m, scenario.seed, watch, receiver)
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
    """Return a tracer of a prepared survey with a custom engine."""
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
    seed, high_pass = ready.scenario.seed, ready.high_pass
    if high_pass is None:
        clean = [np.sqrt(ready.transmit_power_w) * synthesise(paths, pulses, sweep) for sweep in sweeps]
        beat = add_noise(np.concatenate(clean, axis=1), ready.noise_power_w, seed, pulses.index)
        return np.split(beat, len(sweeps), axis=1)
    echoes = [synthesise(high_pass.filtered(paths, sweep), pulses, sweep) for sweep in sweeps]
    silence = np.zeros_like(np.concatenate(echoes, axis=1))
    noise = np.split(add_noise(silence, ready.noise_power_w, seed, pulses.index), len(sweeps), axis=1)
    return [
        np.sqrt(ready.transmit_power_w) * echo + high_pass.shaped(part, sweep.sampling_rate_hz)
        for echo, part, sweep in zip(echoes, noise, sweeps, strict=True)
    ]
