"""From the signals of several receivers to points along each echo: a range and a direction for every stretch of it.

Averaging comes before the direction: a stretch's range and direction are means over its cells and scatterers, weighted
with the same power, and means of points on a plane lie on it. So the means are kept as they are. A mean of unit vectors
is shorter than one by half their variance, that of the beam along the strip of a range cell; and that range and
direction grow together within a stretch moves the mean of their product.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int

from sionna_radar.detection.angle.phase_noise import coherence, phase_covariance, ratio_covariance
from sionna_radar.detection.angle.range_strips import RangeStrips, range_strips, stretches_of
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimator import EchoSpans, span_cells
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.decibel import from_db
from sionna_radar.radar.second_receiver import SideReceiver

# A stretch has at least so many independent looks, or is as long as its echo.
FEWEST_LOOKS = 2.0
# Least mean power over the noise; below it the phase has more noise than the bound says.
LEAST_SNR = 10.0
# By how many standard deviations the coherence may be below that of one surface.
LEAST_COHERENCE_SIGMAS = 3.0
# Direction that is known no better than by this share of the beam's own spread is not known.
LARGEST_SIGMA = 0.5
# Places along a strip (Gauss-Hermite).
NODES = 7


@dataclass(frozen=True, kw_only=True)
class AngleEstimator:
    """Finds where in the beam the ground of each stretch of an echo is.

    receivers: beside the first, one or two, each on its own axis.
    spread: standard deviations of the two-way power over the direction cosines in azimuth and in elevation.
    half_power: direction cosines of the half-power beam's edge in azimuth and in elevation; no points lie beyond.
    length_m: slant range that makes one point; None for what leaves the resolution to the beam's width.
    """

    detector: Detector
    receivers: tuple[SideReceiver, ...]
    spread: tuple[float, float]
    half_power: tuple[float, float]
    length_m: float | None = None

    def find(
        self,
        beats: Sequence[Inexact[np.ndarray, "pulse sample"]],
        pulse: Int[np.ndarray, " pulse"],
        measured: Pose,
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Echoes:
        """Return the points along the echoes of a block, not corrected for Doppler.

        Parameters
        ----------
        beats:
            Beat signals of the first receiver and of those beside it.
        pulse, measured:
            Indices of the pulses in the survey, and their measured poses, which tell how the ground lies in the beam.
        window_m:
            Nearest and farthest range searched in each pulse; None for all ranges.

        """
        spans = self.detector.spans(self.detector.spectra(beats[0]), window_m)
        signals = [self.detector.analyser.amplitude(beat) for beat in beats]
        strips = range_strips(measured, self.spread)
        stretches = _Stretches.of(spans, strips, signals[0], self._length_m(spans, strips))
        found = self._directions(stretches, signals)
        kept = found.usable & self._strong(stretches)
        return Echoes(
            pulse=pulse[stretches.row[kept]],
            number=_number_within(stretches.row[kept]),
            range_m=stretches.range_m[kept],
            range_sigma_m=stretches.range_sigma_m[kept],
            power=stretches.peak_power[kept],
            snr_db=10 * np.log10(stretches.peak_power[kept] / stretches.noise[kept]),
            direction=self._mean_direction(stretches, found.cosines)[kept],
            across_sigma_rad=found.sigma_rad[kept],
        )

    def _length_m(self, spans: EchoSpans, strips: RangeStrips) -> Float[np.ndarray, " echo"]:
        """Return the slant range of a point of each echo."""
        if self.length_m is not None:
            return np.full(len(spans.row), self.length_m)
        middle_m = (spans.start + spans.stop) / 2 * spans.bin_m
        return strips.rows(spans.row).length_m(middle_m)

    def _strong(self, stretches: "_Stretches") -> Bool[np.ndarray, " point"]:
        """Mark the stretches that are not far weaker than the strongest of their pulse, whose skirts they may be."""
        strongest = np.zeros(int(stretches.row.max(initial=0)) + 1)
        np.maximum.at(strongest, stretches.row, stretches.peak_power)
        limit = from_db(self.detector.processing.dynamic_range_db)
        return stretches.peak_power * limit >= strongest[stretches.row]

    def _directions(
        self, stretches: "_Stretches", signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> "_Directions":
        """Return the direction of each stretch, and how well it is known."""
        if self.receivers[0].difference is None:
            return self._by_phase(stretches, signals)
        return self._by_ratio(stretches, signals)

    def _by_phase(self, stretches: "_Stretches", signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "_Directions":
        strips, chirp = stretches.strips, self.detector.analyser.chirp
        cosine, turn, alike = [], [], np.ones(len(stretches.row), dtype=bool)
        for receiver, signal in zip(self.receivers, signals[1:], strict=True):
            assert receiver.baseline_m is not None
            # The beat's phase is that of the way there and back, on a down-sweep its negative.
            per_cosine = -chirp.direction * 2 * np.pi * receiver.baseline_m / chirp.wavelength_m
            ramp = per_cosine * strips.climb[:, receiver.axis - 1] * stretches.climb_per_m
            cross, level = stretches.cross(signal, signals[0], ramp)
            cosine.append(np.angle(cross) / per_cosine)
            along = np.abs(per_cosine * strips.strip[:, receiver.axis - 1]) * strips.along
            # Ground may be tilted: as much as the ramp may be missing or doubled.
            within = np.hypot(along, ramp * np.sqrt(stretches.range_variance_m2))
            expected = coherence(within, stretches.snr)
            scatter = (1 - expected**2) / np.sqrt(2 * stretches.looks)
            alike &= level >= expected - LEAST_COHERENCE_SIGMAS * scatter
            turn.append(per_cosine)
        per_receiver = np.array(turn)
        axes = [receiver.axis - 1 for receiver in self.receivers]
        covariance = phase_covariance(
            per_receiver * strips.strip[:, axes] * strips.along[:, None], stretches.snr, stretches.looks
        )
        return self._placed(stretches, np.stack(cosine), covariance / np.outer(per_receiver, per_receiver), alike)

    def _by_ratio(self, stretches: "_Stretches", signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "_Directions":
        strips = stretches.strips
        place, share = np.polynomial.hermite_e.hermegauss(NODES)
        share = share / share.sum()
        cosine, ratio, slope = [], [], []
        for receiver, signal in zip(self.receivers, signals[1:], strict=True):
            assert receiver.difference is not None
            cross, _ = stretches.cross(signal, signals[0], np.zeros(len(stretches.row)))
            measured = cross.real / np.maximum(stretches.power - stretches.noise_power, stretches.noise)
            cosine.append(receiver.difference.cosine_of(measured))
            along = (strips.strip[:, receiver.axis - 1] * strips.along)[:, None] * place
            ratio.append(receiver.difference.at(cosine[-1][:, None] + along))
            slope.append(receiver.difference.slope)
        covariance = ratio_covariance(np.stack(ratio, axis=1), share, stretches.snr, stretches.looks)
        everywhere = np.ones(len(stretches.row), dtype=bool)
        return self._placed(stretches, np.stack(cosine), covariance / np.outer(slope, slope), everywhere)

    def _placed(
        self,
        stretches: "_Stretches",
        cosine: Float[np.ndarray, "receiver point"],
        covariance: Float[np.ndarray, "point receiver receiver"],
        alike: Bool[np.ndarray, " point"],
    ) -> "_Directions":
        """Return directions left and up of the boresight, and which of them are usable.

        One receiver beside the first knows its own axis; along the other a strip has its mean where the beam weighs it.
        """
        strips = stretches.strips
        if len(self.receivers) == 2:
            across, up = strips.climb, cosine.T
        else:
            own = self.receivers[0].axis - 1
            along_own = np.where(np.abs(strips.mean[:, own]) > 1e-9, strips.mean[:, own], 1e-9)
            across = 1 / along_own[:, None]
            up = strips.mean * (cosine[0] / along_own)[:, None]
        sigma = np.sqrt(np.einsum("pi,pij,pj->p", across, covariance, across))
        beam = np.sqrt(np.sum(strips.climb**2 * np.array(self.spread) ** 2, axis=1))
        inside = np.sum((up / np.array(self.half_power)) ** 2, axis=1) <= 1
        known = (stretches.snr >= LEAST_SNR) & (sigma <= LARGEST_SIGMA * beam)
        return _Directions(cosines=up, sigma_rad=sigma, usable=inside & known & alike)

    @staticmethod
    def _mean_direction(stretches: "_Stretches", cosines: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 3"]:
        """Return mean directions, not normalised; see the module."""
        strips = stretches.strips
        ahead = np.sqrt(np.maximum(1 - np.sum(cosines**2, axis=1), 0.0))
        within = stretches.range_variance_m2 * stretches.climb_per_m**2
        along = strips.along**2 * (1 - 1 / (2 * stretches.looks))
        together = stretches.range_variance_m2 * stretches.climb_per_m / stretches.range_m
        return np.column_stack([ahead - (along + within) / 2, cosines + together[:, None] * strips.climb])


@dataclass(frozen=True, kw_only=True)
class _Directions:
    """Direction cosines left and up of stretches, their standard deviation where the range climbs, and their use."""

    cosines: Float[np.ndarray, "point 2"]
    sigma_rad: Float[np.ndarray, " point"]
    usable: Bool[np.ndarray, " point"]


@dataclass(frozen=True, kw_only=True)
class _Stretches:
    """Stretches of echoes, and sums over their cells.

    row: pulse of the block; strips: how range cells lie across its beam.
    cell_row, cell_bin, begin: the cells, and where each stretch begins among them.
    power, peak_power: of the first receiver, summed and at most; noise: mean power of the noise in a cell.
    range_m, range_variance_m2: mean and variance of the cells' ranges, weighted with their power.
    """

    row: Int[np.ndarray, " point"]
    strips: RangeStrips
    cell_row: Int[np.ndarray, " cell"]
    cell_bin: Int[np.ndarray, " cell"]
    begin: Int[np.ndarray, " point"]
    power: Float[np.ndarray, " point"]
    peak_power: Float[np.ndarray, " point"]
    noise: Float[np.ndarray, " point"]
    range_m: Float[np.ndarray, " point"]
    range_variance_m2: Float[np.ndarray, " point"]
    bin_m: float
    looks_per_bin: float

    @staticmethod
    def of(
        spans: EchoSpans,
        strips: RangeStrips,
        signal: Complex[np.ndarray, "pulse bin"],
        length_m: Float[np.ndarray, " echo"],
    ) -> "_Stretches":
        """Divide echoes into stretches of about some lengths."""
        cell_row, cell_bin, start = span_cells(spans.row, spans.start, spans.stop)
        bins = np.maximum(length_m / spans.bin_m, FEWEST_LOOKS / spans.looks_per_bin)
        echo, first = stretches_of(spans.stop - spans.start, bins)
        begin = start[echo] + first
        value = signal[cell_row, cell_bin]
        power, range_m = value.real**2 + value.imag**2, cell_bin * spans.bin_m
        total = _sums(power, begin)
        mean_m = _sums(power * range_m, begin) / total
        length = np.diff(begin, append=len(cell_row))
        apart = range_m - np.repeat(mean_m, length)
        row = spans.row[echo]
        return _Stretches(
            row=row,
            strips=strips.rows(row),
            cell_row=cell_row,
            cell_bin=cell_bin,
            begin=begin,
            power=total,
            peak_power=np.maximum.reduceat(power, begin) if len(begin) else total,
            noise=_receiver_noise(spans.noise)[row],
            range_m=mean_m,
            range_variance_m2=_sums(power * apart**2, begin) / total,
            bin_m=spans.bin_m,
            looks_per_bin=spans.looks_per_bin,
        )

    @property
    def length(self) -> Int[np.ndarray, " point"]:
        """Bins of each."""
        return np.diff(self.begin, append=len(self.cell_row))

    @property
    def looks(self) -> Float[np.ndarray, " point"]:
        """Independent looks of each."""
        return np.maximum(1.0, self.length * self.looks_per_bin)

    @property
    def noise_power(self) -> Float[np.ndarray, " point"]:
        """Power of the noise, summed over the bins of each."""
        return self.noise * self.length

    @property
    def snr(self) -> Float[np.ndarray, " point"]:
        """Mean power of the echo over the noise."""
        return np.maximum(self.power / self.noise_power - 1, 1e-6)

    @property
    def climb_per_m(self) -> Float[np.ndarray, " point"]:
        """How much the direction climbs from range to range over level ground, rad/m."""
        return 1 / (self.range_m * np.tan(self.strips.incidence_rad))

    @property
    def range_sigma_m(self) -> Float[np.ndarray, " point"]:
        """Standard deviation of the mean of ranges spread evenly over a bin in each look."""
        return self.bin_m / np.sqrt(12 * self.looks)

    def cross(
        self,
        signal: Complex[np.ndarray, "pulse bin"],
        first: Complex[np.ndarray, "pulse bin"],
        ramp_rad_m: Float[np.ndarray, " point"],
    ) -> tuple[Complex[np.ndarray, " point"], Float[np.ndarray, " point"]]:
        """Return the cross-spectrum of each stretch, its phase at the mean range, and its coherence.

        ramp_rad_m: growth of the phase with range that is expected, and taken out.
        """
        one, other = signal[self.cell_row, self.cell_bin], first[self.cell_row, self.cell_bin]
        apart_m = self.cell_bin * self.bin_m - np.repeat(self.range_m, self.length)
        ramp = np.repeat(ramp_rad_m, self.length) * apart_m
        # In real numbers: a product of complex ones may be rounded differently at the end of a block.
        turn, aside = np.cos(ramp), np.sin(ramp)
        real = one.real * other.real + one.imag * other.imag
        imaginary = one.imag * other.real - one.real * other.imag
        cross = _sums(real * turn + imaginary * aside, self.begin) + 1j * _sums(
            imaginary * turn - real * aside, self.begin
        )
        power = _sums(one.real**2 + one.imag**2, self.begin) * self.power
        return cross, np.abs(cross) / np.sqrt(np.maximum(power, np.finfo(float).tiny))


def _receiver_noise(noise: Float[np.ndarray, "pulse bin"]) -> Float[np.ndarray, " pulse"]:
    """Return the noise of each pulse from its estimates around all bins.

    It is white; next to a wide echo the echo raises the estimate, and where no training cells fit it is infinite.
    """
    tested = np.isfinite(noise).all(axis=0)
    if not tested.any():
        return np.full(len(noise), np.inf)
    middle: Float[np.ndarray, " pulse"] = np.median(noise[:, tested], axis=1)
    return middle


def _sums(value: Inexact[np.ndarray, " cell"], begin: Int[np.ndarray, " point"]) -> Inexact[np.ndarray, " point"]:
    """Return the sums over stretches of cells."""
    found: Inexact[np.ndarray, " point"] = np.add.reduceat(value, begin) if len(begin) else value[:0]
    return found


def _number_within(row: Int[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """Return 0, 1, ... for the entries of each group of equal values in a sorted column."""
    return np.arange(len(row)) - np.searchsorted(row, row, side="left")
