"""Tests of two sources for consistency: shift and tilt, the scatter of their differences, and contradictions.

Each pair has three tests at a third of its share of the false alarms. Of the five parameters of the shift one counts if
neither Student's t of a jackknife over blocks (`accuracy.robust_errors`) nor the stated errors of the cells explain it:
over a narrow overlap blocks are not independent. The scatter of the bulk of the differences over their standard
deviations is tested by chi-squared, of as many independent ones as their correlation leaves; and the mean of the
differences over each neighbourhood by its known variance. If errors are Gaussian and as large as stated, a false alarm
in any test of a fusion has the probability `FALSE_ALARM` at most (Bonferroni).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter
from scipy.spatial.distance import cdist
from scipy.special import ndtr, ndtri, stdtr, stdtrit
from scipy.stats import chi2

from sionna_radar.accuracy.checkpoints import gradient
from sionna_radar.accuracy.compare import nmad
from sionna_radar.accuracy.coregistration import MIN_CELLS, Shift, shift_between
from sionna_radar.accuracy.reference import ReferenceSurface
from sionna_radar.accuracy.robust_errors import BLOCKS
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.studies.fusion.shared_errors import SharedErrors

FALSE_ALARM, TESTS = 0.01, 3
# Cells along the side of a neighbourhood: a narrower contradiction is averaged with what surrounds it.
NEIGHBOURHOOD_CELLS = 5
# Cells of which the errors of a fitted shift are computed.
PLANE_CELLS = 300
# Of a parameter of a shift, where surfaces agree exactly.
MIN_SIGMA = 1e-12
# A median absolute deviation is as uncertain as the standard deviation of this fraction of the values (Rousseeuw and
# Croux 1993, "Alternatives to the median absolute deviation").
MAD_EFFICIENCY = 0.37
# A standard deviation of `Shift` is larger than that of Student's distribution by this factor.
STUDENT = float(stdtrit(BLOCKS - 1, 0.975) / ndtri(0.975))
SIGMA_OF = {
    "up_m": "up_sigma_m",
    "tilt_east": "tilt_east_sigma",
    "tilt_north": "tilt_north_sigma",
    "east_m": "east_sigma_m",
    "north_m": "north_sigma_m",
}
FORMS = {
    "up_m": "offset {:+.2f} m",
    "tilt_east": "tilt {:+.2%} east",
    "tilt_north": "tilt {:+.2%} north",
    "east_m": "shift {:+.2f} m east",
    "north_m": "shift {:+.2f} m north",
}

Cells = Float[np.ndarray, "row column"]
Mask = Bool[np.ndarray, "row column"]


@dataclass(frozen=True, kw_only=True)
class GriddedSource:
    """A source on the cells of the fused DEM, NaN in those that it leaves empty.

    sigma_m: standard deviation of each cell; common_m: of what neighbouring cells have in common.
    moved: the shift that was taken out; None without one.
    made_of: as of `Source`.
    """

    name: str
    kind: str
    dem: Raster
    sigma_m: Cells
    common_m: Cells
    moved: Shift | None = None
    made_of: Mapping[str, str] = field(default_factory=dict)

    @property
    def cells(self) -> int:
        """Number of filled cells."""
        return int(self.dem.filled.sum())

    @property
    def variance_m2(self) -> Cells:
        """Variance of the heights."""
        return self.sigma_m**2 + self.common_m**2

    @property
    def median_sigma_m(self) -> float:
        """Median standard deviation of the heights."""
        return float(np.median(np.sqrt(self.variance_m2[self.dem.filled])))


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two sources where both have heights: first minus second.

    cells: common ones.
    shift: of the first against the second, in the middle of the common cells; None with too few.
    significant: the parameters of the shift that differ from zero, by their names in it.
    chi2: mean squared difference over its variance. p: probability of that or more.
    scatter: NMAD of the differences over their standard deviations; 1 unless it is significantly more.
    contradicting: number of cells in whose neighbourhood they contradict each other.
    """

    first: str
    second: str
    cells: int
    shift: Shift | None
    significant: tuple[str, ...]
    chi2: float
    p: float
    scatter: float
    contradicting: int

    @property
    def findings(self) -> list[str]:
        """What the tests found; empty for sources that agree."""
        found = [FORMS[name].format(getattr(self.shift, name)) for name in self.significant]
        if self.scatter > 1.0:
            found.append(f"scatter {self.scatter:.1f} times what is stated")
        if self.contradicting:
            found.append(f"contradiction in {self.contradicting:,} cells")
        return found


def overlaps(one: GriddedSource, other: GriddedSource) -> bool:
    """Return True if two sources have a common cell."""
    return bool((one.dem.filled & other.dem.filled).any())


def _common_box(one: GriddedSource, other: GriddedSource) -> tuple[slice, slice]:
    """Return rows and columns around the common cells of two sources."""
    row, column = np.nonzero(one.dem.filled & other.dem.filled)
    return slice(int(row.min()), int(row.max()) + 1), slice(int(column.min()), int(column.max()) + 1)


