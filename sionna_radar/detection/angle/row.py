"""MUSIC directions of one or two surfaces in a range cell (a roof, the ground before it) by a row of receivers.

In each stretch the covariance of the row's signals is summed over its cells, after removing the phase ramp of level
ground from cell to cell, and averaged with that of the reversed row. A second surface is sought where the second
eigenvalue exceeds that of noise and one surface: noise of power w in N receivers and L looks gives at most
w (1 + sqrt(N / L))^2 (Marchenko and Pastur 1967), and a surface whose phase from receiver to receiver scatters by s
that of the covariance exp(-s^2 (m - n)^2 / 2). One or two directions are MUSIC's; two without separate minima inside
the beam give no point, since a single direction would be a mean of both.

The row's signals in a range cell are x = sum a(u) s + noise, a(u) = exp(j k z u) over the places z of the receivers, u
the direction cosine along the row, and R = E[x x^H]. MUSIC's spectrum 1 / |E^H a|^2, E the eigenvectors of R without
those of the strongest sources (Stoica and Nehorai 1989, "MUSIC, maximum likelihood, and Cramer-Rao bound", IEEE Trans.
ASSP 37), resolves closer sources the more their powers exceed the noise. Two paths of one wave are coherent, and R has
a single source; its forward-backward mean (R + J R* J) / 2 decorrelates them.

A single surface is no point: its direction is the mean by the power that its range is a mean by, which the phase
between the first receiver and its neighbour tells (`arrival`). MUSIC's direction is nearer the mode of the speckle, and
over tilted ground receivers far apart hear other speckle than the one beside the row: both leave the ground.

MUSIC is implemented here in a few lines of NumPy: available libraries are written for other signals, process single
covariances, and one states that it is not designed for real-world applications (doatools).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.detection.angle.arrival import AngleEstimator, Directions
from sionna_radar.detection.angle.segments import Stretches

# Steps of the direction cosine in a spectrum per beam width of the row.
STEPS_IN_BEAM = 100


def forward_backward(covariance: Complex[np.ndarray, "*point e e"]) -> Complex[np.ndarray, "*point e e"]:
    """Return forward-backward averages of the covariances of an evenly spaced row."""
    return (covariance + covariance[..., ::-1, ::-1].conj()) / 2


def noise_projection(
    covariance: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"], sources: int
) -> Float[np.ndarray, "*point n"]:
    """Return the projection of each steering vector on the noise subspace: MUSIC's spectrum is its inverse."""
    signal_space = np.linalg.eigh(covariance)[1][..., -sources:]
    signal_power = np.sum(np.abs(vectors.conj() @ signal_space) ** 2, axis=-1)
    return 1 - signal_power / vectors.shape[1]


def scanned(place_wavelengths: Float[np.ndarray, " element"], reach: float) -> Float[np.ndarray, " n"]:
    """Return direction cosines from -reach to reach, in steps that resolve a row's beam."""
    half = int(np.ceil(reach * float(np.ptp(place_wavelengths)) * STEPS_IN_BEAM)) + 1
    return np.linspace(-reach, reach, 2 * half + 1)


def lowest(
    noise_fraction: Float[np.ndarray, "point n"], cosine: Float[np.ndarray, " n"], sources: int
) -> Float[np.ndarray, "point source"]:
    """Return direction cosines of the lowest minima of a noise fraction, interpolated by parabolas; NaN for none."""
    inner = noise_fraction[:, 1:-1]
    dip = (inner <= noise_fraction[:, :-2]) & (inner < noise_fraction[:, 2:])
    ranked = np.argsort(np.where(dip, inner, np.inf), axis=1, kind="stable")[:, :sources]
    is_minimum = np.take_along_axis(dip, ranked, axis=1)
    row = np.arange(len(noise_fraction))[:, None]
    left, centre, right = (noise_fraction[row, ranked + step] for step in range(3))
    bend = left - 2 * centre + right
    shift = np.where(bend > 0, (left - right) / np.where(bend > 0, 2 * bend, 1.0), 0.0)
    place = cosine[1] - cosine[0]
    return np.where(is_minimum, cosine[ranked + 1] + np.clip(shift, -0.5, 0.5) * place, np.nan)


def separators(vectors: Complex[np.ndarray, "point source e"]) -> Complex[np.ndarray, "point source e"]:
    """Return the weights that pass each source with unit gain and null the others: rows of a pseudo-inverse."""
    # Vectors are rows: A = vectors^T, and A^+ = (A^H A)^-1 A^H.
    conjugate = vectors.conj()
    return np.linalg.inv(conjugate @ np.swapaxes(vectors, 1, 2)) @ conjugate


