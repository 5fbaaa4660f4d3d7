"""Geometric radar shadow: ground within the scan that is hidden from the radar."""

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.raster import Raster
from sionna_radar.scene.raycast import RayCaster

TOLERANCE_M = 0.05


def shadowed(
    truth: Raster,
    caster: RayCaster,
    track_m: Float[np.ndarray, "2 3"],
    incidence_rad: float,
    half_swath_rad: float,
) -> Bool[np.ndarray, "row column"]:
    """Return which cells of the true surface a whisk-broom scan passes over without seeing them.

    The angle between beam and track is the complement of the incidence. A cell that is y across and z below the
    track is therefore scanned from the place x = tan(incidence) hypot(y, z) short of it, and only from there.

    Parameters
    ----------
    truth, caster:
        The true surface as a raster, and rays against it.
    track_m:
        Start and end of a straight, level flight.
    incidence_rad, half_swath_rad:
        The scan.

    """
    start, end = track_m
    length = float(np.linalg.norm(end - start))
    ahead = (end - start) / length
    cell = np.column_stack([truth.grid.centres_m, truth.height_m.ravel()])
    cell[:, 2] = np.where(np.isfinite(cell[:, 2]), cell[:, 2], 0.0)
    offset = cell - start
    across = offset[:, 0] * ahead[1] - offset[:, 1] * ahead[0]
    below = -offset[:, 2]
    along = offset @ ahead - np.tan(incidence_rad) * np.hypot(across, below)
    scanned = (along >= 0) & (along <= length) & (np.abs(np.arctan2(across, below)) <= half_swath_rad)
    scanned &= truth.filled.ravel()
    seen = caster.visible(start + along[:, None] * ahead, cell, TOLERANCE_M)
    return (scanned & ~seen).reshape(truth.grid.shape)
