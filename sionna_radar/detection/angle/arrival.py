"""Points along each echo from several receivers' signals: range and direction of each stretch, and their accuracy.

Averaging comes before the direction: a stretch's range and direction are means over its cells and scatterers, weighted
with the same power, and means of points on a plane lie on it. So the means are kept as they are. A mean of unit vectors
is shorter than one by half their variance, that of the beam along the strip of a range cell; and that range and
direction grow together within a stretch moves the mean of their product.

The accuracy of an angle of arrival is that of its phase: the Cramer-Rao bound, and what speckle leaves. The signals of
the receivers in a range cell are sums over many scatterers, complex Gaussian with the coherence gamma. The phase of the
cross-spectrum averaged over L looks has, where that is not few, the variance of its Cramer-Rao bound (Rodriguez and
Martin 1992, "Theory and design of interferometric synthetic aperture radars"; Seymour and Cumming 1994)

    var(phi) = (1 - gamma^2) / (2 L gamma^2).

Two receivers beside one first have correlated phases; of the second moments of complex Gaussian variables (Goodman
2007, "Speckle Phenomena in Optics", app. A) follows

    cov(phi_i, phi_j) = (Re(c_ij c_00 / (c_i0 c_0j)) - 1) / (2 L).

Over a Gaussian strip, along which the phases grow by a_i and a_j a standard deviation, the ratio is exp(a_i a_j): the
phases of both scatter together, as the mean direction of a speckled strip wanders along it. That does no harm, because
the ground is there: across the strip, where an error lifts a point off the ground, a_i c_i + a_j c_j vanishes, and only
noise and terms of second order in a are left.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int

from sionna_radar.detection.angle.segments import RangeStrips, Stretches, range_strips, wavefront_bend
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimator import EchoSpans
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.numerics import from_db
from sionna_radar.radar.second_receiver import SideReceiver


def phase_covariance(
    along_rad: Float[np.ndarray, "point receiver"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of the phases of side receivers against the first.

    Parameters
    ----------
    along_rad:
        Standard deviation of each receiver's phase along the strip.
    snr:
        Power of the echo over that of the noise in each receiver, a ratio.
    looks:
        Independent looks.

    """
    noise = 1 / snr
    both = np.exp(along_rad[:, :, None] * along_rad[:, None, :])
    own = np.eye(along_rad.shape[1]) * (noise[:, None] * np.exp(along_rad**2))[:, :, None]
    ratio = (both + own) * (1 + noise)[:, None, None]
    return (ratio - 1) / (2 * looks)[:, None, None]


