"""The radar: one sweep a pulse, or an up- and a down-sweep."""

from dataclasses import replace
from functools import cached_property

import numpy as np
from jaxtyping import Int

from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.triangular import PairedEchoes, pair_sweeps
from sionna_radar.detection.volume.detector import ThroughVolume, shows_volume, volume_in_front
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.survey.sensors.sensor import ChirpRecord, Observation, SensorInputs, register_sensor
from sionna_radar.tracing.paths import Paths
from sionna_radar.tracing.steered import SteeredTracer
from sionna_radar.tracing.tracer import Tracer

# A glance at so many pulses shows whether rain fills the beam; if it does, so many show its mean echo.
GLANCE_PULSES, VOLUME_PULSES = 48, 256


class SawtoothRadar:
    """One sweep a pulse; the measured velocity takes the Doppler shift out."""

    def __init__(self, given: SensorInputs) -> None:
        self._given, self._watch = given, given.watch
        self.tracer = given.tracer()

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        with self._watch("synthesise"):
            beat = self._given.receiver.beat(paths, pulses)
        with self._watch("detect"):
            detector, through = self._given.detector, self.through[0]
            window_m = self._given.window_m(pulses, self._given.receiver.chirp)
            if through is None:
                found = detector.find(beat, pulses.index, window_m)
            else:
                found = through.find(detector.analyser.power(beat), pulses, self._given.receiver.chirp, window_m)
        return Observation(
            paths=paths, echoes=found.echoes, profiles=found.profiles, through_volume=through is not None
        )

    @cached_property
    def through(self) -> list[ThroughVolume | None]:
        """The detector, of the one sweep, through the volume that the survey shows; None in clear air."""
        return _volume_in_front(self._given, self.tracer)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground."""
        return self._given.detector.correct(echoes, pulse, measured)

    def record_chirp(self, pulses: Pulses) -> ChirpRecord:
        """Return the chirp of one pulse, with what is found in it."""
        return _record_chirp(self._given, self.tracer, self.through[0], pulses)


class TriangularRadar:
    """An up- and a down-sweep a pulse, which together give range and velocity.

    The beam stands still during the pair, as it does during a sawtooth.
    """

    def __init__(self, given: SensorInputs) -> None:
        self._given, self._watch = given, given.watch
        self.tracer = given.tracer()
        self._sweeps = given.receiver.sweeps

    def observe(self, pulses: Pulses) -> Observation:
        """Return the echoes of a block of pulses."""
        with self._watch("trace"):
            paths = self.tracer.trace(pulses)
        echoes = self.detect(paths, pulses).echoes
        return Observation(paths=paths, echoes=echoes, through_volume=self.through[0] is not None)

    def detect(self, paths: Paths, pulses: Pulses) -> PairedEchoes:
        """Return the echoes of paths with their range rates."""
        with self._watch("synthesise"):
            beats = self._given.receiver.beats(paths, pulses)
        with self._watch("detect"):
            detector = self._given.detector
            up, down = (
                detector.uncorrected(detector.spectra(beat), pulses.index, self._given.window_m(pulses, sweep))
                if through is None
                else through.find(
                    detector.analyser.power(beat), pulses, sweep, self._given.window_m(pulses, sweep)
                ).echoes
                for beat, through, sweep in zip(beats, self.through, self._sweeps, strict=True)
            )
            return pair_sweeps(up, down, self._sweeps[0])

    @cached_property
    def through(self) -> list[ThroughVolume | None]:
        """The detector of each sweep through the volume that the survey shows; None in clear air."""
        return _volume_in_front(self._given, self.tracer)

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes as they are: the pair has taken the Doppler shift out."""
        return echoes

    def record_chirp(self, pulses: Pulses) -> ChirpRecord:
        """Return the chirp of one pulse, the rising half of its pair, with what is found in it."""
        return _record_chirp(self._given, self.tracer, self.through[0], pulses)


@register_sensor("radar", provides_profiles=True)
def radar(given: SensorInputs) -> SawtoothRadar | TriangularRadar:
    """Return the radar of a scenario, by the number of its sweeps."""
    return SawtoothRadar(given) if len(given.receiver.sweeps) == 1 else TriangularRadar(given)


def _volume_in_front(given: SensorInputs, tracer: Tracer | SteeredTracer) -> list[ThroughVolume | None]:
    """Return a detector through the volume for each sweep, from pulses spread over the survey; None in clear air."""
    detector, sweeps = given.detector, given.receiver.sweeps
    if detector.processing.volume_clutter == "off":
        return [None] * len(sweeps)
    for count in (GLANCE_PULSES, VOLUME_PULSES):
        pulses = given.schedule.sample(count)
        beats = given.receiver.beats(tracer.trace(pulses), pulses)
        found = []
        for beat, sweep in zip(beats, sweeps, strict=True):
            power = detector.analyser.power(beat)
            if not shows_volume(detector, power):
                return [None] * len(sweeps)
            if count == VOLUME_PULSES:
                found.append(volume_in_front(detector, power, pulses, sweep))
    return found


def _record_chirp(
    given: SensorInputs, tracer: Tracer | SteeredTracer, through: ThroughVolume | None, pulses: Pulses
) -> ChirpRecord:
    """Return the first sweep of one pulse, with what is found in it.

    Behind rain the threshold is what rain and noise exceed at the false-alarm rate.
    """
    detector, chirp = given.detector, given.receiver.chirp
    beat = given.receiver.beats(tracer.trace(pulses), pulses)[0]
    spectra = detector.spectra(beat)
    if through is None:
        echoes = detector.uncorrected(spectra, pulses.index, given.window_m(pulses, chirp))
    else:
        echoes = through.find(spectra.power, pulses, chirp, given.window_m(pulses, chirp)).echoes
        spectra = replace(spectra, threshold=through.threshold(spectra))
    tested = np.isfinite(spectra.threshold[0])
    return ChirpRecord(
        pulse=int(pulses.index[0]),
        sample_time_s=chirp.sample_time_s,
        beat=beat[0],
        range_m=detector.analyser.range_m,
        power=spectra.power[0],
        threshold=np.where(tested, spectra.threshold[0], np.nan),
        echo_range_m=echoes.range_m,
        echo_power=echoes.power,
    )
