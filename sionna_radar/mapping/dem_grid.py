"""The cells of a survey's DEM."""

import numpy as np

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.coverage import closing_cells

# West, south, east and north in local metres.
Extent = tuple[float, float, float, float]

MAX_DEM_CELLS = 25_000_000
MAX_CLOSED_CELLS = 100_000_000


def dem_grid(spacing_m: float, extent_m: Extent, max_gap_m: float, place: Georeference | None) -> Grid:
    """Return the cells of the DEM: the map's where the terrain has a place on it, so that other rasters fit it.

    Parameters
    ----------
    spacing_m:
        Size of the cells.
    extent_m:
        Ground that the beam's axis meets.
    max_gap_m:
        Widest gap that a map of them closes.
    place:
        Georeference of the local frame, if it has one.

    Raises
    ------
    ScenarioError
        There are too many cells, or too many in a gap.

    """
    west, south, east, north = extent_m
    cells = (east - west + 2 * spacing_m) * (north - south + 2 * spacing_m) / spacing_m**2
    if cells > MAX_DEM_CELLS:
        enough = spacing_m * 1.05 * np.sqrt(cells / MAX_DEM_CELLS)
        message = (
            f"{spacing_m:g} m makes {cells:.3g} cells of {east - west:.0f} x {north - south:.0f} m, more than "
            f"{MAX_DEM_CELLS:,}; raise it to {enough:.2g}"
        )
        raise ScenarioError([Problem("dem.spacing_m", message)])
    centre_m = place.cell_centre_m(spacing_m) if place else (0.0, 0.0)
    grid = Grid.covering(west, south, east, north, spacing_m, centre_m)
    border = 2 * closing_cells(max_gap_m, spacing_m)
    if (grid.rows + border) * (grid.columns + border) > MAX_CLOSED_CELLS:
        message = (
            f"gaps of {max_gap_m:.3g} m (without the key: as wide as the beams lie apart) are {border:,} cells of "
            f"{spacing_m:g} m wide; give a smaller one, or raise dem.spacing_m"
        )
        raise ScenarioError([Problem("dem.max_gap_m", message)])
    return grid
