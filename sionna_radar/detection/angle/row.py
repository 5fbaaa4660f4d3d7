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
    source_powers,
    steering,
)
from sionna_radar.detection.angle.stretches import Stretches

# Scatter of a phase from receiver to receiver up to which one surface is followed, and steps of it.
MOST_SCATTER_RAD, SCATTERS = 1.5, 61
# Half-power widths that are looked through: to where the two-way beam has fallen by more than 20 dB.
SCANNED = 2.0
# Standard deviations of an eigenvalue of L looks, 1 / sqrt(L) of it, by which one surface is exceeded.
EXCEEDED_SIGMAS = 3.0


@dataclass(frozen=True, kw_only=True)
class RowEstimator(AngleEstimator):
    """Finds up to two directions in each stretch, by receivers evenly spaced along one axis."""

    def _directions(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> tuple[Stretches, Directions]:
        places = self._places
        covariance = forward_backward(self._covariance(stretches, signals))
        two = self._two_surfaces(stretches, covariance)
        # Beyond the beam as well: what comes from there is no point, and has no minimum of its own inside.
        cosine = scanned(places, min(SCANNED * self.half_power[self._axis - 1], 0.5 / abs(places[1])))
        vectors = steering(places, cosine)
        one = lowest(noise_share(covariance[~two], vectors, 1), cosine, 1)
        pair = lowest(noise_share(covariance[two], vectors, 2), cosine, 2)
        found = [
            self._described(stretches, covariance, np.flatnonzero(chosen), cosines)
            for chosen, cosines in ((~two, one), (two, pair))
        ]
        index, cosines, share, variance = (np.concatenate(column) for column in zip(*found, strict=True))
        order = np.argsort(index, kind="stable")
        points = stretches.rows(index[order], share[order])
        everywhere = np.ones(len(order), dtype=bool)
        return points, self._placed(points, cosines[None, order], variance[order, None, None], everywhere)

    @property
    def _axis(self) -> int:
        return self.receivers[0].axis

    @property
    def _places(self) -> Float[np.ndarray, " element"]:
        """Places of all receivers along the row in wavelengths, as phases grow: negative on a down-sweep's beats."""
        chirp = self.detector.analyser.chirp
        given = [receiver.baseline_m for receiver in self.receivers]
        assert all(baseline is not None for baseline in given)
        return -chirp.direction * np.array([0.0, *(b for b in given if b is not None)]) / chirp.wavelength_m

    def _covariance(
        self, stretches: Stretches, signals: Sequence[Complex[np.ndarray, "pulse bin"]]
    ) -> Complex[np.ndarray, "point element element"]:
        """Return the covariance of each stretch, a sum over its cells."""
        per_cosine = 2 * np.pi * self._places
        climb = stretches.strips.climb[:, self._axis - 1] * stretches.climb_per_m
        count = len(signals)
        covariance = np.empty((len(stretches.row), count, count), dtype=np.complex128)
        for m, signal in enumerate(signals):
            for n, other in enumerate(signals[: m + 1]):
                covariance[:, m, n], _ = stretches.cross(signal, other, (per_cosine[m] - per_cosine[n]) * climb)
                covariance[:, n, m] = covariance[:, m, n].conj()
        return covariance

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

    def _described(
        self,
        stretches: Stretches,
        covariance: Complex[np.ndarray, "point e e"],
        own: Int[np.ndarray, " own"],
        cosines: Float[np.ndarray, "own source"],
    ) -> tuple[
        Int[np.ndarray, " found"],
        Float[np.ndarray, " found"],
        Float[np.ndarray, " found"],
        Float[np.ndarray, " found"],
    ]:
        """Return stretch, direction cosine, share of the power and variance of each source, where all were found."""
        whole = np.isfinite(cosines).all(axis=1)
        own, cosines = own[whole], cosines[whole]
        places, sources = self._places, cosines.shape[1]
        vectors = steering(places, cosines.ravel()).reshape(len(own), sources, len(places))
        noise = stretches.noise_power[own]
        power = source_powers(covariance[own], vectors, noise)
        variance = cosine_variance(places, vectors, power / noise[:, None], stretches.looks[own])
        share = power / power.sum(axis=1, keepdims=True)
        if sources > 1:
            # Each surface has a mean range by its own speckle; the point has the mean of both by their powers, which
            # differs from it by the other's share of the difference of two means of L looks.
            apart = 2 * (1 - share) ** 2 * (stretches.range_variance_m2 / stretches.looks)[own, None]
            climb = stretches.strips.climb[own, self._axis - 1] * stretches.climb_per_m[own]
            variance = variance + apart * climb[:, None] ** 2
        return np.repeat(own, sources), cosines.ravel(), share.ravel(), variance.ravel()


def _second_eigenvalue(count: int, scatter_rad: Float[np.ndarray, " point"]) -> Float[np.ndarray, " point"]:
    """Return the second over the first eigenvalue of one surface whose phase scatters from receiver to receiver."""
    steps = np.linspace(0.0, MOST_SCATTER_RAD, SCATTERS)
    apart = np.subtract.outer(np.arange(count), np.arange(count))
    value = np.linalg.eigvalsh(np.exp(-(steps[:, None, None] ** 2) * apart**2 / 2))
    found: Float[np.ndarray, " point"] = np.interp(scatter_rad, steps, value[:, -2] / value[:, -1])
    return found