def shift_of(
    one: GriddedSource, other: GriddedSource, shared: SharedErrors, level: float
) -> tuple[Shift, tuple[str, ...]] | None:
    """Return the shift of a source against another one, in the middle of their common cells; None with too few.

    With it the names of the parameters that differ from zero, of which any does by chance with the probability `level`.
    Standard deviations are those of the jackknife, or what the errors of the cells explain where that is larger.
    """
    box = _common_box(one, other)
    grid = one.dem.grid.cut(*box)
    first, second = (Raster(grid=grid, height_m=each.dem.height_m[box]) for each in (one, other))
    common = first.filled & second.filled
    if common.sum() < MIN_CELLS:
        return None
    shift, found = shift_between(first, ReferenceSurface.of(second), common), []
    explained = _explained(grid, common, second, [each.sigma_m[box] for each in (one, other)], shared)
    navigation_m2 = float(np.mean((one.common_m**2 + other.common_m**2)[box][common]))
    for (name, sigma_name), cells in zip(SIGMA_OF.items(), explained, strict=True):
        value, sigma = getattr(shift, name), getattr(shift, sigma_name)
        if value is not None and sigma is not None:
            more_m2 = navigation_m2 if name == "up_m" else 0.0
            by_blocks = stdtr(BLOCKS - 1, -abs(value) / np.hypot(sigma / STUDENT, np.sqrt(more_m2) + MIN_SIGMA))
            by_cells = ndtr(-abs(value) / np.hypot(cells, np.sqrt(more_m2) + MIN_SIGMA))
            if 2 * max(by_blocks, by_cells) < level / len(SIGMA_OF):
                found.append(name)
            larger: dict[str, Any] = {sigma_name: max(sigma, float(cells))}
            shift = replace(shift, **larger)
    return shift, tuple(found)


def _explained(
    grid: Grid, common: Mask, dem: Raster, sigmas_m: list[Cells], shared: SharedErrors
) -> Float[np.ndarray, " parameter"]:
    """Return the standard deviations of the parameters of a least-squares shift, from the errors of the cells."""
    place_m = grid.centres_m - grid.centres_m.mean(axis=0)
    model = np.column_stack([np.ones(len(place_m)), place_m, *(each.ravel() for each in gradient(dem))])
    usable = np.flatnonzero(common.ravel() & np.isfinite(model).all(axis=1))
    if len(usable) == 0:
        return np.full(model.shape[1], np.inf)
    usable = usable[spread_indices(PLANE_CELLS, len(usable))]
    one, other = (each.ravel()[usable] for each in sigmas_m)
    difference_m = np.sqrt(one**2 + other**2 - 2 * shared.covariance_m2(one, other))
    distance_m = cdist(place_m[usable], place_m[usable])
    alike = shared.correlation(float(np.median(one)), float(np.median(other)), distance_m)
    solved = np.linalg.pinv(model[usable]) * difference_m
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", solved, alike, solved), 0.0))


def trend_m(shift: Shift, one: GriddedSource, other: GriddedSource) -> Cells:
    """Return the vertical shift and tilt of a source against another one in all cells."""
    grid = one.dem.grid
    west, east, south, north = grid.cut(*_common_box(one, other)).extent_m
    return shift.trend_m(grid.centres_m, np.array([(west + east) / 2, (south + north) / 2])).reshape(grid.shape)


def compared(one: GriddedSource, other: GriddedSource, shared: SharedErrors, pairs: int) -> tuple[Pair, Mask]:
    """Return the tests of two sources, one of so many pairs, and the cells where they contradict each other."""
    common, level = one.dem.filled & other.dem.filled, FALSE_ALARM / pairs / TESTS
    count, size = int(common.sum()), NEIGHBOURHOOD_CELLS
    sigma_m, navigation_m2 = (one.sigma_m[common], other.sigma_m[common]), one.common_m**2 + other.common_m**2
    cell_m2, mean_m2 = np.zeros((2, *common.shape))
    cell_m2[common] = sigma_m[0] ** 2 + sigma_m[1] ** 2 - 2 * shared.covariance_m2(*sigma_m)
    mean_m2[common] = shared.mean_variance_m2(*sigma_m, size * one.dem.grid.spacing_m)
    difference_m = np.where(common, one.dem.height_m - other.dem.height_m, 0.0)
    total_m = np.sqrt((cell_m2 + navigation_m2)[common])
    independent = shared.independent(float(np.median(sigma_m[0])), float(np.median(sigma_m[1])), count)
    square = float(np.mean((difference_m[common] / total_m) ** 2))
    # A shift is no scatter, and contradictions of some places are not of the bulk.
    shift, found = shift_of(one, other, shared, level) or (None, ())
    shifted_m = 0.0 if shift is None else trend_m(shift, one, other)[common]
    scatter = nmad((difference_m[common] - shifted_m) / total_m)
    if scatter < 1 or chi2.sf(MAD_EFFICIENCY * independent * scatter**2, MAD_EFFICIENCY * independent) >= level:
        scatter = 1.0

    def mean(values: Cells) -> Cells:
        return uniform_filter(np.where(common, values, 0.0), size, mode="constant") / np.maximum(fraction, 1e-9)

    fraction = uniform_filter(common.astype(float), size, mode="constant")
    # A neighbourhood that both fill partly averages less.
    error_m2 = scatter**2 * np.minimum(mean(cell_m2), mean(mean_m2) / np.maximum(fraction, 1e-9)) + mean(navigation_m2)
    beyond = -float(ndtri(level / 2 / max(1.0, count / size**2)))
    apart = common & (np.abs(mean(difference_m)) > beyond * np.sqrt(np.maximum(error_m2, 0.0)))
    pair = Pair(
        first=one.name,
        second=other.name,
        cells=count,
        shift=shift,
        significant=found,
        chi2=square,
        p=float(chi2.sf(independent * square, independent)),
        scatter=float(scatter),
        contradicting=int(apart.sum()),
    )
    return pair, apart
