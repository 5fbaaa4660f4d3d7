"""A DEM with the beam modelled: the most probable terrain given the whole echoes, found by iteration.

1. The power-weighted mean range of each echo, placed on the beam axis, gives a first smoothing surface, and the
   covariance of the terrain and the noise are estimated from it (`smoothing`).
2. The forward model (`echo_model`) predicts every echo from the current surface. Fisher scoring moves the
   surface to the maximum of the posterior of measured profiles and terrain model.
3. Once the echoes' bias is known from the prediction, covariance and noise are estimated again from unbiased
   heights, and the scoring continues.

Only the measured poses, the antenna and the measured profiles are used. A large survey is mapped in square
overlapping tiles; each has its own terrain model, and their surfaces are blended.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.curvature import curvature_on_cells
from sionna_radar.mapping.echo_model import EchoModel, Sightings
from sionna_radar.mapping.mean_ranges import MeanRanges, mean_ranges
from sionna_radar.mapping.smoothing import MOST_ITERATIONS, Heights, Smoothed, smooth

TILE_M = 160.0
OVERLAP_M = 30.0
FEWEST_PULSES = 20
# A fixed number, however small the steps get: the end of the iteration must not depend on rounding.
FIRST_STEPS, LAST_STEPS = 1, 4
# These, and two smoothing surfaces.
STEPS_OF_A_TILE = FIRST_STEPS + LAST_STEPS + 2
OUTLIER_SIGMAS = 4.0
# Of the residual of each step: what is left of it is taken by the next, and of the last it is invisible.
STEP_TOLERANCE = 2e-2
# Of the smoothing surfaces that only begin the iteration.
ROUGH = 1e-4


def refinement_steps(grid: Grid) -> int:
    """Return how many steps `refine` takes over a grid."""
    return STEPS_OF_A_TILE * len(_tiles(grid.x_m)) * len(_tiles(grid.y_m))


def refine(sightings: Sightings, grid: Grid, step: Step = no_step) -> Heightfield:
    """Return the most probable surface over a grid, defined everywhere whether seen or not.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    grid:
        Cells of the DEM.
    step:
        Called after each of `refinement_steps`.

    """
    total, weight = np.zeros(grid.shape), np.zeros(grid.shape)
    echoes = mean_ranges(sightings)
    place = _on_axis(sightings.pose, echoes.range_m)[:, :2]
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    for west, east in _tiles(grid.x_m):
        for south, north in _tiles(grid.y_m):
            core = _taper(x, west, east) * _taper(y, south, north)
            here = _inside(place, west, east, south, north, OVERLAP_M)
            if here.sum() < FEWEST_PULSES:
                for _ in range(STEPS_OF_A_TILE):
                    step()
                continue
            surface = _refine_tile(sightings.rows(here), echoes.rows(here), _part(grid, core > 0), step)
            rows, columns = np.flatnonzero((core > 0).any(axis=1)), np.flatnonzero((core > 0).any(axis=0))
            window = np.ix_(rows, columns)
            total[window] += core[window] * surface.at(x[window].ravel(), y[window].ravel()).reshape(len(rows), -1)
            weight[window] += core[window]
    covered = weight > 0
    fallback = float((total.sum() / weight.sum()) if covered.any() else 0.0)
    return Heightfield(grid=grid, height_m=np.where(covered, total / np.where(covered, weight, 1.0), fallback))


def _refine_tile(sightings: Sightings, echoes: MeanRanges, grid: Grid, step: Step) -> Heightfield:
    grid = _reaching(grid, sightings, echoes)
    fitted = smooth(_heights(sightings, evenly(echoes), np.zeros(len(sightings))), grid, tolerance=ROUGH)
    step()
    for _ in range(FIRST_STEPS):
        fitted = _score_step(sightings, fitted, 1.0)
        step()
    bias, outlier = _bias(sightings, fitted.surface, echoes)
    heights = _heights(sightings, echoes, bias)
    keep = ~outlier
    heights = Heights(heights.place_m[keep], heights.height_m[keep], heights.sigma_m[keep])
    fitted = smooth(heights, grid, tolerance=ROUGH)
    step()
    for _ in range(LAST_STEPS):
        fitted = _score_step(sightings, fitted, max(1.0, fitted.noise_factor))
        step()
    return fitted.surface


def evenly(echoes: MeanRanges) -> MeanRanges:
    """Give all ranges the median uncertainty: before the beam's bias is known, that outweighs speckle."""
    return MeanRanges(range_m=echoes.range_m, sigma_m=np.full(len(echoes), np.median(echoes.sigma_m)))


