"""The ground: elevation rasters of every terrain kind, and their triangles.

Whatever the terrain comes from, it ends as one raster of square cells in the local frame (metres, x east,
y north, z up). Synthetic ground lies nowhere on the Earth; ground from a file carries its place.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.cbook import get_sample_data
from rasterio import Affine
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from sionna_radar.elevation.cutout import Cutout
from sionna_radar.elevation.elevation_file import cut, opened_array, opened_file
from sionna_radar.elevation.local_frame import StatedFrame, place_file
from sionna_radar.elevation.placed_raster import PlacedRaster
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario.terrain import FlatTerrain, FractalTerrain, HillsTerrain, RasterTerrain, SampleTerrain

MAX_SYNTHETIC_CELLS = 16_000_000
# Cells times filter width up to which a filter is applied tap by tap; beyond it Fourier transforms are faster.
MOST_DIRECT_FILTERING = 1e8


def load_elevation(
    terrain: FlatTerrain | HillsTerrain | FractalTerrain | SampleTerrain | RasterTerrain,
    window_m: tuple[float, float, float, float],
) -> tuple[Raster, Georeference | None]:
    """Return the heights of the ground, and where the local frame lies on the Earth.

    window_m: what the survey can see (west, south, east, north) in local metres; of a file no more is
    read, while synthetic ground is always built whole, centred on the origin. The origin of a file's
    frame is `centre_lonlat_deg`, or else the middle of the file.

    Raises ScenarioError or InputFileError, each with the field, its value and the remedy.
    """
    match terrain:
        case FlatTerrain():
            grid = _synthetic_grid(terrain)
            return Raster(grid=grid, height_m=np.zeros(grid.shape)), None
        case HillsTerrain():
            return _hills(terrain), None
        case FractalTerrain():
            return _fractal(terrain), None
        case SampleTerrain() | RasterTerrain():
            cutout = Cutout(window_m=window_m, frame=_stated(terrain), spacing_m=terrain.spacing_m)
            with _opened(terrain) as dataset:
                return cut(dataset, cutout)


def place_of(terrain: SampleTerrain | RasterTerrain) -> PlacedRaster:
    """Return how the elevation file of a terrain lies in its local frame; the file itself is closed again.

    Raises ScenarioError or InputFileError as `load_elevation` does.
    """
    with _opened(terrain) as dataset:
        return place_file(dataset, _stated(terrain))


def mesh_of(raster: Raster) -> tuple[Float[np.ndarray, "vertex 3"], Int[np.ndarray, "face 3"]]:
    """Return vertices and triangles of a raster: two triangles between any four filled neighbours.

        c---d
        | / |      counter-clockwise seen from above: a b d, a d c
        a---b

    Empty cells leave holes, and cells that bear no triangle no vertex.
    """
    index = np.arange(raster.height_m.size).reshape(raster.grid.shape)
    corners = [index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]]
    filled = raster.filled
    if filled.all():
        return np.column_stack([raster.grid.centres_m, raster.height_m.ravel()]), _two_triangles(corners)
    whole = filled[:-1, :-1] & filled[:-1, 1:] & filled[1:, :-1] & filled[1:, 1:]
    faces = _two_triangles([corner[whole] for corner in corners])

    used = np.zeros(index.size, dtype=bool)
    used[faces] = True
    renumbered = np.cumsum(used) - 1
    vertices = np.column_stack([raster.grid.centres_m[used], raster.height_m.ravel()[used]])
    return vertices.astype(np.float64), renumbered[faces]


def _two_triangles(corners: list[Int[np.ndarray, "..."]]) -> Int[np.ndarray, "face 3"]:
    """Return two triangles for each square of corners a, b, c, d."""
    a, b, c, d = (corner.ravel() for corner in corners)
    faces = np.empty((len(a), 2, 3), dtype=np.int64)
    for place, corner in enumerate((a, b, d)):
        faces[:, 0, place] = corner
    for place, corner in enumerate((a, d, c)):
        faces[:, 1, place] = corner
    return faces.reshape(-1, 3)


def _synthetic_grid(terrain: FlatTerrain | HillsTerrain | FractalTerrain) -> Grid:
    """Return the grid whose outermost centres bound the terrain, so that its mesh has the whole size."""
    # The small number keeps 1.1 / 0.1 = 11.000000000000002 from asking for a twelfth cell.
    columns, rows = (math.ceil(size / terrain.spacing_m - 1e-9) + 1 for size in terrain.size_m)
    if terrain.spacing_m > min(terrain.size_m):
        message = f"{terrain.spacing_m:g} exceeds the shorter side of terrain.size_m ({min(terrain.size_m):g} m)"
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    if columns * rows > MAX_SYNTHETIC_CELLS:
        message = (
            f"{terrain.spacing_m:g} makes {columns * rows:,} cells, more than {MAX_SYNTHETIC_CELLS:,}; "
            "raise it or lower terrain.size_m"
        )
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    return Grid(
        west_m=-terrain.spacing_m * (columns - 1) / 2,
        south_m=-terrain.spacing_m * (rows - 1) / 2,
        spacing_m=terrain.spacing_m,
        columns=columns,
        rows=rows,
    )


def _hills(terrain: HillsTerrain) -> Raster:
    """Return white noise under a Gaussian filter, shifted and scaled to heights of 0 to `height_m`."""
    grid = _synthetic_grid(terrain)
    if terrain.filter_sigma_m > 0.5 * min(terrain.size_m):
        # Beyond this the filter leaves only rounding errors to scale up.
        message = (
            f"{terrain.filter_sigma_m:g} exceeds half of the shorter side of terrain.size_m "
            f"({min(terrain.size_m):g} m); lower it or enlarge the terrain"
        )
        raise ScenarioError([Problem("terrain.filter_sigma_m", message)])
    noise = np.random.default_rng(terrain.seed).standard_normal(grid.shape)
    # Wrapped, every cell averages equally many independent neighbours; a mirrored or repeated edge
    # would count some twice and make the hills rougher along the border.
    return _scaled(_filtered(noise, terrain.filter_sigma_m / terrain.spacing_m), grid, terrain.height_m)


def _filtered(noise: Float[np.ndarray, "row column"], sigma: float) -> Float[np.ndarray, "row column"]:
    """Return noise under a wrapped Gaussian filter of so many cells."""
    if noise.size * sigma < MOST_DIRECT_FILTERING:
        return gaussian_filter(noise, sigma, mode="wrap")
    spectrum = np.fft.rfft2(noise)
    for axis, cells in enumerate(noise.shape):
        impulse = np.zeros(cells)
        impulse[0] = 1.0
        # The same taps as above, so that a terrain does not depend on which way it was filtered.
        response = np.fft.fft(gaussian_filter1d(impulse, sigma, mode="wrap")).real
        spectrum *= response[:, None] if axis == 0 else response[: spectrum.shape[1]]
    return np.fft.irfft2(spectrum, s=noise.shape)


def _fractal(terrain: FractalTerrain) -> Raster:
    """Return white noise filtered to a power spectrum of k^-(2 H + 2), scaled to heights of 0 to `height_m`.

    The variance of differences over d is then the integral of (1 - J0(k d)) k^-(2 H + 2) k dk, which goes like d^2H.
    The surface repeats beyond its borders.
    """
    grid = _synthetic_grid(terrain)
    noise = np.random.default_rng(terrain.seed).standard_normal(grid.shape)
    wavenumber = np.hypot(np.fft.fftfreq(grid.rows)[:, None], np.fft.rfftfreq(grid.columns)[None])
    wavenumber[0, 0] = np.inf  # no mean
    surface = np.fft.irfft2(np.fft.rfft2(noise) * wavenumber ** -(terrain.hurst + 1), s=grid.shape)
    return _scaled(surface, grid, terrain.height_m)


def _scaled(surface: Float[np.ndarray, "row column"], grid: Grid, height_m: float) -> Raster:
    """Return a surface shifted and scaled to heights of 0 to `height_m`."""
    lowest, highest = surface.min(), surface.max()
    return Raster(grid=grid, height_m=(surface - lowest) * (height_m / (highest - lowest)))


def _stated(terrain: SampleTerrain | RasterTerrain) -> StatedFrame:
    if isinstance(terrain, SampleTerrain):
        # SRTM counts its heights from the EGM96 geoid.
        return StatedFrame(crs="EPSG:4326", vertical_crs="EPSG:5773", centre_lonlat_deg=terrain.centre_lonlat_deg)
    return StatedFrame(
        crs=terrain.crs,
        vertical_crs=terrain.vertical_crs,
        height_unit=terrain.height_unit,
        centre_lonlat_deg=terrain.centre_lonlat_deg,
    )


@contextmanager
def _opened(terrain: SampleTerrain | RasterTerrain) -> Iterator[Any]:
    if isinstance(terrain, RasterTerrain):
        with opened_file(terrain.path) as dataset:
            yield dataset
        return
    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as tile:
        # xmin, xmax and ymax are outer edges of the cells: the SRTM posts, whole multiples of 3 arc
        # seconds, fall on cell centres. "ymin" is wrong: it lies 344 rows NORTH of ymax. That ymax is the
        # northern edge follows from the highest cell, which so falls on Cross Mountain (36.1983 N,
        # 84.2306 W, 1077 m), and from the town of Jacksboro (36.33 N), which the other way is not inside.
        west, north = float(tile["xmin"]), float(tile["ymax"])
        dx, dy = float(tile["dx"]), float(tile["dy"])
        height_m = np.asarray(tile["elevation"])
    with opened_array(height_m, Affine(dx, 0.0, west, 0.0, -dy, north)) as dataset:
        yield dataset
