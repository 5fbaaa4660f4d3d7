"""Synthetic terrains: flat ground, hills and fractal relief."""

import math

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster

MAX_SYNTHETIC_CELLS = 16_000_000


def synthetic_grid(size_m: tuple[float, float], spacing_m: float) -> Grid:
    """Return the grid whose outermost centres bound the terrain, so that its mesh has the full size."""
    # The tolerance keeps 1.1 / 0.1 = 11.000000000000002 from adding a twelfth cell.
    columns, rows = (math.ceil(size / spacing_m - 1e-9) + 1 for size in size_m)
    if spacing_m > min(size_m):
        message = f"{spacing_m:g} exceeds the shorter side of terrain.size_m ({min(size_m):g} m)"
        raise ScenarioError.of("terrain.spacing_m", message)
    if columns * rows > MAX_SYNTHETIC_CELLS:
        message = (
            f"{spacing_m:g} gives {columns * rows:,} cells, more than {MAX_SYNTHETIC_CELLS:,}; "
            "raise it or lower terrain.size_m"
        )
        raise ScenarioError.of("terrain.spacing_m", message)
    return Grid(
        west_m=-spacing_m * (columns - 1) / 2,
        south_m=-spacing_m * (rows - 1) / 2,
        spacing_m=spacing_m,
        columns=columns,
        rows=rows,
    )


def scaled(surface: Float[np.ndarray, "row column"], grid: Grid, height_m: float) -> Raster:
    """Return a surface shifted and scaled to heights of 0 to `height_m`."""
    lowest, highest = surface.min(), surface.max()
    return Raster(grid=grid, height_m=(surface - lowest) * (height_m / (highest - lowest)))


def flat(size_m: tuple[float, float], spacing_m: float) -> Raster:
    """Return level ground at height zero."""
    grid = synthetic_grid(size_m, spacing_m)
    return Raster(grid=grid, height_m=np.zeros(grid.shape))


# Cells times filter width up to which direct convolution is used; above, Fourier transforms are faster.
MAX_DIRECT_FILTERING = 1e6


def hills(size_m: tuple[float, float], spacing_m: float, filter_sigma_m: float, height_m: float, seed: int) -> Raster:
    """Return white noise under a Gaussian filter, shifted and scaled to heights of 0 to `height_m`."""
    grid = synthetic_grid(size_m, spacing_m)
    if filter_sigma_m > 0.5 * min(size_m):
        # A wider filter leaves only rounding errors.
        message = (
            f"{filter_sigma_m:g} exceeds half of the shorter side of terrain.size_m "
            f"({min(size_m):g} m); lower it or enlarge the terrain"
        )
        raise ScenarioError.of("terrain.filter_sigma_m", message)
    noise = np.random.default_rng(seed).standard_normal(grid.shape)
    # Periodic filtering averages the same number of independent cells everywhere; mirrored or repeated edges
    # would make the hills rougher along the border.
    surface = _filtered(noise, filter_sigma_m / spacing_m)
    return scaled(surface, grid, height_m)


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


def fractal(size_m: tuple[float, float], spacing_m: float, hurst: float, height_m: float, seed: int) -> Raster:
    """Return white noise filtered to a power spectrum of k^-(2 H + 2), scaled to heights of 0 to `height_m`.

    The variance of differences over d is then the integral of (1 - J0(k d)) k^-(2 H + 2) k dk, proportional to d^2H.
    The surface is periodic.
    """
    grid = synthetic_grid(size_m, spacing_m)
    noise = np.random.default_rng(seed).standard_normal(grid.shape)
    wavenumber = np.hypot(np.fft.fftfreq(grid.rows)[:, None], np.fft.rfftfreq(grid.columns)[None])
    wavenumber[0, 0] = np.inf  # no mean
    surface = np.fft.irfft2(np.fft.rfft2(noise) * wavenumber ** -(hurst + 1), s=grid.shape)
    return scaled(surface, grid, height_m)
