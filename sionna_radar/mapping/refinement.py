"""A DEM with the beam modelled: the most probable terrain given the whole echoes, found by iteration.

1. The mean range of each echo gives a first surface, the covariance of the terrain, and the noise (`echo_heights`).
2. The forward model (`echo_model`) predicts every echo from the current surface. Fisher scoring moves the
   surface to the maximum of the posterior of measured profiles and terrain model, until it rests (`settling`).

A range cell of a pulse counts as many looks as its speckle is new in it: neighbouring cells overlap, and so do the
footprints of neighbouring pulses (`speckle`).

Only the measured poses, the antenna and the measured profiles are used. A large survey is mapped in square
overlapping tiles; each has its own terrain model, and their surfaces are blended.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import several_at_once
from sionna_radar.mapping.echo_heights import ROUGH, SURFACES, EchoSurface, echo_surface, on_axis
from sionna_radar.mapping.echo_model import EchoModel, Linearised, Sightings
from sionna_radar.mapping.kriging import Kriging
from sionna_radar.mapping.mean_ranges import MeanRanges, mean_ranges
from sionna_radar.mapping.scoring import MOST_SCORING_STEPS, most_probable
from sionna_radar.mapping.smoothing import Smoothed
from sionna_radar.mapping.speckle import repeats
from sionna_radar.mapping.uncertainty import TiledUncertainty, TileUncertainty
from sionna_radar.mapping.whole_echo import Information, information_of

TILE_M = 160.0
OVERLAP_M = 30.0
FEWEST_PULSES = 20


@dataclass(frozen=True)
class Mapped:
    """A surface over a grid, defined everywhere whether seen or not, and how well it is known."""

    surface: Heightfield
    uncertainty: TiledUncertainty


# A tile's surface, what it was made of, and what whole echoes told beyond their mean ranges, if they were used.
_Tile = tuple[Smoothed, EchoSurface, Information | None]
# The cells that it covers, its weights and its heights there, and how well it is known.
_Piece = tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray, TileUncertainty]


def refinement_steps(grid: Grid) -> int:
    """Return how many steps `refine` takes over a grid."""
    return (SURFACES + MOST_SCORING_STEPS) * _tile_count(grid)


def smoothing_steps(grid: Grid) -> int:
    """Return how many steps `smooth_echoes` takes over a grid."""
    return SURFACES * _tile_count(grid)


def refine(sightings: Sightings, grid: Grid, step: Step = no_step) -> Mapped:
    """Return the most probable surface over a grid given whole echoes.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    grid:
        Cells of the DEM.
    step:
        Called after each of `refinement_steps`.

    """

    def tile(sightings: Sightings, echoes: MeanRanges, part: Grid, step: Step) -> _Tile:
        return _refined(sightings, echo_surface(sightings, echoes, part, step, ROUGH), step)

    return _in_tiles(sightings, grid, tile, step, SURFACES + MOST_SCORING_STEPS)


def smooth_echoes(sightings: Sightings, grid: Grid, step: Step = no_step) -> Mapped:
    """Return the most probable surface over a grid given the mean ranges of whole echoes; see `refine`."""

    def tile(sightings: Sightings, echoes: MeanRanges, part: Grid, step: Step) -> _Tile:
        first = echo_surface(sightings, echoes, part, step)
        return first.smoothed, first, None

    return _in_tiles(sightings, grid, tile, step, SURFACES)


def _in_tiles(
    sightings: Sightings,
    grid: Grid,
    tile: Callable[[Sightings, MeanRanges, Grid, Step], _Tile],
    step: Step,
    steps: int,
) -> Mapped:
    """Return the blended surfaces of all tiles; `steps` are those of each. Several tiles are done side by side."""
    echoes = mean_ranges(sightings)
    place = on_axis(sightings.pose, echoes.range_m)[:, :2]
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    bounds = [(*across, *along) for across in _tiles(grid.x_m) for along in _tiles(grid.y_m)]

    def one(west: float, east: float, south: float, north: float, step: Step) -> _Piece | None:
        here = _inside(place, west, east, south, north, OVERLAP_M)
        if here.sum() < FEWEST_PULSES:
            return None
        core = _taper(x, west, east) * _taper(y, south, north)
        smoothed, first, information = tile(sightings.rows(here), echoes.rows(here), _part(grid, core > 0), step)
        rows, columns = np.flatnonzero((core > 0).any(axis=1)), np.flatnonzero((core > 0).any(axis=0))
        window = np.ix_(rows, columns)
        height = smoothed.surface.at(x[window].ravel(), y[window].ravel()).reshape(len(rows), -1)
        kriging = Kriging(smoothed.model.covariance, first.heights.rows(first.fits), first.smoothed.noise_factor)
        known = TileUncertainty.of((west, east, south, north), kriging, information)
        return window, core[window], height, known

    total, weight = np.zeros(grid.shape), np.zeros(grid.shape)
    known: list[TileUncertainty] = []
    every = range(len(bounds)), [steps] * len(bounds)
    for piece in several_at_once(lambda number, step: one(*bounds[number], step), *every, step):
        if piece is not None:
            window, core, height, of_tile = piece
            total[window] += core * height
            weight[window] += core
            known.append(of_tile)
    covered = weight > 0
    fallback = float((total.sum() / weight.sum()) if covered.any() else 0.0)
    surface = Heightfield(grid=grid, height_m=np.where(covered, total / np.where(covered, weight, 1.0), fallback))
    return Mapped(surface, TiledUncertainty(tuple(known)))


def _refined(sightings: Sightings, first: EchoSurface, step: Step) -> _Tile:
    """Return the surface that fits the whole echoes best, from one through their mean ranges."""
    looks = sightings.looks_per_cell / repeats(first.heights.reach)
    fitted = most_probable(sightings, looks, first.smoothed, first.heights.place_m, step)
    linearised = partial(_some_linearised, sightings, fitted.surface, looks)
    return fitted, first, information_of(first.heights, linearised, sightings.looks_per_cell)


def _some_linearised(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    chosen: Int[np.ndarray, " chosen"],
) -> Linearised:
    keep = np.isin(np.arange(len(sightings)), chosen)
    return EchoModel(sightings.rows(keep), surface).linearise(looks[keep])


def _tile_count(grid: Grid) -> int:
    return len(_tiles(grid.x_m)) * len(_tiles(grid.y_m))


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
