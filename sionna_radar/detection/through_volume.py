"""The ground's echoes behind a volume of rain: likelihood of each pulse, neighbours in the scan, range.

Through a volume a pulse brings one echo at most, that of the surface which ends it. Cells about it that the model
gives to the ground make the run of the echo; the volume's mean that is still there is part of the noise of its
estimators. Where ground stands far over the volume, the scenario's estimator tells the range; where it does not,
the posterior mean of the likelihood does, which knows the end of the volume too.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.detector import Detector, Found, Spectra, strongest_bins
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.height_track import AxisHeights, Tracked, track
from sionna_radar.detection.profiles import Profiles, cut_profiles
from sionna_radar.detection.ranging import ESTIMATORS, EchoRuns, Ranges
from sionna_radar.detection.volume_clutter import VolumeClutter, first_guess, measured_mean
from sionna_radar.detection.volume_end import VolumeEnd
from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.chirp import Chirp

# Probability that the echo lies on the surface it is put on, and that there is any ground at all.
LEAST_PROBABILITY = 0.99
WIDTHS_OF_RUN = 3.0
# Half of the window's response that shapes are spread by, in range cells.
RESPONSE_CELLS = 4
# Level of the ground over the volume at which both ways of ranging count alike.
EVEN_LEVEL = 16.0
ESTIMATION_ROUNDS = 2
LEVEL_ROUNDS = 6
# Levels rarer than this are none.
RAREST_LEVEL = 1e-3
# Between the volume alone and the ground's range there lie this many widths of level ground's echo, and cells.
WIDTHS_BEFORE, CELLS_BEFORE = 5.0, 16


@dataclass(frozen=True, kw_only=True)
class ThroughVolume:
    """A detector of ground behind a volume whose mean echo is known."""

    detector: Detector
    end: VolumeEnd

    @property
    def volume(self) -> VolumeClutter:
        """The volume."""
        return self.end.volume

    def find(
        self, power: Float[np.ndarray, "pulse bin"], pulses: Pulses, sweep: Chirp
    ) -> Found:
        """Return the uncorrected echoes of whole scan lines and the profiles around them.

        Parameters
        ----------
        power:
            Power spectra.
        pulses:
            Whole scan lines; the measured pose alone is used.
        sweep:
            The sweep of these spectra, which tells what motion does to ranges.

        """
        # Line by line, so that rounding does not depend on how many lines a block holds.
        breaks = np.flatnonzero(np.diff(pulses.line)) + 1
        lines = [self._find_line(power[r], pulses.rows(r), sweep) for r in np.split(np.arange(len(pulses)), breaks)]
        return Found(
            echoes=Echoes.concatenate([line.echoes for line in lines]),
            profiles=Profiles.concatenate([line.profiles for line in lines]),
        )

    def _find_line(self, power: Float[np.ndarray, "pulse bin"], pulses: Pulses, sweep: Chirp) -> Found:
        stride = self.detector.analyser.zero_padding
        ratio = self.end.over_volume(power[:, ::stride])
        down, drift = _looking_down(pulses), self._drift_m(pulses, sweep)
        evidence = self.end.evidence(ratio, down, drift)
        tracked = track(evidence, _heights(pulses, sweep), self.end.cell_m, pulses.line)
        width, level = self.end.shape_at(ratio, np.rint(tracked.cell).astype(np.int64), down, drift)
        kept = np.flatnonzero(_accepted(tracked, self.detector.processing.cfar.false_alarm_probability))
        runs, volume = self._runs(power, tracked.cell, width, drift, kept)
        ranges = self._ranges(runs, tracked, level, kept)
        noise = runs.noise[runs.row, runs.peak]
        peak = power[runs.row, runs.peak]
        echoes = Echoes(
            pulse=pulses.index[kept],
            number=np.zeros(len(kept), dtype=np.int64),
            range_m=ranges.range_m,
            range_sigma_m=ranges.sigma_m,
            power=peak,
            snr_db=10 * np.log10(peak / np.maximum(noise, np.finfo(float).tiny)),
        )
        quiet = replace(runs, noise=np.full(power.shape, self.volume.noise))
        profiles = cut_profiles(quiet, pulses.index, stride, volume)
        profiles = replace(profiles, echo_m=ranges.range_m, echo_sigma_m=ranges.sigma_m)
        return Found(echoes=echoes, profiles=profiles)

    def threshold(self, spectra: Spectra) -> Float[np.ndarray, "pulse bin"]:
        """Return the greater of the CFAR's threshold and that of the volume's clutter map."""
        place = np.arange(spectra.power.shape[1]) / self.detector.analyser.zero_padding
        clutter = self.volume.clutter_threshold(self.detector.processing.cfar.false_alarm_probability)
        return np.maximum(spectra.threshold, np.interp(place, np.arange(len(clutter)), clutter))

    def _drift_m(self, pulses: Pulses, sweep: Chirp) -> Float[np.ndarray, " pulse"]:
        """Return by how much the fall of the volume moves its echo: it recedes from a beam that looks down."""
        return sweep.doppler_range_m(self.volume.fall_mps * _looking_down(pulses))

    def _runs(
        self,
        power: Float[np.ndarray, "pulse bin"],
        cell: Float[np.ndarray, " pulse"],
        width: Float[np.ndarray, " pulse"],
        drift_m: Float[np.ndarray, " pulse"],
        kept: Int[np.ndarray, " echo"],
    ) -> tuple[EchoRuns, Float[np.ndarray, "pulse bin"]]:
        """Return the echoes' runs, volume and noise as their noise, and the mean of the volume alone."""
        analyser = self.detector.analyser
        stride, bins = analyser.zero_padding, power.shape[1]
        place = np.arange(bins) / stride
        mean = np.interp(place, np.arange(len(self.volume.mean)), self.volume.mean)
        volume = mean * self.end.in_air(cell, width, drift_m, place)
        reach = WIDTHS_OF_RUN * width + 1
        start = np.clip(np.floor((cell - reach) * stride), 0, bins - 1).astype(np.int64)
        stop = np.clip(np.ceil((cell + reach) * stride) + 1, start + 1, bins).astype(np.int64)
        runs = EchoRuns(
            power=power,
            noise=volume + self.volume.noise,
            row=kept,
            start=start[kept],
            stop=stop[kept],
            peak=strongest_bins(power, kept, start[kept], stop[kept]),
            bin_m=analyser.bin_m,
            looks_per_bin=analyser.looks_per_cell / stride,
            beam=self.detector.beam,
        )
        return runs, volume

    def _ranges(
        self, runs: EchoRuns, tracked: Tracked, level: Float[np.ndarray, " pulse"], kept: Int[np.ndarray, " echo"]
    ) -> Ranges:
        own = ESTIMATORS[self.detector.processing.ranging](runs)
        cell_m = self.end.cell_m
        share = 1 / (1 + (level[kept] / EVEN_LEVEL) ** 4)
        return Ranges(
            range_m=share * tracked.cell[kept] * cell_m + (1 - share) * own.range_m,
            sigma_m=np.hypot(share * tracked.sigma[kept] * cell_m, (1 - share) * own.sigma_m),
        )


