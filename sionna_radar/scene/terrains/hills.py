"""Seeded Gaussian hills."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.terrain import HillsTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs, landscape_of_heights, register_terrain
from sionna_radar.scene.terrains.synthetic import scaled, synthetic_grid

# Cells times filter width up to which a filter is applied tap by tap; above it Fourier transforms are faster.
MOST_DIRECT_FILTERING = 1e6


@register_terrain("hills", HillsTerrain)
def hills(terrain: HillsTerrain, given: TerrainInputs) -> Landscape:
    """Return white noise under a Gaussian filter, shifted and scaled to heights of 0 to `height_m`."""
    grid = synthetic_grid(terrain)
    if terrain.filter_sigma_m > 0.5 * min(terrain.size_m):
        # A wider filter leaves only rounding errors to scale up.
        message = (
            f"{terrain.filter_sigma_m:g} exceeds half of the shorter side of terrain.size_m "
            f"({min(terrain.size_m):g} m); lower it or enlarge the terrain"
        )
        raise ScenarioError([Problem("terrain.filter_sigma_m", message)])
    noise = np.random.default_rng(terrain.seed).standard_normal(grid.shape)
    # With wrap-around, every cell averages equally many independent neighbours; a mirrored or repeated edge
    # would count some twice and make the hills rougher along the border.
    surface = _filtered(noise, terrain.filter_sigma_m / terrain.spacing_m)
    return landscape_of_heights(scaled(surface, grid, terrain.height_m), terrain)


def _filtered(noise: Float[np.ndarray, "row column"], sigma: float) -> Float[np.ndarray, "row column"]:
    """Return noise under a wrapped Gaussian filter of the given width in cells."""
    if noise.size * sigma < MOST_DIRECT_FILTERING:
        return gaussian_filter(noise, sigma, mode="wrap")
    spectrum = np.fft.rfft2(noise)
    for axis, cells in enumerate(noise.shape):
        impulse = np.zeros(cells)
        impulse[0] = 1.0
        # The same taps as above, so that a terrain does not depend on the method of filtering.
        response = np.fft.fft(gaussian_filter1d(impulse, sigma, mode="wrap")).real
        spectrum *= response[:, None] if axis == 0 else response[: spectrum.shape[1]]
    return np.fft.irfft2(spectrum, s=noise.shape)
