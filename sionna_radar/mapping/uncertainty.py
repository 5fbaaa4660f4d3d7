"""The uncertainty of a DEM: the standard deviation of each cell, and of means over windows of cells."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.heights import Heights
from sionna_radar.mapping.kriging import Kriging
from sionna_radar.mapping.local_relief import calm
from sionna_radar.mapping.plausible import Plausible, plausible_terrains
from sionna_radar.mapping.whole_echo import Information, information_of


@runtime_checkable
class Uncertainty(Protocol):
    """What a DEM method knows about the error of its heights."""

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        ...

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return the standard deviation of the mean height over the cells of a window; NaN where it is unknown."""
        ...


@dataclass(frozen=True)
class TileUncertainty:
    """The uncertainty within a tile of the map.

    bounds_m: west, east, south and north of the tile.
    kriging: of the mean ranges of its echoes, for the terrain that the map takes.
    information: what these, and the whole echoes, tell.
    plausible: the terrains that they allow.
    outstanding: echoes that the surface does not explain, such as those of poles and walls: place, radius of the
        footprint, and how far they are from the surface, m.
    """

    bounds_m: tuple[float, float, float, float]
    kriging: Kriging
    information: Information
    plausible: tuple[Plausible, ...]
    outstanding: Float[np.ndarray, "echo 4"] | None = None

    @classmethod
    def of(
        cls,
        bounds_m: tuple[float, float, float, float],
        kriging: Kriging,
        information: Information | None = None,
        outstanding: Float[np.ndarray, "echo 4"] | None = None,
    ) -> "TileUncertainty":
        """Return the uncertainty of a tile; without information, mean ranges alone were used."""
        heights = kriging.heights
        measured = heights.above(heights.trend())
        plausible = plausible_terrains(measured.rows(calm(measured)), kriging.terrain)
        told = information or information_of(heights)
        as_told = replace(kriging, noise_factor=kriging.noise_factor / told.gain(kriging.noise_factor))
        return cls(bounds_m, as_told, told, plausible, outstanding)

    def contains(self, x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
        """Return which places lie in the tile."""
        west, east, south, north = self.bounds_m
        return np.asarray((x >= west) & (x < east) & (y >= south) & (y < north))

    def after(
        self, sigma_m: Float[np.ndarray, " n"], place_m: Float[np.ndarray, "n 2"], window_m: float = 0.0
    ) -> Float[np.ndarray, " n"]:
        """Return the standard deviation of heights, or of their means over a window, by all that the echoes tell."""
        kriging = self.kriging
        told = self.information.after(sigma_m**2, kriging.terrain, self.plausible, kriging.local, place_m, window_m)
        return np.asarray(np.sqrt(told))

    def unexplained_m(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return how far echoes that the surface does not explain are from it, at places within their footprints."""
        farthest = np.zeros(len(place_m))
        for x, y, radius, apart in () if self.outstanding is None else self.outstanding:
            near = np.hypot(place_m[:, 0] - x, place_m[:, 1] - y) < radius
            farthest[near] = np.maximum(farthest[near], apart)
        return farthest


@dataclass(frozen=True)
class TiledUncertainty:
    """The uncertainty of a map of tiles."""

    tiles: tuple[TileUncertainty, ...]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        sigma = np.full(grid.shape, np.nan)
        x, y = np.meshgrid(grid.x_m, grid.y_m)
        for tile in self.tiles:
            here = wanted & tile.contains(x, y)
            if here.any():
                place_m = np.column_stack([x[here], y[here]])
                explained = tile.after(tile.kriging.sigma_m(grid, here)[here], place_m)
                sigma[here] = np.hypot(explained, tile.unexplained_m(place_m))
        return sigma

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return the standard deviation of the mean height over the cells of a window; NaN where it is unknown."""
        x, y = np.median(place_m, axis=0)[:, None]
        for tile in self.tiles:
            if tile.contains(x, y).all():
                # A window may reach beyond all echoes that the tile in its middle was mapped from.
                kriging = replace(tile.kriging, heights=self._heights)
                alone = np.array([kriging.mean_sigma_m(place_m)])
                return float(tile.after(alone, np.column_stack([x, y]), window_m)[0])
        return float("nan")

    @property
    def unexplained(self) -> int:
        """Number of echoes that the surface does not explain."""
        own = ((tile, tile.outstanding) for tile in self.tiles)
        return sum(int(tile.contains(*out[:, :2].T).sum()) for tile, out in own if out is not None)

    @cached_property
    def _heights(self) -> Heights:
        """The heights of all tiles, each from the tile that it lies in."""
        own = (tile.kriging.heights for tile in self.tiles)
        inside = [
            heights.rows(tile.contains(*heights.place_m.T)) for tile, heights in zip(self.tiles, own, strict=True)
        ]
        return Heights.concatenate(inside)
