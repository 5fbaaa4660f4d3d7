"""The DEM method "linear": linear interpolation between points, and its uncertainty.

The error of a weighted mean of measured heights, as an estimate of the height z at a place, has for Gaussian
terrain the variance

    C(0) - 2 sum w_i C(z, y_i) + sum w_i w_j (C(y_i, y_j) + n_ij),

whether or not the weights are the best ones. The noise n_ij is correlated where two heights share speckle; it is
evaluated for every pair of a triangle's corners. The covariances C are those of means over
footprints, so smoothing by a wide beam is included; range estimator bias on slopes is not. Since
distances are short, one covariance serves the whole map, with a local amplitude of short waves.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks_of_bytes, in_background, in_threads
from sionna_radar.inference.terrain import covariance_fit
from sionna_radar.inference.terrain.covariance import CovarianceTable, FittedCovariance
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.local_relief import (
    UNIFORM,
    LocalRelief,
    consistent_mask,
    local_relief,
    low_relief_mask,
    misfit_between_lines,
)
from sionna_radar.mapping.linear.gridding import Interpolated, grid_points
from sionna_radar.mapping.mapper import Estimate, MapInputs
from sionna_radar.mapping.options import LINEAR, SMOOTH, LinearParameters

Floats = Float[np.ndarray, "..."]
# Covariances of long waves and of short ones.
LongAndShort = tuple[CovarianceTable, CovarianceTable]
# Prior standard deviation of the log noise factor: range error estimates are uncertain by a factor.
UNKNOWN_NOISE_FACTOR_SPREAD = 1.0
MIN_POINTS = 20


@dataclass(frozen=True)
class LinearUncertainty:
    """The uncertainty of a map of linear interpolation.

    misfit: how many times larger than stated errors between scan lines are; see `misfit_between_lines`.
    """

    interpolated: Interpolated
    heights: Heights
    fitted: FittedCovariance
    local: LocalRelief
    misfit: float = 1.0

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        # Beside a height little but the curvature within its footprint is missed.
        spread = float(np.median(self.heights.bent_spread_m))
        of_corners = self.heights.place_m.itemsize * 3 * 2
        some = chunks_of_bytes(len(self.interpolated.cell), of_corners)

        def farthest_of(low: int, high: int) -> float:
            return max(float(each.max(initial=0.0)) for each in self._distances(grid, slice(low, high)))

        farthest = max(in_threads(farthest_of, some)) + 1.0
        to_place, between = (
            self.local.divided(self.fitted.covariance, farthest, each) for each in (spread / np.sqrt(2), spread)
        )
        alone = self.local.divided(self.fitted.covariance, 1.0, 0.0)
        sigma = np.full(grid.rows * grid.columns, np.nan)

        def of_cells(low: int, high: int) -> None:
            variance = self._variance_m2(grid, slice(low, high), to_place, between, alone)
            sigma[self.interpolated.cell[low:high]] = self.misfit * np.sqrt(np.maximum(variance, 0.0))

        list(in_threads(of_cells, some))
        return np.where(wanted, sigma.reshape(grid.shape), np.nan)

    def _distances(self, grid: Grid, rows: slice) -> tuple[Float[np.ndarray, "cell 3"], Float[np.ndarray, "cell 3"]]:
        """Return the distances from cells to the corners of their triangles, and the triangles' side lengths, m."""
        corner = self.heights.place_m[self.interpolated.corner[rows]]
        cell = self._cells_m(grid, rows)
        side_m = np.linalg.norm(corner - np.roll(corner, -1, axis=1), axis=2)
        return np.linalg.norm(corner - cell[:, None], axis=2), side_m

    def _variance_m2(
        self, grid: Grid, rows: slice, to_place: LongAndShort, between: LongAndShort, alone: LongAndShort
    ) -> Float[np.ndarray, " cell"]:
        """Return the variance of cells; covariance tables: cell to point, point to point, cell alone."""
        away, side_m = self._distances(grid, rows)
        weight, corner = self.interpolated.weight[rows], self.interpolated.corner[rows]
        of_cell = self.local.at(self._cells_m(grid, rows))[:, None]
        of_corner = self.local.at(self.heights.place_m[corner])
        of_next = np.roll(of_corner, -1, axis=1)

        def covariance(tables: LongAndShort, distance_m: Floats, one: Floats, other: Floats) -> Floats:
            return tables[0].at(distance_m) + one * other * tables[1].at(distance_m)

        noise = self.heights.noise_m2(corner, corner, self.fitted.noise_factor)
        shared = self.heights.noise_m2(corner, np.roll(corner, -1, axis=1), self.fitted.noise_factor)
        # Corner i and the next one are `apart[:, i]`.
        pair = weight * np.roll(weight, -1, axis=1)
        same = covariance(between, np.zeros_like(away), of_corner, of_corner)
        next_one = covariance(between, side_m, of_corner, of_next)
        both = np.sum(weight**2 * (same + noise), axis=1) + 2 * np.sum(pair * (next_one + shared), axis=1)
        before = covariance(alone, np.zeros_like(of_cell), of_cell, of_cell)[:, 0]
        to_cell = np.sum(weight * covariance(to_place, away, of_cell, of_corner), axis=1)
        return before - 2 * to_cell + both

    def _cells_m(self, grid: Grid, rows: slice) -> Float[np.ndarray, "cell 2"]:
        row, column = np.divmod(self.interpolated.cell[rows], grid.columns)
        return np.column_stack([grid.x_m[column], grid.y_m[row]])

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return NaN: the correlation of the errors of neighbouring triangles is not modelled."""
        return float("nan")


def linear_uncertainty(
    interpolated: Interpolated,
    heights: Heights,
    noise_factor_spread: float = UNKNOWN_NOISE_FACTOR_SPREAD,
    microrelief_m: float = 0.0,
) -> LinearUncertainty | None:
    """Return the uncertainty of a linear interpolation between heights; None with too few of them.

    noise_factor_spread: prior standard deviation of the log noise factor; see `fit_covariance`.
    microrelief_m: what is usual on such ground; see `Covariance`.
    """
    if len(heights) < MIN_POINTS or len(interpolated.cell) == 0:
        return None
    measured, window = heights.above(heights.trend(), microrelief_m), SMOOTH.window_heights
    usual = measured.rows(low_relief_mask(measured, window))
    usual = usual.rows(consistent_mask(usual, window, SMOOTH.outlier_sigmas))
    fitted = fit_covariance(usual, noise_factor_spread=noise_factor_spread)
    local = local_relief(measured, fitted, window)
    misfit = misfit_between_lines(measured, fitted, local, window)
    return LinearUncertainty(interpolated, heights, fitted, local or UNIFORM, misfit)


class Linear:
    """Linear interpolation of located echoes."""

    profiles: Literal["unused"] = "unused"

    def __init__(self, parameters: LinearParameters = LINEAR) -> None:
        self.options = parameters

    def __call__(self, inputs: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        on = inputs.points, inputs.grid, inputs.max_gap_m, inputs.shadow_incidence_rad, self.options
        if not inputs.uncertain:
            return Estimate(dem=grid_points(*on).dem)
        gridding = in_background(lambda: grid_points(*on))
        heights, interpolated = inputs.heights(), gridding()
        # Errors of measured directions follow from theory; those of ranges have an unknown factor.
        spread = (
            UNKNOWN_NOISE_FACTOR_SPREAD if inputs.points.across_sigma_m is None else covariance_fit.NOISE_FACTOR_SPREAD
        )
        uncertainty = linear_uncertainty(interpolated, heights, spread, inputs.microrelief_m)
        return (
            Estimate(dem=interpolated.dem)
            if uncertainty is None
            else Estimate.with_sigma(interpolated.dem, uncertainty)
        )
