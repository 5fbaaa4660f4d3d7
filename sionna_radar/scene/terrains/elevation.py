"""Ground from elevation rasters: the user's, and the SRTM tile in matplotlib's sample data."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.cbook import get_sample_data
from rasterio import Affine

from sionna_radar.elevation.elevation_file import Cutout, cut, opened_array, opened_file
from sionna_radar.elevation.file_heights import detail_on, treat_holes
from sionna_radar.elevation.local_frame import MapFrame, StatedFrame, place_file
from sionna_radar.foundation.raster import Raster
from sionna_radar.scene.ground_cover import GroundCover
from sionna_radar.scene.landscape import Landscape, covered_landscape

logger = logging.getLogger("sionna_radar")

# Refinement factor of a roughened terrain's cells relative to the file's.
FINER = 10


# SRTM heights refer to the EGM96 geoid.
SAMPLE_CRS, SAMPLE_VERTICAL_CRS = "EPSG:4326", "EPSG:5773"


@dataclass(frozen=True, kw_only=True)
class Roughness:
    """Random self-affine relief finer than a file's posts: Hurst exponent, RMS height, seed."""

    hurst: float
    rms_m: float
    seed: int


@dataclass(frozen=True, kw_only=True)
class ElevationSource:
    """An elevation raster.

    path: file or URL; None for the sample tile.
    stated: frame settings of the scenario.
    spacing_m: of the cells; None for the file's, a tenth of it with roughness.
    holes: treatment of gaps; None for the sample tile.
    roughness: detail added below the file's spacing; None for none.
    """

    path: Path | str | None
    stated: StatedFrame
    spacing_m: float | None = None
    holes: Literal["keep", "fill", "refuse"] | None = None
    roughness: Roughness | None = None


def file_frame(source: ElevationSource) -> MapFrame:
    """Return the local frame of a terrain's elevation file.

    Raises ScenarioError or InputFileError if it cannot be read or georeferenced.
    """
    with _opened(source.path) as dataset:
        placed = place_file(dataset, source.stated)
    return MapFrame(crs=placed.local, origin_m=placed.origin)


def elevation(source: ElevationSource, cover: GroundCover, window_m: tuple[float, float, float, float]) -> Landscape:
    """Return the ground of an elevation raster, read only within the survey's window."""
    with _opened(source.path) as dataset:
        post_m = min(place_file(dataset, source.stated).steps_m)
        spacing_m = source.spacing_m
        if source.roughness is not None and spacing_m is None:
            spacing_m = post_m / FINER
        cutout = Cutout(window_m=window_m, frame=source.stated, spacing_m=spacing_m)
        raster, georeference = cut(dataset, cutout)
    if source.holes is not None:
        raster = treat_holes(raster, source.holes)
    if source.roughness is not None:
        return covered_landscape(_roughened(raster, post_m, source.roughness), cover, georeference)
    land = covered_landscape(raster, cover, georeference)
    return replace(land, posting_m=max(post_m, raster.grid.spacing_m))


def _roughened(raster: Raster, post_m: float, roughness: Roughness) -> Raster:
    detail_m = detail_on(raster.grid, post_m, roughness.hurst, roughness.rms_m, roughness.seed)
    logger.warning(
        "terrain: seeded detail of %g m RMS (Hurst exponent %g) is added below the file's spacing of %.3g m; the file "
        "does not have it",
        roughness.rms_m,
        roughness.hurst,
        post_m,
    )
    return Raster(grid=raster.grid, height_m=raster.height_m + detail_m)


@contextmanager
def _opened(path: Path | str | None) -> Iterator[Any]:
    if path is not None:
        with opened_file(path) as dataset:
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
