"""Tests of two sources for consistency: shift and tilt, the scatter of their differences, and contradictions.

Each pair has three tests at a third of its share of the false alarms: the five parameters of the shift, by Student's t
of a jackknife over blocks (`accuracy.robust_errors`) or by the known errors of the cells; the scatter of the bulk of the differences over their standard
deviations, by chi-squared of as many independent ones as their correlation leaves; and the mean of the differences over
each neighbourhood, whose variance is known. For errors that are Gaussian and as large as stated a false alarm in any
test of a fusion has the probability `FALSE_ALARM` at most (Bonferroni).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter
from scipy.spatial.distance import cdist
from scipy.special import ndtri, stdtr, stdtrit
from scipy.stats import chi2

from sionna_radar.accuracy.checkpoints import gradient
from sionna_radar.accuracy.compare import nmad
from sionna_radar.accuracy.reference import MIN_CELLS, ReferenceSurface, Shift, shift_between
from sionna_radar.accuracy.robust_errors import BLOCKS
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.studies.fusion.shared_errors import SharedErrors

FALSE_ALARM, TESTS = 0.01, 3
# Cells along the side of a neighbourhood: a narrower contradiction is averaged with what surrounds it.
NEIGHBOURHOOD_CELLS = 5
# Cells of which the errors of a fitted shift are computed.
PLANE_CELLS = 300
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
    """

    name: str
    kind: str
    dem: Raster
    sigma_m: Cells
    common_m: Cells
    moved: Shift | None = None

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


def shift_of(one: GriddedSource, other: GriddedSource, shared: SharedErrors) -> Shift | None:
    """Return the shift of a source against another one, in the middle of their common cells; None with too few.

    Its standard deviations are those of the jackknife, or those that the errors of cells explain where these are larger:
    blocks of a narrow overlap are not independent.
    """
    box = _common_box(one, other)
    grid = one.dem.grid.cut(*box)
    first, second = (Raster(grid=grid, height_m=each.dem.height_m[box]) for each in (one, other))
    common = first.filled & second.filled
    if common.sum() < MIN_CELLS:
        return None
    shift = shift_between(first, ReferenceSurface.of(second), common)
    slope = gradient(second) if shift.east_m is not None else ()
    columns = [np.ones(grid.rows * grid.columns), *(grid.centres_m - grid.centres_m.mean(axis=0)).T]
    model = np.column_stack([*columns, *(each.ravel() for each in slope)])
    usable = np.flatnonzero(common.ravel() & np.isfinite(model).all(axis=1))
    if len(usable) < MIN_CELLS:
        return shift
    usable = usable[spread_indices(PLANE_CELLS, len(usable))]
    sigma_m = [each.sigma_m[box].ravel()[usable] for each in (one, other)]
    difference_m = np.sqrt(sigma_m[0] ** 2 + sigma_m[1] ** 2 - 2 * shared.covariance_m2(*sigma_m))
    usual = float(np.median(sigma_m[0])), float(np.median(sigma_m[1]))
    alike = shared.correlation(*usual, cdist(grid.centres_m[usable], grid.centres_m[usable]))
    solved = np.linalg.pinv(model[usable]) * difference_m
    explained = STUDENT * np.sqrt(np.einsum("ij,jk,ik->i", solved, alike, solved))
    names = list(SIGMA_OF.values())[: len(explained)]
    larger = {name: max(getattr(shift, name), float(each)) for name, each in zip(names, explained, strict=True)}
    return replace(shift, **larger)


def trend_m(shift: Shift, one: GriddedSource, other: GriddedSource) -> Cells:
    """Return the vertical shift and tilt of a source against another one in all cells."""
    grid = one.dem.grid
    west, east, south, north = grid.cut(*_common_box(one, other)).extent_m
    return shift.trend_m(grid.centres_m, np.array([(west + east) / 2, (south + north) / 2])).reshape(grid.shape)


def significant(shift: Shift, level: float, navigation_m: float = 0.0) -> tuple[str, ...]:
    """Return the parameters of a shift that differ from zero, by their names in it.

    level: probability of any by chance. navigation_m: standard deviation of a vertical shift that navigation explains.
    """
    found = []
    for name, sigma_name in SIGMA_OF.items():
        value, sigma = getattr(shift, name), getattr(shift, sigma_name)
        if value is not None and sigma is not None:
            sigma = max(float(np.hypot(sigma / STUDENT, navigation_m if name == "up_m" else 0.0)), 1e-12)
            if 2 * float(stdtr(BLOCKS - 1, -abs(value) / sigma)) < level / len(SIGMA_OF):
                found.append(name)
    return tuple(found)


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
    shift = shift_of(one, other, shared)
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
    explained_m = float(np.sqrt(np.mean(navigation_m2[common])))
    pair = Pair(
        first=one.name,
        second=other.name,
        cells=count,
        shift=shift,
        significant=() if shift is None else significant(shift, level, explained_m),
        chi2=square,
        p=float(chi2.sf(independent * square, independent)),
        scatter=float(scatter),
        contradicting=int(apart.sum()),
    )
    return pair, apart
