"""Synthetic terrains: flat ground, hills and fractal relief."""

import math

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario.terrain import FlatTerrain, FractalTerrain, HillsTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs, landscape_of_heights

MAX_SYNTHETIC_CELLS = 16_000_000


def synthetic_grid(terrain: FlatTerrain | HillsTerrain | FractalTerrain) -> Grid:
    """Return the grid whose outermost centres bound the terrain, so that its mesh has the full size."""
    # The tolerance keeps 1.1 / 0.1 = 11.000000000000002 from adding a twelfth cell.
    columns, rows = (math.ceil(size / terrain.spacing_m - 1e-9) + 1 for size in terrain.size_m)
    if terrain.spacing_m > min(terrain.size_m):
        message = f"{terrain.spacing_m:g} exceeds the shorter side of terrain.size_m ({min(terrain.size_m):g} m)"
        raise ScenarioError([Problem("terrain.spacing_m", message)])
    if columns * rows > MAX_SYNTHETIC_CELLS:
        message = (
            f"{terrain.spacing_m:g} gives {columns * rows:,} cells, more than {MAX_SYNTHETIC_CELLS:,}; "
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


def scaled(surface: Float[np.ndarray, "row column"], grid: Grid, height_m: float) -> Raster:
    """Return a surface shifted and scaled to heights of 0 to `height_m`."""
    lowest, highest = surface.min(), surface.max()
    return Raster(grid=grid, height_m=(surface - lowest) * (height_m / (highest - lowest)))


def flat(terrain: FlatTerrain, given: TerrainInputs) -> Landscape:
    """Return level ground at height zero."""
    grid = synthetic_grid(terrain)
    return landscape_of_heights(Raster(grid=grid, height_m=np.zeros(grid.shape)), terrain)


# Cells times filter width up to which direct convolution is used; above, Fourier transforms are faster.
MAX_DIRECT_FILTERING = 1e6


def hills(terrain: HillsTerrain, given: TerrainInputs) -> Landscape:
    """Return white noise under a Gaussian filter, shifted and scaled to heights of 0 to `height_m`."""
    grid = synthetic_grid(terrain)
    if terrain.filter_sigma_m > 0.5 * min(terrain.size_m):
        # A wider filter leaves only rounding errors.
        message = (
            f"{terrain.filter_sigma_m:g} exceeds half of the shorter side of terrain.size_m "
            f"({min(terrain.size_m):g} m); lower it or enlarge the terrain"
        )
        raise ScenarioError([Problem("terrain.filter_sigma_m", message)])
    noise = np.random.default_rng(terrain.seed).standard_normal(grid.shape)
    # Periodic filtering averages the same number of independent cells everywhere; mirrored or repeated edges
    # would make the hills rougher along the border.
    surface = _filtered(noise, terrain.filter_sigma_m / terrain.spacing_m)
    return landscape_of_heights(scaled(surface, grid, terrain.height_m), terrain)


def _filtered(noise: Float[np.ndarray, "row column"], sigma: float) -> Float[np.ndarray, "row column"]:
    """Return noise under a wrapped Gaussian filter of the given width in cells."""
    if noise.size * sigma < MAX_DIRECT_FILTERING:
        return gaussian_filter(noise, sigma, mode="wrap")
    spectrum = np.fft.rfft2(noise)
    for axis, cells in enumerate(noise.shape):
        impulse = np.zeros(cells)
        impulse[0] = 1.0
        # Same taps as above: the terrain does not depend on the method of filtering.
        response = np.fft.fft(gaussian_filter1d(impulse, sigma, mode="wrap")).real
        spectrum *= response[:, None] if axis == 0 else response[: spectrum.shape[1]]
    return np.fft.irfft2(spectrum, s=noise.shape)


def fractal(terrain: FractalTerrain, given: TerrainInputs) -> Landscape:
    """Return white noise filtered to a power spectrum of k^-(2 H + 2), scaled to heights of 0 to `height_m`.

    The variance of differences over d is then the integral of (1 - J0(k d)) k^-(2 H + 2) k dk, proportional to d^2H.
    The surface is periodic.
    """
    grid = synthetic_grid(terrain)
    noise = np.random.default_rng(terrain.seed).standard_normal(grid.shape)
    wavenumber = np.hypot(np.fft.fftfreq(grid.rows)[:, None], np.fft.rfftfreq(grid.columns)[None])
    wavenumber[0, 0] = np.inf  # no mean
    surface = np.fft.irfft2(np.fft.rfft2(noise) * wavenumber ** -(terrain.hurst + 1), s=grid.shape)
    return landscape_of_heights(scaled(surface, grid, terrain.height_m), terrain)
