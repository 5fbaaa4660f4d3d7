"""Comparing a DEM with the true surface."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.raster import Raster

LE90_MEANING = (
    "90th percentile of |error|, bias included; tools that report the width |P95 - P5| print about twice as much"
)


@dataclass(frozen=True, kw_only=True)
class DemError:
    """Elevation error, DEM minus truth, over the cells where both have a height.

    count: number of those cells.
    coverage: their share of the illuminated cells that have a truth.
    nmad_m: 1.4826 times the median absolute deviation from the median error: the standard deviation of a normal
        distribution with the same middle half, robust to outliers.
    le90_m: linear error at 90 %: the 90th percentile of |error|, bias included. Some tools use the name for the width
        |P95 - P5|, about twice as much for normal errors.
    """

    count: int
    coverage: float
    min_m: float
    max_m: float
    std_m: float
    mean_m: float
    rms_m: float
    nmad_m: float
    le90_m: float


def difference(dem: Raster, truth: Raster) -> Raster:
    """Return DEM minus truth on their common grid.

    Raises ValueError where their grids differ.
    """
    if dem.grid != truth.grid:
        message = f"DEM and truth lie on different grids, {dem.grid} and {truth.grid}; sample one on the other"
        raise ValueError(message)
    return Raster(grid=dem.grid, height_m=dem.height_m - truth.height_m)


def summarise(error: Raster, illuminated: Bool[np.ndarray, "row column"]) -> DemError:
    """Return the statistics of an error raster.

    Parameters
    ----------
    error:
        DEM minus truth; empty where either is.
    illuminated:
        Cells that the survey could have mapped, the reference of the coverage.

    """
    values: Float[np.ndarray, " cell"] = error.height_m[error.filled]
    if len(values) == 0:
        nan = float("nan")
        return DemError(
            count=0, coverage=0.0, min_m=nan, max_m=nan, std_m=nan, mean_m=nan, rms_m=nan, nmad_m=nan, le90_m=nan
        )
    mappable = int(illuminated.sum())
    return DemError(
        count=len(values),
        coverage=float((error.filled & illuminated).sum() / mappable) if mappable else 0.0,
        min_m=float(values.min()),
        max_m=float(values.max()),
        std_m=float(values.std()),
        mean_m=float(values.mean()),
        rms_m=float(np.sqrt(np.mean(values**2))),
        nmad_m=float(1.4826 * np.median(np.abs(values - np.median(values)))),
        le90_m=float(np.percentile(np.abs(values), 90)),
    )
