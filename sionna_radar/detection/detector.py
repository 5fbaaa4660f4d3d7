"""From a block of beat signals to echoes: spectrum, CFAR, grouping, ranging, Doppler correction."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Inexact, Int

from sionna_radar.detection.cfar import Cfar
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.profiles import Profiles, cut_profiles
from sionna_radar.detection.ranging.beam_profile import BeamProfile, beam_profile
from sionna_radar.detection.ranging.estimator import EchoRuns, RangeEstimator, build_range_estimator, run_cells
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.signal.high_pass import HighPass

# Noise of the cell under test and of the nearest training cell may share this much of their power.
SHARED_NOISE = 0.01
# Half of the window's response that is kept, in range cells; of a tapered window little lies beyond.
RESPONSE_CELLS = 6


@dataclass(frozen=True, kw_only=True)
class Spectra:
    """Power spectra of a block with what the CFAR makes of them.

    noise: estimate of the mean noise power, free of the bias of the CFAR's kind; infinite where no cell is tested.
    """

    power: Float[np.ndarray, "pulse bin"]
    noise: Float[np.ndarray, "pulse bin"]
    threshold: Float[np.ndarray, "pulse bin"]


@dataclass(frozen=True, kw_only=True)
class Found:
    """What a block of pulses brought: its echoes, not corrected for Doppler, and the profiles around them."""

    echoes: Echoes
    profiles: Profiles


@dataclass(frozen=True, kw_only=True)
class Detector:
    """The processing of a scenario for one chirp.

    estimator: finds the ranges of echoes.
    beam: what the antenna makes of a plane, for estimators that fit it; None where it is unknown.
    """

    analyser: SpectrumAnalyser
    cfar: Cfar
    processing: ProcessingTable
    estimator: RangeEstimator
    beam: BeamProfile | None = None

    def spectra(self, beat: Inexact[np.ndarray, "pulse sample"]) -> Spectra:
        """Return spectra, noise estimates and thresholds of beat signals."""
        power = self.analyser.power(beat)
        level, both = self.cfar.noise_level(power)
        factor = np.where(both, self.cfar.both_sides_factor, self.cfar.one_side_factor)
        mean = np.where(both, self.cfar.both_sides_mean, self.cfar.one_side_mean)
        return Spectra(power=power, noise=level / mean, threshold=level * factor)

    def detect(
        self, beat: Inexact[np.ndarray, "pulse sample"], pulse: Int[np.ndarray, " pulse"], measured: Pose
    ) -> Echoes:
        """Return the echoes of a block.

        Parameters
        ----------
        beat:
            Beat signals.
        pulse:
            Running numbers of the pulses.
        measured:
            Poses as the navigation system reports them; their velocity corrects for Doppler.

        """
        return self.echoes(self.spectra(beat), pulse, measured)

    def find(
        self,
        beat: Inexact[np.ndarray, "pulse sample"],
        pulse: Int[np.ndarray, " pulse"],
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Found:
        """Return the uncorrected echoes of a block together with the range profiles around them.

        window_m: nearest and farthest range of each pulse that is searched; None for all.
        """
        runs = self._select(self._runs(self.spectra(beat), window_m))
        profiles = cut_profiles(runs, pulse, self.processing.zero_padding)
        return Found(echoes=self._estimated(runs, pulse), profiles=profiles)

    def echoes(self, spectra: Spectra, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return the echoes in spectra that are computed already."""
        return self.correct(self.uncorrected(spectra, pulse), pulse, measured)

    def uncorrected(
        self,
        spectra: Spectra,
        pulse: Int[np.ndarray, " pulse"],
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Echoes:
        """Return the echoes where they lie on the axis of the spectrum, Doppler shift included."""
        return self._estimated(self._select(self._runs(spectra, window_m)), pulse)

    def _estimated(self, runs: EchoRuns, pulse: Int[np.ndarray, " pulse"]) -> Echoes:
        ranges = self.estimator(runs)
        peak_power = runs.power[runs.row, runs.peak]
        noise = runs.noise[runs.row, runs.peak]
        return Echoes(
            pulse=pulse[runs.row],
            number=_number_within(runs.row),
            range_m=ranges.range_m,
            range_sigma_m=ranges.sigma_m,
            power=peak_power,
            snr_db=10 * np.log10(peak_power / np.maximum(noise, np.finfo(float).tiny)),
        )

    def correct(self, echoes: Echoes, pulse: Int[np.ndarray, " pulse"], measured: Pose) -> Echoes:
        """Return echoes of some pulses, sorted, with the Doppler shift of still ground taken out of their ranges."""
        if not self.processing.doppler_correction:
            return echoes
        shift = self.analyser.chirp.doppler_range_m(measured.boresight_range_rate_mps)
        return replace(echoes, range_m=echoes.range_m - shift[np.searchsorted(pulse, echoes.pulse)])

    def _runs(self, spectra: Spectra, window_m: Float[np.ndarray, "pulse 2"] | None = None) -> EchoRuns:
        """Return the runs of cells around detected ones, gaps of up to `merge_gap_m` bridged."""
        tested = self.analyser.range_m >= self.processing.min_range_m
        if self.analyser.chirp.sampling == "real":
            # Within half a cell of the highest frequency a real signal's noise is not circular, and the CFAR fails.
            tested &= self.analyser.range_m < self.analyser.chirp.max_range_m - self.analyser.chirp.range_resolution_m
        if window_m is not None:
            range_m = self.analyser.range_m
            tested = tested & (range_m >= window_m[:, :1]) & (range_m <= window_m[:, 1:])
            # What lies elsewhere must not raise the level that an echo's weak cells are measured by.
            spectra = replace(spectra, power=np.where(tested, spectra.power, 0.0))
        detected = (spectra.power > spectra.threshold) & tested
        row, start, stop = _true_runs((detected | self._raised(spectra)) & tested)
        gap = int(self.processing.merge_gap_m / self.analyser.bin_m)
        follows = np.zeros(len(row), dtype=bool)
        follows[1:] = (row[1:] == row[:-1]) & (start[1:] - stop[:-1] <= gap)
        first = np.flatnonzero(~follows)
        last = np.append(first[1:], len(row)) - 1
        row, start, stop = row[first], start[first], stop[last] if len(row) else stop
        before = np.concatenate([np.zeros((len(detected), 1), dtype=np.int64), np.cumsum(detected, axis=1)], axis=1)
        found = before[row, stop] > before[row, start]
        row, start, stop = row[found], start[found], stop[found]
        return EchoRuns(
            power=spectra.power,
            noise=spectra.noise,
            row=row,
            start=start,
            stop=stop,
            peak=strongest_bins(spectra.power, row, start, stop),
            bin_m=self.analyser.bin_m,
            looks_per_bin=self.analyser.looks_per_cell / self.analyser.zero_padding,
            beam=self.beam,
        )

    def _raised(self, spectra: Spectra) -> Bool[np.ndarray, "pulse bin"]:
        """Mark the cells that belong to an echo once one of its cells is detected.

        An echo wider than the training window masks itself: its own power raises the threshold, and the CFAR
        leaves a few cells of it. So cells count that stand out of the quietest training window of the pulse
        and are not far weaker than its strongest cell.
        """
        factor = self.cfar.both_sides_factor * self.cfar.both_sides_mean
        quiet = np.min(spectra.noise, axis=1, keepdims=True) * factor
        strongest = np.max(spectra.power, axis=1, keepdims=True) / from_db(self.processing.dynamic_range_db)
        return spectra.power > np.maximum(quiet, strongest)

    def _select(self, runs: EchoRuns) -> EchoRuns:
        """Keep the echoes that the scenario asks for, none far weaker than the strongest of its pulse."""
        peak_power = runs.power[runs.row, runs.peak]
        strongest = np.zeros(len(runs.power))
        np.maximum.at(strongest, runs.row, peak_power)
        keep = peak_power >= strongest[runs.row] / from_db(self.processing.dynamic_range_db)
        if self.processing.echoes == "strongest":
            keep &= _first_of_row(runs.row, peak_power == strongest[runs.row])
        elif self.processing.echoes == "first":
            keep = _first_of_row(runs.row, keep)
        return runs.rows(keep)


def build_detector(
    processing: ProcessingTable,
    chirp: Chirp,
    antenna: Antenna | None = None,
    high_pass: HighPass | None = None,
    estimator: RangeEstimator | None = None,
) -> Detector:
    """Return the processing of a scenario.

    Parameters
    ----------
    processing, chirp:
        The processing and the sweep it is for.
    antenna:
        The antenna, for estimators that know the beam.
    high_pass:
        Of the receiver, which the calibration takes out of the spectra.
    estimator:
        A range estimator in place of the one that `processing` names.

    Raises
    ------
    ScenarioError
        The window spreads the cell under test into the training cells.

    """
    analyser = SpectrumAnalyser(chirp, processing.window, processing.zero_padding, high_pass)
    table = processing.cfar
    correlation = analyser.noise_correlation(table.guard + table.training + 1)
    shared = np.flatnonzero(correlation**2 > SHARED_NOISE)
    if table.guard < shared[-1]:
        message = f"{table.guard} cells; the window {processing.window!r} needs at least {shared[-1]}; raise it"
        raise ScenarioError([Problem("processing.cfar.guard", message)])
    cfar = Cfar(
        kind=table.kind,
        guard=table.guard,
        training=table.training,
        false_alarm_probability=table.false_alarm_probability,
        rank=table.rank,
        stride=processing.zero_padding,
        correlation=correlation,
    )
    response = analyser.response(RESPONSE_CELLS * processing.zero_padding, processing.zero_padding)
    beam = None if antenna is None else beam_profile(antenna, response)
    return Detector(
        analyser=analyser,
        cfar=cfar,
        processing=processing,
        estimator=estimator or build_range_estimator(processing),
        beam=beam,
    )


def _true_runs(
    mask: Bool[np.ndarray, "row bin"],
) -> tuple[Int[np.ndarray, " run"], Int[np.ndarray, " run"], Int[np.ndarray, " run"]]:
    """Return row, first bin and bin past the end of every run of true cells."""
    edged = np.zeros((mask.shape[0], mask.shape[1] + 2), dtype=np.int8)
    edged[:, 1:-1] = mask
    step = np.diff(edged, axis=1)
    row, start = np.nonzero(step == 1)
    return row, start, np.nonzero(step == -1)[1]


def strongest_bins(
    power: Float[np.ndarray, "row bin"],
    row: Int[np.ndarray, " run"],
    start: Int[np.ndarray, " run"],
    stop: Int[np.ndarray, " run"],
) -> Int[np.ndarray, " run"]:
    """Return the strongest bin of each run, the nearest of equals."""
    if len(row) == 0:
        return np.zeros(0, dtype=np.int64)
    cell_row, cell_bin, begin = run_cells(row, start, stop)
    value = power[cell_row, cell_bin]
    highest = np.repeat(np.maximum.reduceat(value, begin), stop - start)
    return np.minimum.reduceat(np.where(value == highest, cell_bin, power.shape[1]), begin)


def _first_of_row(row: Int[np.ndarray, " run"], wanted: Bool[np.ndarray, " run"]) -> Bool[np.ndarray, " run"]:
    """Mark the first wanted run of each row."""
    index = np.flatnonzero(wanted)
    _, first = np.unique(row[index], return_index=True)
    marked = np.zeros(len(row), dtype=bool)
    marked[index[first]] = True
    return marked


def _number_within(row: Int[np.ndarray, " echo"]) -> Int[np.ndarray, " echo"]:
    """Return 0, 1, ... within equal values of a sorted column."""
    return np.arange(len(row)) - np.searchsorted(row, row, side="left")
