"""Surfaces over one another: the bare ground under what stands on it, and air under what overhangs.

A vertical ray from below meets undersides, which face down, and tops, which face up. From a top to the next underside
is air; from an underside to the next top is not, nor is what a top without an underside covers: a roof on walls alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import find_objects, label

from sionna_radar.foundation.raster import Grid
from sionna_radar.scene.raycast import EDGE_JUMP_M, EDGE_STEP_M, RayCaster

# Air less high than this is a gap between things that stand on one another.
LEAST_AIR_M = 0.1
# A ray goes on from this far behind the last surface; the ray tracer counts in float32.
STEP_M = 0.002
MOST_LAYERS = 32
RAYS_AT_ONCE = 1_000_000


# Of the places with an overhang, so many are named.
MOST_PLACES = 20


@dataclass(frozen=True, kw_only=True)
class OverhungPlace:
    """Cells side by side with air under a surface: how many, and their extent (west, south, east, north), local."""

    cells: int
    extent_m: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Overhang:
    """Cells of a DEM above which there is more than one surface.

    cells: how many. share: of all cells that have a surface. places: where, the largest first, at most `MOST_PLACES`.
    """

    cells: int
    share: float
    places: tuple[OverhungPlace, ...] = ()


def bare_ground(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float, top_m: float
) -> Float[np.ndarray, " n"]:
    """Return the height of the lowest surface that faces up at horizontal positions; NaN where there is none."""
    first = _lowest_top(caster, point_m, bottom_m, top_m)
    # A ray along the edge of two triangles may slip between them; a slightly offset one then decides.
    aside = _lowest_top(caster, point_m + EDGE_STEP_M, bottom_m, top_m)
    slipped = np.nan_to_num(first - aside, nan=np.inf) > EDGE_JUMP_M
    return np.where(slipped & np.isfinite(aside), aside, first)


def _lowest_top(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float, top_m: float
) -> Float[np.ndarray, " n"]:
    found = np.full(len(point_m), np.nan)
    height = np.full(len(point_m), bottom_m)
    going = np.arange(len(point_m))
    for _ in range(MOST_LAYERS):
        if len(going) == 0:
            break
        met, up = _next_above(caster, point_m[going], height[going])
        found[going[up]] = met[up]
        height[going] = met + STEP_M
        going = going[np.isfinite(met) & ~up & (met < top_m)]
    return found


def overhang(caster: RayCaster, grid: Grid, bottom_m: float) -> Overhang:
    """Return the cells of a grid where air lies between two surfaces, at their centres."""
    centre_m = grid.centres_m
    over, seen = np.zeros((2, len(centre_m)), dtype=bool)
    for start in range(0, len(centre_m), RAYS_AT_ONCE):
        part = slice(start, start + RAYS_AT_ONCE)
        over[part], seen[part] = _air_below(caster, centre_m[part], bottom_m)
    cells = int(over.sum())
    places = _places(over.reshape(grid.shape), grid)
    return Overhang(cells=cells, share=cells / int(seen.sum()) if seen.any() else 0.0, places=places)


def _places(over: Bool[np.ndarray, "row column"], grid: Grid) -> tuple[OverhungPlace, ...]:
    """Return where cells lie side by side or corner to corner, the largest places first."""
    number, _ = label(over, structure=np.ones((3, 3)))
    count = np.bincount(number.ravel())[1:]
    found = []
    for own, (rows, columns) in enumerate(find_objects(number)):
        west, east, south, north = grid.cut(rows, columns).extent_m
        found.append(OverhungPlace(cells=int(count[own]), extent_m=(west, south, east, north)))
    return tuple(sorted(found, key=lambda place: -place.cells)[:MOST_PLACES])


def _air_below(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return at which places there is air under a surface, and at which there is a surface at all."""
    airy, met_any = np.zeros((2, len(point_m)), dtype=bool)
    height = np.full(len(point_m), bottom_m)
    top = np.full(len(point_m), np.nan)  # the last surface met, if it faces up
    going = np.arange(len(point_m))
    for _ in range(MOST_LAYERS):
        if len(going) == 0:
            break
        met, up = _next_above(caster, point_m[going], height[going])
        hit = np.isfinite(met)
        met_any[going] |= hit
        airy[going] |= hit & ~up & (met - top[going] > LEAST_AIR_M)
        top[going] = np.where(up, met, np.nan)
        height[going] = met + STEP_M
        going = going[hit & ~airy[going]]
    return airy, met_any


def _next_above(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], from_m: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return the height of the next surface over each place, NaN if there is none, and whether it faces up."""
    origin = np.column_stack([point_m, from_m])
    found = caster.intersect(caster.prepare(origin, np.broadcast_to([0.0, 0.0, 1.0], origin.shape)))
    hit = found.is_valid().numpy()
    distance = np.where(hit, found.t.numpy(), np.nan).astype(np.float64)
    return from_m + distance, hit & (found.n.numpy()[2] > 0)
