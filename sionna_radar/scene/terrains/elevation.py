"""Ground from elevation rasters: the user's, and the SRTM tile in matplotlib's sample data."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.cbook import get_sample_data
from rasterio import Affine

from sionna_radar.elevation.elevation_file import Cutout, cut, opened_array, opened_file
from sionna_radar.elevation.file_heights import detail_on, treat_holes
from sionna_radar.elevation.local_frame import MapFrame, StatedFrame, place_file
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario.terrain import RasterTerrain, Roughness, SampleTerrain
from sionna_radar.scene.landscape import Landscape, TerrainInputs, landscape_of_heights

logger = logging.getLogger("sionna_radar")

# Refinement factor of a roughened terrain's cells relative to the file's.
FINER = 10


def file_frame(terrain: SampleTerrain | RasterTerrain) -> MapFrame:
    """Return the local frame of a terrain's elevation file.

    Raises ScenarioError or InputFileError if it cannot be read or georeferenced.
    """
    with _opened(terrain) as dataset:
        placed = place_file(dataset, _stated(terrain))
    return MapFrame(crs=placed.local, origin_m=placed.origin)


def elevation(terrain: SampleTerrain | RasterTerrain, given: TerrainInputs) -> Landscape:
    """Return the ground of an elevation raster, read only within the survey's window."""
    with _opened(terrain) as dataset:
        post_m = min(place_file(dataset, _stated(terrain)).steps_m)
        spacing_m = terrain.spacing_m
        if isinstance(terrain, RasterTerrain) and terrain.roughen and spacing_m is None:
            spacing_m = post_m / FINER
        cutout = Cutout(window_m=given.window_m, frame=_stated(terrain), spacing_m=spacing_m)
        raster, georeference = cut(dataset, cutout)
    if isinstance(terrain, RasterTerrain):
        raster = _roughened(treat_holes(raster, terrain.holes), post_m, terrain.roughen)
        if terrain.roughen:
            return landscape_of_heights(raster, terrain, georeference)
    land = landscape_of_heights(raster, terrain, georeference)
    return replace(land, posting_m=max(post_m, raster.grid.spacing_m))


def _roughened(raster: Raster, post_m: float, roughness: Roughness | None) -> Raster:
    if roughness is None:
        return raster
    detail_m = detail_on(raster.grid, post_m, roughness.hurst, roughness.rms_m, roughness.seed)
    logger.warning(
        "terrain: seeded detail of %g m RMS (Hurst exponent %g) is added below the file's spacing of %.3g m; the file "
        "does not have it",
        roughness.rms_m,
        roughness.hurst,
        post_m,
    )
    return Raster(grid=raster.grid, height_m=raster.height_m + detail_m)


def _stated(terrain: SampleTerrain | RasterTerrain) -> StatedFrame:
    if isinstance(terrain, SampleTerrain):
        # SRTM heights refer to the EGM96 geoid.
        return StatedFrame(crs="EPSG:4326", vertical_crs="EPSG:5773", centre_lonlat_deg=terrain.centre_lonlat_deg)
    return StatedFrame(
        crs=terrain.crs,
        vertical_crs=terrain.vertical_crs,
        height_unit=terrain.height_unit,
        centre_lonlat_deg=terrain.centre_lonlat_deg,
    )


@contextmanager
def _opened(terrain: SampleTerrain | RasterTerrain) -> Iterator[Any]:
    if isinstance(terrain, RasterTerrain):
        with opened_file(terrain.path) as dataset:
            yield dataset
        return
    with np.load(get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as tile:
        # xmin, xmax and ymax are outer edges of the cells: the SRTM posts, whole multiples of 3 arc
        # seconds, are cell centres. "ymin" is wrong: it is 344 rows NORTH of ymax. That ymax is the
        # northern edge follows from the highest cell, which then is on Cross Mountain (36.1983 N,
        # 84.2306 W, 1077 m), and from the town of Jacksboro (36.33 N), which otherwise is outside.
        west, north = float(tile["xmin"]), float(tile["ymax"])
        dx, dy = float(tile["dx"]), float(tile["dy"])
        height_m = np.asarray(tile["elevation"])
    with opened_array(height_m, Affine(dx, 0.0, west, 0.0, -dy, north)) as dataset:
        yield dataset
