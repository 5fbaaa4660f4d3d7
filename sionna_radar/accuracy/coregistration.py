"""Shift of a DEM against measured heights, horizontal and vertical, and the tilt between the two.

With the DEM h and the reference z,

    h(x) = z(x - d) + u + t . (x - x0) + errors,

d being the horizontal shift of the DEM against the reference, u the vertical one, t a tilt and x0 the middle of the
DEM. It is linearised by the slopes, as by Nuth and Kaeaeb (2011, "Co-registration and bias corrections of satellite
elevation data sets for quantifying glacier thickness change", The Cryosphere 5, 271-290), and iterated.

The slopes contain noise, from which least squares derive a shift even of flat ground. So the slopes of the DEM are the
instruments of those of the reference, whose errors are independent of them: theta = (Z'X)^-1 Z'r. Where the two have no
relief in common, the standard deviation of d grows without bound. Neighbouring errors are alike, as far as the relief
is: standard deviations are those of estimates without one of eight parts of the map (`accuracy.robust_errors`).
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.accuracy.checkpoints import gradient
from sionna_radar.accuracy.compare import nmad
from sionna_radar.accuracy.reference import OFFSET_CHECKPOINTS, SEARCHED_M, ReferenceSurface, widened
from sionna_radar.accuracy.robust_errors import BLOCKS, blocks_of, robust_fit
from sionna_radar.foundation.raster import Grid, Raster

# Number of trial shifts to each side of none.
TRIALS = 5
MAX_ITERATIONS = 20
# Residuals beyond this many NMAD do not take part in the estimate of the shift.
OUTLIERS = 4.0
# Fewest common cells of which a shift is estimated.
MIN_CELLS = 60
# Fewest checkpoints from which a tilt is estimated.
TILT_CHECKPOINTS = 10


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Shift of a DEM against a reference, with standard deviations; None where it was not estimated.

    The standard deviations come from few parts of the map; 1.96 of them to either side are an interval of 95 %.

    east_m, north_m: horizontal; None for checkpoints, and where the relief does not determine it.
    up_m: vertical, in the middle of the DEM.
    tilt_east, tilt_north: slopes of the difference, m per m.
    rms_m, shifted_rms_m: of DEM minus reference, before and after the shift is taken out, at the same places: without
        the outliers of what is left.
    """

    up_m: float
    up_sigma_m: float
    east_m: float | None = None
    north_m: float | None = None
    east_sigma_m: float | None = None
    north_sigma_m: float | None = None
    tilt_east: float | None = None
    tilt_north: float | None = None
    tilt_east_sigma: float | None = None
    tilt_north_sigma: float | None = None
    rms_m: float
    shifted_rms_m: float

    def trend_m(self, place_m: Float[np.ndarray, "n 2"], middle_m: Float[np.ndarray, "2"]) -> Float[np.ndarray, " n"]:
        """Return the vertical shift and tilt at places."""
        tilt = np.array([self.tilt_east or 0.0, self.tilt_north or 0.0])
        return self.up_m + (place_m - middle_m) @ tilt


