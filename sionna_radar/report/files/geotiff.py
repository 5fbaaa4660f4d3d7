"""Rasters of a survey as cloud-optimised GeoTIFFs, in map coordinates where the scenario is georeferenced."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sionna_radar.foundation.geotiff import write_pixels
from sionna_radar.foundation.raster import Georeference, Raster


def write_geotiff(
    path: Path,
    raster: Raster,
    georeference: Georeference | None,
    description: str,
    height_offset_m: float,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a raster as a cloud-optimised GeoTIFF of float32, rows from north to south and empty cells NaN.

    The band has its description, its unit, and GDAL's pixel statistics (STATISTICS_MINIMUM, _MAXIMUM, _MEAN, _STDDEV,
    _VALID_PERCENT), which programs show without reading a pixel.

    Parameters
    ----------
    path:
        Output file.
    raster:
        Heights in the local frame.
    georeference:
        Georeference of the local frame; without one the file has local coordinates and no CRS.
    description:
        Quantity of the band.
    height_offset_m:
        Offset added to the heights.
    metadata:
        Metadata of the file, besides the band's description.

    """
    pixels = (raster.height_m[::-1] + height_offset_m).astype(np.float32)
    crs_wkt = georeference.crs_wkt if georeference else None
    write_pixels(path, pixels, raster.grid.transform(georeference), crs_wkt, description, metadata)
