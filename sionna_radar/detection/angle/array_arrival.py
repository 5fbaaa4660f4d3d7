"""Points from a MIMO frame: range and range rate of each cell, and directions of arrival from its channels.

Stationary ground of range rate v lies on the cone u.m = -v / |m| about the measured motion m of the radar. On it one
angle is left, phi about the motion, which the channels tell: the spectrum |a(phi)^H x|^2 of a cell's channels x is that
of beams across the track, each with the phases that its own direction and range rate give to the chirps of a block, so
that the motion between transmitters is compensated exactly, at the range rate interpolated between the cells: half a
cell of N blocks is a phase of pi / N from one block to the next, which transmitters in turn would take for an angle.
Range rates beyond half of the blocks' rate fold into the
same cell; all cones that the antenna sees are compared, and the phases of the codes tell them apart.

A cell holds up to two sources, as the cone meets level ground left and right of the track. The second is sought in
what the first leaves, and both are refined in turns, each where the part of its vector outside of the other's explains
most: maximum likelihood for sources of unknown amplitudes in white noise, by alternating projection (Ziskind and Wax
1988, "Maximum likelihood localization of multiple sources by alternating projection", IEEE Trans. ASSP 36).

Where another direction explains a cell nearly as well (a side lobe, or a cone of another fold), the source is left out:
the difference of both powers over the noise is the logarithm of the likelihoods' ratio, and must reach that of a false
alarm.

The variance of phi is its Cramer-Rao bound for unknown amplitudes (Stoica and Nehorai 1989, see `row`): w / (2 |s|^2 h)
with the noise w of a channel and h the squared length of a's derivative outside of the space of all sources. Speckle
adds to it: a cell's scatterers spread in range and range rate with the standard deviation of the windows' response, and
given the power P of their sum the place of its phase centre scatters by that over sqrt(2 P / <P>), as for a complex
Gaussian sum whose first moment has an independent part (Goodman 2007, "Speckle Phenomena in Optics", app. A). The
phase centre lies on the ground; the cell's centre, where the point is placed, does not.

A source is detected where the spectrum exceeds a multiple of the noise. In noise the spectrum at a direction is
exponential, and that of G scanned directions exceeds w ln(G / p) somewhere with a probability of at most p (Boole's
inequality), which is the rate of false alarms of a cell. Directions are scanned only in cells whose power, summed over
the channels and so gamma distributed, belongs to the strongest few of a hundred cells of noise. Ground fills whole
regions of a map, and a ring of cells beside the tested one holds more of it; so the noise is estimated from an order
statistic of the whole map, its lowest tenth. Echoes can only raise that, and lower the rate of false alarms.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Inexact, Int
from scipy.ndimage import maximum_filter, uniform_filter
from scipy.special import gammainccinv, gammaincinv

from sionna_radar.detection.angle.cone_scan import Cells, Cones, ConeScan
from sionna_radar.detection.angle.frame_map import FrameMap
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.windows import unit_window
from sionna_radar.radar.mimo_array import MimoArray

# Quantile of the powers of a map from which its noise is estimated.
NOISE_QUANTILE = 0.1
# Fraction of noise-only cells in which directions are scanned.
SCANNED = 0.03
# Passes over both sources.
REFINEMENTS = 3
# Cells over which the mean power about one is taken, each way.
MEAN_CELLS = 5
# Sources weaker than the strongest across the track by more than this, within this number of beams, are rejected: one
# look of speckle falls by 10 dB below its mean in one cell of ten.
CLUTTER_DYNAMIC_RANGE_DB, CLUTTER_BEAMS = 12.0, 3


@dataclass(frozen=True, kw_only=True)
class Sources(Columns):
    """Sources in cells of a map.

    rate, cell: of the map; fold: how many times the range rate is folded.
    range_m: interpolated between the cells, not corrected for Doppler.
    direction: in the antenna's frame. power: of its amplitude.
    phi_sigma_rad: standard deviation of the angle about the motion.
    """

    rate: Int[np.ndarray, " source"]
    cell: Int[np.ndarray, " source"]
    fold: Int[np.ndarray, " source"]
    range_m: Float[np.ndarray, " source"]
    direction: Float[np.ndarray, "source 3"]
    power: Float[np.ndarray, " source"]
    phi_sigma_rad: Float[np.ndarray, " source"]


@dataclass(frozen=True, kw_only=True)
class ArrayEstimator:
    """Finds points in the frames of an array.

    analyser: of the range, one bin a cell. array: its calibrated model.
    rate_window: over the blocks. min_range_m: nothing nearer is detected.
    false_alarm_probability: of a source in a cell. dynamic_range_db: weaker sources beside another are left out.
    half_view_rad: directions farther from boresight are left out.
    strongest: whether sources far weaker than others in nearly their direction are left out, as rain in front of ground
        is: the power of what fills a beam falls with the square of the range, whatever it is.
    average_cells: cells of range rate and of range that are averaged to a point.
    max_sigma_m: points of a larger standard deviation are left out.
    """

    analyser: SpectrumAnalyser
    array: MimoArray
    rate_window: str
    min_range_m: float
    false_alarm_probability: float
    dynamic_range_db: float
    half_view_rad: float
    average_cells: tuple[int, int]
    max_sigma_m: float
    strongest: bool = False

    def map(self, beats: Inexact[np.ndarray, "chirp rx sample"]) -> FrameMap:
        """Return the channels of a frame over range rate and range, with the noise."""
        array, (_, receivers, samples) = self.array, beats.shape
        spectrum = self.analyser.amplitude(beats.reshape(-1, samples))
        shaped = spectrum.reshape(array.blocks, len(array.code) * receivers, -1)
        row = np.arange(array.blocks) - array.blocks // 2
        # Phases count from the middle of the frame.
        turn = np.exp(2j * np.pi * row * (array.blocks - 1) / 2 / array.blocks)
        weighted = shaped * self.rate_weights[:, None, None]
        channel = np.fft.fftshift(np.fft.fft(weighted, axis=0), axes=0) * turn[:, None, None]
        channel = np.ascontiguousarray(channel.transpose(0, 2, 1))
        frame = FrameMap(
            channel=channel,
            noise=np.inf,
            rate_mps=array.direction * row * array.rate_cell_mps,
            range_m=self.analyser.range_m,
        )
        return replace(frame, noise=self._noise(frame))

    @cached_property
    def rate_weights(self) -> Float[np.ndarray, " block"]:
        """Weights of the blocks of a frame, with a sum of one."""
        return unit_window(self.rate_window, self.array.blocks)

    def _noise(self, frame: FrameMap) -> float:
        channels = frame.channel.shape[2]
        tested = frame.power[:, frame.range_m >= self.min_range_m]
        return float(np.quantile(tested, NOISE_QUANTILE) * channels / gammaincinv(channels, NOISE_QUANTILE))

    def scanned(self, frame: FrameMap) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"]]:
        """Return the rows and cells of a map in which directions are scanned."""
        channels = frame.channel.shape[2]
        threshold = frame.noise * gammainccinv(channels, max(SCANNED, self.false_alarm_probability)) / channels
        rate, cell = np.nonzero((frame.power > threshold) & (frame.range_m >= self.min_range_m))
        return rate, cell

    def find_all(
        self,
        frames: Inexact[np.ndarray, "pulse chirp rx sample"],
        pulses: Pulses,
        expected: ExpectedGround | None = None,
    ) -> Echoes:
        """Return the points of some frames, see `find`."""
        measured = pulses.measured
        return Echoes.concatenate(
            [
                self.find(frame, int(pulses.index[row]), measured.rows(np.array([row])), expected)
                for row, frame in enumerate(frames)
            ]
        )

    def find(
        self,
        beats: Inexact[np.ndarray, "chirp rx sample"],
        pulse: int,
        measured: Pose,
        expected: ExpectedGround | None = None,
    ) -> Echoes:
        """Return the points of a frame, their ranges not corrected for Doppler.

        beats: of the frame, chirp by chirp.
        pulse, measured: its index, and the pose (one row) in its middle.
        expected: what is known of the ground beforehand; sources elsewhere are left out.
        """
        frame = self.map(beats)
        sources = self.sources(frame, measured)
        if expected is not None:
            place_m = (
                sources.range_m[:, None] * (sources.direction @ measured.R_world_antenna[0].T) + measured.position_m[0]
            )
            sources = sources.rows(expected.holds(place_m, measured.position_m[0]))
        if self.strongest and len(sources):
            sources = sources.rows(self._outstanding(frame, sources))
        return self._points(frame, sources, pulse, measured)

    def _outstanding(self, frame: FrameMap, sources: Sources) -> Bool[np.ndarray, " source"]:
        """Mark sources not far weaker than the strongest in their direction, at equal range."""
        level = sources.power * sources.range_m**2
        beam = np.floor(sources.direction[:, 1] / self._beam).astype(np.int64)
        highest = np.zeros(int(np.ptp(beam)) + 1)
        np.maximum.at(highest, beam - beam.min(), level)
        around = maximum_filter(highest, size=CLUTTER_BEAMS, mode="constant")[beam - beam.min()]
        return level * from_db(CLUTTER_DYNAMIC_RANGE_DB) >= around

    @property
    def _beam(self) -> float:
        """Direction cosine of a beam of the virtual array."""
        return self.array.wavelength_m / max(float(self.array.size_m.max()), self.array.wavelength_m)

    @on_one_thread
    def sources(self, frame: FrameMap, measured: Pose) -> Sources:
        """Return the detected sources of a map."""
        cones = Cones.of(frame, 2 * self.array.highest_rate_mps, measured)
        down = np.nan_to_num(-measured.R_world_antenna[0, 2])
        scan = ConeScan(self.array, cones, self.half_view_rad, down)
        rate, cell = self.scanned(frame)
        beside = frame.between(rate, cell, self.rate_weights, 0)
        cells = Cells(
            rate=rate,
            cell=cell,
            range_m=frame.range_m[cell] + frame.between(rate, cell, self.analyser.window, 1) * self.analyser.bin_m,
            faster_mps=beside * self.array.direction * self.array.rate_cell_mps,
            x=frame.channel[rate, cell],
        )
        level, first, directions = scan.strongest(cells)
        # Over the power of a source: the beams add the channels.
        least = frame.noise * np.log(np.maximum(directions, 1) / self.false_alarm_probability) / self.array.gain
        one = np.flatnonzero(level >= least)
        cells, least = cells.rows(one), least[one]
        first = scan.refined(cells, first.rows(one))
        left = replace(cells, x=cells.x - scan.fitted(cells, first))
        beside, second, _ = scan.strongest(left)
        two = (beside >= least) & (beside * from_db(self.dynamic_range_db) >= level[one])
        single, double = np.flatnonzero(~two), np.flatnonzero(two)
        pairs = first.rows(double), second.rows(double)
        for _ in range(REFINEMENTS):
            pairs = scan.refined(cells.rows(double), pairs[0], pairs[1]), pairs[1]
            pairs = pairs[0], scan.refined(cells.rows(double), pairs[1], pairs[0])
        parts, least_lead = [], frame.noise * -np.log(self.false_alarm_probability) / self.array.gain
        for sources, rows in (((first.rows(single),), single), (pairs, double)):
            candidates = cells.rows(rows)
            amplitude, h = scan.solved(candidates, sources)
            lead = scan.lead(candidates, sources, self.analyser.bin_m)
            for number, where in enumerate(sources):
                kept = np.flatnonzero((lead[:, number] >= least_lead) & np.isfinite(h[:, number]))
                power = np.abs(amplitude[kept, number]) ** 2
                parts.append(
                    Sources(
                        rate=candidates.rate[kept],
                        cell=candidates.cell[kept],
                        fold=cones.fold[where.cone[kept]],
                        range_m=candidates.range_m[kept],
                        direction=cones.at(where.rows(kept), candidates.faster_mps[kept]),
                        power=power,
                        phi_sigma_rad=np.sqrt(frame.noise / (2 * power * h[kept, number])),
                    )
                )
        return Sources.concatenate(parts)

    def _points(self, frame: FrameMap, sources: Sources, pulse: int, measured: Pose) -> Echoes:
        """Return the means of neighbouring sources, as points with standard deviations."""
        range_m = sources.range_m
        mean = uniform_filter(frame.power, MEAN_CELLS, mode=("wrap", "nearest"))[sources.rate, sources.cell]
        speckle = mean / (2 * np.maximum(frame.power[sources.rate, sources.cell], 1e-300))
        range_sigma = self.spread_cells(self.analyser.window) * self.analyser.bin_m * np.sqrt(speckle)
        across = self._across_rad(sources, speckle, measured)
        usable = np.flatnonzero(np.hypot(across * range_m, range_sigma) <= self.max_sigma_m)
        return self._averaged(frame, sources.rows(usable), range_m[usable], range_sigma[usable], across[usable], pulse)

    def _across_rad(
        self, sources: Sources, speckle: Float[np.ndarray, " source"], measured: Pose
    ) -> Float[np.ndarray, " source"]:
        """Return the standard deviation of the angle up across each ray; of the one to the left without a motion."""
        velocity = measured.R_world_antenna[0].T @ measured.velocity_mps[0]
        if np.isnan(velocity).any():
            return sources.phi_sigma_rad
        down, u = -measured.R_world_antenna[0, 2], sources.direction
        speed = max(float(np.linalg.norm(velocity)), 1e-9)
        cosine = u @ velocity / speed
        sine = np.sqrt(np.maximum(1 - cosine**2, 1e-6))
        cone_sigma = self.spread_cells(self.rate_weights) * self.array.rate_cell_mps / speed / sine * np.sqrt(speckle)
        # Unit vectors across the ray: away from the motion on its cone, and around it.
        away = (cosine[:, None] * u - velocity / speed) / sine[:, None]
        around = np.cross(velocity / speed, u) / sine[:, None]
        vertical = down - (u @ down)[:, None] * u
        vertical /= np.maximum(np.linalg.norm(vertical, axis=1), 1e-9)[:, None]
        return np.hypot(
            np.einsum("ni,ni->n", vertical, away) * cone_sigma,
            np.einsum("ni,ni->n", vertical, around) * sine * sources.phi_sigma_rad,
        )

    @staticmethod
    def spread_cells(weights: Float[np.ndarray, " n"]) -> float:
        """Return the standard deviation of a window's power response, in cells: of where a cell's scatterers lie.

        The second moment of a spectrum is the energy of its signal's derivative (Parseval).
        """
        slope = np.gradient(np.append(weights, weights[0]))[:-1] * len(weights)
        return float(np.sqrt(np.sum(slope**2) / np.sum(weights**2)) / (2 * np.pi))

    def _averaged(
        self,
        frame: FrameMap,
        sources: Sources,
        range_m: Float[np.ndarray, " source"],
        range_sigma_m: Float[np.ndarray, " source"],
        across_rad: Float[np.ndarray, " source"],
        pulse: int,
    ) -> Echoes:
        rates, cells = self.average_cells
        key = np.column_stack(
            [
                (sources.rate + sources.fold * len(frame.rate_mps)) // rates,
                sources.cell // cells,
                np.floor(sources.direction[:, 1:] / self._beam),
            ]
        ).astype(np.int64)
        _, group = np.unique(key, axis=0, return_inverse=True)
        group = group.ravel()
        variance = range_sigma_m**2 + (range_m * across_rad) ** 2
        weight = 1 / np.maximum(variance, 1e-12)
        total = np.bincount(group, weight)
        mean = np.column_stack(
            [np.bincount(group, weight * range_m * sources.direction[:, axis]) / total for axis in range(3)]
        )
        length = np.linalg.norm(mean, axis=1)
        count = np.bincount(group)
        shared = self._shared(count)
        strongest = np.zeros(len(total))
        np.maximum.at(strongest, group, sources.power)
        range_2 = np.bincount(group, weight**2 * range_sigma_m**2) / total**2 * shared
        across_2 = np.bincount(group, weight**2 * (range_m * across_rad) ** 2) / total**2 * shared
        order = np.argsort(length, kind="stable")
        return Echoes(
            pulse=np.full(len(order), pulse),
            number=np.arange(len(order)),
            range_m=length[order],
            range_sigma_m=np.sqrt(range_2)[order],
            power=strongest[order],
            echo_snr_db=10 * np.log10(np.maximum(strongest / frame.noise * self.array.gain, 1e-30))[order],
            direction=(mean / length[:, None])[order],
            across_sigma_rad=(np.sqrt(across_2) / length)[order],
        )

    def _shared(self, count: Int[np.ndarray, " group"]) -> Float[np.ndarray, " group"]:
        """Return the rise in variance of means of cells by windows, which correlate neighbours."""
        rates, cells = self.average_cells
        full = rates * cells
        if full == 1:
            return np.ones(len(count))
        raised = 1.0
        for weights, number in ((self.rate_weights, rates), (self.analyser.window, cells)):
            energy = np.abs(np.fft.fft(weights**2)) / np.sum(weights**2)
            lag = np.abs(np.subtract.outer(np.arange(number), np.arange(number)))
            raised *= float(np.sum(energy[lag] ** 2)) / number
        return 1 + (np.minimum(count, full) - 1) / (full - 1) * (raised - 1)
