"""Scattered heights for mapping: means over footprints, with noise that neighbouring pulses share.

The footprint of an echo on the ground is Gaussian. Each point has its footprint, and the number of pulses over which
its speckle repeats (`PointFootprints`).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from sionna_radar.detection.angle.segments import LENGTH_OVER_WIDTH, range_strips
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks
from sionna_radar.mapping.echo_model.beam import BeamNodes
from sionna_radar.mapping.echo_model.speckle import AT_ONCE, SpeckleMemory, repeats, speckle_reach
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.terrain.covariance import MIN_NOISE_M, Measured, repeated_pairs
from sionna_radar.radar.chirp import Chirp

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
        """Return the heights above a trend plane, the input of a covariance fit; microrelief_m: see `Measured`."""
        return Measured(
            place_m=self.place_m,
            height_m=self.height_m - trend[0] - self.place_m @ trend[1:],
            sigma_m=self.sigma_m,
            spread_m=self.spread_m,
            order=self.order,
            reach=self.reach,
            microrelief_m=microrelief_m,
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


# A ray closer to the horizon counts as this far below it: its footprint would be endless.
SHALLOWEST = 0.1


def footprint_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the axes of each pulse's footprint on level ground, as long as its standard deviations.

    The two-way pattern is taken for a Gaussian with the same second moments in azimuth and in elevation.
    """
    axes = []
    for number, spread in enumerate(beam.spread, start=1):
        axes.append(range_m[:, None] * spread * _on_ground(pose, pose.R_world_antenna[:, :, number]))
    return np.stack(axes, axis=1)


def strip_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the same axes for points at measured directions: the strip of a range cell, and the cells of a point."""
    strips = range_strips(pose, beam.spread)
    width = strips.along * LENGTH_OVER_WIDTH * np.cos(strips.incidence_rad)
    both = np.stack([strips.strip * strips.along[:, None], strips.climb * width[:, None]], axis=1)
    offset = np.einsum("pij,pkj->pki", pose.R_world_antenna[:, :, 1:], both)
    return np.stack([range_m[:, None] * _on_ground(pose, offset[:, k]) for k in range(2)], axis=1)


def _on_ground(pose: Pose, aside: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, "pulse 2"]:
    """Return small offsets from the boresight at unit range, projected along it onto level ground."""
    ahead = pose.boresight
    down = np.minimum(ahead[:, 2], -SHALLOWEST)
    met: Float[np.ndarray, "pulse 3"] = aside - (aside[:, 2] / down)[:, None] * ahead
    return met[:, :2]


MIN_DISTANCE_M = 1e-9


@dataclass(frozen=True, kw_only=True)
class PointFootprints:
    """Footprints of points, in the order of the points.

    footprint_m: axes of its footprint on level ground, as long as its standard deviations.
    reach: over how many pulses its speckle repeats; see `speckle`.
    """

    footprint_m: Float[np.ndarray, "point 2 2"]
    reach: Float[np.ndarray, " point"]


def point_footprints(
    points: Points,
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
    beam: BeamNodes,
    chirp: Chirp,
    memory: SpeckleMemory,
) -> PointFootprints:
    """Return the footprint and speckle reach of each point.

    points: located echoes.
    measured: returns the measured poses of pulses by their indices.
    beam, chirp, memory: of the radar, and of the ground.
    """
    pulse, first, row = np.unique(points.pulse, return_index=True, return_inverse=True)

    def pose_of(row: Int[np.ndarray, " row"]) -> Pose:
        return measured(pulse[row])

    reach = speckle_reach(pulse, pose_of, points.range_m[first], beam, chirp, memory)
    axes_of = footprint_axes if points.across_sigma_m is None else strip_axes

    def footprints(low: int, high: int) -> Float[np.ndarray, "some 2 2"]:
        unique_rows, back = np.unique(row[low:high], return_inverse=True)
        return axes_of(pose_of(unique_rows).rows(back), points.range_m[low:high], beam)

    footprint_m = np.concatenate([footprints(*bounds) for bounds in chunks(len(points), AT_ONCE)])
    reach = reach[row] if points.reach is None else np.maximum(reach[row], points.reach)
    return PointFootprints(footprint_m=footprint_m, reach=reach)


def point_heights(points: Points, view: PointFootprints | None) -> Heights:
    """Return points as heights: over their footprints, or at single places if these are unknown."""
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / np.maximum(np.linalg.norm(away, axis=1), MIN_DISTANCE_M)
    place, height, sigma = points.position_m[:, :2], points.position_m[:, 2], points.range_sigma_m * steep
    if points.across_sigma_m is not None:
        sigma = np.hypot(sigma, points.across_sigma_m * np.sqrt(1 - steep**2))
        if view is not None:
            # Of two pulses that share their speckle only points in the same range cells do: instead of every two points
            # of both, each counts as independent, with the errors that do as much harm.
            sigma = sigma * np.sqrt(repeats(view.reach))
            view = replace(view, reach=np.zeros(len(points)))
    if view is None:
        return Heights.at_places(place, height, sigma)
    return Heights(
        place_m=place,
        height_m=height,
        sigma_m=sigma,
        footprint_m=view.footprint_m,
        order=points.pulse.astype(float),
        reach=view.reach,
    )
