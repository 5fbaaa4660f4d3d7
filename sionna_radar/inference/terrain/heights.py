"""Scattered heights for mapping: means over footprints, with noise that neighbouring pulses share.

The footprint of an echo on the ground is Gaussian. Each point has its footprint, and the number of pulses over which
its speckle repeats (`PointFootprints`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.beam import BeamNodes
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.inference.terrain.covariance_fit import MIN_NOISE_M, Measured, repeated_pairs

# Nodes along each axis of a footprint: of one within a cell, and of a wider one.
FEW, MANY = 3, 5
# Least ratio of width to length of a set of places from which a slope across it is estimated: echoes of a fixed beam
# lie on a line but for centimetres. By choice: no swath, and no roof, is so narrow.
MIN_WIDTH_RATIO = 0.02


@dataclass(frozen=True, kw_only=True)
class Heights(Columns):
    """Scattered heights: means of the terrain over Gaussian footprints, with noise.

    sigma_m: standard deviation of the noise.
    footprint_m: the two axes of each footprint on the ground, as long as its standard deviations; zero for a height at
        one place.
    order, reach: position in the sequence of pulses, and over how many of them speckle repeats; see `speckle`.
    """

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]
    footprint_m: Float[np.ndarray, "n 2 2"]
    order: Float[np.ndarray, " n"]
    reach: Float[np.ndarray, " n"]

    @classmethod
    def at_places(
        cls, place_m: Float[np.ndarray, "n 2"], height_m: Float[np.ndarray, " n"], sigma_m: Float[np.ndarray, " n"]
    ) -> "Heights":
        """Return heights at single places, with independent noise."""
        count = len(place_m)
        return cls(
            place_m=place_m,
            height_m=height_m,
            sigma_m=sigma_m,
            footprint_m=np.zeros((count, 2, 2)),
            order=np.arange(count, dtype=float),
            reach=np.zeros(count),
        )

    @property
    def spread_m(self) -> Float[np.ndarray, " n"]:
        """Standard deviation of a round footprint as large as each."""
        return np.sqrt(np.linalg.norm(self.footprint_m, axis=2).prod(axis=1))

    @property
    def bent_spread_m(self) -> Float[np.ndarray, " n"]:
        """Standard deviation of a round footprint whose mean leaves curved ground as far as the mean over each does.

        With the covariance S of a footprint and the second derivatives H of the ground a mean leaves it by tr(H S) / 2.
        Ground that is alike in all directions has E[H_ij H_kl] ~ d_ij d_kl + d_ik d_jl + d_il d_jk, so that the square
        is (tr S)^2 + 2 tr S^2 on average, 8 s^4 for a round footprint. A long footprint leaves it farther than a round
        one of the same area, `spread_m`.
        """
        axes = self.footprint_m
        covariance = np.einsum("nai,naj->nij", axes, axes)
        trace, of_square = np.trace(covariance, axis1=1, axis2=2), np.sum(covariance**2, axis=(1, 2))
        return ((trace**2 + 2 * of_square) / 8) ** 0.25

    def variance_m2(self, factor: float) -> Float[np.ndarray, " n"]:
        """Return the variance of independent errors that do as much harm; see `smoothing.smooth_with`."""
        return factor * repeats(self.reach) * np.maximum(self.sigma_m, MIN_NOISE_M) ** 2

    def noise_m2(
        self, one: Int[np.ndarray, "..."], other: Int[np.ndarray, "..."], factor: float
    ) -> Float[np.ndarray, "..."]:
        """Return the covariance of the noise of pairs of heights; their variance where both are the same."""
        sigma = np.maximum(self.sigma_m, MIN_NOISE_M)
        repeated = repeated_pairs(self.order[one], self.order[other], self.reach[one], self.reach[other])
        shared: Float[np.ndarray, ...] = np.where(one == other, 1.0, repeated)
        return factor * sigma[one] * sigma[other] * shared

    def above(self, trend: Float[np.ndarray, "3"], microrelief_m: float = 0.0) -> Measured:
        """Return the heights above their trend plane, the input of a covariance fit; microrelief_m: see `Measured`."""
        return Measured(
            place_m=self.place_m,
            height_m=self.height_m - trend[0] - self.place_m @ trend[1:],
            sigma_m=self.sigma_m,
            spread_m=self.spread_m,
            order=self.order,
            reach=self.reach,
            microrelief_m=microrelief_m,
            detrended=True,
        )

    def trend(self) -> Float[np.ndarray, "3"]:
        """Return the plane through them: height at the origin, slopes toward east and north."""
        return plane_through(self.place_m, self.height_m)

    def weights(self, grid: Grid) -> csr_matrix:
        """Return the matrix that makes these means of the heights of a grid's cells (Gauss-Hermite quadrature)."""
        flat = Heightfield(grid=grid, height_m=np.zeros(grid.shape))
        widest = float(np.abs(self.footprint_m).max(initial=0.0))
        if widest == 0:
            return flat.weights(*self.place_m.T)
        place, weight = np.polynomial.hermite_e.hermegauss(FEW if widest < grid.spacing_m else MANY)
        weight = weight / weight.sum()
        offset = np.stack([axis.ravel() for axis in np.meshgrid(place, place, indexing="ij")], axis=1)
        around = self.place_m[:, None] + np.einsum("kj,njx->nkx", offset, self.footprint_m)
        each = flat.weights(*around.reshape(-1, 2).T)
        count = len(offset)
        mean = csr_matrix(
            (
                np.tile(np.outer(weight, weight).ravel(), len(self)),
                np.arange(count * len(self)),
                np.arange(len(self) + 1) * count,
            ),
            shape=(len(self), count * len(self)),
        )
        return mean @ each


def plane_through(place_m: Float[np.ndarray, "n 2"], height_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "3"]:
    """Return the plane of least squares: height at the origin, slopes toward east and north, level across a line."""
    along = supported_directions(place_m)
    design = np.column_stack([np.ones(len(place_m)), place_m @ along])
    coefficients = np.linalg.lstsq(design, height_m, rcond=None)[0]
    return np.concatenate([coefficients[:1], along @ coefficients[1:]])


def supported_directions(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "2 k"]:
    """Return the directions along which heights at some places constrain a slope, as columns.

    East and north; or the one direction of places on a line; none for a single place.
    """
    _, width_m, direction = np.linalg.svd(place_m - place_m.mean(axis=0), full_matrices=False)
    constrained = width_m > max(
        MIN_WIDTH_RATIO * width_m[0], np.finfo(float).eps * np.abs(place_m).max() * len(place_m)
    )
    return np.eye(2) if constrained.all() and len(constrained) == 2 else direction[constrained].T


def footprint_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the axes of each pulse's footprint on level ground, as long as its standard deviations.

    The two-way pattern is taken for a Gaussian with the same second moments in azimuth and in elevation.
    """
    axes = []
    for number, spread in enumerate(beam.spread, start=1):
        axes.append(range_m[:, None] * spread * on_ground(pose, pose.R_world_antenna[:, :, number]))
    return np.stack(axes, axis=1)


def on_ground(pose: Pose, aside: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, "pulse 2"]:
    """Return small offsets from the boresight at unit range, projected along it onto level ground."""
    ahead = pose.boresight
    down = np.minimum(ahead[:, 2], -MIN_GRAZING_SINE)
    met: Float[np.ndarray, "pulse 3"] = aside - (aside[:, 2] / down)[:, None] * ahead
    return met[:, :2]
