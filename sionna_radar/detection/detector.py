"""The detector: spectrum, CFAR, clustering, ranging, Doppler correction, and pairing of up- and down-sweeps.

The two halves of a triangular sweep give range and range rate without prior knowledge of the velocity. Motion shifts
the echoes of the up-sweep and the down-sweep in opposite directions: their mean is the range, their difference the
range rate (Rouveure et al. 2017, eq. 2 for each half).
"""

from dataclasses import dataclass, replace
from typing import Literal, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Inexact, Int

from sionna_radar.detection.cfar import Cfar
from sionna_radar.detection.echoes import Echoes, Profiles, cut_profiles
from sionna_radar.detection.ranging.estimators import (
    EchoSpans,
    RangeEstimator,
    RangeLoop,
    Ranges,
    TrackerRange,
    moments,
    span_cells,
)
from sionna_radar.detection.ranging.plane_fit import BeamProfile
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose, rows_of
from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.errors import PluginError
from sionna_radar.radar.chirp import Chirp

# Largest power correlation allowed between the noise of the cell under test and of the nearest training cell.
SHARED_NOISE = 0.01
# Standard deviations of an echo behind its centre that the range axis has to hold.
CUT_WIDTHS = 2.0
# Half-length of the window's response, in range cells; a tapered window has little power beyond.
RESPONSE_CELLS = 6


@dataclass(frozen=True, kw_only=True)
class Spectra:
    """Power spectra of a block, with the noise estimates and thresholds of the CFAR.

    noise: estimate of the mean noise power, corrected for the bias of the kind of CFAR; infinite where untested.
    """

    power: Float[np.ndarray, "pulse bin"]
    noise: Float[np.ndarray, "pulse bin"]
    threshold: Float[np.ndarray, "pulse bin"]


@dataclass(frozen=True, kw_only=True)
class Detections:
    """Detections in a block of pulses: its echoes, not corrected for Doppler, and the profiles around them."""

    echoes: Echoes
    profiles: Profiles


@dataclass(frozen=True, kw_only=True)
class VolumeOptions:
    """Options of detection behind a volume; `scenario.processing.VolumeTable` says what each is."""

    estimation_rounds: int
    smoothed_cells: int
    cells_before: int
    widths_before: float
    floor_share: float
    width_spread_nepers: float
    height_step_cells: float
    rain_rate_mm_per_h: float | None


