"""Seeded self-affine ground."""

import numpy as np

from sionna_radar.scenario.terrain import FractalTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs, landscape_of_heights, register_terrain
from sionna_radar.scene.terrains.synthetic import scaled, synthetic_grid


@register_terrain("fractal", FractalTerrain)
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