def shows_volume(detector: Detector, power: Float[np.ndarray, "pulse bin"]) -> bool:
    """Tell whether the spectra of pulses spread over a survey show a volume in front of the ground."""
    return detector.beam is not None and _first_guess(detector, power) is not None


def _first_guess(detector: Detector, power: Float[np.ndarray, "pulse bin"]) -> VolumeClutter | None:
    stride = detector.analyser.zero_padding
    range_m = detector.analyser.range_m[::stride]
    first = int(np.searchsorted(range_m, detector.processing.min_range_m))
    return first_guess(power[:, ::stride], range_m, first, len(range_m) - 2)


def volume_in_front(
    detector: Detector, power: Float[np.ndarray, "pulse bin"], pulses: Pulses, sweep: Chirp
) -> ThroughVolume | None:
    """Return a detector through the volume that some spectra show; None in clear air.

    Parameters
    ----------
    detector:
        The processing of the scenario.
    power:
        Spectra of pulses spread over the survey.
    pulses, sweep:
        Those pulses and their sweep.

    """
    analyser = detector.analyser
    if detector.beam is None:
        return None
    stride = analyser.zero_padding
    cells = power[:, ::stride]
    range_m = analyser.range_m[::stride]
    first = int(np.searchsorted(range_m, detector.processing.min_range_m))
    guess = _first_guess(detector, power)
    if guess is None:
        return None
    through = _through(detector, guess, first, len(range_m))
    for _ in range(ESTIMATION_ROUNDS):
        through = _estimated_again(through, cells, pulses, sweep, range_m)
    return through


