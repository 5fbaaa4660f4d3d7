"""Heights as a page shows them: thinned to what a browser draws at once, and cast where no map has any."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.truth import CLEAR_M
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.report.page.packing import Pack
from sionna_radar.scene.build import BuiltScene
from sionna_radar.scene.raycast import truth_dem

# Cells of one map, and of one surface in three dimensions.
MOST_MAP_CELLS, MOST_RELIEF_CELLS = 400_000, 60_000
HEIGHT_STEP_M = 0.001


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

    def of(self, values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
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


def surroundings(built: BuiltScene, box: tuple[float, float, float, float], most: int) -> Raster:
    """Return the highest surface in a box (west, east, south, north), in at most so many cells."""
    west, east, south, north = box
    spacing_m = max(float(np.sqrt((east - west) * (north - south) / most)), 1e-3)
    grid = Grid(
        west_m=west,
        south_m=south,
        spacing_m=spacing_m,
        columns=max(2, int((east - west) / spacing_m) + 1),
        rows=max(2, int((north - south) / spacing_m) + 1),
    )
    return truth_dem(built.caster, grid, float(built.scene.bounds_m[1, 2]) + CLEAR_M)


def around(raster: Raster, inner: Grid) -> Raster:
    """Return a raster without the cells inside another grid, where a finer surface is."""
    west, east, south, north = inner.extent_m
    margin = raster.grid.spacing_m
    x, y = raster.grid.x_m[None, :], raster.grid.y_m[:, None]
    inside = (x > west + margin) & (x < east - margin) & (y > south + margin) & (y < north - margin)
    return raster.within(~inside)