def outside(
    vectors: Complex[np.ndarray, "point source e"], derivative: Complex[np.ndarray, "point source e"]
) -> Float[np.ndarray, "point source"]:
    """Return the squared lengths of the derivatives of vectors outside of the space of them all."""
    along = derivative @ np.swapaxes(separators(vectors), 1, 2)
    return np.sum(np.abs(derivative - along @ vectors) ** 2, axis=2)


def source_powers(
    covariance: Complex[np.ndarray, "point e e"],
    vectors: Complex[np.ndarray, "point source e"],
    noise: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point source"]:
    """Return the powers of sources in known directions, by least squares, not below the noise in one receiver."""
    inverse = separators(vectors)
    clean = covariance - noise[:, None, None] * np.eye(covariance.shape[-1])
    power = np.einsum("pse,pef,psf->ps", inverse, clean, inverse.conj()).real
    return np.maximum(power, noise[:, None])


def cosine_variance(
    vectors: Complex[np.ndarray, "point source e"],
    derivative: Complex[np.ndarray, "point source e"],
    power_over_noise: Float[np.ndarray, "point source"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point source"]:
    """Return the variances of direction cosines of uncorrelated sources: the Cramer-Rao bound of strong ones.

    1 / (2 L R h), R the power over the noise and h the squared length of a's derivative outside the space of all
    sources (Stoica and Nehorai 1989; see above).
    """
    return 1 / (2 * looks[:, None] * power_over_noise * np.maximum(outside(vectors, derivative), 1e-12))


# Largest phase scatter from receiver to receiver tabulated for one surface, and number of steps.
MAX_SCATTER_RAD, SCATTERS = 1.5, 61
# Scanned directions in half-power widths: there the two-way beam has fallen by more than 20 dB.
SCANNED = 2.0
# Excess over one surface that counts as a second, in standard deviations 1 / sqrt(L) of an eigenvalue of L looks.
EXCEEDED_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class RowEstimator(AngleEstimator):
    """Estimator of up to two directions in each stretch, by receivers evenly spaced along the axis of the last one.

    A receiver on the other axis, if any, measures each direction's cosine there.
    """

    def _directions(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> tuple[Stretches, Directions]:
        sampled = self._products(stretches, signals)
        count = len(self._places)
        covariance = forward_backward(sampled[:, :count, :count])
        double = self._two_surfaces(stretches, covariance)
        # Scan beyond the beam: sources there give no point, and must not appear as minima inside.
        cosine = scanned(self._places, min(SCANNED * self.half_power[self._axis], 0.5 / abs(self._places[1])))
        vectors = self._vectors(cosine)
        toward = lowest(noise_projection(covariance[double], vectors, 2), cosine, 2)
        stretch, weight, cosines, variance = self._sources(
            stretches, sampled, covariance, np.flatnonzero(double), toward
        )
        mean_cosines, mean_covariance = self._mean_cosines(stretches, signals, [*self._cross_receiver, self._row[1]])
        single = np.flatnonzero(~double)
        stretch, weight = np.append(stretch, single), np.append(weight, np.ones(len(single)))
        cosines = np.concatenate([cosines, mean_cosines.T[single]])
        diagonal = variance[:, :, None] * np.eye(variance.shape[1])
        order = np.argsort(stretch, kind="stable")
        points = stretches.rows(stretch[order], weight[order])
        known = np.concatenate([diagonal, mean_covariance[single]])[order]
        return points, self._placed(points, cosines[order].T, known, np.ones(len(order), dtype=bool))

    @property
    def _axis(self) -> int:
        return self.axes[-1]

    @cached_property
    def _row(self) -> list[int]:
        """The row's receivers: the first, and those on the axis of the last."""
        return [0, *(number for number, axis in enumerate(self.axes, start=1) if axis == self._axis)]

    @property
    def _cross_receiver(self) -> list[int]:
        """The receiver beside the row, on the other axis, if there is one."""
        return [number for number in range(len(self.axes) + 1) if number not in self._row]

    @cached_property
    def _places(self) -> Float[np.ndarray, " element"]:
        """Positions of the row's receivers in wavelengths, signed like their phases."""
        return self.array.phase_per_cosine[self._row, self._axis] / (2 * np.pi)

    def _vectors(self, cosine: Float[np.ndarray, " n"]) -> Complex[np.ndarray, "n element"]:
        """Return steering vectors of the row on plane wavefronts."""
        direction = np.zeros((len(cosine), 3))
        direction[:, 1 + self._axis] = cosine
        return self.array.responses(direction, np.zeros(len(cosine)))[1][:, self._row]

    def _products(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> Complex[np.ndarray, "point receiver receiver"]:
        """Return the cross products of the receivers' signals, row first, summed over each stretch's cells."""
        ordered = [*self._row, *self._cross_receiver]
        products = np.empty((len(stretches.row), len(ordered), len(ordered)), dtype=np.complex128)
        for m, one in enumerate(ordered):
            for n, other in enumerate(ordered[: m + 1]):
                products[:, m, n], _ = self._cross(stretches, signals, one, other)
                products[:, n, m] = products[:, m, n].conj()
        return products

    def _two_surfaces(
        self, stretches: Stretches, covariance: Complex[np.ndarray, "point e e"]
    ) -> Bool[np.ndarray, " point"]:
        """Return the mask of points whose second eigenvalue exceeds that of one surface and noise; see the module."""
        count, looks = covariance.shape[-1], stretches.looks
        value = np.linalg.eigvalsh(covariance)
        noise = stretches.noise_power * (1 + np.sqrt(count / looks)) ** 2
        strips = stretches.strips
        along = strips.strip[:, self._axis] * strips.along
        # On tilted ground the ramp may vanish or double.
        ramp = strips.climb[:, self._axis] * stretches.climb_per_m * np.sqrt(stretches.range_variance_m2)
        spacing = 2 * np.pi * abs(self._places[1] - self._places[0])
        eigenvalue_ratio = _second_eigenvalue(count, spacing * np.hypot(along, ramp))
        single_surface = eigenvalue_ratio * value[:, -1] * (1 + EXCEEDED_SIGMAS / np.sqrt(looks))
        return value[:, -2] > single_surface + noise

    def _sources(
        self,
        stretches: Stretches,
        sampled: Complex[np.ndarray, "point receiver receiver"],
        covariance: Complex[np.ndarray, "point e e"],
        selected: Int[np.ndarray, " own"],
        cosine: Float[np.ndarray, "own source"],
    ) -> tuple[
        Int[np.ndarray, " direction"],
        Float[np.ndarray, " direction"],
        Float[np.ndarray, "direction axis"],
        Float[np.ndarray, "direction axis"],
    ]:
        """Return stretch, share of the power, direction cosines and their variances of all sources of some stretches.

        One row per source of a stretch with all sources resolved; the axes are in the order of the receivers.
        """
        complete = np.isfinite(cosine).all(axis=1)
        selected, cosine = selected[complete], cosine[complete]
        count, sources = len(self._places), cosine.shape[1]
        vectors = self._vectors(cosine.ravel()).reshape(len(selected), sources, count)
        noise = stretches.noise_power[selected]
        power = source_powers(covariance[selected], vectors, noise)
        ratio, looks = power / noise[:, None], stretches.looks[selected]
        power_fraction = power / power.sum(axis=1, keepdims=True)
        variance = cosine_variance(vectors, 2j * np.pi * self._places * vectors, ratio, looks)
        # The mean range of each surface depends on its own speckle; the point's is the mean of both by their powers,
        # off by the other's share of the difference of two means of L looks.
        mean_variance_m2 = (
            2 * (1 - power_fraction) ** 2 * (stretches.range_variance_m2 / stretches.looks)[selected, None]
        )
        climb = stretches.strips.climb[selected, self._axis] * stretches.climb_per_m[selected]
        variance = variance + mean_variance_m2 * climb[:, None] ** 2
        cosines, variances = [cosine.ravel()], [variance.ravel()]
        if sampled.shape[1] > count:
            # Signal of each source in the receiver beside the row, by least squares over the stretch's cells.
            weight = separators(vectors)
            source_covariance = weight @ sampled[selected, :count, :count] @ np.swapaxes(weight.conj(), 1, 2)
            side_receiver = np.linalg.solve(source_covariance, weight @ sampled[selected, :count, count:])[:, :, 0]
            per_cosine = self._turn(self._cross_receiver[0])
            cosines.insert(0, (-np.angle(side_receiver) / per_cosine).ravel())
            variances.insert(0, (1 / (looks[:, None] * ratio * per_cosine**2)).ravel())
        return (
            np.repeat(selected, sources),
            power_fraction.ravel(),
            np.stack(cosines, axis=1),
            np.stack(variances, axis=1),
        )


def _second_eigenvalue(count: int, scatter_rad: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the ratio of the second to the first eigenvalue of one surface with this phase scatter per receiver."""
    steps = np.linspace(0.0, MAX_SCATTER_RAD, SCATTERS)
    separation = np.subtract.outer(np.arange(count), np.arange(count))
    value = np.linalg.eigvalsh(np.exp(-(steps[:, None, None] ** 2) * separation**2 / 2))
    return np.interp(scatter_rad, steps, value[:, -2] / value[:, -1])
