"""Ground from elevation rasters (the user's, and the SRTM tile in matplotlib's sample data) and point clouds."""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, Int
from pyproj import CRS

from sionna_radar.elevation.elevation_file import (
    MAX_CELLS,
    MOVE,
    Cutout,
    check_spacing,
    cut,
    opened_file,
    warn_of_coarser_cells,
)
from sionna_radar.elevation.file_heights import detail_on, treat_holes
from sionna_radar.elevation.local_frame import (
    MapFrame,
    StatedFrame,
    frame_about,
    horizontal_crs_of,
    place_file,
    stated_crs,
)
from sionna_radar.elevation.placed_raster import HeightSystem, cloud_height_system
from sionna_radar.elevation.point_cloud import CloudFile, Piece, PlacedCloud, gridded, open_cloud
from sionna_radar.elevation.wrong_cells import warn_of_lone_cells
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Georeference, Grid, Raster, spans
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


def _sample_data() -> Path:
    """Return the folder of matplotlib's sample data; the package itself, slow to load, is not imported."""
    found = find_spec("matplotlib")
    assert found is not None, "matplotlib is a dependency"
    assert found.origin is not None
    return Path(found.origin).parent / "mpl-data" / "sample_data"


@contextmanager
def _opened(path: Path | str | None) -> Iterator[Any]:
    if path is not None:
        with opened_file(path) as dataset:
            yield dataset
        return
    # rasterio, which nothing but a file needs, takes long to import.
    from rasterio import Affine

    from sionna_radar.foundation.raster_file import opened_array

    with np.load(_sample_data() / "jacksboro_fault_dem.npz") as tile:
        # xmin, xmax and ymax are outer edges of the cells: the SRTM posts, whole multiples of 3 arc
        # seconds, are cell centres. "ymin" is wrong: it is 344 rows NORTH of ymax. That ymax is the
        # northern edge follows from the highest cell, which then is on Cross Mountain (36.1983 N,
        # 84.2306 W, 1077 m), and from the town of Jacksboro (36.33 N), which otherwise is outside.
        west, north = float(tile["xmin"]), float(tile["ymax"])
        dx, dy = float(tile["dx"]), float(tile["dy"])
        height_m = np.asarray(tile["elevation"])
    with opened_array(height_m, Affine(dx, 0.0, west, 0.0, -dy, north)) as dataset:
        yield dataset


# Default spacing: mean number of points per cell, and least spacing in metres.
POINTS_IN_CELL, FINEST_M = 4, 0.05


def place_cloud(cloud: CloudFile, stated: StatedFrame) -> PlacedCloud:
    """Return the placement of a cloud: CRS, local frame, middle and height system.

    Raises ScenarioError for an invalid CRS, or one that does not contain the cloud.
    """
    file_crs = _crs_of(cloud, stated)
    if file_crs is None:
        if stated.centre_lonlat_deg is not None:
            message = "the file has no CRS; give terrain.crs, or remove terrain.centre_lonlat_deg"
            raise ScenarioError.of("terrain.centre_lonlat_deg", message)
        unit_m = {"ft": 0.3048, "ftUS": 1200 / 3937}.get(stated.height_unit or "m", 1.0)
        return PlacedCloud(crs=None, frame=None, middle=cloud.middle, heights=HeightSystem(unit_m=unit_m))
    crs = horizontal_crs_of(file_crs)
    frame = frame_about(crs, cloud.middle, stated.centre_lonlat_deg, "cloud's middle")
    heights = cloud_height_system(file_crs, stated.vertical_crs, stated.height_unit)
    return PlacedCloud(crs=crs, frame=frame, middle=cloud.middle, heights=heights)


def _crs_of(cloud: CloudFile, stated: StatedFrame) -> CRS | None:
    if stated.crs is not None:
        return stated_crs(stated.crs)
    return CRS.from_wkt(cloud.crs_wkt) if cloud.crs_wkt else None


@dataclass(frozen=True, kw_only=True)
class CloudSource:
    """A point cloud as ground.

    stated: what the file does not say of its own frame.
    points: which of its points count. statistic, percentile: of their heights in a cell.
    spacing_m: of the cells; None for four points in one on average.
    holes: what cells without points become.
    """

    path: Path
    stated: StatedFrame
    points: Literal["first", "ground", "all"] = "first"
    statistic: Literal["mean", "max", "percentile"] = "mean"
    percentile: float = 50.0
    spacing_m: float | None = None
    holes: Literal["keep", "fill", "refuse"] = "fill"


