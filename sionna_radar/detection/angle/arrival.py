"""Direction of arrival along each echo from several receivers: points with range, direction and accuracy.

Averaging precedes the direction: a stretch's range and direction are means over its cells and scatterers, weighted
with the same power, and means of points on a plane lie on it. So the means are used unmodified. A mean of unit vectors
is shorter than one by half their variance, that of the beam along the strip of a range cell; and the correlation of
range and direction within a stretch shifts the mean of their product.

The accuracy of an angle of arrival is that of its phase: the Cramer-Rao bound, and speckle. The signals of the
receivers in a range cell are sums over many scatterers, complex Gaussian with the coherence gamma. The phase of the
cross-spectrum averaged over many looks L has the variance of its Cramer-Rao bound (Rodriguez and Martin 1992, "Theory
and design of interferometric synthetic aperture radars"; Seymour and Cumming 1994)

    var(phi) = (1 - gamma^2) / (2 L gamma^2).

Two receivers beside a first have correlated phases; from the second moments of complex Gaussian variables (Goodman
2007, "Speckle Phenomena in Optics", app. A) follows

    cov(phi_i, phi_j) = (Re(c_ij c_00 / (c_i0 c_0j)) - 1) / (2 L).

Over a Gaussian strip, along which the phases grow by a_i and a_j per standard deviation, the ratio is exp(a_i a_j): the
phases of both scatter together, as speckle shifts the mean direction along the strip. This is harmless, because the
point stays on the ground: across the strip, where an error lifts a point off the ground, a_i c_i + a_j c_j vanishes,
and only noise and terms of second order in a remain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int

from sionna_radar.detection.angle.segments import MIN_LOOKS, RangeStrips, Stretches, range_strips
from sionna_radar.detection.detector import Detector, number_within
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.detection.spectrum import SEEN_CELLS
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.decibels import from_db
from sionna_radar.radar.mimo_array import DifferencePattern, MimoArray


def speckle_looks(looks: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the looks of which a mean weighted with the speckled field has its variance on average.

    Given the power P that is heard its variance is that of L looks times the mean of P over P, and the mean of 1 / P
    over L looks of exponential power is L / (L - 1). The noise of a phase counts for the power that is heard as it is.
    """
    return np.maximum(looks, MIN_LOOKS) - 1


