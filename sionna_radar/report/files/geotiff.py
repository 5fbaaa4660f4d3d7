"""Rasters as cloud-optimised GeoTIFFs: tiled, with overviews, statistics, units and what made them.

GDAL's COG driver writes them. They hold neither a date nor a path, so that equal surveys give equal files.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from sionna_radar.foundation.raster import Georeference, Grid, Raster

# Pixels along the side of a tile; overviews halve a raster until it fits into one.
TILE = 256


def write_geotiff(
    path: Path,
    raster: Raster,
    georeference: Georeference | None,
    description: str,
    height_offset_m: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a raster as a cloud-optimised GeoTIFF of float32, rows from north to south and empty cells NaN.

    The band has its description, its unit, and the statistics of its pixels as GDAL names them (STATISTICS_MINIMUM,
    _MAXIMUM, _MEAN, _STDDEV, _VALID_PERCENT): programs show them without reading a pixel.

    Parameters
    ----------
    path:
        Where to write.
    raster:
        Heights in the local frame.
    georeference:
        Place of the local frame; without one the file has local coordinates and no CRS.
    description:
        What the band holds.
    height_offset_m:
        Offset added to the heights.
    metadata:
        Metadata of the file, besides the band's description.

    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.transform import Affine

    grid = raster.grid
    pixels = (raster.height_m[::-1] + height_offset_m).astype(np.float32)
    profile = {
        "driver": "COG",
        "dtype": "float32",
        "count": 1,
        "height": grid.rows,
        "width": grid.columns,
        "nodata": np.nan,
        "crs": georeference.crs_wkt if georeference else None,
        "transform": Affine(*_transform(grid, georeference)),
        "blocksize": TILE,
        "compress": "deflate",
        "predictor": "YES",
        # The default of the driver depends on the version of GDAL; an average leaves out empty cells.
        "overview_resampling": "average",
        "num_threads": "1",
    }
    with warnings.catch_warnings():
        # rasterio takes a local raster of unit cells in the corner of the frame for one without a transform.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as file:
            file.write(pixels, 1)
            file.set_band_description(1, description)
            file.units = ("m",)
            file.update_tags(1, **_statistics(pixels))
            file.update_tags(**(metadata or {}), QUANTITY=description, UNITS="m")


def _statistics(pixels: Float32[np.ndarray, "row column"]) -> dict[str, str]:
    """Return the statistics of the filled pixels, as written; without any, only that there is none."""
    values = pixels[np.isfinite(pixels)].astype(float)
    share = {"STATISTICS_VALID_PERCENT": f"{100 * len(values) / max(pixels.size, 1):.4g}"}
    if len(values) == 0:
        return share
    found = {"MINIMUM": values.min(), "MAXIMUM": values.max(), "MEAN": values.mean(), "STDDEV": values.std()}
    return {f"STATISTICS_{name}": repr(float(value)) for name, value in found.items()} | share


def _transform(grid: Grid, georeference: Georeference | None) -> tuple[float, ...]:
    """Return the six numbers from columns and rows, counted from the north-west corner, to coordinates."""
    east_m, north_m = georeference.origin_m[:2] if georeference else (0.0, 0.0)
    west_edge, _, _, north_edge = grid.extent_m
    size = grid.spacing_m
    # To a micrometre: sums of local and map coordinates have round-off that other rasters of the same cells lack.
    # Not rasterio's from_origin: its multiplication causes a warning with affine 3.
    return size, 0.0, round(west_edge + east_m, 6), 0.0, -size, round(north_edge + north_m, 6)