def coherence(along_rad: Float[np.ndarray, "..."], snr: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the coherence of two receivers over a strip, with noise in both."""
    found: Float[np.ndarray, ...] = np.exp(-(along_rad**2) / 2) * snr / (1 + snr)
    return found


def ratio_covariance(
    ratio: Float[np.ndarray, "point receiver node"],
    share: Float[np.ndarray, " node"],
    snr: Float[np.ndarray, " point"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point receiver receiver"]:
    """Return the covariance of measured ratios of difference and sum.

    A ratio is the mean over the strip's scatterers, weighted by a speckled field, and half of that field's variance is
    in phase with the sum.

    Parameters
    ----------
    ratio, share:
        Ratios at places along the strip, and their shares of its power.
    snr, looks:
        See `phase_covariance`; the noise of the difference is that of the sum.

    """
    apart = ratio - np.sum(ratio * share, axis=2, keepdims=True)
    spread = np.einsum("pin,pjn,n->pij", apart, apart, share)
    noise = np.eye(ratio.shape[1]) * (1 + np.sum(ratio * share, axis=2) ** 2)[:, :, None] / snr[:, None, None]
    return (spread + noise) / (2 * looks)[:, None, None]


# Least mean power over the noise; below it the phase has more noise than the bound says.
MIN_SNR = 10.0
# By how many standard deviations the coherence may be below that of one surface.
MIN_COHERENCE_SIGMAS = 3.0
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
        stretches = Stretches.of(spans, strips, signals[0], self._length_m(spans, strips))
        stretches, found = self._directions(stretches, signals)
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

    def _strong(self, stretches: Stretches) -> Bool[np.ndarray, " point"]:
        """Mark the stretches that are not far weaker than the strongest of their pulse, whose skirts they may be."""
        strongest = np.zeros(int(stretches.row.max(initial=0)) + 1)
        np.maximum.at(strongest, stretches.row, stretches.peak_power)
        limit = from_db(self.detector.processing.dynamic_range_db)
        return stretches.peak_power * limit >= strongest[stretches.row]

    def _directions(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> tuple[Stretches, "Directions"]:
        """Return stretches, and the direction of each with how well it is known."""
        if self.receivers[0].difference is None:
            return stretches, self._by_phase(stretches, signals)
        return stretches, self._by_ratio(stretches, signals)

    def _by_phase(self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "Directions":
        strips, chirp = stretches.strips, self.detector.analyser.chirp
        cosine, turn, alike = [], [], np.ones(len(stretches.row), dtype=bool)
        for receiver, signal in zip(self.receivers, signals[1:], strict=True):
            assert receiver.baseline_m is not None
            # The beat's phase is that of the way there and back, on a down-sweep its negative.
            per_cosine = -chirp.direction * 2 * np.pi * receiver.baseline_m / chirp.wavelength_m
            ramp = per_cosine * strips.climb[:, receiver.axis - 1] * stretches.climb_per_m
            bend = wavefront_bend(per_cosine, receiver.baseline_m)
            cross, level = stretches.cross(signal, signals[0], ramp, bend)
            cosine.append(np.angle(cross) / per_cosine)
            along = np.abs(per_cosine * strips.strip[:, receiver.axis - 1]) * strips.along
            # Ground may be tilted: as much as the ramp may be missing or doubled.
            within = np.hypot(along, ramp * np.sqrt(stretches.range_variance_m2))
            expected = coherence(within, stretches.snr)
            scatter = (1 - expected**2) / np.sqrt(2 * stretches.looks)
            alike &= level >= expected - MIN_COHERENCE_SIGMAS * scatter
            turn.append(per_cosine)
        per_receiver = np.array(turn)
        axes = [receiver.axis - 1 for receiver in self.receivers]
        covariance = phase_covariance(
            per_receiver * strips.strip[:, axes] * strips.along[:, None], stretches.snr, stretches.looks
        )
        return self._placed(stretches, np.stack(cosine), covariance / np.outer(per_receiver, per_receiver), alike)

    def _by_ratio(self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]) -> "Directions":
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
        stretches: Stretches,
        cosine: Float[np.ndarray, "receiver point"],
        covariance: Float[np.ndarray, "point receiver receiver"],
        alike: Bool[np.ndarray, " point"],
    ) -> "Directions":
        """Return directions left and up of the boresight, and which of them are usable.

        One receiver beside the first knows its own axis; along the other a strip has its mean where the beam weighs it.
        """
        strips = stretches.strips
        if len({receiver.axis for receiver in self.receivers}) == 2:
            across, up = strips.climb, cosine.T
        else:
            own = self.receivers[0].axis - 1
            along_own = np.where(np.abs(strips.mean[:, own]) > 1e-9, strips.mean[:, own], 1e-9)
            across = 1 / along_own[:, None]
            up = strips.mean * (cosine[0] / along_own)[:, None]
        sigma = np.sqrt(np.einsum("pi,pij,pj->p", across, covariance, across))
        beam = np.sqrt(np.sum(strips.climb**2 * np.array(self.spread) ** 2, axis=1))
        inside = np.sum((up / np.array(self.half_power)) ** 2, axis=1) <= 1
        known = (stretches.snr >= MIN_SNR) & (sigma <= LARGEST_SIGMA * beam)
        return Directions(cosines=up, sigma_rad=sigma, usable=inside & known & alike)

    @staticmethod
    def _mean_direction(stretches: Stretches, cosines: Float[np.ndarray, "point 2"]) -> Float[np.ndarray, "point 3"]:
        """Return mean directions, not normalised; see the module."""
        strips = stretches.strips
        ahead = np.sqrt(np.maximum(1 - np.sum(cosines**2, axis=1), 0.0))
        within = stretches.range_variance_m2 * stretches.climb_per_m**2
        along = strips.along**2 * (1 - 1 / (2 * stretches.looks))
        together = stretches.range_variance_m2 * stretches.climb_per_m / stretches.range_m
        return np.column_stack([ahead - (along + within) / 2, cosines + together[:, None] * strips.climb])


@dataclass(frozen=True, kw_only=True)
class Directions:
    """Direction cosines left and up of stretches, their standard deviation where the range climbs, and their use."""

    cosines: Float[np.ndarray, "point 2"]
    sigma_rad: Float[np.ndarray, " point"]
    usable: Bool[np.ndarray, " point"]


def _number_within(row: Int[np.ndarray, " point"]) -> Int[np.ndarray, " point"]:
    """Return 0, 1, ... for the entries of each group of equal values in a sorted column."""
    return np.arange(len(row)) - np.searchsorted(row, row, side="left")
