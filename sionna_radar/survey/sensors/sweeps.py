"""Detection in the beat signals of single or paired sweeps, simulated or recorded."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Inexact, Int

from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.detector import Detector, PairedEchoes, pair_sweeps
from sionna_radar.detection.echoes import Echoes, Profiles
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.detection.preprocessing import burst_mean, zeroed
from sionna_radar.detection.volume.detector import ThroughVolume
from sionna_radar.detection.volume.estimation import shows_volume, volume_in_front
from sionna_radar.flight.pulses import Bursts, Pose, Pulses, PulseSequence
from sionna_radar.radar.chirp import Chirp

# The beat signals of each sweep of a pulse, and of all its chirps.
Beats = Sequence[Inexact[np.ndarray, "pulse sample"]]
ChirpBeats = Sequence[Inexact[np.ndarray, "chirp sample"]]

# Pulses sampled to test whether rain fills the beam, and to estimate its mean echo.
GLANCE_PULSES, VOLUME_PULSES = 48, 256
# Pulses that the volume's motion is estimated from.
MOTION_PULSES = 1024
# Pulses averaged to estimate leakage: 256 suppress everything that changes by 24 dB.
STILL_PULSES = 256


@dataclass(frozen=True, kw_only=True)
class SweepDetections:
    """Detections in the beat signals of a block of pulses; ranges are not corrected for Doppler.

    profiles: around the echoes of single sweeps; None for pairs.
    through_volume: whether the echoes are those of ground behind a volume of rain.
    """

    echoes: Echoes
    profiles: Profiles | None
    through_volume: bool


@dataclass(frozen=True, kw_only=True)
class ChirpRecord:
    """One chirp at the stages of its processing, for figures.

    beat: samples of the beat signal, sqrt(W); real or complex (I/Q).
    range_m: range axis of the spectrum, not corrected for Doppler.
    power: calibrated power spectrum; threshold: what a cell must exceed; NaN where none is tested.
    echo_range_m, echo_power: the echoes found, on the axis of the spectrum.
    """

    pulse: int
    sample_time_s: Float[np.ndarray, " sample"]
    beat: Inexact[np.ndarray, " sample"]
    range_m: Float[np.ndarray, " cell"]
    power: Float[np.ndarray, " cell"]
    threshold: Float[np.ndarray, " cell"]
    echo_range_m: Float[np.ndarray, " echo"]
    echo_power: Float[np.ndarray, " echo"]


@dataclass(frozen=True, kw_only=True)
class SweepDetector:
    """Detect the echoes of one sweep per pulse, or pair those of an up- and a down-sweep.

    schedule: all pulses of the survey, of which some are looked at for rain before it starts.
    expected_ground: what is known of the ground beforehand; None for nothing.
    beats: returns the beat signals of pulses, or of all their chirps (of bursts), as they are sampled.
    """

    detector: Detector
    sweeps: tuple[Chirp, ...]
    schedule: PulseSequence
    expected_ground: ExpectedGround | None
    beats: Callable[[Pulses], Beats]
    bursts: Bursts | None = None

    @property
    def paired(self) -> bool:
        """Whether a pulse is an up- and a down-sweep."""
        return len(self.sweeps) > 1

    @cached_property
    def through(self) -> list[ThroughVolume | None]:
        """The detector of each sweep through the volume that the survey shows; None in clear air."""
        detector = self.detector
        if detector.volume_clutter == "off" or detector.analyser.chirp.gate_s:  # a gate leaves out what it is told from
            return [None] * len(self.sweeps)
        for count in (GLANCE_PULSES, VOLUME_PULSES):
            pulses, powers = self._sample_spectra(count)
            if not all(shows_volume(detector, power, pulses) for power in powers):
                return [None] * len(self.sweeps)
        more_pulses, more_powers = self._sample_spectra(MOTION_PULSES)
        return [
            volume_in_front(detector, power, pulses, sweep, more_power, more_pulses)
            for power, more_power, sweep in zip(powers, more_powers, self.sweeps, strict=True)
        ]

    def _sample_spectra(self, count: int) -> tuple[Pulses, list[Float[np.ndarray, "pulse bin"]]]:
        """Return pulses spread over the survey, and the power spectra of each sweep."""
        pulses = self.schedule.sample(count)
        return pulses, [self.detector.analyser.power(beat) for beat in self.cleaned(self.beats(pulses), pulses)]

    @cached_property
    def still(self) -> list[Inexact[np.ndarray, " sample"]]:
        """The constant part of each sweep's chirps: the mean over pulses sampled over the survey."""
        return [beat.mean(axis=0) for beat in self.beats(self.schedule.sample(STILL_PULSES))]

    def cleaned(self, beats: ChirpBeats, pulses: Pulses) -> Beats:
        """Return beats without leakage and interference, as the processing asks; coherent bursts averaged."""
        detector = self.detector
        if detector.leakage == "subtract":
            beats = [beat - still for beat, still in zip(beats, self.still, strict=True)]
        beats = [zeroed(beat) for beat in beats] if detector.interference == "zeroing" else beats
        if self.bursts is None or detector.analyser.averaged > 1:
            return beats
        rate_mps, offset_s = pulses.measured.boresight_range_rate_mps, self.bursts.offset_s
        return [burst_mean(beat, sweep, offset_s, rate_mps) for beat, sweep in zip(beats, self.sweeps, strict=True)]

    def detect(self, beats: Beats, pulses: Pulses) -> SweepDetections:
        """Return the echoes in the beat signals of a block of pulses."""
        beats = self.cleaned(beats, pulses)
        if self.paired:
            through_volume = self.through[0] is not None
            return SweepDetections(
                echoes=self._pairs(beats, pulses).echoes, profiles=None, through_volume=through_volume
            )
        return self.detect_in(self.detector.analyser.power(beats[0]), pulses)

    def directions(self, angle: AngleEstimator, beats: ChirpBeats, pulses: Pulses) -> Echoes:
        """Return echoes with directions of arrival of a block, from the beat signals of all receivers."""
        # Leakage is the same in all receivers.
        cleaned = [self.cleaned([beat], pulses)[0] for beat in beats]
        return angle.find(cleaned, pulses.index, pulses.measured, self.window_m(pulses))

    def detect_in(self, power: Float[np.ndarray, "pulse bin"], pulses: Pulses) -> SweepDetections:
        """Return the echoes in the power spectra of single sweeps."""
        through, window_m = self.through[0], self.window_m(pulses)
        if through is None:
            detections = self.detector.find_in(power, pulses.index, window_m)
        else:
            detections = through.find(power, pulses, self.sweeps[0], window_m)
        return SweepDetections(
            echoes=detections.echoes, profiles=detections.profiles, through_volume=through is not None
        )

    def pairs(self, beats: Beats, pulses: Pulses) -> PairedEchoes:
        """Return the echoes of pairs of sweeps with their range rates."""
        return self._pairs(self.cleaned(beats, pulses), pulses)

    def _pairs(self, beats: Beats, pulses: Pulses) -> PairedEchoes:
        detector = self.detector
        up, down = (
            detector.uncorrected(detector.spectra(beat), pulses.index, self._window_m(pulses, sweep))
            if through is None
            else through.find(
                detector.analyser.power(beat), pulses, sweep, self._window_m(pulses, sweep), on_axis=True
            ).echoes
            for beat, through, sweep in zip(beats, self.through, self.sweeps, strict=True)
        )
        return pair_sweeps(up, down, self.sweeps[0])

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes without the Doppler shift of still ground; a pair has taken it out."""
        return echoes if self.paired else self.detector.correct(echoes, pulse, measured)

    def record_chirps(self, pulses: Pulses) -> list[ChirpRecord]:
        """Return the first sweep of each of some pulses, with what is found in it.

        Where powers are averaged, the samples are those of the first chirp.
        Behind rain the threshold is what rain and noise exceed at the false-alarm rate, and the echo that which its
        whole scan line makes most probable.
        """
        if self.through[0] is None:
            return self._records(pulses, pulses.index)
        # Line by line: few chirps may lie in many lines.
        lines = map(self.schedule.pulses, self.schedule.lines_of(pulses.index))
        return [record for line in lines for record in self._records(line, pulses.index)]

    def _records(self, pulses: Pulses, wanted: Int[np.ndarray, " chirp"]) -> list[ChirpRecord]:
        """Return the records of those of some pulses that are wanted, all of which tell of rain."""
        detector, chirp, through = self.detector, self.sweeps[0], self.through[0]
        beat = self.cleaned(self.beats(pulses), pulses)[0]
        spectra = detector.spectra(beat)
        if through is None:
            echoes = detector.uncorrected(spectra, pulses.index, self._window_m(pulses, chirp))
        else:
            echoes = through.find(spectra.power, pulses, chirp, self._window_m(pulses, chirp), on_axis=True).echoes
            spectra = replace(spectra, threshold=through.threshold(spectra))
        rows = np.flatnonzero(np.isin(pulses.index, wanted))
        beat, power, threshold = beat[rows * detector.analyser.averaged], spectra.power[rows], spectra.threshold[rows]
        threshold = np.where(np.isfinite(threshold), threshold, np.nan)
        echoes_of_pulse = [echoes.of_pulses(pulses.index[row : row + 1]) for row in rows]
        return [
            ChirpRecord(
                pulse=int(pulses.index[row]),
                sample_time_s=chirp.sample_time_s,
                beat=beat[record],
                range_m=detector.analyser.range_m,
                power=power[record],
                threshold=threshold[record],
                echo_range_m=echoes_of_pulse[record].range_m,
                echo_power=echoes_of_pulse[record].power,
            )
            for record, row in enumerate(rows)
        ]

    def window_m(self, pulses: Pulses) -> Float[np.ndarray, "pulse 2"] | None:
        """Return the ranges in which the ground is searched in the first sweep of pulses; None for all."""
        return self._window_m(pulses, self.sweeps[0])

    def _window_m(self, pulses: Pulses, sweep: Chirp) -> Float[np.ndarray, "pulse 2"] | None:
        """Return the ranges in which a sweep's ground is searched; None for all."""
        return None if self.expected_ground is None else self.expected_ground.window_m(pulses, sweep)
