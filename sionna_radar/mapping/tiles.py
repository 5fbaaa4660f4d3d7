"""Tiled maps: square overlapping tiles, each with its own terrain model, whose surfaces are blended.

A tile depends on nothing of the others, so that they may be done side by side, in other processes, or another day; its
bytes, `Piece.packed`, are what travels and what is kept.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.columns import columns_of, packed, table_of
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import several_at_once
from sionna_radar.inference.echo.likelihood import MeanRanges, Sightings, mean_ranges
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.smoothing import Smoothed
from sionna_radar.inference.terrain.uncertainty import Information, TiledUncertainty, TileUncertainty
from sionna_radar.mapping.echo_heights import EchoSurface
from sionna_radar.mapping.options import SMOOTH, SmoothParameters

MIN_PULSES = 20

# Surface of a tile, the echoes it was fitted to, and the information of whole echoes, if they were used.
TileSurface = tuple[Smoothed, EchoSurface, Information | None]


@dataclass(frozen=True)
class Tiling:
    """How the surface of a tile is made from echoes over a grid, and how many steps that takes at the most."""

    surface: Callable[[Sightings, MeanRanges, Grid, SmoothParameters], TileSurface]
    steps: int
    options: SmoothParameters = SMOOTH

    def sides(self, cells_m: Float[np.ndarray, " cell"]) -> list[tuple[float, float]]:
        """Return the bounds of tiles over a row of cells; a short row is one tile."""
        length = float(cells_m[-1] - cells_m[0])
        count = max(1, int(np.ceil(length / self.options.tile_m)))
        bounds = np.linspace(float(cells_m[0]), float(cells_m[-1]), count + 1)
        bounds[[0, -1]] += -2 * self.options.overlap_m, 2 * self.options.overlap_m
        return [(float(a), float(b)) for a, b in pairwise(bounds)]

    def taper(self, cells_m: Float[np.ndarray, " cell"], low: float, high: float) -> Float[np.ndarray, " cell"]:
        """Return the weight of a tile along an axis: 1 inside, falling to 0 over the overlap at its bounds."""
        overlap_m = self.options.overlap_m
        half = overlap_m / 2
        return np.clip((cells_m - low + half) / overlap_m, 0, 1) * np.clip((high + half - cells_m) / overlap_m, 0, 1)

    def steps_over(self, grid: Grid) -> int:
        """Return the number of steps over a grid."""
        return self.steps * len(self.sides(grid.x_m)) * len(self.sides(grid.y_m))


@dataclass(frozen=True)
class Piece:
    """The surface over a tile, with its uncertainty.

    first: row and column of its first cell in the map; weight: of its heights where tiles overlap.
    """

    first: Int[np.ndarray, "2"]
    weight: Float[np.ndarray, "row column"]
    height_m: Float[np.ndarray, "row column"]
    uncertainty: TileUncertainty

    @property
    def window(self) -> tuple[slice, slice]:
        """Its rows and columns in the map."""
        (row, column), (rows, columns) = self.first, self.weight.shape
        return slice(row, row + rows), slice(column, column + columns)

    def packed(self) -> bytes:
        """Return its bytes, from which `Tiles.unpacked` makes it again, bit for bit."""
        return packed(piece=self)


@runtime_checkable
class TilePiece(Protocol):
    """What is mapped of a tile."""

    def packed(self) -> bytes:
        """Return its bytes, from which `MapTiles.unpacked` makes it again, bit for bit."""
        ...


AnyPiece = TypeVar("AnyPiece", bound=TilePiece)
AnyPiece_co = TypeVar("AnyPiece_co", bound=TilePiece, covariant=True)


@runtime_checkable
class MapTiles(Protocol[AnyPiece_co]):
    """The tiles of a map."""

    @property
    def steps(self) -> int:
        """How many steps each takes at the most."""
        ...

    def __len__(self) -> int:
        """Return their number."""
        ...

    def piece(self, number: int) -> AnyPiece_co | None:
        """Return the map of a tile; None with too few echoes."""
        ...

    def unpacked(self, content: bytes) -> AnyPiece_co:
        """Return the piece of some bytes."""
        ...


# Evaluates all tiles, in order, in this process or on workers.
EachPiece = Callable[[MapTiles[Any]], Iterable[Any]]


def pieces_here(tiles: MapTiles[AnyPiece]) -> Iterable[AnyPiece | None]:
    """Return the pieces of all tiles, evaluated by the threads of this process."""
    return several_at_once(tiles.piece, range(len(tiles)), [tiles.steps] * len(tiles))


@dataclass(frozen=True)
class Mapped:
    """A surface over a whole grid, whether seen or not, with its uncertainty."""

    surface: Heightfield
    uncertainty: TiledUncertainty


@dataclass(frozen=True)
class Tiles:
    """The tiles of a map: whole echoes, the cells of the map, and how the surface of a tile is made."""

    sightings: Sightings
    grid: Grid
    tiling: Tiling

    def __len__(self) -> int:
        return len(self._bounds)

    @property
    def steps(self) -> int:
        """How many steps a tile takes at the most."""
        return self.tiling.steps

    def piece(self, number: int) -> Piece | None:
        """Return the surface of a tile; None where there are too few echoes."""
        west, east, south, north = bounds = self._bounds[number]
        (x, y), margin_m = self._place_m.T, self.tiling.options.overlap_m
        here = (x > west - margin_m) & (x < east + margin_m) & (y > south - margin_m) & (y < north + margin_m)
        if here.sum() < MIN_PULSES:
            return None
        taper, options = self.tiling.taper, self.tiling.options
        across, along = taper(self.grid.x_m, west, east), taper(self.grid.y_m, south, north)
        window = _span(along > 0), _span(across > 0)
        tile_grid = self.grid.cut(*window)
        tile_echoes = self.sightings.rows(here), self._echoes.rows(here)
        smoothed, first, information = self.tiling.surface(*tile_echoes, tile_grid, options)
        factor = first.smoothed.noise_factor
        if self.sightings.profiles.volume is not None:
            # Errors that neighbours share look like little noise.
            factor = max(factor, 1.0)
        kriging = Kriging(smoothed.model.covariance, first.heights.rows(first.fits), factor, smoothed.model.local)
        east_m, north_m = np.meshgrid(tile_grid.x_m, tile_grid.y_m)
        return Piece(
            first=np.array([side.start for side in window]),
            weight=across[window[1]] * along[window[0], None],
            height_m=smoothed.surface.at(east_m.ravel(), north_m.ravel()).reshape(tile_grid.shape),
            uncertainty=TileUncertainty.of(
                bounds,
                kriging,
                information,
                first.outstanding(),
                window_heights=options.window_heights,
                microrelief_m=self.sightings.microrelief_m,
            ),
        )

    def unpacked(self, content: bytes) -> Piece:
        """Return the piece of some bytes."""
        piece: Piece = table_of(Piece, "piece", columns_of(content))
        return piece

    def mapped(self, each: EachPiece = pieces_here) -> Mapped:
        """Return the blended surfaces of all tiles."""
        total, weight = np.zeros(self.grid.shape), np.zeros(self.grid.shape)
        uncertainties: list[TileUncertainty] = []
        for piece in each(self):
            if piece is not None:
                total[piece.window] += piece.weight * piece.height_m
                weight[piece.window] += piece.weight
                uncertainties.append(piece.uncertainty)
        covered = weight > 0
        fallback = float((total.sum() / weight.sum()) if covered.any() else 0.0)
        height = np.where(covered, total / np.where(covered, weight, 1.0), fallback)
        return Mapped(Heightfield(grid=self.grid, height_m=height), TiledUncertainty(tuple(uncertainties)))

    @cached_property
    def _bounds(self) -> list[tuple[float, float, float, float]]:
        """West, east, south and north of each tile."""
        sides = self.tiling.sides
        return [(*across, *along) for across in sides(self.grid.x_m) for along in sides(self.grid.y_m)]

    @cached_property
    def _echoes(self) -> MeanRanges:
        return mean_ranges(self.sightings)

    @cached_property
    def _place_m(self) -> Float[np.ndarray, "pulse 2"]:
        return self.sightings.places(self._echoes.range_m)[:, :2]


def _span(wanted: Bool[np.ndarray, " cell"]) -> slice:
    """Return the cells of a row that are wanted, which lie together."""
    wanted_cells = np.flatnonzero(wanted)
    return slice(int(wanted_cells[0]), int(wanted_cells[-1]) + 1)