def _through(detector: Detector, volume: VolumeClutter, first: int, cells: int) -> ThroughVolume:
    analyser = detector.analyser
    assert detector.beam is not None
    end = VolumeEnd(
        volume=volume,
        beam=detector.beam,
        cell_m=analyser.chirp.range_resolution_m,
        looks=analyser.looks_per_cell,
        response=analyser.response(RESPONSE_CELLS, 1),
        first=first,
        cells=cells,
    )
    return ThroughVolume(detector=detector, end=end)


def _estimated_again(
    through: ThroughVolume,
    cells: Float[np.ndarray, "pulse cell"],
    pulses: Pulses,
    sweep: Chirp,
    range_m: Float[np.ndarray, " cell"],
) -> ThroughVolume:
    """Return the volume's mean from what lies before the ground, and how strong the ground is over it."""
    end, volume = through.end, through.volume
    down, drift = _looking_down(pulses), through._drift_m(pulses, sweep)
    by_level = end.by_level(end.over_volume(cells), down, drift)
    share = _level_share(by_level - np.log(volume.level_share).astype(np.float32), volume.level_share)
    ground = np.argmax(by_level.max(axis=2), axis=1)
    spread = np.sqrt(end.beam.share @ end.beam.sine**2)
    width = ground * spread * np.sqrt(1 / np.maximum(down, 0.05) ** 2 - 1 + 0.1)
    before = ground - WIDTHS_BEFORE * width - CELLS_BEFORE
    number = np.arange(len(range_m))
    alone = (number < before[:, None]) & (number >= end.first)
    mean = measured_mean(volume, cells, alone, range_m)
    kept = share > RAREST_LEVEL
    kept[1:-1] |= kept[2:] | kept[:-2]
    known = VolumeClutter(mean=mean, noise=volume.noise, level=volume.level[kept], level_share=share[kept])
    return _through(through.detector, known, end.first, end.cells)


def _level_share(
    likelihood: Float[np.ndarray, "pulse cell level"], share: Float[np.ndarray, " level"]
) -> Float[np.ndarray, " level"]:
    """Return how often each level occurs: the shares under which the pulses are most likely."""
    # Over cells an even prior; only the ratio between levels counts.
    most = likelihood.max(axis=(1, 2), keepdims=True)
    weight = np.exp(np.maximum(likelihood - most, -60.0)).sum(axis=1)
    for _ in range(LEVEL_ROUNDS):
        own = weight * share
        share = (own / own.sum(axis=1, keepdims=True)).mean(axis=0)
        share = (share + 1e-5) / np.sum(share + 1e-5)
    return share


def _looking_down(pulses: Pulses) -> Float[np.ndarray, " pulse"]:
    return -pulses.measured.boresight[:, 2]


def _heights(pulses: Pulses, sweep: Chirp) -> AxisHeights:
    pose = pulses.measured
    shift_m = sweep.doppler_range_m(pose.boresight_range_rate_mps)
    return AxisHeights(position_m=pose.position_m, boresight=pose.boresight, shift_m=shift_m)


def _accepted(tracked: Tracked, false_alarm_probability: float) -> Bool[np.ndarray, " pulse"]:
    strong = tracked.evidence > -np.log(false_alarm_probability)
    accepted: Bool[np.ndarray, " pulse"] = strong & (tracked.probability >= LEAST_PROBABILITY)
    return accepted
