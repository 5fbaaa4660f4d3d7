"""Points in space from a frame of an array: range and range rate of a cell, and directions from its channels.

Stationary ground of range rate v lies on the cone u.m = -v / |m| about the measured motion m of the radar. On it one
angle is left, phi about the motion, which the channels tell: the spectrum |a(phi)^H x|^2 of a cell's channels x is that
of beams across the track, each with the phases that its own direction and range rate give to the chirps of a block, so
that the motion between transmitters is compensated exactly. Range rates beyond half of the blocks' rate fold into the
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

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int
from scipy.ndimage import uniform_filter
from scipy.special import gammainccinv, gammaincinv

from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.numerics import from_db, window
from sionna_radar.radar.mimo_array import MimoArray

# Quantile of a map's powers that tells its noise.
NOISE_QUANTILE = 0.1
# Share of cells of noise in which directions are scanned.
SCANNED = 0.03
# Directions in a spectrum per beam of the virtual array.
STEPS_IN_BEAM = 4
# Steps of a parabola to a source's place, each half as wide.
ASCENTS = 3
# Passes over both sources.
REFINEMENTS = 6
# Least share of a source's vector outside of another's: a quarter of a beam.
LEAST_APART = 0.05
# Cells over which the mean power about one is taken, each way.
MEAN_CELLS = 5
# Error of a steering vector's phases by a range that many cells share, rad.
CURVATURE_RAD = 0.05


@dataclass(frozen=True, kw_only=True)
class FrameMap:
    """The channels of a frame over range rate and range.

    channel: complex amplitudes; a beat of power P in every chirp has that of P.
    noise: power of the noise in a channel of a cell.
    rate_mps: of the rows, folded; range_m: of the cells, not corrected for Doppler.
    """

    channel: Complex[np.ndarray, "rate range channel"]
    noise: float
    rate_mps: Float[np.ndarray, " rate"]
    range_m: Float[np.ndarray, " range"]

    @cached_property
    def power(self) -> Float[np.ndarray, "rate range"]:
        """Mean power of the channels."""
        mean: Float[np.ndarray, "rate range"] = np.mean(np.abs(self.channel) ** 2, axis=2)
        return mean


@dataclass(frozen=True, kw_only=True)
class Sources(Columns):
    """Sources in cells of a map.

    rate, cell: of the map; fold: how many times the range rate is folded.
    direction: in the antenna's frame. power: of its amplitude.
    phi_sigma_rad: standard deviation of the angle about the motion.
    """

    rate: Int[np.ndarray, " source"]
    cell: Int[np.ndarray, " source"]
    fold: Int[np.ndarray, " source"]
    direction: Float[np.ndarray, "source 3"]
    power: Float[np.ndarray, " source"]
    phi_sigma_rad: Float[np.ndarray, " source"]


@dataclass(frozen=True, kw_only=True)
class Cone:
    """Directions of one range rate in the antenna's frame: u = axis + across cos(phi) + up sin(phi)."""

    range_rate_mps: float
    fold: int
    axis: Float[np.ndarray, "3"]
    across: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]

    def at(self, phi_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return unit vectors."""
        return self.axis + np.outer(np.cos(phi_rad), self.across) + np.outer(np.sin(phi_rad), self.up)


@dataclass(frozen=True)
class Angles(Columns):
    """Directions on cones: the angle about the motion, and the number of the cone."""

    phi_rad: Float[np.ndarray, " n"]
    cone: Int[np.ndarray, " n"]


@dataclass(frozen=True, kw_only=True)
class ArrayEstimator:
    """Finds points in the frames of an array.

    analyser: of the range, one bin a cell. array: its calibrated model.
    rate_window: over the blocks. min_range_m: nothing nearer is detected.
    false_alarm_probability: of a source in a cell. dynamic_range_db: weaker sources beside another are left out.
    half_view_rad: directions farther from boresight are left out.
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
        found = FrameMap(
            channel=channel,
            noise=np.inf,
            rate_mps=array.direction * row * array.rate_cell_mps,
            range_m=self.analyser.range_m,
        )
        return replace(found, noise=self._noise(found))

    @cached_property
    def rate_weights(self) -> Float[np.ndarray, " block"]:
        """Weights of the blocks of a frame, with a sum of one."""
        weights = window(self.rate_window, self.array.blocks)
        return weights / weights.sum()

    def _noise(self, found: FrameMap) -> float:
        channels = found.channel.shape[2]
        tested = found.power[:, found.range_m >= self.min_range_m]
        return float(np.quantile(tested, NOISE_QUANTILE) * channels / gammaincinv(channels, NOISE_QUANTILE))

    def scanned(self, found: FrameMap) -> tuple[Int[np.ndarray, " cell"], Int[np.ndarray, " cell"]]:
        """Return the rows and cells of a map in which directions are scanned."""
        channels = found.channel.shape[2]
        threshold = found.noise * gammainccinv(channels, max(SCANNED, self.false_alarm_probability)) / channels
        rate, cell = np.nonzero((found.power > threshold) & (found.range_m >= self.min_range_m))
        return rate, cell

    def find(self, beats: Inexact[np.ndarray, "chirp rx sample"], pulse: int, measured: Pose) -> Echoes:
        """Return the points of a frame, their ranges not corrected for Doppler.

        Parameters
        ----------
        beats:
            Of the frame, chirp by chirp.
        pulse, measured:
            Its index, and the pose (one row) in its middle.

        """
        found = self.map(beats)
        sources = self.sources(found, measured)
        return self._points(found, sources, pulse, measured)

    def sources(self, found: FrameMap, measured: Pose) -> Sources:
        """Return the detected sources of a map."""
        rate, cell = self.scanned(found)
        parts = [_none()]
        for row in np.unique(rate):
            cones = list(self._cones(float(found.rate_mps[row]), measured))
            own = cell[rate == row]
            parts += [
                self._in_row(found, int(row), own[some], cones, _down(measured))
                for some in self._alike(found.range_m[own])
            ]
        return Sources.concatenate(parts)

    def _cones(self, rate_mps: float, measured: Pose) -> Iterator[Cone]:
        """Yield the cones of all range rates that fold into one and lie within view."""
        velocity = measured.R_world_antenna[0].T @ measured.velocity_mps[0]
        speed = float(np.linalg.norm(velocity))
        if speed == 0:
            return
        ahead = velocity / speed
        # Across: as far from the boresight as can be, so that phi = 90 deg is the direction next to it.
        up = np.array([1.0, 0.0, 0.0]) - ahead[0] * ahead
        if np.linalg.norm(up) < 1e-6:
            up = np.array([0.0, 0.0, 1.0]) - ahead[2] * ahead
        up /= np.linalg.norm(up)
        across = np.cross(up, ahead)
        span = 2 * self.array.highest_rate_mps
        most = int(np.ceil(speed / span)) + 1
        for fold in range(-most, most + 1):
            rate = rate_mps + fold * span
            cosine = -rate / speed
            if abs(cosine) >= 1:
                continue
            sine = np.sqrt(1 - cosine**2)
            nearest = cosine * ahead[0] + sine * up[0]
            if nearest >= np.cos(self.half_view_rad):
                yield Cone(range_rate_mps=rate, fold=fold, axis=cosine * ahead, across=sine * across, up=sine * up)

    def _alike(self, range_m: Float[np.ndarray, " cell"]) -> Iterator[Int[np.ndarray, " some"]]:
        """Yield cells whose wavefronts are bent alike."""
        elements = (self.array.transmitter_m, self.array.receiver_m)
        square = max(float(np.sum(e**2, axis=1).max()) for e in elements)
        per_curvature = np.pi * square / self.array.wavelength_m
        number = np.floor(per_curvature / np.maximum(range_m, self.analyser.bin_m) / CURVATURE_RAD)
        for each in np.unique(number):
            yield np.flatnonzero(number == each)

    def _grid(self, cones: list[Cone]) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return the scanned angles about the motion, and the cone of each; each cone's from one edge to the other."""
        size = max(float(self.array.size_m.max()) / self.array.wavelength_m, 1.0)
        step = 1 / (size * STEPS_IN_BEAM)
        phi = np.arange(0.0, np.pi, step)
        angle, number = [], []
        for index, cone in enumerate(cones):
            seen = phi[cone.at(phi)[:, 0] >= np.cos(self.half_view_rad)]
            angle.append(seen)
            number.append(np.full(len(seen), index))
        return np.concatenate(angle), np.concatenate(number)

    def _in_row(
        self,
        found: FrameMap,
        row: int,
        cell: Int[np.ndarray, " cell"],
        cones: list[Cone],
        down: Float[np.ndarray, "3"],
    ) -> Sources:
        if not cones or not len(cell):
            return _none()
        phi, cone = self._grid(cones)
        if len(phi) < 3:
            return _none()
        scan = _Scan(self.array, cones, phi, cone, float(1 / np.mean(1 / found.range_m[cell])), down)
        x = found.channel[row, cell]
        # Over the power of a source: the beams add the channels.
        least = found.noise * np.log(len(phi) / self.false_alarm_probability) / self.array.gain
        first = scan.refined(x, scan.strongest(x))
        level = scan.power(x, first)
        one = level >= least
        if not one.any():
            return _none()
        x, cell, first, level = x[one], cell[one], first.rows(np.flatnonzero(one)), level[one]
        left = x - scan.fitted(x, first)
        second = scan.refined(left, scan.strongest(left))
        beside = scan.power(left, second)
        two = (beside >= least) & (beside * from_db(self.dynamic_range_db) >= level)
        single, double = np.flatnonzero(~two), np.flatnonzero(two)
        both = self._refined(scan, x[double], first.rows(double), second.rows(double))
        parts, least_lead = [], found.noise * -np.log(self.false_alarm_probability) / self.array.gain
        for sources, own in (((first.rows(single),), single), (both, double)):
            amplitude, h = scan.solved(x[own], sources)
            lead = scan.lead(x[own], sources, self.analyser.bin_m)
            for number, where in enumerate(sources):
                kept = np.flatnonzero((lead[:, number] >= least_lead) & np.isfinite(h[:, number]))
                power = np.abs(amplitude[kept, number]) ** 2
                parts.append(self._table(scan, found, row, cell[own[kept]], where.rows(kept), power, h[kept, number]))
        return Sources.concatenate(parts)

    @staticmethod
    def _refined(
        scan: "_Scan", x: Complex[np.ndarray, "n channel"], first: Angles, second: Angles
    ) -> tuple[Angles, Angles]:
        """Return both sources of cells, each sought anew in what the other leaves."""
        for _ in range(REFINEMENTS):
            first = scan.refined(x, first, second)
            second = scan.refined(x, second, first)
        return first, second

    def _table(
        self,
        scan: "_Scan",
        found: FrameMap,
        row: int,
        cell: Int[np.ndarray, " n"],
        where: Angles,
        power: Float[np.ndarray, " n"],
        h: Float[np.ndarray, " n"],
    ) -> Sources:
        return Sources(
            rate=np.full(len(where), row),
            cell=cell,
            fold=np.array([c.fold for c in scan.cones])[where.cone],
            direction=scan.direction(where),
            power=power,
            phi_sigma_rad=np.sqrt(found.noise / (2 * power * h)),
        )

    def _points(self, found: FrameMap, sources: Sources, pulse: int, measured: Pose) -> Echoes:
        """Return the means of neighbouring sources, as points with standard deviations."""
        velocity = measured.R_world_antenna[0].T @ measured.velocity_mps[0]
        down = _down(measured)
        speed = max(float(np.linalg.norm(velocity)), 1e-9)
        u, range_m = sources.direction, found.range_m[sources.cell]
        mean = uniform_filter(found.power, MEAN_CELLS, mode=("wrap", "nearest"))[sources.rate, sources.cell]
        speckle = mean / (2 * np.maximum(found.power[sources.rate, sources.cell], 1e-300))
        range_sigma = self.spread_cells(self.analyser.window) * self.analyser.bin_m * np.sqrt(speckle)
        cosine = u @ velocity / speed
        sine = np.sqrt(np.maximum(1 - cosine**2, 1e-6))
        cone_sigma = self.spread_cells(self.rate_weights) * self.array.rate_cell_mps / speed / sine * np.sqrt(speckle)
        # Unit vectors across the ray: away from the motion on its cone, and around it.
        away = (cosine[:, None] * u - velocity / speed) / sine[:, None]
        around = np.cross(velocity / speed, u) / sine[:, None]
        vertical = down - (u @ down)[:, None] * u
        vertical /= np.maximum(np.linalg.norm(vertical, axis=1), 1e-9)[:, None]
        across = np.hypot(
            np.einsum("ni,ni->n", vertical, away) * cone_sigma,
            np.einsum("ni,ni->n", vertical, around) * sine * sources.phi_sigma_rad,
        )
        usable = np.flatnonzero(np.hypot(across * range_m, range_sigma) <= self.max_sigma_m)
        return self._averaged(found, sources.rows(usable), range_m[usable], range_sigma[usable], across[usable], pulse)

    @staticmethod
    def spread_cells(weights: Float[np.ndarray, " n"]) -> float:
        """Return the standard deviation of a window's power response, in cells: of where a cell's scatterers lie.

        The second moment of a spectrum is the energy of its signal's derivative (Parseval).
        """
        slope = np.gradient(np.append(weights, weights[0]))[:-1] * len(weights)
        return float(np.sqrt(np.sum(slope**2) / np.sum(weights**2)) / (2 * np.pi))

    def _averaged(
        self,
        found: FrameMap,
        sources: Sources,
        range_m: Float[np.ndarray, " source"],
        range_sigma_m: Float[np.ndarray, " source"],
        across_rad: Float[np.ndarray, " source"],
        pulse: int,
    ) -> Echoes:
        rates, cells = self.average_cells
        beam = self.array.wavelength_m / max(float(self.array.size_m.max()), self.array.wavelength_m)
        key = np.column_stack(
            [
                (sources.rate + sources.fold * len(found.rate_mps)) // rates,
                sources.cell // cells,
                np.floor(sources.direction[:, 1:] / beam),
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
            snr_db=10 * np.log10(np.maximum(strongest / found.noise * self.array.gain, 1e-30))[order],
            direction=(mean / length[:, None])[order],
            across_sigma_rad=(np.sqrt(across_2) / length)[order],
        )

    def _shared(self, count: Int[np.ndarray, " group"]) -> Float[np.ndarray, " group"]:
        """Return by how much windows, which correlate neighbouring cells, raise the variance of means of cells."""
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


class _Scan:
    """Steering vectors along the cones of a range rate."""

    def __init__(
        self,
        array: MimoArray,
        cones: list[Cone],
        phi_rad: Float[np.ndarray, " n"],
        cone: Int[np.ndarray, " n"],
        range_m: float,
        down: Float[np.ndarray, "3"],
    ) -> None:
        self.array, self.cones, self.range_m, self._down = array, cones, range_m, down
        self._phi, self._cone = phi_rad, cone
        self._vectors = self.vectors(Angles(phi_rad, cone))
        self._step = float(np.diff(phi_rad[:2])[0])

    def direction(self, where: Angles) -> Float[np.ndarray, "n 3"]:
        """Return unit vectors in the antenna's frame."""
        axis, across, up = (np.array([getattr(c, name) for c in self.cones]) for name in ("axis", "across", "up"))
        phi, cone = where.phi_rad[:, None], where.cone
        return axis[cone] + np.cos(phi) * across[cone] + np.sin(phi) * up[cone]

    def vectors(self, where: Angles) -> Complex[np.ndarray, "n channel"]:
        """Return steering vectors."""
        rate_mps = np.array([c.range_rate_mps for c in self.cones])[where.cone]
        return self.array.steering(self.direction(where), rate_mps, self.range_m)

    def strongest(self, x: Complex[np.ndarray, "cell channel"]) -> Angles:
        """Return the scanned direction where the spectrum of each cell is highest."""
        best = np.argmax(np.abs(x @ self._vectors.conj().T) ** 2, axis=1)
        return Angles(self._phi[best], self._cone[best])

    def refined(self, x: Complex[np.ndarray, "cell channel"], where: Angles, beside: Angles | None = None) -> Angles:
        """Return where near a direction a source explains most of each cell, besides another source or alone."""
        step, phi = self._step, where.phi_rad
        for _ in range(ASCENTS):
            left, centre, right = (
                self._explained(x, Angles(phi + side * step, where.cone), beside) for side in (-1, 0, 1)
            )
            bend = left - 2 * centre + right
            peaked = np.clip((left - right) / np.where(bend < 0, 2 * bend, 1.0), -1.0, 1.0)
            phi = phi + step * np.where(bend < 0, peaked, np.sign(right - left))
            step = step / 2
        return Angles(phi, where.cone)

    def _explained(
        self, x: Complex[np.ndarray, "cell channel"], where: Angles, beside: Angles | None
    ) -> Float[np.ndarray, " cell"]:
        a = self.vectors(where)
        size = np.sum(np.abs(a) ** 2, axis=1)
        if beside is not None:
            other = self.vectors(beside)
            shared = np.einsum("nc,nc->n", other.conj(), a) / np.sum(np.abs(other) ** 2, axis=1)
            a = a - shared[:, None] * other
        left = np.sum(np.abs(a) ** 2, axis=1)
        explained: Float[np.ndarray, " cell"] = np.abs(np.einsum("nc,nc->n", a.conj(), x)) ** 2 / np.maximum(
            left, LEAST_APART * size
        )
        return explained

    def power(self, x: Complex[np.ndarray, "cell channel"], where: Angles) -> Float[np.ndarray, " cell"]:
        """Return the power of a source there, by its spectrum."""
        a = self.vectors(where)
        size = np.sum(np.abs(a) ** 2, axis=1)
        power: Float[np.ndarray, " cell"] = np.abs(np.einsum("nc,nc->n", a.conj(), x)) ** 2 / size**2
        return power

    def lead(
        self, x: Complex[np.ndarray, "cell channel"], sources: tuple[Angles, ...], cell_m: float
    ) -> Float[np.ndarray, "cell source"]:
        """Return by how much the power of sources exceeds that of any direction away from them, or on another cone.

        Away is farther than a beam, and than two range cells of `cell_m` of level ground are long.
        """
        size = np.sum(np.abs(self._vectors[0]) ** 2)
        power = np.abs(x @ self._vectors.conj().T) ** 2 / size**2
        for where in sources:
            near = STEPS_IN_BEAM * self._step + self._long_rad(where, 2 * cell_m)
            close = np.abs(self._phi - where.phi_rad[:, None]) <= near[:, None]
            power[close & (self._cone == where.cone[:, None])] = 0.0
        return np.column_stack([self.power(x, where) for where in sources]) - power.max(axis=1, keepdims=True)

    def _long_rad(self, where: Angles, length_m: float) -> Float[np.ndarray, " cell"]:
        """Return the angle about the motion over which the range to level ground grows by a length."""
        step = 0.01 * self._step
        height, beside = (self.direction(Angles(where.phi_rad + by, where.cone)) @ self._down for by in (0.0, step))
        slope = np.abs(beside - height) / step / np.maximum(height, 1e-3)
        angle: Float[np.ndarray, " cell"] = np.minimum(length_m / self.range_m / np.maximum(slope, 1e-3), np.pi)
        return angle

    def fitted(self, x: Complex[np.ndarray, "cell channel"], where: Angles) -> Complex[np.ndarray, "cell channel"]:
        """Return the part of the channels that one source explains."""
        a = self.vectors(where)
        amplitude = np.einsum("nc,nc->n", a.conj(), x) / np.sum(np.abs(a) ** 2, axis=1)
        part: Complex[np.ndarray, "cell channel"] = amplitude[:, None] * a
        return part

    def solved(
        self, x: Complex[np.ndarray, "cell channel"], sources: tuple[Angles, ...]
    ) -> tuple[Complex[np.ndarray, "cell source"], Float[np.ndarray, "cell source"]]:
        """Return the amplitudes of sources by least squares, and h of each (see the module); NaN for the same place."""
        a = np.stack([self.vectors(where) for where in sources], axis=2)
        step = 0.01 * self._step
        slopes = []
        for where in sources:
            ahead, behind = (self.vectors(Angles(where.phi_rad + side * step, where.cone)) for side in (1, -1))
            slopes.append((ahead - behind) / (2 * step))
        slope = np.stack(slopes, axis=2)
        gram = np.einsum("ncs,nct->nst", a.conj(), a)
        singular = np.abs(np.linalg.det(gram)) < 1e-6 * a.shape[1] ** len(sources)
        gram[singular] = np.eye(len(sources))
        inverse = np.linalg.inv(gram)
        amplitude = np.einsum("nst,nct,nc->ns", inverse, a.conj(), x)
        along = np.einsum("ncs,nct->nst", a.conj(), slope)
        h = np.sum(np.abs(slope) ** 2, axis=1) - np.einsum("nst,nsu,nut->nt", along.conj(), inverse, along).real
        h[singular] = np.nan
        return amplitude, np.maximum(h, 1e-9)


def _down(measured: Pose) -> Float[np.ndarray, "3"]:
    """Return the direction down in the antenna's frame."""
    down: Float[np.ndarray, "3"] = -measured.R_world_antenna[0, 2]
    return down


def _none() -> Sources:
    index, number = np.zeros(0, dtype=np.int64), np.zeros(0)
    return Sources(rate=index, cell=index, fold=index, direction=np.zeros((0, 3)), power=number, phi_sigma_rad=number)
