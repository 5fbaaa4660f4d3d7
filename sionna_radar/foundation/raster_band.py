"""Values of a raster's band: what is stored, its scale and offset, and what stands for no data."""

from typing import Any

import numpy as np
from jaxtyping import Float

# A stand-in for "no data" that many files do not declare: below any land, as a height.
UNDECLARED_NODATA = -9999.0


def band_values(dataset: Any, stored: Any, band: int = 1) -> Float[np.ndarray, "row column"]:
    """Return the values of a band of an open raster (rasterio), of its number from 1, in the band's unit.

    NaN where the file declares no data, or stores `UNDECLARED_NODATA`.
    stored: masked array of what was read of it.
    """
    with np.errstate(invalid="ignore"):  # a signalling NaN in a damaged file
        values: Float[np.ndarray, "row column"] = stored.astype(np.float64).filled(np.nan)
    values[values == UNDECLARED_NODATA] = np.nan
    return values * dataset.scales[band - 1] + dataset.offsets[band - 1]
