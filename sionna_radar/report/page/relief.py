"""Heights as a page shows them: thinned to what a browser draws at once, and cast where no map has any."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.truth import CLEAR_M
from sionna_radar.foundation.raster import Grid
from sionna_radar.report.page.packing import Pack
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster

# Cells of one map, and of one surface in three dimensions.
MOST_MAP_CELLS, MOST_RELIEF_CELLS = 400_000, 60_000
HEIGHT_STEP_M = 0.001
# How much lower surroundings are under the edge of a map: of itself, and of their cells.
UNDER_M, UNDER_SHARE = 0.05, 0.1


@dataclass(frozen=True, kw_only=True)
class Thinned:
    """Every n-th cell of a grid, along both of its axes."""

    grid: Grid
    every: int

    @property
    def cells(self) -> Grid:
        """The cells that are left."""
        grid, n = self.grid, self.every
        return Grid(
            west_m=grid.west_m,
            south_m=grid.south_m,
            spacing_m=grid.spacing_m * n,
            columns=-(-grid.columns // n),
            rows=-(-grid.rows // n),
        )

    def of(self, values: np.ndarray) -> np.ndarray:
        """Return the values of the cells that are left."""
        return values[:: self.every, :: self.every]

    @property
    def note(self) -> str:
        """What was left out, in words; empty for nothing."""
        if self.every == 1:
            return ""
        return f"every {_ordinal(self.every)} cell each way is shown ({self.grid.spacing_m * self.every:g} m)"


def thinned(grid: Grid, most: int) -> Thinned:
    """Return a grid thinned to at most so many cells."""
    every = max(1, int(np.sqrt(grid.columns * grid.rows / most)))
    while -(-grid.columns // every) * -(-grid.rows // every) > most:
        every += 1
    return Thinned(grid=grid, every=every)


def _ordinal(number: int) -> str:
    return f"{number}{ {2: 'nd', 3: 'rd'}.get(number, 'th') }"


def axes_of(grid: Grid, origin_m: tuple[float, ...] = (0.0, 0.0)) -> dict[str, float]:
    """Return the first cell's centre and the spacing for a map, in the coordinates that it shows."""
    return {"x0": grid.west_m + origin_m[0], "y0": grid.south_m + origin_m[1], "step": grid.spacing_m}


def packed_map(
    pack: Pack, grid: Grid, values: Float[np.ndarray, "row column"], step: float, origin_m: tuple[float, ...]
) -> dict[str, Any]:
    """Return a map for a page."""
    return {**axes_of(grid, origin_m), "z": pack.rounded(values, step)}


@dataclass(frozen=True, kw_only=True)
class Surroundings:
    """The highest surface around a map, on lines of which some are the map's first and last.

    Plotly drops cells next to empty ones: it goes on for one cell under the map, a little lower, and is empty inside.
    """

    x_m: Float[np.ndarray, " column"]
    y_m: Float[np.ndarray, " row"]
    height_m: Float[np.ndarray, "row column"]

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the surface for a page."""
        return {"x": pack.exact(self.x_m), "y": pack.exact(self.y_m), "z": pack.rounded(self.height_m, HEIGHT_STEP_M)}


def surroundings(
    caster: RayCaster, scene: Scene, box: tuple[float, float, float, float], most: int, inner: Grid | None = None
) -> Surroundings:
    """Return the highest surface in a box (west, east, south, north) of a scene, in about so many cells.

    caster: of the surfaces that count. inner: a map that is left out.
    """
    west, east, south, north = box
    step_m = max(float(np.sqrt((east - west) * (north - south) / most)), 1e-3)
    x = _lines(west, east, inner.x_m if inner else None, step_m)
    y = _lines(south, north, inner.y_m if inner else None, step_m)
    across, along = np.meshgrid(x, y)
    places = np.column_stack([across.ravel(), along.ravel()])
    height = caster.from_above(places, float(scene.bounds_m[1, 2]) + CLEAR_M).reshape(across.shape)
    if inner:
        for depth_m, value in ((0.0, -UNDER_M - UNDER_SHARE * step_m), (step_m, np.nan)):
            columns, rows = (
                (v > edges[0] + depth_m) & (v < edges[-1] - depth_m) for v, edges in ((x, inner.x_m), (y, inner.y_m))
            )
            height[np.ix_(rows, columns)] += value
    return Surroundings(x_m=x, y_m=y, height_m=height)


def _lines(
    low: float, high: float, inner: Float[np.ndarray, " cell"] | None, step_m: float
) -> Float[np.ndarray, " line"]:
    """Return places from low to high about a step apart, among them the ends of an inner map and a step within."""
    first, last = (low, high) if inner is None else (float(inner[0]), float(inner[-1]))
    stops = np.unique(np.clip([low, first, first + step_m, last - step_m, last, high], low, high))
    parts = [np.linspace(a, b, max(1, round((b - a) / step_m)), endpoint=False) for a, b in pairwise(stops)]
    return np.concatenate([*parts, stops[-1:]])
