"""Plane fits to the regions of a stepped map: level ground, and roofs that may fill the beam only partly.

Echoes are located on the beam axis. A roof that ends within the beam returns only from the part of the beam that it
fills: at its far edge the echo is nearer than the intersection of axis and roof, so the located point is too high.
Once the cells of a roof are known, the mean range over the filled part of each beam is predicted, and the plane is
fitted to the differences.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.flight.pulses import rows_of
from sionna_radar.foundation.numerics import MAD_SIGMA
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.beam import beam_samples
from sionna_radar.inference.echo.likelihood import MeanRanges, Sightings, in_world
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.inference.terrain.heights import Heights, supported_directions
from sionna_radar.inference.terrain.smoothing import TerrainModel
from sionna_radar.mapping.echo_heights import heights_over, reaching
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points

# Error common to all echoes of a plane, m, which their number does not reduce: bias of mean ranges over windows of
# whole cells with power beside the echo. Not derived: the ground of `buildings`, with a standard deviation of 8 mm, was
# off by 10.5 mm (root mean square over seeds 1-24), and 8 mm in the mean.
LEVEL_SIGMA_M = 0.01
ROUNDS = 4
# Prior standard deviation of the slope across a line of heights, which they do not constrain: by choice, as roofs are
# pitched.
UNCONSTRAINED_SLOPE_SIGMA = 0.3
# Reject a plane whose residual exceeds this multiple of the noise.
MAX_RESIDUAL_RATIO = 2.0
# Fewest echoes of a plane fit: twice the number of unknowns.
MIN_ECHOES = 6


@dataclass(frozen=True)
class Plane:
    """A plane with its covariance.

    middle_m: a place; coefficients: the height there, and the slopes toward east and north; covariance: theirs.
    """

    middle_m: Float[np.ndarray, "2"]
    coefficients: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]

    def at(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return heights."""
        return np.asarray(self._design(place_m) @ self.coefficients)

    def sigma_m(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the standard deviations of heights."""
        design = self._design(place_m)
        variance = np.einsum("nk,kl,nl->n", design, self.covariance, design)
        return np.asarray(np.sqrt(variance + LEVEL_SIGMA_M**2))

    def _design(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        return np.column_stack([np.ones(len(place_m)), place_m - self.middle_m])


def plane_of_echoes(
    sightings: Sightings, echoes: MeanRanges, grid: Grid, options: SteppedParameters = STEPPED
) -> Plane | None:
    """Return the plane through whole echoes of one region; None if another surface fits them better.

    sightings, echoes: profiles and measured poses of the pulses that see only this region, and their mean ranges.
    grid: cells of the map.
    options: of the method.
    """
    reach = sightings.repeated(echoes.range_m)
    grid = reaching(grid, sightings, echoes)
    trend = np.array([np.median(sightings.places(echoes.range_m)[:, 2]), 0.0, 0.0])
    for _ in range(ROUNDS):
        heights, fits = heights_over(TerrainModel.flat(grid, trend), sightings, echoes, reach, options)
        if fits.sum() < MIN_ECHOES:
            return None
        fit = robust_plane(heights.rows(fits), 0.0, options.outlier_sigmas)
        plane, rough = fit.plane, fit.spread
        trend = np.array([plane.at(np.zeros((1, 2)))[0], *plane.coefficients[1:]])
    if rough > MAX_RESIDUAL_RATIO or _curved(heights.rows(fits), plane, rough, options.outlier_sigmas):
        return None
    return plane


def plane_of_points(
    coarse_m: Float[np.ndarray, "row column"],
    inside: Bool[np.ndarray, "row column"],
    points: Points,
    grid: Grid,
    spread_m: float,
    step_m: float,
    beam_rad: float,
    options: SteppedParameters = STEPPED,
) -> Plane | None:
    """Return the plane through the located echoes of a region; None if they are not planar.

    coarse_m, inside: the coarse map, and the cells of the region.
    points: located echoes.
    grid: cells of the map.
    spread_m: how far coarse heights scatter about planes; twice as far are no plane's.
    step_m: echoes farther above or below are not of this region.
    beam_rad: standard deviation of the two-way pattern in elevation: echoes of what fills a part of the beam only are
        off its axis by as much, on the same side all along a border, which tilts a plane.
    options: of the method.
    """
    on_cells = Heights.at_places(grid.centres_m[inside.ravel()], coarse_m[inside], np.ones(int(inside.sum())))
    rough = robust_plane(on_cells, spread_m, options.outlier_sigmas)
    row, column, on_grid = grid.cell_of(points.position_m)
    on = on_grid & inside[row, column]
    on &= np.abs(points.position_m[:, 2] - rough.plane.at(points.position_m[:, :2])) < step_m
    if on.sum() < MIN_ECHOES:
        return rough.plane if rough.spread <= 2 * spread_m else None
    of = points.rows(np.flatnonzero(on))
    place, height = of.position_m[:, :2], of.position_m[:, 2]
    located = Heights.at_places(place, height, np.ones(len(of)))
    fit = robust_plane(located, _off_axis_m(of, beam_rad), options.outlier_sigmas)
    return fit.plane if fit.spread <= 2 * spread_m else None


def _off_axis_m(points: Points, beam_rad: float) -> float:
    """Return the height error, m, of echoes `beam_rad` off the axis, at the median ground range."""
    away = points.origin_m - points.position_m
    return beam_rad * float(np.median(np.hypot(away[:, 0], away[:, 1])))


def spread(values: Float[np.ndarray, " n"]) -> float:
    """Return a robust standard deviation about zero: that of a normal distribution with the same middle half."""
    return MAD_SIGMA * float(np.median(np.abs(values))) if len(values) else 0.0


@dataclass(frozen=True)
class PlaneFit:
    """A robust plane fit, and the residual relative to the noise."""

    plane: Plane
    spread: float


def robust_plane(heights: Heights, least_m: float, outlier_sigmas: float) -> PlaneFit:
    """Return the plane through most of some heights: a level one if a tilt explains too little (Schwarz).

    A tilt that moves the heights by no more than `least_m`, in the root mean square, is none.
    """
    level, tilted = (_fitted(heights, unknowns, outlier_sigmas) for unknowns in (1, 3))
    unit = max(tilted.spread, 1e-6) * outlier_sigmas

    def misfit(fit: PlaneFit) -> float:
        rest = (heights.height_m - fit.plane.at(heights.place_m)) / heights.sigma_m
        return float(np.sum(np.minimum(np.abs(rest) / unit, 1.0) ** 2)) * outlier_sigmas**2

    moved = tilted.plane.at(heights.place_m) - level.plane.at(heights.place_m)
    needed = 2 * np.log(len(heights)) * float(np.mean(repeats(heights.reach)))
    is_tilted = misfit(level) - misfit(tilted) > needed and np.sqrt(np.mean(moved**2)) > least_m
    return tilted if is_tilted else level


def _fitted(heights: Heights, unknowns: int, outlier_sigmas: float) -> PlaneFit:
    """Return the level plane, of one unknown, or the tilted one, of three, through most of some heights."""
    middle = heights.place_m.mean(axis=0)
    along = supported_directions(heights.place_m) if unknowns > 1 else np.zeros((2, 0))
    design = np.column_stack([np.ones(len(heights)), (heights.place_m - middle) @ along]) / heights.sigma_m[:, None]
    value = heights.height_m / heights.sigma_m
    kept = np.ones(len(heights), dtype=bool)
    for _ in range(ROUNDS):
        fit = np.linalg.lstsq(design[kept], value[kept], rcond=None)[0]
        rest = value - design @ fit
        rough = max(spread(rest), 1e-6)
        kept = np.abs(rest) <= outlier_sigmas * rough
    repeated = float(np.mean(repeats(heights.reach[kept])))
    coefficients = np.concatenate([fit[:1], along @ fit[1:]])
    to_axes = np.vstack([np.eye(1, 1 + along.shape[1]), np.column_stack([np.zeros(2), along])])
    covariance = to_axes @ np.linalg.pinv(design[kept].T @ design[kept]) @ to_axes.T * rough**2 * repeated
    if 0 < along.shape[1] < 2:
        covariance[1:, 1:] += UNCONSTRAINED_SLOPE_SIGMA**2 * (np.eye(2) - along @ along.T)
    return PlaneFit(Plane(middle, coefficients, covariance), rough)


def _curved(heights: Heights, plane: Plane, rough: float, outlier_sigmas: float) -> bool:
    """Return True if a quadratic surface is likelier by more than its further unknowns explain (Schwarz)."""
    rest = (heights.height_m - plane.at(heights.place_m)) / heights.sigma_m
    kept = np.abs(rest) <= outlier_sigmas * max(rough, 1.0)
    x, y = (heights.place_m[kept] - plane.middle_m).T
    scale = max(float(np.hypot(x, y).max()), 1e-9)
    x, y = x / scale, y / scale
    design = np.column_stack([np.ones(len(x)), x, y, x * x, x * y, y * y]) / heights.sigma_m[kept, None]
    left = rest[kept] - design @ np.linalg.lstsq(design, rest[kept], rcond=None)[0]
    gain = (rest[kept] @ rest[kept] - left @ left) / float(np.mean(repeats(heights.reach[kept]))) / max(rough, 1.0) ** 2
    return bool(gain > 3 * np.log(len(x)))


SAMPLES = 400
# Below this fill factor the echo is determined by the region's outline, which is known to one cell. By trial of 0.3 to
# 0.9 on the seeds 1-8 of `buildings`; on 9-24 it serves as well.
MIN_FILL_FACTOR = 0.8


@dataclass(frozen=True)
class FilledBeams:
    """Fits roof planes to located echoes whose beams the roof fills only partly. outlier_sigmas: see `robust_plane`."""

    points: Points
    sightings: Sightings
    outlier_sigmas: float

    def refitted(self, plane: Plane, inside: Bool[np.ndarray, "row column"], grid: Grid, step_m: float) -> Plane:
        """Return the plane of a region, fitted to the echoes of the part of each beam that it fills.

        plane: the plane through located echoes, which stays where too few beams are filled.
        inside, grid: the cells of the region, of this grid.
        step_m: echoes farther above or below are not of this region.
        """
        heights = self._heights(plane, inside, grid, step_m)
        return plane if len(heights) < MIN_ECHOES else robust_plane(heights, 0.0, self.outlier_sigmas).plane

    def _heights(self, plane: Plane, inside: Bool[np.ndarray, "row column"], grid: Grid, step_m: float) -> Heights:
        """Return the heights that echoes measure on a plane, at the power-weighted centre of its part of each beam."""
        (height, east, north), (x, y) = plane.coefficients, plane.middle_m
        near = self._near(grid, plane, step_m)
        points, pose = self.points.rows(near), self.sightings.pose.rows(self._row[near])
        sample, sample_power = self._samples
        ray = in_world(pose, sample)
        origin = pose.position_m

        def falls(direction: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
            """Return the decrease of the height over the plane per unit range along rays."""
            return np.asarray(east * direction[..., 0] + north * direction[..., 1] - direction[..., 2])

        above = origin[:, 2] - height - east * (origin[:, 0] - x) - north * (origin[:, 1] - y)
        range_m = above[:, None] / falls(ray)
        place = origin[:, None] + range_m[..., None] * ray
        row, column, on = grid.cell_of(place.reshape(-1, 3))
        on[on] = inside[row[on], column[on]]
        power = np.where(range_m > 0, sample_power / range_m**2, 0.0)
        inside_power = power * on.reshape(power.shape)
        total = inside_power.sum(axis=1)
        filled = total > MIN_FILL_FACTOR * power.sum(axis=1)
        inside_power = inside_power[filled] / total[filled, None]
        mean_m = np.sum(inside_power * range_m[filled], axis=1)
        middle = np.einsum("pk,pki->pi", inside_power, place[filled])
        excess = (mean_m - points.range_m[filled]) * falls(pose.boresight[filled])
        alike = np.abs(excess) < step_m
        count = int(alike.sum())
        level = height + (middle[alike, :2] - plane.middle_m) @ plane.coefficients[1:] + excess[alike]
        return Heights.at_places(middle[alike, :2], level, np.ones(count))

    def _near(self, grid: Grid, plane: Plane, step_m: float) -> Bool[np.ndarray, " point"]:
        """Return the echoes whose axes may be over a window, and that may lie on a plane."""
        west, east, south, north = grid.extent_m
        x, y, z = self.points.position_m.T
        reach_m = 2 * float(self.points.range_m.max(initial=0.0)) * float(np.ptp(self.sightings.beam.elevation))
        within_reach = (x > west - reach_m) & (x < east + reach_m) & (y > south - reach_m) & (y < north + reach_m)
        return np.asarray(within_reach & (np.abs(z - plane.at(self.points.position_m[:, :2])) < 2 * step_m))

    @cached_property
    def _row(self) -> Int[np.ndarray, " point"]:
        return rows_of(self.sightings.profiles.pulse, self.points.pulse)

    @cached_property
    def _samples(self) -> tuple[Float[np.ndarray, "sample 3"], Float[np.ndarray, " sample"]]:
        return beam_samples(self.sightings.beam, SAMPLES)