def phase_covariance(
    along_rad: Float[np.ndarray, "point receiver"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of the phases of side receivers against the first.

    along_rad: standard deviation of each receiver's phase along the strip.
    snr: power of the echo over that of the noise in each receiver, a ratio.
    looks: independent looks.
    """
    noise = 1 / snr
    speckle = np.exp(along_rad[:, :, None] * along_rad[:, None, :])
    receiver_noise = np.eye(along_rad.shape[1]) * (noise[:, None] * np.exp(along_rad**2))[:, :, None]
    ratio = (speckle + receiver_noise) * (1 + noise)[:, None, None]
    from_noise = (ratio - speckle) / (2 * looks)[:, None, None]
    return from_noise + (speckle - 1) / (2 * speckle_looks(looks))[:, None, None]


def coherence(along_rad: Float[np.ndarray, "..."], snr: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the coherence of two receivers over a strip, with noise in both."""
    return np.exp(-(along_rad**2) / 2) * snr / (1 + snr)


def ratio_covariance(
    ratio: Float[np.ndarray, "point receiver node"],
    weight: Float[np.ndarray, " node"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of measured ratios of difference and sum.

    A ratio is the mean over the strip's scatterers, weighted by a speckled field, and half of that field's variance is
    in phase with the sum.

    ratio, weight: ratios at nodes along the strip, and their shares of its power.
    snr, looks: see `phase_covariance`; the noise of the difference is that of the sum.
    """
    deviation = ratio - np.sum(ratio * weight, axis=2, keepdims=True)
    spread = np.einsum("pin,pjn,n->pij", deviation, deviation, weight)
    noise = np.eye(ratio.shape[1]) * (1 + np.sum(ratio * weight, axis=2) ** 2)[:, :, None] / snr[:, None, None]
    return spread / (2 * speckle_looks(looks))[:, None, None] + noise / (2 * looks)[:, None, None]


# Minimum mean power over the noise; below it the phase is noisier than the bound.
MIN_SNR = 10.0
# Largest deficit of the coherence against that of one surface, in standard deviations.
MIN_COHERENCE_SIGMAS = 3.0
# Largest standard deviation of a usable direction, as a fraction of the beam's spread.
LARGEST_SIGMA = 0.5
# Nodes along a strip (Gauss-Hermite).
NODES = 7


@dataclass(frozen=True, kw_only=True)
class AngleEstimator:
    """Estimator of the direction of the ground within the beam for each stretch of an echo.

    array: its first receiver at the origin, each other one on the axis to the left or up.
    spread: standard deviations of the two-way power over the direction cosines in azimuth and in elevation.
    half_power: direction cosines of the half-power beam's edge in azimuth and in elevation; no points lie beyond.
    length_m: slant range per point; None to match the resolution set by the beam's width.
    """

    detector: Detector
    array: MimoArray
    spread: tuple[float, float]
    half_power: tuple[float, float]
    length_m: float | None = None

    @property
    def axes(self) -> tuple[int, ...]:
        """Axes of the receivers after the first: 0 to the left, 1 up."""
        if self.array.difference:
            return tuple(pattern.axis - 1 for pattern in self.array.difference)
        return tuple(int(axis) for axis in np.argmax(np.abs(self.array.receiver_m[1:, 1:]), axis=1))

    def find(
        self,
        beats: Sequence[Inexact[np.ndarray, "pulse sample"]],
        pulse: Int[np.ndarray, " pulse"],
        measured: Pose,
        window_m: Float[np.ndarray, "pulse 2"] | None = None,
    ) -> Echoes:
        """Return the points along the echoes of a block, not corrected for Doppler.

        beats: beat signals of the first receiver and of those beside it.
        pulse, measured: indices of the pulses in the survey, and their measured poses, for the tilt of the ground in
            the beam.
        window_m: nearest and farthest range searched in each pulse; None for all ranges.
        """
        spans = self.detector.spans(self.detector.spectra(beats[0]), window_m)
        signals = [self.detector.analyser.amplitude(beat) for beat in beats]
        strips = range_strips(measured, self.spread)
        shift_m = self.detector.shift_m(measured)
        edge_bins = self.detector.analyser.edge_cells * self.detector.analyser.zero_padding**2
        stretches = Stretches.of(spans, strips, signals[0], self._length_m(spans, strips), shift_m, edge_bins)
        stretches, directions = self._directions(stretches, signals)
        usable = directions.usable & self._strong(stretches)
        leaked_m = self._leaked_m(stretches, np.where(usable[:, None], directions.cosines, 0.0))
        return Echoes(
            pulse=pulse[stretches.row[usable]],
            number=number_within(stretches.row[usable]),
            range_m=(stretches.range_m + leaked_m)[usable],
            range_sigma_m=stretches.range_sigma_m[usable],
            power=stretches.peak_power[usable],
            echo_snr_db=10 * np.log10(stretches.peak_power[usable] / stretches.noise[usable]),
            direction=self._mean_direction(stretches, directions.cosines)[usable],
            across_sigma_rad=directions.sigma_rad[usable],
        )

    def _leaked_m(self, stretches: Stretches, cosines: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, " point"]:
        """Return the mean range of the scatterers in stretches, less that of the cells that hear them, m.

        A cell hears the ranges about its own by the window's response. On a flank of the beam it hears more of the
        ranges that are nearer to the beam's middle.
        """
        analyser, climb = self.detector.analyser, stretches.strips.climb
        half = SEEN_CELLS * analyser.zero_padding
        offset_m, heard = np.arange(-half, half + 1) * analyser.bin_m, analyser.response(half, analyser.zero_padding)
        from_middle = np.sum(cosines * climb, axis=1)[:, None] + stretches.climb_per_m[:, None] * offset_m
        weight = heard * np.exp(-(from_middle**2) / (2 * np.sum((climb * self.spread) ** 2, axis=1)[:, None]))
        return np.sum(weight * offset_m, axis=1) / weight.sum(axis=1)

    def _length_m(self, spans: EchoSpans, strips: RangeStrips) -> Float[np.ndarray, " echo"]:
        """Return the slant range of a point of each echo."""
        if self.length_m is not None:
            return np.full(len(spans.row), self.length_m)
        middle_m = (spans.first_bin + (spans.start + spans.stop) / 2) * spans.bin_m
        return strips.rows(spans.row).length_m(middle_m)

    def _strong(self, stretches: Stretches) -> Bool[np.ndarray, " point"]:
        """Mark the stretches within the dynamic range of their pulse's strongest; weaker ones may be its skirts."""
        strongest = np.zeros(int(stretches.row.max(initial=0)) + 1)
        np.maximum.at(strongest, stretches.row, stretches.peak_power)
        limit = from_db(self.detector.dynamic_range_db)
        return stretches.peak_power * limit >= strongest[stretches.row]

    def _directions(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> tuple[Stretches, "Directions"]:
        """Return stretches, and the direction of each with its accuracy."""
        if self.array.difference:
            return stretches, self._by_ratio(stretches, signals)
        return stretches, self._by_phase(stretches, signals)

    def _cross(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]], one: int, other: int
    ) -> tuple[Complex[np.ndarray, " point"], Float[np.ndarray, " point"]]:
        """Return the cross-spectrum of two receivers, and its coherence, see `Stretches.cross`.

        Wavefronts are spheres: the way back is b^2 (1 - u^2) / 2r longer than -b u (Fresnel's approximation). Without
        that bend, a phase that falls with the range, directions are those from the first receiver, the origin of
        ranges, and otherwise from the middle of both.
        """
        phases = self.array.phase_per_cosine
        ramp = (stretches.strips.climb @ (phases[one] - phases[other])) * stretches.climb_per_m
        bend = -phases.sum(axis=1) * np.linalg.norm(self.array.receiver_m, axis=1) / 2
        return stretches.cross(signals[one], signals[other], ramp, bend[one] - bend[other])

    def _by_phase(self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "Directions":
        strips = stretches.strips
        coherent = np.ones(len(stretches.row), dtype=bool)
        for number, axis in enumerate(self.axes, start=1):
            _, level = self._cross(stretches, signals, number, 0)
            turn = self._turn(number)
            along = np.abs(turn * strips.strip[:, axis]) * strips.along
            ramp = turn * strips.climb[:, axis] * stretches.climb_per_m
            # On tilted ground the ramp may vanish or double.
            phase_sigma_rad = np.hypot(along, ramp * np.sqrt(stretches.range_variance_m2))
            expected = coherence(phase_sigma_rad, stretches.snr)
            scatter = (1 - expected**2) / np.sqrt(2 * stretches.looks)
            coherent &= level >= expected - MIN_COHERENCE_SIGMAS * scatter
        cosine, covariance = self._mean_cosines(stretches, signals, range(1, len(signals)))
        return self._placed(stretches, cosine, covariance, coherent)

    def _turn(self, number: int) -> float:
        """Return the phase of a receiver per direction cosine on its axis."""
        return float(self.array.phase_per_cosine[number].sum())

    def _mean_cosines(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]], numbers: Sequence[int]
    ) -> tuple[Float[np.ndarray, "receiver point"], Float[np.ndarray, "point receiver receiver"]]:
        """Return mean direction cosines by the phases of some receivers against the first, and their covariance."""
        turn, axes = np.array([self._turn(number) for number in numbers]), [self.axes[number - 1] for number in numbers]
        cross = np.stack([self._cross(stretches, signals, number, 0)[0] for number in numbers])
        along_rad = turn * stretches.strips.strip[:, axes] * stretches.strips.along[:, None]
        covariance = phase_covariance(along_rad, stretches.snr, stretches.looks) / np.outer(turn, turn)
        return np.angle(cross) / turn[:, None], covariance

    def _by_ratio(self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "Directions":
        strips = stretches.strips
        place, weight = np.polynomial.hermite_e.hermegauss(NODES)
        weight = weight / weight.sum()
        outer, cosine, ratio, slope = [], [], [], []
        for pattern, signal in zip(self.array.difference, signals[1:], strict=True):
            cross, _ = stretches.cross(signal, signals[0], np.zeros(len(stretches.row)))
            measured = cross.real / np.maximum(stretches.power - stretches.noise_power, stretches.noise)
            along_sigma = strips.strip[:, pattern.axis - 1] * strips.along
            radial_sigma = (
                strips.climb[:, pattern.axis - 1] * stretches.climb_per_m * np.sqrt(stretches.range_variance_m2)
            )
            outer.append(pattern.cosine_of(measured))
            spread = np.hypot(along_sigma, radial_sigma)[:, None] * place
            cosine.append(_mean_cosine(pattern, outer[-1], spread, weight))
            # The scatter is that of the ratio where it was measured.
            ratio.append(pattern.at(outer[-1][:, None] + along_sigma[:, None] * place))
            slope.append(pattern.slope)
        covariance = ratio_covariance(np.stack(ratio, axis=1), weight, stretches.snr, stretches.looks)
        # The ratio tells little of directions that seem to lie beyond the beam.
        inside = self._in_beam(self._left_and_up(stretches.strips, np.stack(outer)))
        return self._placed(stretches, np.stack(cosine), covariance / np.outer(slope, slope), inside)

    def _placed(
        self,
        stretches: Stretches,
        cosine: Float[np.ndarray, "receiver point"],
        covariance: Float[np.ndarray, "point receiver receiver"],
        coherent: Bool[np.ndarray, " point"],
    ) -> "Directions":
        """Return directions left and up of the boresight, and the mask of usable ones."""
        strips, up = stretches.strips, self._left_and_up(stretches.strips, cosine)
        across = strips.climb if len(set(self.axes)) == 2 else 1 / self._mean_along_axis(strips)[:, None]
        sigma = np.hypot(
            np.sqrt(np.einsum("pi,pij,pj->p", across, covariance, across)),
            strips.bent_rad / np.sqrt(2 * speckle_looks(stretches.looks)),
        )
        beam = np.sqrt(np.sum(strips.climb**2 * np.array(self.spread) ** 2, axis=1))
        accurate = (stretches.snr >= MIN_SNR) & (sigma <= LARGEST_SIGMA * beam)
        return Directions(cosines=up, sigma_rad=sigma, usable=self._in_beam(up) & accurate & coherent)

    def _left_and_up(
        self, strips: RangeStrips, cosine: Float[np.ndarray, "receiver point"]
    ) -> Float[np.ndarray, "point 2"]:
        """Return direction cosines left and up from those along the receivers' axes.

        One receiver beside the first measures its own axis only; along the other a strip has its beam-weighted mean.
        """
        if len(set(self.axes)) == 2:
            return cosine.T
        return strips.mean * (cosine[0] / self._mean_along_axis(strips))[:, None]

    def _mean_along_axis(self, strips: RangeStrips) -> Float[np.ndarray, " point"]:
        mean = strips.mean[:, self.axes[0]]
        return np.where(np.abs(mean) > 1e-9, mean, 1e-9)

    def _in_beam(self, up: Float[np.ndarray, "point 2"]) -> Bool[np.ndarray, " point"]:
        return np.sum((up / np.array(self.half_power)) ** 2, axis=1) <= 1

    @staticmethod
    def _mean_direction(stretches: Stretches, cosines: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 3"]:
        """Return mean directions, not normalised; see the module."""
        strips = stretches.strips
        ahead = np.sqrt(np.maximum(1 - np.sum(cosines**2, axis=1), 0.0))
        radial_variance = stretches.range_variance_m2 * stretches.climb_per_m**2
        strip_variance = strips.along**2 * (1 - 1 / (2 * stretches.looks))
        covariance = stretches.range_variance_m2 * stretches.climb_per_m / stretches.range_m
        return np.column_stack(
            [ahead - (strip_variance + radial_variance) / 2, cosines + covariance[:, None] * strips.climb]
        )


def _mean_cosine(
    pattern: DifferencePattern,
    outer: Float[np.ndarray, " point"],
    spread: Float[np.ndarray, "point node"],
    weight: Float[np.ndarray, " node"],
) -> Float[np.ndarray, " point"]:
    """Return the mean direction cosine of scatterers whose mean ratio is that of the direction cosine `outer`.

    The ratio bends upward away from the boresight, so that its mean is that of a direction farther out.

    spread: of the scatterers' cosines about their mean, at nodes of the weights.
    """
    cosine = outer
    # What is left of the second order in the spread is of the fourth after one step, of the sixth after another.
    for _ in range(2):
        cosine = outer - (pattern.cosine_of(pattern.at(cosine[:, None] + spread) @ weight) - cosine)
    return cosine


@dataclass(frozen=True, kw_only=True)
class Directions:
    """Direction cosines left and up of stretches, their standard deviation along `climb`, and the usable ones."""

    cosines: Float[np.ndarray, "point 2"]
    sigma_rad: Float[np.ndarray, " point"]
    usable: Bool[np.ndarray, " point"]
