"""DEM error statistics against the true surface, and tests between the DEMs of two engines.

A randomisation test over tiles of the map decides whether two engines' DEMs differ by more than speckle. It takes four
DEMs of one survey, two seeds of each engine. If both engines see the same surface, the four are exchangeable in every
tile: whichever two are assigned to one engine, the squared distance between the means of both pairs,

    d^2 = sum over the tile's cells of ((G + G' - S - S') / 2)^2,

has the same distribution. There are three possible pairings, and a tile's share is the true pairing's d^2 over the
sum of all three. The sum of the shares over all tiles is compared with its values when the pairing of each tile is
drawn at random (Pitman 1937, "Significance tests which may be applied to samples from any populations"). No
distribution of the errors is assumed (it is far from Gaussian along walls), and each tile counts for at most one;
tiles need only be independent, so they are three correlation lengths wide. The share of draws that reach the sum of
the true pairing is the probability of a false alarm.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.numerics import MAD_SIGMA
from sionna_radar.foundation.raster import Raster

LE90_MEANING = (
    "90th percentile of |error|, bias included; tools that report the width |P95 - P5| print about twice as much"
)
# Standard terms for the fields.
MEANING = {
    "rms_m": "RMSE: root of the mean squared error, bias included",
    "mean_m": "bias: mean error, DEM minus truth",
    "std_m": "STD: standard deviation of the error about its mean",
    "nmad_m": "1.4826 times the median of |error - median error|",
    "le68_m": "68.27th percentile of |error|, bias included",
    "le90_m": LE90_MEANING,
    "le95_m": "95th percentile of |error|, bias included",
    "over_1m": "share of cells with an error beyond 1 m either way: where there are walls, those on the wrong side",
    "p95_p5_m": "width between the 5th and the 95th percentile of the error, which other tools call LE90",
}
# The share of a normal distribution within one standard deviation.
ONE_SIGMA_PERCENT = 68.27


@dataclass(frozen=True, kw_only=True)
class DemError:
    """Elevation error, DEM minus truth, over the cells where both have a height.

    count: number of those cells.
    coverage: their share of the illuminated cells with a true height.
    nmad_m: 1.4826 times the median absolute deviation from the median error: the standard deviation of a normal
        distribution with the same middle half, robust to outliers.
    le68_m, le90_m, le95_m: linear errors: the percentiles of |error|, bias included. Some tools use the name LE90 for
        the width |P95 - P5|, about twice as much for normal errors: p95_p5_m.
    over_1m: share of the cells with |error| > 1 m; NaN where results of earlier versions do not hold it.
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
    le68_m: float
    le95_m: float
    p95_p5_m: float
    over_1m: float = float("nan")


def difference(dem: Raster, truth: Raster) -> Raster:
    """Return DEM minus truth, m, on their common grid, NaN where either is empty; ValueError if the grids differ."""
    if dem.grid != truth.grid:
        raise ValueError(f"DEM and truth lie on different grids, {dem.grid} and {truth.grid}; sample one on the other")
    return Raster(grid=dem.grid, height_m=dem.height_m - truth.height_m, quantity="height error")


def summarise(error: Raster, illuminated: Bool[np.ndarray, "row column"]) -> DemError:
    """Return the statistics of an error, m, and its coverage of the illuminated cells, those that can be mapped."""
    values: Float[np.ndarray, " cell"] = error.height_m[error.filled]
    error_statistics = statistics(values, len(values))
    mappable = int(illuminated.sum())
    return replace(error_statistics, coverage=float((error.filled & illuminated).sum() / mappable) if mappable else 0.0)


def statistics(values: Float[np.ndarray, " cell"], mappable: int) -> DemError:
    """Return the statistics of finite errors among a number of mappable cells."""
    if len(values) == 0:
        unknown = {name: float("nan") for name in DemError.__annotations__ if name.endswith("_m")}
        return DemError(count=0, coverage=0.0, **unknown)
    le68, le90, le95 = np.percentile(np.abs(values), [ONE_SIGMA_PERCENT, 90, 95])
    low, high = np.percentile(values, [5, 95])
    return DemError(
        count=len(values),
        coverage=len(values) / mappable,
        min_m=float(values.min()),
        max_m=float(values.max()),
        std_m=float(values.std()),
        mean_m=float(values.mean()),
        rms_m=float(np.sqrt(np.mean(values**2))),
        nmad_m=nmad(values),
        le90_m=float(le90),
        le68_m=float(le68),
        le95_m=float(le95),
        p95_p5_m=float(high - low),
        over_1m=float(np.mean(np.abs(values) > 1.0)),
    )


def nmad(values: Float[np.ndarray, " cell"]) -> float:
    """Return 1.4826 times the median absolute deviation from the median of finite errors (Hoehle and Hoehle 2009)."""
    return float(MAD_SIGMA * np.median(np.abs(values - np.median(values))))
