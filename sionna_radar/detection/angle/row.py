"""Directions in one range cell by a row of receivers: beam formers, and two surfaces (a roof, the ground before it).

In each stretch the covariance of the row's signals is summed over its cells, after the phase that level ground would
add from cell to cell is taken out, and averaged with that of the row turned around. A second surface is looked for
where the second eigenvalue exceeds what noise and one surface leave: noise of power w in N receivers and L looks at
most w (1 + sqrt(N / L))^2 (Marchenko and Pastur 1967), and a surface whose phase from receiver to receiver scatters by
s that of the covariance exp(-s^2 (m - n)^2 / 2). One or two directions are MUSIC's; two that have no minimum of their
own inside the beam give no point, since the direction of one would be a mean of both.

The row's signals in a range cell are x = sum a(u) s + noise, a(u) = exp(j k z u) over the places z of the receivers, u
the direction cosine along the row, and R = E[x x^H]. MUSIC's spectrum 1 / |E^H a|^2, E the eigenvectors of R without
those of the strongest sources (Stoica and Nehorai 1989, "MUSIC, maximum likelihood, and Cramer-Rao bound", IEEE Trans.
ASSP 37), tells nearer sources apart as their powers exceed the noise. Two ways of one wave are coherent, and R has one
source alone; its mean with that of the row turned around, (R + J R* J) / 2, parts them.

MUSIC stands here in a few lines of NumPy: the libraries at hand are written for studies of other signals, hold single
covariances, and one of them says that it is not designed for real-world applications (doatools).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.detection.angle.arrival import AngleEstimator, Directions
from sionna_radar.detection.angle.segments import Stretches, wavefront_bend

# Steps of the direction cosine in a spectrum: so many in the width of the row's own beam.
STEPS_IN_BEAM = 100


def steering(
    place_wavelengths: Float[np.ndarray, " element"], cosine: Float[np.ndarray, " n"]
) -> Complex[np.ndarray, "n element"]:
    """Return the steering vectors of a row of receivers at places in wavelengths, one per direction cosine."""
    vectors: Complex[np.ndarray, "n element"] = np.exp(2j * np.pi * np.outer(cosine, place_wavelengths))
    return vectors


def forward_backward(covariance: Complex[np.ndarray, "*point e e"]) -> Complex[np.ndarray, "*point e e"]:
    """Return covariances of an even row averaged with those of the row turned around."""
    averaged: Complex[np.ndarray, "*point e e"] = (covariance + covariance[..., ::-1, ::-1].conj()) / 2
    return averaged


def noise_share(
    covariance: Complex[np.ndarray, "*point e e"], vectors: Complex[np.ndarray, "n e"], sources: int
) -> Float[np.ndarray, "*point n"]:
    """Return the share of each direction's wave outside the space of the sources: MUSIC's spectrum is its inverse."""
    own = np.linalg.eigh(covariance)[1][..., -sources:]
    inside = np.sum(np.abs(vectors.conj() @ own) ** 2, axis=-1)
    share: Float[np.ndarray, "*point n"] = 1 - inside / vectors.shape[1]
    return share


def scanned(place_wavelengths: Float[np.ndarray, " element"], reach: float) -> Float[np.ndarray, " n"]:
    """Return direction cosines to `reach` on either side, in steps that resolve a row's beam."""
    half = int(np.ceil(reach * float(np.ptp(place_wavelengths)) * STEPS_IN_BEAM)) + 1
    return np.linspace(-reach, reach, 2 * half + 1)


def lowest(
    share: Float[np.ndarray, "point n"], cosine: Float[np.ndarray, " n"], sources: int
) -> Float[np.ndarray, "point source"]:
    """Return the direction cosines of the lowest minima of the noise share, interpolated by parabolas; NaN for none."""
    inner = share[:, 1:-1]
    dip = (inner <= share[:, :-2]) & (inner < share[:, 2:])
    ranked = np.argsort(np.where(dip, inner, np.inf), axis=1, kind="stable")[:, :sources]
    found = np.take_along_axis(dip, ranked, axis=1)
    row = np.arange(len(share))[:, None]
    before, at, after = (share[row, ranked + step] for step in range(3))
    bend = before - 2 * at + after
    shift = np.where(bend > 0, (before - after) / np.where(bend > 0, 2 * bend, 1.0), 0.0)
    place = cosine[1] - cosine[0]
    return np.where(found, cosine[ranked + 1] + np.clip(shift, -0.5, 0.5) * place, np.nan)


def separators(vectors: Complex[np.ndarray, "point source e"]) -> Complex[np.ndarray, "point source e"]:
    """Return the weights that pass each of some sources as it is, and none of the others: rows of a pseudo-inverse."""
    # Of vectors as rows: A = vectors^T, and A^+ = (A^H A)^-1 A^H.
    conjugate = vectors.conj()
    weights: Complex[np.ndarray, "point source e"] = np.linalg.inv(conjugate @ np.swapaxes(vectors, 1, 2)) @ conjugate
    return weights


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
    place_wavelengths: Float[np.ndarray, " element"],
    vectors: Complex[np.ndarray, "point source e"],
    power_over_noise: Float[np.ndarray, "point source"],
    looks: Float[np.ndarray, " point"],
) -> Float[np.ndarray, "point source"]:
    """Return the variances of direction cosines of uncorrelated sources: the Cramer-Rao bound of strong ones.

    1 / (2 L R h), R the power over the noise and h the squared length of a's derivative outside the space of all
    sources (Stoica and Nehorai 1989; see above).
    """
    derivative = 2j * np.pi * place_wavelengths * vectors
    # The projection onto the sources' space.
    conjugate = vectors.conj()
    gram = np.linalg.inv(conjugate @ np.swapaxes(vectors, 1, 2))
    along = conjugate @ np.swapaxes(derivative, 1, 2)
    inside = np.einsum("pis,pij,pjs->ps", along.conj(), gram, along).real
    outside = np.sum(np.abs(derivative) ** 2, axis=2) - inside
    return 1 / (2 * looks[:, None] * power_over_noise * np.maximum(outside, 1e-12))


# Scatter of a phase from receiver to receiver up to which one surface is followed, and steps of it.
MAX_SCATTER_RAD, SCATTERS = 1.5, 61
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
        """Return the mask of points whose second eigenvalue exceeds that of one surface and noise; see the module."""
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
    steps = np.linspace(0.0, MAX_SCATTER_RAD, SCATTERS)
    apart = np.subtract.outer(np.arange(count), np.arange(count))
    value = np.linalg.eigvalsh(np.exp(-(steps[:, None, None] ** 2) * apart**2 / 2))
    found: Float[np.ndarray, " point"] = np.interp(scatter_rad, steps, value[:, -2] / value[:, -1])
    return found
