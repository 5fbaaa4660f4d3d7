"""Fusion: one DEM, with its uncertainty, from the maps and points of several sensors and flight lines.

The height that source i states in a cell is z + e_i + u_i. The error e_i of the cell has the stated standard deviation
s_i. It holds noise, independent between sources, and the relief that the terrain prior leaves out, which they share:
the errors of two sources have the covariance c_ij (`shared_errors`). u_i is common to the cells of a source: what its
navigation states, v_i, and beyond that unknown shifts.

Consistency first. For each two sources vertical offset, tilt and horizontal shift are estimated (`accuracy.reference`),
with Student's t of a jackknife over blocks; and the differences are compared with their variance
s_i^2 + s_j^2 - 2 c_ij + v_i^2 + v_j^2. Where the bulk of them scatters more than that, fused standard deviations are
larger by as much (Birge 1932, "The calculation of errors by the method of least squares", Physical Review 40, 207).
The mean of the differences over a neighbourhood has a known variance, too: where it lies beyond what both sources
state, they contradict each other. All tests together give a false alarm in 1 % of fusions.

Then each cell takes the largest set of sources that agree with each other, if it has more than half of those that fill
the cell: of three, the two that agree. Without such a majority, as of two that contradict each other, the cell stays
empty: the terrain prior cannot tell, since a surface half a metre higher is as smooth, and a hole is safer than a wrong
height that is stated to be good. With the covariance M of their errors, M_ii = s_i^2 + v_i^2 and M_ij = c_ij, the
fused height is the best linear unbiased estimate (Aitken 1935), of the weights M^-1 1 / (1' M^-1 1) and the variance
1 / (1' M^-1 1). Under the prior alone, the same source twice weighs as once, and more sources never lower what none of
them resolves. A cell that one source fills is that source's.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter
from scipy.special import ndtri, stdtr, stdtrit
from scipy.stats import chi2

from sionna_radar.accuracy.compare import nmad
from sionna_radar.accuracy.reference import MIN_CELLS, ReferenceSurface, Shift, shift_between
from sionna_radar.accuracy.robust_errors import BLOCKS
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Grid, Raster, spans
from sionna_radar.inference.terrain.covariance import MIN_NOISE_M, Covariance, fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.studies.fusion.shared_errors import NEIGHBOURHOOD_CELLS, SharedErrors
from sionna_radar.studies.fusion.sources import Source, common_grid, read_sources

logger = logging.getLogger("sionna_radar")

# Probability that sources without contradictions show any, over all tests of a fusion.
FALSE_ALARM = 0.01
# Cells from which the terrain prior is fitted.
PRIOR_CELLS = 1500
# Least fraction of a neighbourhood that both sources fill.
MIN_NEIGHBOURS = 0.5
# A standard deviation of `Shift` makes an interval of 95 % of 1.96 of it; Student's is this much narrower.
STUDENT = float(stdtrit(BLOCKS - 1, 0.975) / ndtri(0.975))

Cells = Float[np.ndarray, "row column"]


@dataclass(frozen=True, kw_only=True)
class SourceSummary:
    """A source on the cells of the fused DEM.

    cells: that it fills; alone: those that it makes alone. sigma_m: its median standard deviation.
    moved: what was taken out of it; None if nothing was.
    """

    name: str
    kind: str
    cells: int
    alone: int
    sigma_m: float
    moved: Shift | None


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two sources where both have heights: first minus second.

    cells: common ones. shift: of the first against the second; None of too few cells.
    significant: names of the parameters of the shift that differ from zero, `up_m` to `tilt_north`.
    chi2: mean squared difference over its variance; p: of that, for the independent differences there are.
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
    def agrees(self) -> bool:
        """Whether no test found a difference."""
        return not self.significant and self.scatter == 1.0 and self.contradicting == 0


@dataclass(frozen=True, kw_only=True)
class Fusion:
    """One DEM from several sources.

    dem, sigma: heights and their standard deviations; empty where no source has heights, or where they contradict each
        other without a majority.
    source: for each cell the sum of 2^number over the sources that made it; of those in `sources`.
    contradictions: span of the heights of all sources, m, in cells in which some contradict each other.
    covariance: the terrain prior. noted: warnings.
    """

    sources: tuple[SourceSummary, ...]
    pairs: tuple[Pair, ...]
    dem: Raster
    sigma: Raster
    source: Raster
    contradictions: Raster
    covariance: Covariance
    aligned_to: str | None
    warnings: tuple[str, ...]

    @property
    def legend(self) -> dict[int, str]:
        """The sources of each value of `source`."""
        values = np.unique(self.source.height_m[self.source.filled]).astype(int).tolist()
        return {v: " + ".join(s.name for n, s in enumerate(self.sources) if v >> n & 1) for v in values}

    @property
    def suspect(self) -> str | None:
        """The one of three or more sources that is shifted against all others, which are not against each other."""
        shifted = [{pair.first, pair.second} for pair in self.pairs if pair.significant]
        names = [s.name for s in self.sources if sum(s.name in {p.first, p.second} for p in self.pairs) > 1]
        found = [name for name in names if shifted and all(name in pair for pair in shifted)]
        return found[0] if len(found) == 1 and len(shifted) > 1 else None


def fuse(
    sources: Sequence[str | Path],
    *,
    sigma_m: float | Mapping[str, float] | None = None,
    spacing_m: float | None = None,
    align_to: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Fusion:
    """Fuse surveys, recordings, point clouds and elevation rasters into one DEM with its uncertainty.

    Sources are tested for consistency first; where they contradict each other, they are not averaged.

    Parameters
    ----------
    sources:
        Two to twelve: folders of `run` or `process`, recordings, LAS or LAZ clouds, or elevation rasters. The order
        has no effect.
    sigma_m:
        Standard deviation, m, of clouds and rasters that state none; or by path, which then comes first.
    spacing_m:
        Size of the cells, m; default: those of the finest raster.
    align_to:
        The source from whose heights the shifts of all others are taken out; default: none is.
    overrides:
        Settings for recordings, as for `process`.

    Returns
    -------
    The DEM in metres, its standard deviations, the sources of each cell, contradictions, and the tests of each pair.

    Raises
    ------
    InputFileError
        A source cannot be read, states no standard deviation, overlaps no other, or has another datum.
    ScenarioError
        Too few or too many sources, or an option that does not fit.

    Examples
    --------
    >>> from pathlib import Path
    >>> hills = load_scenario("hills", {"platform.length_m": 10.0, "dem.method": "smooth"})
    >>> for seed in (1, 2):
    ...     files = write_survey(run(hills.replace({"seed": seed})), Path(f"line{seed}"))
    >>> fused = fuse(["line1", "line2"])
    >>> fused.legend[3]
    'line1 + line2'
    """
    paths = [Path(path) for path in sources]
    read = read_sources(paths, sigma_m, overrides or {})
    grid = common_grid(read, spacing_m)
    microrelief_m = max(source.microrelief_m for source in read)
    read = [source.on_map(grid, microrelief_m) for source in read]
    reference = None
    if align_to is not None:
        given = dict(zip(sorted(paths, key=lambda path: (path.name, str(path))), read, strict=True))
        if Path(align_to) not in given:
            raise ScenarioError.of_option("--align-to", f"{str(align_to)!r} is no source; name one as it is given")
        reference = given[Path(align_to)]
    return fuse_sources(read, grid, microrelief_m, reference)


@dataclass(frozen=True, kw_only=True)
class _Gridded:
    """A source on the common grid; NaN in its empty cells."""

    name: str
    height_m: Cells
    sigma_m: Cells
    common_m: Cells

    @property
    def filled(self) -> Bool[np.ndarray, "row column"]:
        """Cells with a height."""
        return np.isfinite(self.height_m)

    @property
    def variance_m2(self) -> Cells:
        """Variance of the heights, errors of navigation included."""
        return self.sigma_m**2 + self.common_m**2


def fuse_sources(
    sources: Sequence[Source], grid: Grid, microrelief_m: float, reference: Source | None = None
) -> Fusion:
    """Return the fusion of sources on a grid; see `fuse`."""
    made = [_on(source, grid) for source in sources]
    _check_overlap(sources, made)
    moved: list[Shift | None] = [None] * len(made)
    if reference is not None:
        held = made[list(sources).index(reference)]
        for number, source in enumerate(sources):
            if source is not reference:
                made[number], moved[number] = _aligned(source, made[number], held, grid)
    heights = _finest(made, grid)
    covariance = fit_covariance(heights.above(heights.trend(), microrelief_m)).covariance
    stated = np.concatenate([each.sigma_m[each.filled] for each in made])
    shared = SharedErrors(covariance, grid.spacing_m, (float(stated.min()), float(stated.max())))
    overlapping = [(i, j) for i, j in combinations(range(len(made)), 2) if (made[i].filled & made[j].filled).any()]
    pairs: dict[tuple[int, int], Pair] = {}
    apart: dict[tuple[int, int], Bool[np.ndarray, "row column"]] = {}
    with stage("comparing", len(overlapping)):
        for number in overlapping:
            one, other = (made[n] for n in number)
            pairs[number], apart[number] = _compared(one, other, grid, shared, len(overlapping))
            advance()
    height_m, sigma_m, code = _fused(made, apart, pairs, shared)
    span_m = np.full(grid.shape, np.nan)
    contradicted = np.logical_or.reduce([*apart.values()])
    everything = np.stack([each.height_m for each in made])[:, contradicted]
    span_m[contradicted] = np.nanmax(everything, axis=0) - np.nanmin(everything, axis=0)
    fusion = Fusion(
        sources=tuple(
            SourceSummary(
                name=source.name,
                kind=source.kind,
                cells=int(each.filled.sum()),
                alone=int((code == 2**number).sum()),
                sigma_m=float(np.median(np.sqrt(each.variance_m2[each.filled]))),
                moved=moved[number],
            )
            for number, (source, each) in enumerate(zip(sources, made, strict=True))
        ),
        pairs=tuple(pairs.values()),
        dem=Raster(grid=grid, height_m=height_m),
        sigma=Raster(grid=grid, height_m=sigma_m, quantity="standard deviation of the height"),
        source=Raster(grid=grid, height_m=np.where(code > 0, code, np.nan), quantity="mask"),
        contradictions=Raster(grid=grid, height_m=span_m, quantity="height difference"),
        covariance=covariance,
        aligned_to=None if reference is None else reference.name,
        warnings=(),
    )
    fusion = replace(fusion, warnings=tuple(_warnings(fusion)))
    for warning in fusion.warnings:
        logger.warning("%s", warning)
    return fusion


def _on(source: Source, grid: Grid, shift_m: tuple[float, float] = (0.0, 0.0)) -> _Gridded:
    """Return a source on a grid, moved by a horizontal shift."""
    surface = source.surface
    assert surface is not None
    assert source.sigma_m is not None
    height_m = surface.on(grid, shift_m).height_m
    sigma_m = np.maximum(surface.on(grid, shift_m, source.sigma_m).height_m, MIN_NOISE_M)
    common_m = np.zeros(grid.shape)
    if source.navigation_m is not None:
        common_m = np.nan_to_num(surface.on(grid, shift_m, source.navigation_m).height_m)
    filled = np.isfinite(height_m) & np.isfinite(sigma_m)
    return _Gridded(
        name=source.name,
        height_m=np.where(filled, height_m, np.nan),
        sigma_m=np.where(filled, sigma_m, np.nan),
        common_m=common_m,
    )


def _check_overlap(sources: Sequence[Source], made: Sequence[_Gridded]) -> None:
    """Raise InputFileError for a source without a cell in common with any other."""
    for source, one in zip(sources, made, strict=True):
        if not any((one.filled & other.filled).any() for other in made if other is not one):
            west, south, east, north = source.extent_m
            message = f"has no cell in common with another source; it covers {spans((west, south, east, north))}"
            raise InputFileError(f"{source.named} {message}; leave it out, or add one that overlaps both")


def _finest(made: Sequence[_Gridded], grid: Grid) -> Heights:
    """Return heights spread over all cells, each of the source of the smallest standard deviation, for the prior."""
    variance = np.stack([np.where(each.filled, each.variance_m2, np.inf) for each in made])
    best = np.argmin(variance, axis=0)
    row, column = np.nonzero(np.isfinite(variance.min(axis=0)))
    stride = max(1, round(np.sqrt(len(row) / PRIOR_CELLS)))
    kept = (row % stride == 0) & (column % stride == 0)
    cell = row[kept], column[kept]
    height_m, sigma_m = (
        np.stack([getattr(each, name) for each in made])[best[cell], *cell] for name in ("height_m", "sigma_m")
    )
    return Heights.at_places(np.column_stack([grid.x_m[cell[1]], grid.y_m[cell[0]]]), height_m, sigma_m)


# --------------------------------------------------------------------------------------------------- consistency
PARAMETERS = ("up_m", "tilt_east", "tilt_north", "east_m", "north_m")


def p_values(shift: Shift, navigation_m: float) -> dict[str, float]:
    """Return the probability of each parameter of a shift by chance; 1 where it was not estimated.

    navigation_m: standard deviation of the vertical shift that navigation explains.
    """
    found = {}
    for name in PARAMETERS:
        stem = name.removesuffix("_m")
        value = getattr(shift, name)
        sigma = getattr(shift, f"{stem}_sigma_m" if name.endswith("_m") else f"{stem}_sigma")
        if value is None or sigma is None:
            found[name] = 1.0
            continue
        sigma = np.hypot(sigma / STUDENT, navigation_m if name == "up_m" else 0.0)
        found[name] = 2 * float(stdtr(BLOCKS - 1, -abs(value) / max(sigma, 1e-12)))
    return found


def _shift(one: _Gridded, other: _Gridded, grid: Grid) -> Shift | None:
    common = one.filled & other.filled
    if common.sum() < MIN_CELLS:
        return None
    surface = ReferenceSurface.of(Raster(grid=grid, height_m=other.height_m))
    return shift_between(Raster(grid=grid, height_m=one.height_m), surface, common)


def _compared(
    one: _Gridded, other: _Gridded, grid: Grid, shared: SharedErrors, pairs: int
) -> tuple[Pair, Bool[np.ndarray, "row column"]]:
    """Return the tests of two sources, one of so many pairs, and the cells where they contradict each other."""
    common, level = one.filled & other.filled, FALSE_ALARM / pairs
    shift = _shift(one, other, grid)
    navigation_m2 = one.common_m**2 + other.common_m**2
    explained_m = float(np.sqrt(np.mean(navigation_m2[common])))
    significant = (
        ()
        if shift is None
        else tuple(name for name, p in p_values(shift, explained_m).items() if p < level / 3 / len(PARAMETERS))
    )
    sigma_m = one.sigma_m[common], other.sigma_m[common]
    variance = one.variance_m2 + other.variance_m2
    variance[common] -= 2 * shared.covariance_m2(*sigma_m)
    difference_m = one.height_m - other.height_m
    z = difference_m[common] / np.sqrt(variance[common])
    count = int(common.sum())
    independent = shared.effective_cells((float(np.median(sigma_m[0])), float(np.median(sigma_m[1]))), count)
    square = float(np.mean(z**2))
    # The bulk's scatter: contradictions, and what is common to all differences, are no noise.
    scatter = nmad(z)
    if chi2.sf(independent * scatter**2, independent) >= level / 3:
        scatter = 1.0
    scatter = max(scatter, 1.0)
    of_mean = np.zeros(grid.shape)
    of_mean[common] = shared.mean_variance_m2(*sigma_m)
    size = NEIGHBOURHOOD_CELLS
    fraction = uniform_filter(common.astype(float), size, mode="constant")
    with np.errstate(invalid="ignore", divide="ignore"):
        mean_m, cell_m2, mean_m2, common_m2 = (
            uniform_filter(np.where(common, values, 0.0), size, mode="constant") / fraction
            for values in (difference_m, variance - navigation_m2, of_mean, navigation_m2)
        )
        # A neighbourhood that is filled partly averages less.
        error_m2 = scatter**2 * np.minimum(cell_m2, mean_m2 / fraction) + common_m2
        windows = max(1.0, count / size**2)
        apart = (
            common
            & (fraction >= MIN_NEIGHBOURS)
            & (np.abs(mean_m) > -ndtri(level / 3 / windows / 2) * np.sqrt(error_m2))
        )
    pair = Pair(
        first=one.name,
        second=other.name,
        cells=count,
        shift=shift,
        significant=significant,
        chi2=square,
        p=float(chi2.sf(independent * square, independent)),
        scatter=scatter,
        contradicting=int(apart.sum()),
    )
    return pair, apart


def _aligned(source: Source, made: _Gridded, held: _Gridded, grid: Grid) -> tuple[_Gridded, Shift]:
    """Return a source without its shift against another one: the offset, and what else of it is significant."""
    shift = _shift(made, held, grid)
    if shift is None:
        message = f"has fewer than {MIN_CELLS} cells in common with {held.name}, to which it is to be aligned"
        raise InputFileError(f"{source.named} {message}; leave --align-to out, or name another source")
    level = FALSE_ALARM / len(PARAMETERS)
    kept = {name: p < level or name == "up_m" for name, p in p_values(shift, 0.0).items()}
    if kept["east_m"] or kept["north_m"]:
        # A vertical shift that goes with a horizontal one.
        kept["east_m"] = kept["north_m"] = True
    shift = replace(shift, **{name: getattr(shift, name) if kept[name] else None for name in PARAMETERS})
    moved = _on(source, grid, (-(shift.east_m or 0.0), -(shift.north_m or 0.0)))
    west, east, south, north = grid.extent_m
    middle_m = np.array([(west + east) / 2, (south + north) / 2])
    trend_m = shift.trend_m(grid.centres_m, middle_m).reshape(grid.shape)
    common_m = np.hypot(held.common_m, shift.up_sigma_m / STUDENT)
    return replace(moved, height_m=moved.height_m - trend_m, common_m=common_m), shift


# --------------------------------------------------------------------------------------------------------- fusing
def _fused(
    made: Sequence[_Gridded],
    apart: Mapping[tuple[int, int], Bool[np.ndarray, "row column"]],
    pairs: Mapping[tuple[int, int], Pair],
    shared: SharedErrors,
) -> tuple[Cells, Cells, Int[np.ndarray, "row column"]]:
    """Return heights, standard deviations, and the sum of 2^number of the sources of each cell; 0 for none."""
    filled = np.stack([each.filled for each in made])
    shape = filled.shape[1:]
    height_m, sigma_m, code = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    # Cells of the same sources and contradictions are treated at once.
    facts = np.concatenate([filled, *(cells[None] for cells in apart.values())]).reshape(-1, filled[0].size)
    patterns, pattern_of = np.unique(facts, axis=1, return_inverse=True)
    for number, pattern in enumerate(patterns.T):
        present = np.flatnonzero(pattern[: len(made)]).tolist()
        against = {pair for pair, fact in zip(apart, pattern[len(made) :], strict=True) if fact}
        chosen = majority(present, against)
        if not chosen:
            continue
        cells = (pattern_of.ravel() == number).reshape(shape)
        stated = [made[n].sigma_m[cells] for n in chosen]
        covariance = np.empty((len(stated[0]), len(chosen), len(chosen)))
        for i, n in enumerate(chosen):
            covariance[:, i, i] = made[n].variance_m2[cells]
        for i, j in combinations(range(len(chosen)), 2):
            covariance[:, i, j] = covariance[:, j, i] = shared.covariance_m2(stated[i], stated[j])
        precision = np.linalg.solve(covariance, np.ones((*covariance.shape[:2], 1)))[..., 0]
        variance = 1 / precision.sum(axis=1)
        heights = np.stack([made[n].height_m[cells] for n in chosen], axis=1)
        height_m[cells] = variance * np.sum(precision * heights, axis=1)
        scatter = max((pairs[pair].scatter for pair in combinations(chosen, 2)), default=1.0)
        sigma_m[cells] = scatter * np.sqrt(variance)
        code[cells] = sum(2**n for n in chosen)
    return height_m, sigma_m, code


def majority(present: Sequence[int], against: set[tuple[int, int]]) -> tuple[int, ...]:
    """Return the only largest set of sources that agree, more than half of those present; empty without one.

    against: pairs, in increasing order, that contradict each other.
    """
    for size in range(len(present), len(present) // 2, -1):
        agreeing = [each for each in combinations(present, size) if against.isdisjoint(combinations(each, 2))]
        if agreeing:
            return agreeing[0] if len(agreeing) == 1 else ()
    return ()


def _warnings(fusion: Fusion) -> list[str]:
    """Return what a user must know of the sources."""
    shifted = [pair for pair in fusion.pairs if pair.significant]
    warnings = [
        f"{pair.first} lies {pair.shift.up_m:+.2f} m off {pair.second}; look at datum, unit and range zero of both, or "
        "take the shifts out with --align-to"
        for pair in shifted
        if pair.shift is not None and "up_m" in pair.significant
    ]
    if fusion.suspect is not None:
        warnings.append(f"{fusion.suspect} is shifted against all other sources, which agree")
    left = int((fusion.contradictions.filled & ~fusion.dem.filled).sum())
    if left:
        warnings.append(f"{left:,} cells are left empty: their sources contradict each other, and none has a majority")
    return warnings
