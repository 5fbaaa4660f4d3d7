"""Points in several directions of one range cell, by a row of receivers: a roof, and the ground in front of it.

In each stretch the covariance of the row's signals is summed over its cells, after the phase that level ground would
add from cell to cell is taken out, and averaged with that of the row turned around. A second surface is looked for
where the second eigenvalue exceeds what noise and one surface leave: noise of power w in N receivers and L looks at
most w (1 + sqrt(N / L))^2 (Marchenko and Pastur 1967), and a surface whose phase from receiver to receiver scatters by
s that of the covariance exp(-s^2 (m - n)^2 / 2). One or two directions are MUSIC's; two that have no minimum of their
own inside the beam give no point, since the direction of one would be a mean of both.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.detection.angle.arrival import AngleEstimator, Directions
from sionna_radar.detection.angle.beam_former import (
    cosine_variance,
    forward_backward,
    lowest,
    noise_share,
    scanned,
    separators,
    source_powers,
    steering,
)
from sionna_radar.detection.angle.stretches import Stretches, wavefront_bend

# Scatter of a phase from receiver to receiver up to which one surface is followed, and steps of it.
MOST_SCATTER_RAD, SCATTERS = 1.5, 61
# Half-power widths that are looked through: to where the two-way beam has fallen by more than 20 dB.
SCANNED = 2.0
# Standard deviations of an eigenvalue of L looks, 1 / sqrt(L) of it, by which one surface is exceeded.
EXCEEDED_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class RowEstimator(AngleEstimator):
    """Finds up to two directions in each stretch, by receivers evenly spaced along the axis of the last one.

    One on the other axis, if there is one, tells each direction's cosine there.
    """

    def _directions(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> tuple[Stretches, Directions]:
        sampled = self._products(stretches, signals)
        count = len(self._places)
        covariance = forward_backward(sampled[:, :count, :count])
        two = self._two_surfaces(stretches, covariance)
        # Beyond the beam as well: what comes from there is no point, and has no minimum of its own inside.
        cosine = scanned(self._places, min(SCANNED * self.half_power[self._axis - 1], 0.5 / abs(self._places[1])))
        vectors = steering(self._places, cosine)
        found = []
        for sources, own in ((1, np.flatnonzero(~two)), (2, np.flatnonzero(two))):
            toward = lowest(noise_share(covariance[own], vectors, sources), cosine, sources)
            found.append(self._sources(stretches, sampled, covariance, own, toward))
        stretch, share, cosines, variance = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(stretch, kind="stable")
        points = stretches.rows(stretch[order], share[order])
        diagonal = variance[order][:, :, None] * np.eye(variance.shape[1])
        return points, self._placed(points, cosines[order].T, diagonal, np.ones(len(order), dtype=bool))

    @property
    def _axis(self) -> int:
        return self.receivers[-1].axis

    @property
    def _phases(self) -> Float[np.ndarray, "receiver 2"]:
        """Phases of the row's receivers, and of one beside it, by direction cosines left and up.

        On a down-sweep a beat's phase is the negative of that of the way there and back.
        """
        chirp = self.detector.analyser.chirp
        row = [each for each in self.receivers if each.axis == self._axis]
        beside = [each for each in self.receivers if each.axis != self._axis]
        phases = np.zeros((1 + len(self.receivers), 2))
        for number, receiver in enumerate(row + beside, start=1):
            assert receiver.baseline_m is not None
            per_cosine = 2 * np.pi * receiver.baseline_m / chirp.wavelength_m
            phases[number, receiver.axis - 1] = -chirp.direction * per_cosine
        return phases

    @property
    def _places(self) -> Float[np.ndarray, " element"]:
        """Places of the row's receivers in wavelengths, by the signs of their phases."""
        row = 1 + sum(receiver.axis == self._axis for receiver in self.receivers)
        places: Float[np.ndarray, " element"] = self._phases[:row, self._axis - 1] / (2 * np.pi)
        return places

    def _products(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> Complex[np.ndarray, "point receiver receiver"]:
        """Return the products of the receivers' signals, those of the row first, summed over each stretch's cells."""
        phases, order = self._phases, [receiver.axis != self._axis for receiver in self.receivers]
        per_cosine = phases.sum(axis=1)  # each receiver lies on one axis
        wavelength_m = self.detector.analyser.chirp.wavelength_m
        bend = [wavefront_bend(each, abs(each) * wavelength_m / (2 * np.pi)) for each in per_cosine]
        ordered = [signals[0], *(signals[1:][number] for number in np.argsort(order, kind="stable"))]
        products = np.empty((len(stretches.row), len(ordered), len(ordered)), dtype=np.complex128)
        climb = stretches.strips.climb * stretches.climb_per_m[:, None]
        for m, signal in enumerate(ordered):
            for n, other in enumerate(ordered[: m + 1]):
                ramp = climb @ (phases[m] - phases[n])
                products[:, m, n], _ = stretches.cross(signal, other, ramp, bend[m] - bend[n])
                products[:, n, m] = products[:, m, n].conj()
        return products

    def _two_surfaces(
        self, stretches: Stretches, covariance: Complex[np.ndarray, "point e e"]
    ) -> Bool[np.ndarray, " point"]:
        """Return where the second eigenvalue is that of a second surface; see the module."""
        count, looks = covariance.shape[-1], stretches.looks
        value = np.linalg.eigvalsh(covariance)
        noise = stretches.noise_power * (1 + np.sqrt(count / looks)) ** 2
        strips = stretches.strips
        along = strips.strip[:, self._axis - 1] * strips.along
        # Ground may be tilted: as much as the ramp may be missing or doubled.
        ramp = strips.climb[:, self._axis - 1] * stretches.climb_per_m * np.sqrt(stretches.range_variance_m2)
        spacing = 2 * np.pi * abs(self._places[1] - self._places[0])
        left = _second_eigenvalue(count, spacing * np.hypot(along, ramp))
        one = left * value[:, -1] * (1 + EXCEEDED_SIGMAS / np.sqrt(looks))
        return value[:, -2] > one + noise

    def _sources(
        self,
        stretches: Stretches,
        sampled: Complex[np.ndarray, "point receiver receiver"],
        covariance: Complex[np.ndarray, "point e e"],
        own: Int[np.ndarray, " own"],
        cosine: Float[np.ndarray, "own source"],
    ) -> tuple[
        Int[np.ndarray, " found"],
        Float[np.ndarray, " found"],
        Float[np.ndarray, "found axis"],
        Float[np.ndarray, "found axis"],
    ]:
        """Return stretch, share of the power, direction cosines and their variances of all sources of some stretches.

        One row for each source of a stretch in which all were found; the axes are in the order of the receivers.
        """
        whole = np.isfinite(cosine).all(axis=1)
        own, cosine = own[whole], cosine[whole]
        count, sources = len(self._places), cosine.shape[1]
        vectors = steering(self._places, cosine.ravel()).reshape(len(own), sources, count)
        noise = stretches.noise_power[own]
        power = source_powers(covariance[own], vectors, noise)
        ratio, looks = power / noise[:, None], stretches.looks[own]
        variance = cosine_variance(self._places, vectors, ratio, looks)
        share = power / power.sum(axis=1, keepdims=True)
        if sources > 1:
            # Each surface has a mean range by its own speckle; the point has the mean of both by their powers, which
            # differs from it by the other's share of the difference of two means of L looks.
            apart = 2 * (1 - share) ** 2 * (stretches.range_variance_m2 / stretches.looks)[own, None]
            climb = stretches.strips.climb[own, self._axis - 1] * stretches.climb_per_m[own]
            variance = variance + apart * climb[:, None] ** 2
        cosines, variances = [cosine.ravel()], [variance.ravel()]
        if sampled.shape[1] > count:
            # What the receiver beside the row hears of each source, by least squares over the stretch's cells.
            weight = separators(vectors)
            heard = weight @ sampled[own, :count, :count] @ np.swapaxes(weight.conj(), 1, 2)
            beside = np.linalg.solve(heard, weight @ sampled[own, :count, count:])[:, :, 0]
            per_cosine = self._phases[-1, 2 - self._axis]
            cosines.insert(0, (-np.angle(beside) / per_cosine).ravel())
            variances.insert(0, (1 / (looks[:, None] * ratio * per_cosine**2)).ravel())
        return np.repeat(own, sources), share.ravel(), np.stack(cosines, axis=1), np.stack(variances, axis=1)


def _second_eigenvalue(count: int, scatter_rad: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the second over the first eigenvalue of one surface whose phase scatters from receiver to receiver."""
    steps = np.linspace(0.0, MOST_SCATTER_RAD, SCATTERS)
    apart = np.subtract.outer(np.arange(count), np.arange(count))
    value = np.linalg.eigvalsh(np.exp(-(steps[:, None, None] ** 2) * apart**2 / 2))
    found: Float[np.ndarray, " point"] = np.interp(scatter_rad, steps, value[:, -2] / value[:, -1])
    return found