def cloud_frame(source: CloudSource) -> MapFrame | None:
    """Return the local frame of a cloud on the map; None for one without a CRS."""
    with open_cloud(source.path) as cloud:
        return place_cloud(cloud, source.stated).frame


def points(source: CloudSource, cover: GroundCover, window_m: tuple[float, float, float, float]) -> Landscape:
    """Return the ground of a point cloud, gridded within the survey's window."""
    with open_cloud(source.path) as cloud:
        placed = place_cloud(cloud, source.stated)
        grid = _grid(cloud, placed, source.spacing_m, window_m)

        def pieces() -> Iterator[Piece]:
            return cloud.pieces(source.points, placed.local_of, placed.heights.unit_m)

        raster = gridded(pieces, grid, source.statistic, source.percentile / 100)
    if not raster.filled.any():
        message = f"no point chosen by points = {source.points!r} lies in the part that is flown, {spans(window_m)}, "
        message += f"and the cloud covers {spans(cloud.extent_m(placed.local_of))}; move the flight"
        if source.points == "ground":
            message += ", or set points = 'first' if the file is not classified"
        raise ScenarioError.of("terrain.points", message)

    def place(row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        origin_m = (0.0, 0.0) if placed.frame is None else placed.frame.origin_m
        return np.column_stack([grid.x_m[column], grid.y_m[row]]) + origin_m

    warn_of_lone_cells(raster.height_m, grid.spacing_m, place, None if placed.frame is None else placed.frame.crs)
    raster = treat_holes(raster, source.holes)
    corners = raster.filled
    if not (corners[:-1, :-1] & corners[:-1, 1:] & corners[1:, :-1] & corners[1:, 1:]).any():
        message = f"{grid.spacing_m:g} m leaves no 2 x 2 cells with points; raise it, or set terrain.holes = 'fill'"
        raise ScenarioError.of("terrain.spacing_m", message)
    if placed.frame is None:
        return covered_landscape(_lowered(raster, 0.0), cover)
    base_m = float(math.floor(np.nanmin(raster.height_m)))
    georeference = Georeference(
        crs_wkt=placed.heights.compound(placed.frame.crs).to_wkt(), origin_m=(*placed.frame.origin_m, base_m)
    )
    return covered_landscape(_lowered(raster, base_m), cover, georeference)


def _lowered(raster: Raster, base_m: float) -> Raster:
    return Raster(grid=raster.grid, height_m=raster.height_m - base_m)


def _grid(
    cloud: CloudFile, placed: PlacedCloud, spacing_m: float | None, window_m: tuple[float, float, float, float]
) -> Grid:
    """Return the cells of the part of the cloud visible to the survey."""
    cloud_m = cloud.extent_m(placed.local_of)
    west, south = (max(ours, theirs) for ours, theirs in zip(cloud_m[:2], window_m[:2], strict=True))
    east, north = (min(ours, theirs) for ours, theirs in zip(cloud_m[2:], window_m[2:], strict=True))
    if not (west < east and south < north):
        message = f"the flight sees {spans(window_m)}, but the cloud covers {spans(cloud_m)}; {MOVE}"
        raise ScenarioError.of("terrain", message)
    area_m2 = (cloud_m[2] - cloud_m[0]) * (cloud_m[3] - cloud_m[1])
    spacing = spacing_m or max(FINEST_M, float(f"{math.sqrt(POINTS_IN_CELL * area_m2 / cloud.points):.2g}"))
    min_spacing = math.sqrt((east - west) * (north - south) / MAX_CELLS)
    if spacing < min_spacing:
        requested, spacing = spacing, math.ceil(min_spacing * 100) / 100
        warn_of_coarser_cells(requested, spacing)
    check_spacing(spacing, east - west, north - south)
    columns, rows = (max(2, int((upper - lower) / spacing)) for lower, upper in ((west, east), (south, north)))
    return Grid(west_m=west + spacing / 2, south_m=south + spacing / 2, spacing_m=spacing, columns=columns, rows=rows)
