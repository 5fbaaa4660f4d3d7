"""Errors of surveys over the cells that all of them mapped, and areas too unequal for errors to be compared."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.raster import Raster

# Largest distance between corners of cells that coincide, in cells: map coordinates are rounded to a micrometre.
ALIGNED = 1e-3
# Largest difference of mapped areas, relative to the larger, between surveys whose errors may be compared as they are.
AREAS_ALIKE = 0.05


def unequal_areas(areas: Sequence[tuple[str, float]]) -> str:
    """Return the sentence about areas, by name, m2, that differ by more than `AREAS_ALIKE`; "" if they do not."""
    known = [(name, area) for name, area in areas if np.isfinite(area)]
    if len(known) < 2:
        return ""
    (least_name, least), (most_name, most) = (pick(known, key=lambda pair: pair[1]) for pick in (min, max))
    if most <= 0 or least >= (1 - AREAS_ALIKE) * most:
        return ""
    return (
        f"mapped areas differ by {1 - least / most:.0%} ({least:,.0f} m2 at {least_name}, {most:,.0f} m2 at "
        f"{most_name}), and an error over fewer cells may be smaller for that alone"
    )


def common_rms_m(errors: Sequence[Raster]) -> list[float] | None:
    """Return the RMS error of each map over the cells that all fill; None if there are none, or do not coincide.

    The maps are reduced one by one, so that no stack of them is held in memory.
    """
    windows = _common_windows(errors)
    if windows is None:
        return None
    common = np.logical_and.reduce([np.isfinite(window) for window in windows])
    if not common.any():
        return None
    return [float(np.sqrt(np.mean(window[common].astype(float) ** 2))) for window in windows]


def _common_windows(maps: Sequence[Raster]) -> list[Float[np.ndarray, "row column"]] | None:
    """Return the part of each map that all have in common; None if their cells do not coincide. NaN in empty cells."""
    if len({raster.grid.spacing_m for raster in maps}) != 1:  # or no maps
        return None
    transforms = np.array([raster.grid.transform for raster in maps])
    # Of the north-west corners: rows to the south, columns to the east.
    corner = np.column_stack([-transforms[:, 5], transforms[:, 2]]) / maps[0].grid.spacing_m
    start = corner.max(axis=0) - corner
    size = np.min([raster.grid.shape - first for raster, first in zip(maps, start, strict=True)], axis=0)
    if np.abs(start - np.round(start)).max() > ALIGNED or size.min() < 0.5:
        return None
    rows, columns = np.round(size).astype(int)
    starts = zip(maps, np.round(start).astype(int), strict=True)
    return [raster.height_m[::-1][row : row + rows, column : column + columns] for raster, (row, column) in starts]