def _score_step(sightings: Sightings, fitted: Smoothed, noise_factor: float) -> Smoothed:
    """Return the surface after one step of Fisher scoring."""
    model, white = fitted.model, fitted.white
    linear = EchoModel(sightings, fitted.surface).linearise(
        np.full(len(sightings), sightings.looks_per_cell / noise_factor)
    )
    weights = fitted.surface.weights(*linear.place_m.reshape(-1, 2).T)
    right = model.coloured(weights.T @ linear.score.ravel()) - white
    step = model.solve(curvature_on_cells(linear, fitted.surface), right, MOST_ITERATIONS, STEP_TOLERANCE)
    return Smoothed(model, white + step, fitted.noise_factor)


def _bias(
    sightings: Sightings, surface: Heightfield, echoes: MeanRanges
) -> tuple[Float[np.ndarray, " pulse"], Bool[np.ndarray, " pulse"]]:
    """Return how far each predicted mean range exceeds the axis range, and which echoes do not fit the surface."""
    pose = sightings.pose
    axis = pose.boresight
    predicted = EchoModel(sightings, surface).centroid_m() - sightings.shift_m(axis[:, None])[:, 0]
    bias = predicted - surface.first_hit(pose.position_m, axis, sightings.reach_m)
    residual = (echoes.range_m - predicted) / echoes.sigma_m
    known = np.isfinite(bias)
    scale = max(1.0, 1.4826 * float(np.median(np.abs(residual[known])))) if known.any() else 1.0
    odd = ~known | (np.abs(np.nan_to_num(residual)) > OUTLIER_SIGMAS * scale)
    if odd.mean() > 0.5:
        odd = ~known
    return np.where(known, bias, 0.0), odd


def _heights(sightings: Sightings, echoes: MeanRanges, bias_m: Float[np.ndarray, " pulse"]) -> Heights:
    point = _on_axis(sightings.pose, echoes.range_m - bias_m)
    sigma = echoes.sigma_m * np.abs(sightings.pose.boresight[:, 2])
    return Heights(point[:, :2], point[:, 2], np.maximum(sigma, 0.02))


def _on_axis(pose: Pose, range_m: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, "pulse 3"]:
    return pose.position_m + range_m[:, None] * pose.boresight


def _reaching(grid: Grid, sightings: Sightings, echoes: MeanRanges) -> Grid:
    """Return the grid that covers another and all of the footprints."""
    direction = sightings.direction()[:, sightings.beam.corners]
    down = np.minimum(direction[..., 2], -0.1)
    drop = echoes.range_m * -sightings.pose.boresight[:, 2]
    reach = np.minimum(drop[:, None] / -down, sightings.reach_m)
    place = (sightings.pose.position_m[:, None, :2] + reach[..., None] * direction[..., :2]).reshape(-1, 2)
    (west, south), (east, north) = place.min(axis=0), place.max(axis=0)
    return Grid.covering(
        min(west, float(grid.x_m[0])),
        min(south, float(grid.y_m[0])),
        max(east, float(grid.x_m[-1])),
        max(north, float(grid.y_m[-1])),
        grid.spacing_m,
        (grid.west_m, grid.south_m),
    )


def _tiles(cells_m: Float[np.ndarray, " cell"]) -> list[tuple[float, float]]:
    """Return the bounds of tiles over a row of cells; a short row is one tile."""
    length = float(cells_m[-1] - cells_m[0])
    count = max(1, int(np.ceil(length / TILE_M)))
    bounds = np.linspace(float(cells_m[0]), float(cells_m[-1]), count + 1)
    bounds[[0, -1]] += -2 * OVERLAP_M, 2 * OVERLAP_M
    return [(float(a), float(b)) for a, b in pairwise(bounds)]


def _taper(place: Float[np.ndarray, "row column"], low: float, high: float) -> Float[np.ndarray, "row column"]:
    """Return the weight of a tile: 1 inside, falling to 0 over the overlap at its bounds."""
    half = OVERLAP_M / 2
    return np.clip((place - low + half) / OVERLAP_M, 0, 1) * np.clip((high + half - place) / OVERLAP_M, 0, 1)


def _inside(
    place: Float[np.ndarray, "n 2"], west: float, east: float, south: float, north: float, margin: float
) -> Bool[np.ndarray, " n"]:
    x, y = place.T
    in_x = (x > west - margin) & (x < east + margin)
    inside: Bool[np.ndarray, " n"] = in_x & (y > south - margin) & (y < north + margin)
    return inside


def _part(grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Grid:
    rows, columns = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
    return Grid(
        west_m=float(grid.x_m[columns[0]]),
        south_m=float(grid.y_m[rows[0]]),
        spacing_m=grid.spacing_m,
        columns=len(columns),
        rows=len(rows),
    )