def shift_between(dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"]) -> Shift:
    """Return the shift of a DEM against a surface, without a horizontal one where the relief does not determine it.

    cells: those of the DEM from which it is estimated, `MIN_CELLS` of them common to both at least.
    """
    shift = _fitted(dem, reference, cells, _coarse_shift(dem, reference, cells))
    at_the_limit = max(abs(shift.east_m or 0.0), abs(shift.north_m or 0.0)) >= SEARCHED_M
    # Within a wider interval another trial shift fits as well.
    if at_the_limit or 2 * max(shift.east_sigma_m or 0.0, shift.north_sigma_m or 0.0) > SEARCHED_M / TRIALS:
        return _fitted(dem, reference, cells, None)
    return shift


def _fitted(
    dem: Raster,
    reference: ReferenceSurface,
    cells: Bool[np.ndarray, "row column"],
    start_m: Float[np.ndarray, "2"] | None,
) -> Shift:
    """Return the fitted shift, beginning with a horizontal one; without a horizontal one for None."""
    moved = start_m is not None
    shift_m = np.zeros(2) if start_m is None else start_m
    place = dem.grid.centres_m - middle_m(dem.grid)
    constant = np.column_stack([np.ones(len(place)), place])
    slopes = [-component.ravel() for component in gradient(dem)]
    for _ in range(MAX_ITERATIONS if moved else 1):
        surface = reference.on(dem.grid, tuple(shift_m))
        residual = (dem.height_m - surface.height_m).ravel()
        own = [-component.ravel() for component in gradient(surface)]
        model = np.column_stack([*own, constant]) if moved else constant
        instruments = np.column_stack([*slopes, constant]) if moved else constant
        usable = cells.ravel() & np.isfinite(np.column_stack([residual, model, instruments])).all(axis=1)
        if moved and not usable.any():
            # No cell has slopes on both surfaces, as where the DEM has single cells only: the direction is not
            # determined.
            return _fitted(dem, reference, cells, None)
        usable &= np.abs(residual - np.median(residual[usable])) <= OUTLIERS * max(nmad(residual[usable]), 1e-6)
        solved = robust_fit(model[usable], instruments[usable], residual[usable], blocks_of(place[usable]))
        if not moved:
            break
        step_m = np.clip(solved.estimate[:2], -dem.grid.spacing_m, dem.grid.spacing_m)
        shift_m = np.clip(shift_m + step_m, -SEARCHED_M, SEARCHED_M)
        if np.abs(step_m).max() < 1e-3 * dem.grid.spacing_m:
            break
    left, sigma = residual - model @ solved.estimate, solved.sigma
    horizontal: dict[str, float] = {}
    if moved:
        names = ("east_m", "north_m", "east_sigma_m", "north_sigma_m")
        horizontal = dict(zip(names, map(float, [*shift_m, *sigma[:2]]), strict=True))
    rms_m, shifted_rms_m = _rms_of_both((dem.height_m - reference.on(dem.grid).height_m).ravel()[usable], left[usable])
    up_m, tilt_east, tilt_north = map(float, solved.estimate[-3:])
    up_sigma_m, tilt_east_sigma, tilt_north_sigma = map(float, sigma[-3:])
    return Shift(
        up_m=up_m,
        up_sigma_m=up_sigma_m,
        tilt_east=tilt_east,
        tilt_north=tilt_north,
        tilt_east_sigma=tilt_east_sigma,
        tilt_north_sigma=tilt_north_sigma,
        rms_m=rms_m,
        shifted_rms_m=shifted_rms_m,
        **horizontal,
    )


def _coarse_shift(
    dem: Raster, reference: ReferenceSurface, cells: Bool[np.ndarray, "row column"]
) -> Float[np.ndarray, "2"]:
    """Return the trial shift, of whole cells of one surface around the DEM, after which both differ least, by NMAD."""
    grid = dem.grid
    trials = np.unique(np.rint(SEARCHED_M / TRIALS / grid.spacing_m * np.arange(-TRIALS, TRIALS + 1)).astype(int))
    reach = int(trials[-1])
    around = reference.on(widened(grid, reach)).height_m
    spreads = {}
    for east, north in product(trials, trials):
        moved = around[reach - north :, reach - east :][: grid.rows, : grid.columns]
        difference = (dem.height_m - moved)[cells]
        finite = difference[np.isfinite(difference)]
        if len(finite) > len(difference) / 2:
            spreads[east, north] = nmad(finite)
    best = min(spreads, key=lambda trial: (spreads[trial], np.hypot(*trial))) if spreads else (0, 0)
    return grid.spacing_m * np.array(best, dtype=float)


def trend_of(error_m: Float[np.ndarray, " n"], place_m: Float[np.ndarray, "n 2"], middle_m: np.ndarray) -> Shift:
    """Return the vertical shift of a DEM against checkpoints, and its tilt if there are enough."""
    model = np.ones((len(error_m), 1))
    if len(error_m) >= TILT_CHECKPOINTS:
        model = np.column_stack([model, place_m - middle_m])
    # Of few checkpoints each is far from the others, and a block of its own.
    block = blocks_of(place_m) if len(error_m) >= OFFSET_CHECKPOINTS * BLOCKS else np.arange(len(error_m))
    fit = robust_fit(model, model, error_m, block)
    solved, sigma, left = fit.estimate, fit.sigma, error_m - model @ fit.estimate
    tilt: dict[str, float] = {}
    if len(solved) == 3:
        names = ("tilt_east", "tilt_north", "tilt_east_sigma", "tilt_north_sigma")
        tilt = dict(zip(names, map(float, [*solved[1:], *sigma[1:]]), strict=True))
    rms_m, shifted_rms_m = _rms_of_both(error_m, left)
    return Shift(up_m=float(solved[0]), up_sigma_m=float(sigma[0]), rms_m=rms_m, shifted_rms_m=shifted_rms_m, **tilt)


def middle_m(grid: Grid) -> Float[np.ndarray, "2"]:
    """Return the middle of a grid, east and north, m."""
    west, east, south, north = grid.extent_m
    return np.array([(west + east) / 2, (south + north) / 2])


def _rms_of_both(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"]) -> tuple[float, float]:
    """Return the RMS of two sets of errors at the same places, without the outliers of the second."""
    finite = np.isfinite(before) & np.isfinite(after)
    if not finite.any():
        return float("nan"), float("nan")
    before, after = before[finite], after[finite]
    kept = np.abs(after - np.median(after)) <= OUTLIERS * max(nmad(after), 1e-6)
    return float(np.sqrt(np.mean(before[kept] ** 2))), float(np.sqrt(np.mean(after[kept] ** 2)))
