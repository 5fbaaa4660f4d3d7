"""The strip on which the echoes of a survey lie, and whether it is too narrow for a map."""

import numpy as np

from sionna_radar.mapping.points import Points

# Echoes on a strip narrower than this many cells count as a line; fewer echoes than the other always do.
NARROWEST_CELLS, LEAST_ON_STRIP = 3, 3


def strip_width_m(points: Points) -> float:
    """Return the width of the strip on which points lie, in plan view, m; 0 of too few."""
    if len(points) < LEAST_ON_STRIP:
        return 0.0
    place_m = points.position_m[:, :2] - points.position_m[:, :2].mean(axis=0)
    across = np.linalg.svd(place_m, full_matrices=False)[2][1]
    return float(np.ptp(place_m @ across))


def on_a_strip(points: Points, spacing_m: float) -> bool:
    """Return True for points on a strip of which no map with cells of `spacing_m` can be made."""
    return strip_width_m(points) < NARROWEST_CELLS * spacing_m
