"""Probability of each point to be of the ground, from a map of the ground and the plants on it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from sionna_radar.mapping.mapper import Estimate
from sionna_radar.mapping.points import Points

# Among plants an echo is as probably of the ground as of them, before its height is known.
GROUND_AMONG_PLANTS = 0.5


def classified(points: Points, estimate: Estimate) -> Points:
    """Return points with `ground_probability`; as they are where the map knows one surface.

    The height of a point of the ground is normal about the ground, with the errors of both. One of plants is anywhere
    between ground and top, as probably at each height, with the same errors. Beyond the map it is of the ground.
    """
    canopy = estimate.canopy
    if canopy is None:
        return points
    dem, sigma = canopy.ground, canopy.ground_sigma
    row, column, inside = dem.grid.cell_of(points.position_m[:, :2])
    row, column = np.where(inside, row, 0), np.where(inside, column, 0)

    def here(values: Float[np.ndarray, "row column"]) -> Float[np.ndarray, " point"]:
        return np.where(inside, values[row, column], np.nan)

    # What points and map share moves none against the other.
    own_m2 = np.maximum(here(sigma.height_m) ** 2 - points.shared_height_sigma_m**2, 0.0)
    # The ground of a map is that of the cell's middle, and the mean of an echo is over its footprint.
    relief_m = _relief(dem.height_m)[row, column]
    error_m = np.sqrt((points.steepness * points.range_sigma_m) ** 2 + own_m2 + relief_m**2)
    above_m = points.position_m[:, 2] - here(dem.height_m)
    plants, height_m = here(canopy.plants.height_m), np.maximum(here(canopy.height.height_m), error_m)
    of_ground = np.exp(-0.5 * (above_m / error_m) ** 2) / (np.sqrt(2 * np.pi) * error_m)
    of_plants = (ndtr(above_m / error_m) - ndtr((above_m - height_m) / error_m)) / height_m
    of_ground = of_ground * (1 - plants * (1 - GROUND_AMONG_PLANTS))
    of_plants = of_plants * plants * (1 - GROUND_AMONG_PLANTS)
    both = of_ground + of_plants
    # Far from both it is of what is nearer.
    far = both <= 0
    probability = np.where(far, above_m < height_m / 2, of_ground / np.where(far, 1.0, both))
    return replace(points, ground_probability=np.where(np.isfinite(above_m), probability, 1.0).astype(float))


def _relief(height_m: Float[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
    """Return the standard deviation of heights within each cell, from the slopes to its neighbours; 0 where unknown."""
    east, north = (np.nan_to_num(np.gradient(height_m, axis=axis)) for axis in (1, 0))
    return np.sqrt((east**2 + north**2) / 12)
