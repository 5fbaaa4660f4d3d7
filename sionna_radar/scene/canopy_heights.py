"""Heights of a stand's plants: a canopy-height raster, or a cloud's returns of plants less the scenario's terrain."""

import numpy as np
from jaxtyping import Float
from pyproj import CRS

from sionna_radar.elevation.local_frame import frame_of, horizontal_crs_of
from sionna_radar.elevation.placed_raster import HeightSystem, cloud_height_system
from sionna_radar.elevation.point_cloud import PlacedCloud, gridded, open_cloud
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference, Grid, Heights, box_around, spans
from sionna_radar.scene.ground_cover import raster_at
from sionna_radar.scene.vegetation import Stand

MAX_CELLS = 50_000_000


def plant_heights(
    georeference: Georeference | None,
    ground_m: Heights,
    stand: Stand,
    key: str,
    point_m: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    """Return the heights of a stand's plants above ground at horizontal positions; NaN without data.

    georeference, ground_m: of the terrain; the ground's height is NaN beyond it.
    stand, key: the stand, with a file, and its dotted key.
    point_m: east and north, local.

    Raises InputFileError if the file cannot be used.
    Raises ScenarioError if only one of it and the terrain is on the map.
    """
    assert stand.path is not None
    if stand.of_cloud:
        return _of_cloud(georeference, ground_m, stand, key, point_m)
    heights_m = np.full(len(point_m), np.nan)
    covered, cells = raster_at(stand.path, f"{key}.path", "heights of plants in metres", point_m, georeference)
    heights_m[covered] = np.ma.filled(cells.astype(np.float64), np.nan)
    return heights_m


def _of_cloud(
    georeference: Georeference | None,
    ground_m: Heights,
    stand: Stand,
    key: str,
    point_m: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, " n"]:
    """Return the height above ground of the highest point of the stand's classes in each cell."""
    assert stand.path is not None
    frame = frame_of(georeference)
    grid = Grid.covering(*box_around(point_m), stand.cloud_spacing_m)
    if grid.rows * grid.columns > MAX_CELLS:
        message = (
            f"{stand.cloud_spacing_m:g} makes {grid.rows * grid.columns:,} cells of the stand, more than "
            f"{MAX_CELLS:,}; raise it, or give a smaller polygon_m"
        )
        raise ScenarioError.of(f"{key}.cloud_spacing_m", message)
    with open_cloud(stand.path, f"{key}.path") as cloud:
        crs = None if cloud.crs_wkt is None else CRS.from_wkt(cloud.crs_wkt)
        if (crs is None) != (frame is None):
            raise ScenarioError.of(f"{key}.path", "either the cloud or the terrain has no CRS; give both, or none")
        placed = PlacedCloud(
            crs=None if crs is None else horizontal_crs_of(crs),
            frame=frame,
            middle=cloud.middle,
            heights=HeightSystem(unit_m=1.0) if crs is None else cloud_height_system(crs, key=key),
        )
        cloud_m = cloud.extent_m(placed.local_of)
        top = gridded(lambda: cloud.pieces(stand.classes, placed.local_of, placed.heights.unit_m), grid, "max", 0.0)
    if not top.filled.any():
        raise InputFileError(
            f"{key}.path = {shown(stand.path)}: has no points of the classes {', '.join(map(str, stand.classes))} in "
            f"the stand, {spans(box_around(point_m))}, and covers {spans(cloud_m)}; give the classes of its plants, or "
            "another file"
        )
    row, column, in_grid = grid.cell_of(point_m)
    # Ground height at the cell centres.
    base_m = ground_m(grid.centres_m).reshape(grid.shape)
    lowest_m = georeference.origin_m[2] if georeference else 0.0
    height = top.height_m - lowest_m - base_m
    return np.where(in_grid, height[row, column], np.nan)
