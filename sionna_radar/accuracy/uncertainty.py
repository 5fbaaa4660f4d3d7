"""Calibration of a DEM's stated uncertainty: coverage of intervals, spread of z, means over windows.

z is the error over the standard deviation stated by the map for the cell. If errors are normal and the statement is
right, z has unit variance, and the shares of |z| below the quantiles of the normal distribution are the nominal
coverages of the intervals.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from scipy.special import ndtri

from sionna_radar.accuracy.breakdown import SLOPES_DEG
from sionna_radar.accuracy.checkpoints import slope_deg
from sionna_radar.accuracy.compare import nmad
from sionna_radar.foundation.raster import Raster
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.points import Points

INTERVALS_PERCENT = (50, 68, 90, 95)
ECHO_DISTANCES_M = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, np.inf)
WINDOWS_M = (10.0, 30.0, 100.0)
# Largest and smallest number of windows per size, spread over the map, and the minimum share of filled cells in each.
MAX_WINDOWS, MIN_WINDOWS, FILLED_SHARE = 24, 3, 0.9


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Errors over their stated standard deviations, over some cells.

    count: number of the cells.
    coverage: share of the cells whose truth lies in the interval stated for each of `INTERVALS_PERCENT`.
    nmad_z, rms_z, mean_z: of error / sigma. sigma_rms_m: of sigma.
    """

    count: int
    coverage: dict[str, float]
    nmad_z: float
    rms_z: float
    mean_z: float
    sigma_rms_m: float


@dataclass(frozen=True, kw_only=True)
class CalibrationClass:
    """The calibration over the cells of one class; low is inclusive, high exclusive."""

    low: float
    high: float
    calibration: Calibration


@dataclass(frozen=True, kw_only=True)
class WindowMeans:
    """Errors of mean heights over windows of one size.

    window_m: side of the windows; count: their number.
    error_rms_m: of the mean errors; sigma_rms_m: of the standard deviations stated for them.
    ratio: the first over the second.
    """

    window_m: float
    count: int
    error_rms_m: float
    sigma_rms_m: float
    ratio: float


@dataclass(frozen=True, kw_only=True)
class UncertaintyCheck:
    """Stated uncertainty of a DEM against its errors over lit cells.

    cells: over all of them; by_slope: classes of the true slope, degrees; by_echo_distance: classes of the distance
    from the nearest echo on the ground, m; means: of windows, where the method provides the covariance between cells.
    """

    cells: Calibration
    by_slope: tuple[CalibrationClass, ...]
    by_echo_distance: tuple[CalibrationClass, ...]
    means: tuple[WindowMeans, ...]


def check_uncertainty(
    error: Raster,
    sigma: Raster,
    truth: Raster,
    lit: Bool[np.ndarray, "row column"],
    points: Points | None,
    uncertainty: Uncertainty | None,
) -> UncertaintyCheck | None:
    """Return the comparison of a DEM's stated uncertainty with its errors; None without a lit cell.

    error, sigma, truth: DEM minus truth, its stated standard deviation, and the truth, on one grid.
    lit: cells that the main beam reached.
    points: the located echoes; None if they are not known.
    uncertainty: uncertainty of means over cells; None if the method does not provide it.
    """
    cells = error.filled & sigma.filled & lit
    if not cells.any():
        return None
    error_m, sigma_m = error.height_m[cells], sigma.height_m[cells]
    place = error.grid.centres_m[cells.ravel()]
    nearest = (
        KDTree(points.position_m[:, :2]).query(place)[0]
        if points is not None and len(points)
        else np.full(len(place), np.inf)
    )
    return UncertaintyCheck(
        cells=calibration(error_m, sigma_m),
        by_slope=_by_class(error_m, sigma_m, slope_deg(truth)[cells], SLOPES_DEG),
        by_echo_distance=_by_class(error_m, sigma_m, nearest, ECHO_DISTANCES_M),
        means=() if uncertainty is None else tuple(_means(error, cells, uncertainty)),
    )


def calibration(error_m: Float[np.ndarray, " cell"], sigma_m: Float[np.ndarray, " cell"]) -> Calibration:
    """Return the calibration of stated standard deviations."""
    z = error_m / np.maximum(sigma_m, np.finfo(float).tiny)
    bounds = ndtri(0.5 + np.array(INTERVALS_PERCENT) / 200)
    return Calibration(
        count=len(z),
        coverage={
            str(percent): float(np.mean(np.abs(z) <= bound))
            for percent, bound in zip(INTERVALS_PERCENT, bounds, strict=True)
        },
        nmad_z=nmad(z),
        rms_z=float(np.sqrt(np.mean(z**2))),
        mean_z=float(z.mean()),
        sigma_rms_m=float(np.sqrt(np.mean(sigma_m**2))),
    )


def _by_class(
    error_m: Float[np.ndarray, " cell"],
    sigma_m: Float[np.ndarray, " cell"],
    value: Float[np.ndarray, " cell"],
    bounds: tuple[float, ...],
) -> tuple[CalibrationClass, ...]:
    classes = []
    for low, high in pairwise(bounds):
        members = (value >= low) & (value < high)
        if members.any():
            class_calibration = calibration(error_m[members], sigma_m[members])
            classes.append(CalibrationClass(low=low, high=high, calibration=class_calibration))
    return tuple(classes)


def _means(error: Raster, cells: Bool[np.ndarray, "row column"], uncertainty: Uncertainty) -> Iterator[WindowMeans]:
    """Yield the errors of means over windows, for each size with enough windows in the map."""
    x, y = np.meshgrid(error.grid.x_m, error.grid.y_m)
    for window_m in WINDOWS_M:
        mean_m, sigma_m = [], []
        for rows, columns in _windows(cells, round(window_m / error.grid.spacing_m)):
            filled = cells[rows, columns]
            place = np.column_stack([x[rows, columns][filled], y[rows, columns][filled]])
            mean_m.append(float(error.height_m[rows, columns][filled].mean()))
            sigma_m.append(uncertainty.mean_sigma_m(place, window_m))
        valid = np.isfinite(sigma_m)
        if valid.sum() >= MIN_WINDOWS:
            error_rms = float(np.sqrt(np.mean(np.square(mean_m)[valid])))
            sigma_rms = float(np.sqrt(np.mean(np.square(sigma_m)[valid])))
            yield WindowMeans(
                window_m=window_m,
                count=int(valid.sum()),
                error_rms_m=error_rms,
                sigma_rms_m=sigma_rms,
                ratio=error_rms / max(sigma_rms, np.finfo(float).tiny),
            )


def _windows(cells: Bool[np.ndarray, "row column"], side: int) -> list[tuple[slice, slice]]:
    """Return adjacent, nearly filled windows, evenly subsampled if there are many."""
    if side < 1:
        return []
    windows = [
        (slice(row, row + side), slice(column, column + side))
        for row in range(0, cells.shape[0] - side + 1, side)
        for column in range(0, cells.shape[1] - side + 1, side)
        if cells[row : row + side, column : column + side].mean() >= FILLED_SHARE
    ]
    chosen = np.unique(np.linspace(0, max(len(windows) - 1, 0), MAX_WINDOWS).astype(int))
    return [windows[number] for number in chosen] if windows else []
