"""Breakdown of a DEM's error: checkpoints, classes of terrain and view, canopy, and the variogram of the error."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sionna_radar.accuracy.checkpoints import NOTHING_COVERED, CheckpointTest, checkpoint_test, gradient, slope_deg
from sionna_radar.accuracy.compare import DemError, nmad, statistics
from sionna_radar.accuracy.illumination import Walls
from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points

SLOPES_DEG = (0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0)
INCIDENCES_DEG = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0, 180.0)
DISTANCES_M = (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, np.inf)


@dataclass(frozen=True, kw_only=True)
class ErrorClass:
    """The error over the cells of one class; NaN without any.

    low, high: its bounds, in degrees or metres; low is inclusive, high exclusive except in the last class.
    count: number of cells. Other fields are as in `DemError`.
    """

    low: float
    high: float
    count: int
    rms_m: float
    mean_m: float
    std_m: float
    nmad_m: float


def by_class(
    error_m: Float[np.ndarray, " cell"], value: Float[np.ndarray, " cell"], bounds: tuple[float, ...]
) -> tuple[ErrorClass, ...]:
    """Return the error by classes of a value, without cells whose value is NaN, and without empty classes.

    error_m: DEM minus truth, finite.
    bounds: of the classes, ascending.
    """
    number = np.searchsorted(bounds, value, side="right") - 1
    number[value == bounds[-1]] = len(bounds) - 2
    classes = []
    for index, (low, high) in enumerate(pairwise(bounds)):
        errors = error_m[(number == index) & ~np.isnan(value)]
        if len(errors):
            rms_m, mean_m, std_m = float(np.sqrt(np.mean(errors**2))), float(errors.mean()), float(errors.std())
            error_class = ErrorClass(
                low=low, high=high, count=len(errors), rms_m=rms_m, mean_m=mean_m, std_m=std_m, nmad_m=nmad(errors)
            )
            classes.append(error_class)
    return tuple(classes)


def incidence_deg(
    truth: Raster, points: Points | None, cells: Bool[np.ndarray, "row column"]
) -> Float[np.ndarray, " cell"]:
    """Return the incidence angle of some cells: between their normals and the direction to the radar.

    The radar is at its measured position of the nearest point. NaN where the slope is undefined, or without points.
    """
    count = int(cells.sum())
    if points is None or len(points) == 0 or count == 0:
        return np.full(count, np.nan)
    chosen = cells.ravel()
    place = np.column_stack([truth.grid.centres_m[chosen], truth.height_m.ravel()[chosen]])
    east, north = (component.ravel()[chosen] for component in gradient(truth))
    nearest = KDTree(points.position_m[:, :2]).query(place[:, :2])[1]
    to_radar = points.origin_m[nearest] - place
    # The normal is (-east, -north, 1), not yet of unit length.
    cos = to_radar[:, 2] - to_radar[:, 0] * east - to_radar[:, 1] * north
    cos /= np.linalg.norm(to_radar, axis=1) * np.sqrt(1 + east**2 + north**2)
    return np.rad2deg(np.arccos(np.clip(cos, -1.0, 1.0)))


CLASSES = 14
# Pairs drawn in each class of lags; those with an empty end are dropped.
PAIRS = 4000
MIN_PAIRS = 30
# Largest lag as a share of the mapped area's longer side; beyond, few pairs are independent.
FARTHEST = 0.5


@dataclass(frozen=True, kw_only=True)
class VariogramLag:
    """Semivariance of the error in one class of lags: half the mean squared difference of pairs.

    lag_m: mean distance of the pairs.
    semivariance_m2: Matheron's estimator.
    robust_m2: Dowd's estimator, from the median of the differences, robust to outliers.
    """

    lag_m: float
    pairs: int
    semivariance_m2: float
    robust_m2: float


@dataclass(frozen=True, kw_only=True)
class Variogram:
    """An empirical variogram.

    variance_m2: of all errors; the sill of the semivariance at uncorrelated distances.
    correlation_length_m: lag at which it exceeds 1 - 1/e of the sill; None if it does so at no lag, or at the first.
    lags: by ascending distance.
    """

    variance_m2: float
    correlation_length_m: float | None
    lags: tuple[VariogramLag, ...]


def variogram(error: Raster, cells: Bool[np.ndarray, "row column"], seed: int) -> Variogram | None:
    """Return the variogram, m², of an error over some cells, where filled; None without enough of them.

    Equally many pairs are drawn in each class of lags: one end among the cells, the other in a random direction.
    """
    valid = error.filled & cells
    row, column = np.nonzero(valid)
    if len(row) < MIN_PAIRS:
        return None
    values = np.where(valid, error.height_m, np.nan)
    farthest = FARTHEST * max(float(np.ptp(row)), float(np.ptp(column)), 4.0)
    generator = pulse_generator(seed, Stream.VARIOGRAM, 0)
    lags = []
    for low, high in pairwise(np.geomspace(1.0, farthest, CLASSES + 1)):
        start = generator.integers(len(row), size=PAIRS)
        distance, angle = generator.uniform(low, high, PAIRS), generator.uniform(0.0, 2 * np.pi, PAIRS)
        down, right = np.rint(distance * np.sin(angle)).astype(int), np.rint(distance * np.cos(angle)).astype(int)
        other_row, other_column = row[start] + down, column[start] + right
        in_map = (other_row >= 0) & (other_row < values.shape[0]) & (other_column >= 0)
        in_map &= other_column < values.shape[1]
        start, end = start[in_map], (other_row[in_map], other_column[in_map])
        step = values[end] - values[row[start], column[start]]
        lag = _lag(step, np.hypot(down[in_map], right[in_map]) * error.grid.spacing_m)
        if lag is not None:
            lags.append(lag)
    variance_m2 = float(np.var(error.height_m[valid]))
    return Variogram(variance_m2=variance_m2, correlation_length_m=_length_m(lags, variance_m2), lags=tuple(lags))


def _lag(step_m: Float[np.ndarray, " pair"], distance_m: Float[np.ndarray, " pair"]) -> VariogramLag | None:
    valid = np.isfinite(step_m)
    if valid.sum() < MIN_PAIRS:
        return None
    step = step_m[valid]
    return VariogramLag(
        lag_m=float(distance_m[valid].mean()),
        pairs=len(step),
        semivariance_m2=float(np.mean(step**2) / 2),
        # 2.198 is the ratio of variance and squared median of |x| of a normal distribution (Dowd 1984).
        robust_m2=float(2.198 * np.median(np.abs(step)) ** 2 / 2),
    )


def _length_m(lags: list[VariogramLag], variance_m2: float) -> float | None:
    threshold_m2 = (1 - np.exp(-1.0)) * variance_m2
    for near, far in pairwise(lags):
        if near.semivariance_m2 < threshold_m2 <= far.semivariance_m2:
            fraction = (threshold_m2 - near.semivariance_m2) / (far.semivariance_m2 - near.semivariance_m2)
            return near.lag_m + fraction * (far.lag_m - near.lag_m)
    return None


# Largest number of cells at which distances and incidence angles are evaluated.
MAX_CELLS = 100_000


@dataclass(frozen=True, kw_only=True)
class Breakdown:
    """The error of lit cells by explanatory variables; see `sionna_radar.accuracy` for each.

    by_slope: classes of the true slope, degrees.
    by_incidence: classes of the angle between the true surface's normal and the direction to the radar, degrees.
    by_wall_distance: classes of the distance from the nearest wall, metres; None without walls.
    by_cover: by name of the cover; None where it is not known, or all the same.
    variogram: None with too few cells.
    """

    checkpoints: CheckpointTest
    by_slope: tuple[ErrorClass, ...]
    by_incidence: tuple[ErrorClass, ...]
    by_wall_distance: tuple[ErrorClass, ...] | None
    by_cover: dict[str, DemError] | None
    variogram: Variogram | None


def break_down(
    error: Raster,
    truth: Raster,
    lit: Bool[np.ndarray, "row column"],
    points: Points | None,
    walls: Walls | None,
    seed: int,
    covered: Mapping[str, float] = NOTHING_COVERED,
    checkpoint_sigma_m: float | None = None,
    covers: Mapping[str, Bool[np.ndarray, "row column"]] | None = None,
) -> Breakdown:
    """Return the breakdown of a DEM's error by classes of ground and view, with checkpoints and variogram.

    error, truth, lit: DEM minus truth, the truth, and the cells that the main beam reached.
    points: located echoes, for the radar's positions; None if they are not known.
    walls: of the scene; None if they are not known.
    seed: of the scenario, for checkpoints and pairs.
    covered, checkpoint_sigma_m: see `checkpoint_test`.
    covers: cells of each cover.
    """
    cells = error.filled & lit
    sample = _some(cells, seed)
    error_m = error.height_m[sample]
    distances = None
    if walls:
        place = error.grid.centres_m[sample.ravel()]
        distances = by_class(error_m, walls.distance_m(place, DISTANCES_M[-2]), DISTANCES_M)
    by_cover = {
        name: statistics(error.height_m[cells & cover_cells], int((lit & cover_cells).sum()))
        for name, cover_cells in (covers or {}).items()
        if (cells & cover_cells).any()
    }
    return Breakdown(
        checkpoints=checkpoint_test(error, truth, lit, seed, covered, checkpoint_sigma_m),
        by_slope=by_class(error.height_m[cells], slope_deg(truth)[cells], SLOPES_DEG),
        by_incidence=by_class(error_m, incidence_deg(truth, points, sample), INCIDENCES_DEG),
        by_wall_distance=distances,
        by_cover=by_cover or None,
        variogram=variogram(error, cells, seed),
    )


def _some(cells: Bool[np.ndarray, "row column"], seed: int) -> Bool[np.ndarray, "row column"]:
    """Return the cells, or a random sample of `MAX_CELLS` of them."""
    indices = np.flatnonzero(cells)
    if len(indices) <= MAX_CELLS:
        return cells
    chosen = np.zeros(cells.size, dtype=bool)
    chosen[pulse_generator(seed, Stream.CELLS, 0).choice(indices, MAX_CELLS, replace=False)] = True
    return chosen.reshape(cells.shape)
