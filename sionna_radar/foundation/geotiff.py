"""Rasters as cloud-optimised GeoTIFFs: tiled, with overviews, statistics, units and what made them.

GDAL's COG driver writes them. They hold neither a date nor a path, so that equal surveys give equal files.
"""

import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

# Pixels along the side of a tile; overviews halve a raster until it fits into one.
TILE = 256


def write_pixels(
    path: Path,
    pixels: Float32[np.ndarray, "row column"],
    transform: tuple[float, ...],
    crs_wkt: str | None,
    description: str,
    unit: str,
    metadata: Mapping[str, str],
) -> None:
    """Write values as a cloud-optimised GeoTIFF.

    The band has its description, its unit, and the statistics of its pixels as GDAL names them (STATISTICS_MINIMUM,
    _MAXIMUM, _MEAN, _STDDEV, _VALID_PERCENT): programs show them without reading a pixel.

    Parameters
    ----------
    path:
        Where to write.
    pixels:
        Rows from north to south; an empty one is NaN.
    transform:
        The six numbers from columns and rows, counted from the north-west corner, to coordinates.
    crs_wkt:
        Their reference system; None for local metres.
    description, unit:
        Contents of the band.
    metadata:
        Metadata of the file, besides the band's description.

    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning
    from rasterio.transform import Affine

    profile = {
        "driver": "COG",
        "dtype": "float32",
        "count": 1,
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "nodata": np.nan,
        "crs": crs_wkt,
        "transform": Affine(*transform),
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
            file.units = (unit,)
            file.update_tags(1, **_statistics(pixels))
            file.update_tags(**metadata, QUANTITY=description, UNITS=unit)


def _statistics(pixels: Float32[np.ndarray, "row column"]) -> dict[str, str]:
    """Return the statistics of the filled pixels, as written; without any, only that there is none."""
    values = pixels[np.isfinite(pixels)].astype(float)
    share = {"STATISTICS_VALID_PERCENT": f"{100 * len(values) / max(pixels.size, 1):.4g}"}
    if len(values) == 0:
        return share
    found = {"MINIMUM": values.min(), "MAXIMUM": values.max(), "MEAN": values.mean(), "STDDEV": values.std()}
    return {f"STATISTICS_{name}": repr(float(value)) for name, value in found.items()} | share