@dataclass(frozen=True, kw_only=True)
class Detector:
    """The processing of one chirp.

    min_range_m: nothing nearer is detected.
    merge_gap_m: detected cells no farther apart are one echo.
    dynamic_range_db: echoes this far below the strongest of their pulse are dropped.
    kept: which echoes of a pulse are kept.
    doppler_correction: whether the Doppler shift of stationary ground is removed from ranges.
    leakage, interference: whether the mean of the chirps is subtracted, and whether bursts are set to zero.
    volume_clutter: whether a volume in front of the ground is looked for; volume: options of detection behind it.
    behind_volume: echoes that are kept where there is one: that of the ground, or all that stand out of the volume too.
    estimator: estimates the ranges of echoes.
    beam: the antenna's echo of a plane, for estimators that fit it; None if the antenna is unknown.
    speckle_looks: number of averaged powers in a pulse with independent speckle.
    volume_echo_w: mean power in a range cell at one metre of a volume of reflectivity one (m2/m3); None if unknown.
    near_field_m: of the antenna, for a volume's echo.
    """

    analyser: SpectrumAnalyser
    cfar: Cfar
    estimator: RangeEstimator
    min_range_m: float
    merge_gap_m: float
    dynamic_range_db: float
    kept: Literal["first", "strongest", "all"]
    doppler_correction: bool
    volume: VolumeOptions
    leakage: Literal["keep", "subtract"] = "keep"
    interference: Literal["keep", "zeroing"] = "keep"
    volume_clutter: Literal["auto", "off"] = "auto"
    behind_volume: Literal["ground", "all"] = "ground"
    beam: BeamProfile | None = None
    speckle_looks: int = 1
    volume_echo_w: float | None = None
    near_field_m: float = 0.0

    def spectra(self, beat: Inexact[np.ndarray, "chirp sample"]) -> Spectra:
        """Return spectra, noise estimates and thresholds of beat signals."""
        return self.tested(self.analyser.power(beat))

    def tested(self, power: Float[np.ndarray, "pulse bin"]) -> Spectra:
        """Return power spectra with their noise estimates and thresholds."""
        level, two_sided = self.cfar.noise_level(self.over_floor(power))
        if self.analyser.noise_rise is not None:
            level = level * self.analyser.noise_rise
        factor = np.where(two_sided, self.cfar.both_sides_factor, self.cfar.one_side_factor)
        mean = np.where(two_sided, self.cfar.both_sides_mean, self.cfar.one_side_mean)
        return Spectra(power=power, noise=level / mean, threshold=level * factor)

    def over_floor(self, power: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, "pulse bin"]:
        """Return powers over the rise of the noise in their bins, in which noise is white."""
        return power if self.analyser.noise_rise is None else power / self.analyser.noise_rise

    def detect(
        self, beat: Inexact[np.ndarray, "chirp sample"], pulse: Int[np.ndarray, " pulse"], measured: Pose
    ) -> Echoes:
        """Return the echoes of beat signals, corrected for Doppler by the measured velocity."""
        return self.echoes(self.spectra(beat), pulse, measured)

    def find_in(
        self,
        power: Float[np.ndarray, "pulse bin"],
        pulse: Int[np.ndarray, " pulse"],
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Detections:
        """Return the uncorrected echoes of power spectra together with the range profiles around them.

        window_m: nearest and farthest range searched in each pulse; None for all ranges.
        """
        spans = self.spans(self.tested(power), window_m)
        profiles = cut_profiles(spans, pulse, self.analyser.zero_padding)
        return Detections(echoes=self._estimated(spans, pulse), profiles=profiles)

    def spans(self, spectra: Spectra, window_m: Float[np.ndarray, "pulse 2"] | None = None) -> EchoSpans:
        """Return the spans of bins of the echoes selected by the scenario."""
        return self._select(self._spans(spectra, window_m))

    def echoes(self, spectra: Spectra, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes in spectra already computed."""
        return self.correct(self.uncorrected(spectra, pulse), pulse, measured)

    def uncorrected(
        self,
        spectra: Spectra,
        pulse: Int[np.ndarray, " pulse"],
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Echoes:
        """Return the echoes at their ranges on the spectrum's axis, Doppler shift included."""
        return self._estimated(self.spans(spectra, window_m), pulse)

    def _estimated(self, spans: EchoSpans, pulse: Int[np.ndarray, " pulse"]) -> Echoes:
        ranges = self.estimator(spans)
        check_ranges(ranges, len(spans.row), self.estimator)
        peak_power = spans.power[spans.row, spans.peak]
        noise = spans.noise[spans.row, spans.peak]
        return Echoes(
            pulse=pulse[spans.row],
            number=number_within(spans.row),
            range_m=ranges.range_m + spans.first_bin * spans.bin_m,
            range_sigma_m=ranges.sigma_m,
            power=peak_power,
            echo_snr_db=10 * np.log10(peak_power / np.maximum(noise, np.finfo(float).tiny)),
        )

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes with ranges corrected for the Doppler shift of stationary ground.

        pulse: indices, increasing, of the pulses that `measured` has the poses of.
        """
        if not self.doppler_correction:
            return echoes
        row = rows_of(pulse, echoes.pulse)
        if echoes.direction is not None:
            toward = np.einsum("eij,ej->ei", measured.R_world_antenna[row], echoes.direction)
            rate_mps = -np.einsum("ei,ei->e", measured.velocity_mps[row], toward)
            return replace(echoes, range_m=echoes.range_m - self.analyser.chirp.doppler_range_m(rate_mps))
        return replace(echoes, range_m=echoes.range_m - self.shift_m(measured)[row])

    def shift_m(self, measured: Pose) -> Float[np.ndarray, " pulse"]:
        """Return the range shift of pulses by the Doppler of stationary ground on the boresight; zero if it is left."""
        moving = measured.boresight_range_rate_mps * self.doppler_correction
        return self.analyser.chirp.doppler_range_m(moving)

    def range_loop(self) -> RangeLoop | None:
        """Return a new loop over the ranges of pulses; None for an estimator that takes each by itself."""
        tracker = self.estimator
        return RangeLoop(time_constant_s=tracker.time_constant_s) if isinstance(tracker, TrackerRange) else None

    def _spans(self, spectra: Spectra, window_m: Float[np.ndarray, "pulse 2"] | None = None) -> EchoSpans:
        """Return the spans of cells around detected ones, bridging gaps of up to `merge_gap_m`.

        An echo wider than the training window masks itself: it raises its own threshold, and the CFAR detects
        only a few of its cells. So a cell counts if it exceeds the threshold of the pulse's quietest training window
        and lies within the dynamic range of the pulse's strongest cell.
        """
        range_m, chirp = self.analyser.range_m, self.analyser.chirp
        low = np.full(len(spectra.power), np.searchsorted(range_m, self.min_range_m))
        high = np.full(len(spectra.power), self._end_bin)
        if chirp.sampling == "real" and chirp.gate_s:  # as at the highest frequency, so at zero
            low = np.maximum(low, np.searchsorted(range_m, chirp.gate_m + chirp.range_resolution_m, side="right"))
        if window_m is not None:
            low = np.maximum(low, np.searchsorted(range_m, window_m[:, 0]))
            high = np.minimum(high, np.searchsorted(range_m, window_m[:, 1], side="right"))
        # Power outside of the tested cells must not raise the limit for the weak cells of an echo.
        cell = np.arange(len(range_m))
        tested = (cell >= low[:, None]) & (cell < high[:, None])
        searched = np.where(tested, spectra.power, 0.0)
        if window_m is not None:
            spectra = replace(spectra, power=searched)
        noise, threshold = self.over_floor(spectra.noise), self.over_floor(spectra.threshold)
        quiet = np.min(noise, axis=1) * (self.cfar.both_sides_factor * self.cfar.both_sides_mean)
        searched = self.over_floor(searched)
        limit = np.maximum(quiet, np.max(searched, axis=1) / from_db(self.dynamic_range_db))
        gap = int(self.merge_gap_m / self.analyser.bin_m)
        row, start, stop, peak = detected_spans(searched, threshold, limit, low, high, gap).T
        return EchoSpans(
            power=spectra.power,
            noise=spectra.noise,
            row=row,
            start=start,
            stop=stop,
            peak=peak,
            bin_m=self.analyser.bin_m,
            first_bin=self.analyser.first_bin,
            looks_per_bin=self.speckle_looks * self.analyser.looks_per_cell / self.analyser.zero_padding,
            beam=self.beam,
        )

    @property
    def lobe_cells(self) -> int:
        """Half-length of the window's main lobe, in range cells."""
        return int(np.flatnonzero(self.cfar.correlation**2 > SHARED_NOISE)[-1])

    @property
    def _end_bin(self) -> int:
        """End of the bins that are searched."""
        range_m, chirp = self.analyser.range_m, self.analyser.chirp
        if chirp.sampling != "real":
            return len(range_m)
        # Within half a cell of the highest frequency a real signal's noise is not circular, and the CFAR fails.
        return int(np.searchsorted(range_m, chirp.max_range_m - chirp.range_resolution_m))

    def _select(self, spans: EchoSpans) -> EchoSpans:
        """Keep the echoes selected by the scenario, dropping those far weaker than the strongest of their pulse.

        Where the end of the range axis cuts an echo off the rest has folded, and nothing tells its range. An echo that
        is stronger before the searched cells than in them is the skirt of a nearer one; of I/Q samples those before the
        first cell are the last ones, which may hold its skirt, too.
        """
        sides = [np.maximum(spans.start - 1, 0)]
        if self.analyser.chirp.sampling != "real":
            sides = [spans.start - 1, spans.stop % spans.power.shape[1]]
        beside = np.max([spans.power[spans.row, side] for side in sides], axis=0)
        spans = spans.rows(beside <= spans.power[spans.row, spans.peak])
        peak_power = spans.power[spans.row, spans.peak]
        strongest = np.zeros(len(spans.power))
        np.maximum.at(strongest, spans.row, peak_power)
        keep = peak_power >= strongest[spans.row] / from_db(self.dynamic_range_db)
        if self.kept == "strongest":
            keep &= _first_of_row(spans.row, peak_power == strongest[spans.row])
        elif self.kept == "first":
            keep = _first_of_row(spans.row, keep)
        kept = spans.rows(keep)
        at_end = kept.stop == self._end_bin
        if at_end.any():
            echo = moments(kept.rows(at_end))
            at_end[at_end] = echo.centre + CUT_WIDTHS * echo.width > self._end_bin
        return kept.rows(~at_end)


def check_ranges(ranges: object, echoes: int, estimator: RangeEstimator) -> None:
    """Raise PluginError unless a custom range estimator returned one finite range per echo."""
    if (
        isinstance(ranges, Ranges)
        and np.shape(ranges.range_m) == np.shape(ranges.sigma_m) == (echoes,)
        and np.all(np.isfinite(ranges.range_m))
    ):
        return
    message = f"range estimator {type(estimator).__name__}: return `Ranges` with a finite range for each of the echoes"
    raise PluginError(message)


def detected_spans(
    power: Float[np.ndarray, "row bin"],
    threshold: Float[np.ndarray, "row bin"],
    limit: Float[np.ndarray, " row"],
    low: Int[np.ndarray, " row"],
    high: Int[np.ndarray, " row"],
    gap: int,
) -> Int[np.ndarray, "span 4"]:
    """Return row, first bin, end and strongest bin (the nearest of several) of each span with a detected cell.

    A cell above its threshold is detected, one above the limit of its row belongs to a span.
    low, high: first tested bin of each row, and the end of these bins.
    gap: most bins between two cells of one span.
    """
    room = 2 * len(power) + 8
    while True:
        spans = np.empty((room, 4), dtype=np.int64)
        count = find_spans(power, threshold, limit, low, high, gap, spans)
        if count <= room:
            return spans[:count]
        room = count


@compiled
@no_type_check
def find_spans(power, threshold, limit, low, high, gap, spans):
    """Write the spans, as far as there is room, and return how many they are; see `detected_spans`."""
    count = 0
    for row in range(len(power)):
        values, levels, least = power[row], threshold[row], limit[row]
        start, stop, detected = -1, -1, False
        for b in range(low[row], high[row] + 1):
            inside = b < high[row]
            above = inside and values[b] > levels[b]
            if inside and not above and not values[b] > least:
                continue
            if inside and start >= 0 and b - stop <= gap:
                stop, detected = b + 1, detected or above
                continue
            if detected:
                peak = start
                for k in range(start + 1, stop):
                    if values[k] > values[peak]:
                        peak = k
                if count < len(spans):
                    spans[count, 0], spans[count, 1], spans[count, 2], spans[count, 3] = row, start, stop, peak
                count += 1
            start, stop, detected = b, b + 1, above
    return count


def strongest_bins(
    power: Float[np.ndarray, "row bin"],
    row: Int[np.ndarray, " span"],
    start: Int[np.ndarray, " span"],
    stop: Int[np.ndarray, " span"],
) -> Int[np.ndarray, " span"]:
    """Return the strongest bin of each span, the nearest if several are equal."""
    if len(row) == 0:
        return np.zeros(0, dtype=np.int64)
    cell_row, cell_bin, begin = span_cells(row, start, stop)
    value = power[cell_row, cell_bin]
    highest = np.repeat(np.maximum.reduceat(value, begin), stop - start)
    return np.minimum.reduceat(np.where(value == highest, cell_bin, power.shape[1]), begin)


def _first_of_row(row: Int[np.ndarray, " span"], candidate: Bool[np.ndarray, " span"]) -> Bool[np.ndarray, " span"]:
    """Mark the first candidate span of each row."""
    index = np.flatnonzero(candidate)
    _, first = np.unique(row[index], return_index=True)
    mask = np.zeros(len(row), dtype=bool)
    mask[index[first]] = True
    return mask


def number_within(row: Int[np.ndarray, " echo"]) -> Int[np.ndarray, " echo"]:
    """Return 0, 1, ... for the entries of each group of equal values in a sorted column."""
    return np.arange(len(row)) - np.searchsorted(row, row, side="left")


@dataclass(frozen=True, kw_only=True)
class PairedEchoes:
    """Echoes of pairs of sweeps, with ranges free of Doppler shift, and the range rate of each."""

    echoes: Echoes
    range_rate_mps: Float[np.ndarray, " echo"]


def pair_sweeps(up: Echoes, down: Echoes, chirp: Chirp) -> PairedEchoes:
    """Combine the echoes of the rising and the falling halves.

    up, down: at most one echo per pulse, not corrected for Doppler; a pulse without both is dropped.
    chirp: the rising half.
    """
    pulse, up_row, down_row = np.intersect1d(up.pulse, down.pulse, return_indices=True)
    up_m, down_m = up.range_m[up_row], down.range_m[down_row]
    # The halves are one sweep duration apart, and the range changes in between.
    slope = 2 * float(chirp.doppler_range_m(np.ones(1))[0]) - chirp.duration_s
    snr = [10 ** (echoes.echo_snr_db[rows] / 10) for echoes, rows in ((up, up_row), (down, down_row))]
    reach, shared_m = None, None
    if up.reach is not None and down.reach is not None:
        reach = (up.reach[up_row] + down.reach[down_row]) / 2
    if up.shared_sigma_m is not None and down.shared_sigma_m is not None:
        # Each half has learned the volume and the ground by itself.
        shared_m = np.hypot(up.shared_sigma_m[up_row], down.shared_sigma_m[down_row]) / 2
    echoes = Echoes(
        pulse=pulse,
        number=np.zeros(len(pulse), dtype=np.int64),
        range_m=(up_m + down_m) / 2,
        range_sigma_m=np.hypot(up.range_sigma_m[up_row], down.range_sigma_m[down_row]) / 2,
        power=(up.power[up_row] + down.power[down_row]) / 2,
        echo_snr_db=10 * np.log10((snr[0] + snr[1]) / 2),
        reach=reach,
        shared_sigma_m=shared_m,
    )
    return PairedEchoes(echoes=echoes, range_rate_mps=(up_m - down_m) / slope)
