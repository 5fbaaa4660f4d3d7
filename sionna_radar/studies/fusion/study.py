"""Fusion: one DEM, with its uncertainty, from the maps and points of several sensors and flight lines.

The height that source i states in a cell is z + e_i + u_i. The error e_i of the cell has the stated standard deviation
s_i. It holds noise, independent between sources, and relief that the terrain prior leaves out, which they share: the
errors of two sources have the covariance c_ij (`shared_errors`). u_i is common to neighbouring cells of the source:
what its navigation states, v_i, and beyond that unknown shifts.

Consistency first (`consistency`): offset, tilt and horizontal shift of each two sources, the scatter of their
differences, and the mean of these over neighbourhoods. Where the bulk of the differences scatters more than both state,
fused standard deviations are larger by as much (Birge 1932, "The calculation of errors by the method of least squares",
Physical Review 40, 207). Where a neighbourhood lies beyond what both state, they contradict each other there.

Then each cell takes the largest set of sources that agree, if it is more than half of those that fill the cell: of
three, the two that agree. A source that is shifted against two others or more, which agree with each other, yields to
them elsewhere, too. Without such a majority, as of two that contradict each other, the cell stays empty. The terrain
prior cannot decide: a surface half a metre higher is as probable, and a hole is safer than a wrong height that is
stated to be good. With the covariance M of their errors, M_ii = s_i^2 + v_i^2 and M_ij = c_ij, the fused height is the
best linear unbiased estimate (Aitken 1935), of the weights M^-1 1 / (1' M^-1 1) and the variance 1 / (1' M^-1 1). More
sources so never lower what none of them resolves. A cell that one source fills is that source's.
"""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int
from pyproj import CRS
from scipy.spatial.distance import cdist

from sionna_radar.accuracy.coregistration import MIN_CELLS
from sionna_radar.accuracy.reference import ReferenceSurface
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Georeference, Grid, Raster, spans
from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.covariance_fit import MIN_NOISE_M, fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.studies.fusion.consistency import (
    FALSE_ALARM,
    SIGMA_OF,
    STUDENT,
    Cells,
    GriddedSource,
    Mask,
    Pair,
    compared,
    overlaps,
    shift_of,
    trend_m,
)
from sionna_radar.studies.fusion.shared_errors import SharedErrors
from sionna_radar.studies.fusion.sources import Source, common_grid, mapped, read_sources, sorted_paths

logger = logging.getLogger("sionna_radar")

# Fewest cells from which the terrain prior is fitted, about, and the distance between those of a first fit, in cells.
MIN_PRIOR_CELLS, FIRST_STRIDE = 300, 3

Numbers = tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Fusion:
    """One DEM from several sources.

    dem, sigma: heights and their standard deviations; empty where no source has heights, or where they contradict each
        other without a majority.
    source: for each cell the sum of 2^n over the sources that made it, n being their numbers in `sources` from 0.
    contradictions: span of the heights of all sources, m, in cells in which two contradict each other.
    pairs: the tests of each two sources with common cells. covariance: the terrain prior.
    aligned_to: the source from whose heights the shifts of the others were taken out.
    """

    sources: tuple[GriddedSource, ...]
    pairs: tuple[Pair, ...]
    dem: Raster
    sigma: Raster
    source: Raster
    contradictions: Raster
    covariance: Covariance
    aligned_to: str | None

    @property
    def legend(self) -> dict[int, str]:
        """The sources of each value of `source`."""
        values = np.unique(self.source.height_m[self.source.filled]).astype(int).tolist()
        return {v: " + ".join(s.name for n, s in enumerate(self.sources) if v >> n & 1) for v in values}

    @property
    def suspect(self) -> str | None:
        """The source that is shifted against two others or more, which agree with each other."""
        return shifted_alone(self.pairs)

    @property
    def left_empty(self) -> int:
        """Number of cells that are empty because their sources contradict each other."""
        return int((self.contradictions.filled & ~self.dem.filled).sum())

    @property
    def warnings(self) -> list[str]:
        """What a user must know of the sources."""
        remedy = "look at datum, unit, range zero and mounting of both, or take shifts out with --align-to"
        found = [
            f"{pair.first} against {pair.second}: {', '.join(pair.findings)}; {remedy}"
            for pair in self.pairs
            if pair.significant
        ]
        found += [
            f"{pair.first} and {pair.second} hold the same heights in all {pair.cells:,} common cells: copies of one "
            "measurement count twice; leave one out"
            for pair in self.pairs
            if pair.chi2 == 0.0
        ]
        if self.suspect is not None:
            found.append(f"{self.suspect} is shifted against the other sources, which agree with each other")
        if self.left_empty:
            found.append(
                f"{self.left_empty:,} cells stay empty: their sources contradict each other without a majority"
            )
        return found


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
        Too few or too many sources, a fusion beside a source that it holds, or an option that does not fit.

    Examples
    --------
    >>> from pathlib import Path
    >>> hills = load_scenario("hills", {"platform.length_m": 10.0, "dem.method": "smooth"})
    >>> for seed in (1, 2):
    ...     files = write_survey(run(hills.replace({"seed": seed})), Path(f"line{seed}"))
    >>> fuse(["line1", "line2"]).legend
    {1: 'line1', 2: 'line2', 3: 'line1 + line2'}
    """
    paths = sorted_paths(sources)
    if align_to is not None and Path(align_to) not in paths:
        raise ScenarioError.of_option("--align-to", f"{str(align_to)!r} is no source; name one as it is given")
    read = read_sources(paths, sigma_m, overrides or {})
    grid, crs = common_grid(read, spacing_m)
    microrelief_m = max(source.microrelief_m for source in read)
    read = [mapped(source, grid, microrelief_m) for source in read]
    return fuse_sources(read, grid, crs, microrelief_m, None if align_to is None else paths.index(Path(align_to)))


@on_one_thread
def fuse_sources(
    sources: Sequence[Source], grid: Grid, crs: CRS | None, microrelief_m: float, reference: int | None = None
) -> Fusion:
    """Return the fusion of mapped sources on a grid in their map; see `fuse`.

    reference: number of the source from which the shifts of the others are taken out.
    """
    made = [on_grid(source, grid) for source in sources]
    _check_overlap(sources, made)
    shared = _shared_errors(made, made if reference is None else [made[reference]], grid, microrelief_m)
    made = [on_grid(source, grid, prior=shared.covariance) for source in sources]
    high_m = max(float(np.nanmax(each.sigma_m)) for each in made)
    shared = replace(shared, sigma_m=(shared.sigma_m[0], high_m))
    if reference is not None:
        held = made[reference]
        made = [m if m is held else _aligned(s, m, held, shared) for s, m in zip(sources, made, strict=True)]
    numbers = [(i, j) for i, j in combinations(range(len(made)), 2) if overlaps(made[i], made[j])]
    pairs: dict[Numbers, Pair] = {}
    apart: dict[Numbers, Mask] = {}
    with stage("comparing", len(numbers)):
        for i, j in numbers:
            pairs[i, j], apart[i, j] = compared(made[i], made[j], shared, len(numbers))
            advance()
    height_m, sigma_m, code = _fused(made, apart, pairs, shared)
    contradicted = np.logical_or.reduce([*apart.values()])
    several = np.stack([each.dem.height_m for each in made])[:, contradicted]
    span_m = np.full(grid.shape, np.nan)
    span_m[contradicted] = np.nanmax(several, axis=0) - np.nanmin(several, axis=0)
    place = None if crs is None else Georeference(crs_wkt=crs.to_wkt(), origin_m=(0.0, 0.0, 0.0))
    cells = replace(grid, georeference=place)
    fusion = Fusion(
        sources=tuple(made),
        pairs=tuple(pairs.values()),
        dem=Raster(grid=cells, height_m=height_m),
        sigma=Raster(grid=cells, height_m=sigma_m, quantity="standard deviation of the height"),
        source=Raster(grid=cells, height_m=np.where(code > 0, code, np.nan), quantity="mask"),
        contradictions=Raster(grid=cells, height_m=span_m, quantity="height difference"),
        covariance=shared.covariance,
        aligned_to=None if reference is None else made[reference].name,
    )
    for warning in fusion.warnings:
        logger.warning("%s", warning)
    return fusion


def on_grid(
    source: Source, grid: Grid, shift_m: tuple[float, float] = (0.0, 0.0), prior: Covariance | None = None
) -> GriddedSource:
    """Return a source on a grid, moved by a horizontal shift.

    prior: of the ground; with it standard deviations hold what is not known of it between the source's own cells.
    """
    assert source.dem is not None
    assert source.sigma_m is not None
    surface = ReferenceSurface.of(source.dem)

    def values(of: Cells | None) -> Cells:
        return surface.on(grid, shift_m, None if of is None else of[::-1]).height_m

    height_m, sigma_m = values(None), np.maximum(values(source.sigma_m), MIN_NOISE_M)
    if prior is not None:
        sigma_m = np.hypot(sigma_m, interpolation_sigma_m(source.dem.grid, grid, shift_m, prior))
    height_m[~np.isfinite(sigma_m)] = np.nan
    sigma_m[~np.isfinite(height_m)] = np.nan
    navigation_m = np.zeros(grid.shape) if source.navigation_m is None else np.nan_to_num(values(source.navigation_m))
    dem = Raster(grid=grid, height_m=height_m)
    return GriddedSource(
        name=source.name,
        kind=source.kind,
        dem=dem,
        sigma_m=sigma_m,
        common_m=navigation_m,
        made_of=source.made_of,
    )


def interpolation_sigma_m(own: Grid, grid: Grid, shift_m: tuple[float, float], prior: Covariance) -> Cells:
    """Return the standard deviation of ground of a prior about its bilinear heights between cells of its own.

    own: these cells, moved by a horizontal shift. The result is zero in their middles, and of cells smaller than the
    grid's, of which heights are means.
    """
    step_m = own.spacing_m
    if step_m < grid.spacing_m:
        return np.zeros(grid.shape)
    # Fractions of a cell from the last middle to the west and the south; a millionth is rounding.
    east, north = (
        np.where(np.abs(cell - np.rint(cell)) < 1e-6, 0.0, cell - np.floor(cell))
        for cell in ((grid.x_m - shift_m[0] - own.west_m) / step_m, (grid.y_m - shift_m[1] - own.south_m) / step_m)
    )
    corners = list(product((0.0, 1.0), repeat=2))
    weight = np.stack([np.outer(np.abs(1 - j - north), np.abs(1 - i - east)) for i, j in corners])
    away_m = np.stack([step_m * np.hypot(*np.meshgrid(east - i, north - j)) for i, j in corners])
    apart = prior.at(step_m * cdist(corners, corners))
    variance_m2 = float(prior.at(np.zeros(1))[0]) - 2 * np.sum(weight * prior.at(away_m), axis=0)
    return np.sqrt(np.maximum(variance_m2 + np.einsum("iyx,ij,jyx->yx", weight, apart, weight), 0.0))


def _check_overlap(sources: Sequence[Source], made: Sequence[GriddedSource]) -> None:
    """Raise InputFileError for a source without a cell in common with any other."""
    for source, one in zip(sources, made, strict=True):
        if not any(overlaps(one, other) for other in made if other is not one):
            west, east, south, north = source.extent_m
            message = f"has no cell in common with another source; it covers {spans((west, south, east, north))}"
            raise InputFileError(f"{source.named} {message}; leave it out, or add one that overlaps both")


def _shared_errors(
    made: Sequence[GriddedSource], trusted: Sequence[GriddedSource], grid: Grid, microrelief_m: float
) -> SharedErrors:
    """Return the errors that sources share, by the terrain prior of the heights of some of them.

    In each cell the source of the smallest standard deviation counts. A map is smoother than its ground where cells are
    closer than its resolution: the prior is fitted again to cells that far apart.
    """
    variance = np.stack([np.where(each.dem.filled, each.variance_m2, np.inf) for each in trusted])
    row, column = np.nonzero(np.isfinite(variance.min(axis=0)))
    best = np.argmin(variance[:, row, column], axis=0)
    place_m = np.column_stack([grid.x_m[column], grid.y_m[row]])
    height_m = np.stack([each.dem.height_m for each in trusted])[best, row, column]
    sigma_m = np.stack([each.sigma_m for each in trusted])[best, row, column]
    heights = Heights.at_places(place_m - place_m.mean(axis=0), height_m, sigma_m)
    stated_m = np.concatenate([each.sigma_m[each.dem.filled] for each in made])
    low, high, usual = float(stated_m.min()), float(stated_m.max()), float(np.median(sigma_m))
    measured, most = heights.above(heights.trend(), microrelief_m), max(1, int(np.sqrt(len(row) / MIN_PRIOR_CELLS)))

    def fitted(stride: float) -> SharedErrors:
        every = int(np.clip(round(stride), 1, most))
        kept = np.flatnonzero((row % every == 0) & (column % every == 0))
        return SharedErrors(fit_covariance(measured.rows(kept)).covariance, grid.spacing_m, (low, high))

    return fitted(fitted(FIRST_STRIDE).resolution_m(usual) / grid.spacing_m)


def _aligned(source: Source, made: GriddedSource, held: GriddedSource, shared: SharedErrors) -> GriddedSource:
    """Return a source without its shift against another one: the offset, and what else of it is significant."""
    found = shift_of(made, held, shared, FALSE_ALARM) if overlaps(made, held) else None
    if found is None:
        message = f"has fewer than {MIN_CELLS} cells in common with {held.name}, to which it is to be aligned"
        raise InputFileError(f"{source.named} {message}; leave --align-to out, or name another source")
    shift, grid, kept = found[0], made.dem.grid, {"up_m", *found[1]}
    left_out: dict[str, Any] = {name: None for name in SIGMA_OF if name not in kept}
    shift = replace(shift, **left_out)
    moved = on_grid(source, grid, (-(shift.east_m or 0.0), -(shift.north_m or 0.0)), shared.covariance)
    dem = Raster(grid=grid, height_m=moved.dem.height_m - trend_m(shift, made, held))
    return replace(moved, dem=dem, common_m=np.hypot(held.common_m, shift.up_sigma_m / STUDENT), moved=shift)


def _fused(
    made: Sequence[GriddedSource],
    apart: Mapping[Numbers, Mask],
    pairs: Mapping[Numbers, Pair],
    shared: SharedErrors,
) -> tuple[Cells, Cells, Int[np.ndarray, "row column"]]:
    """Return heights, standard deviations, and the sum of 2^n of the sources of each cell; 0 for none."""
    filled = np.stack([each.dem.filled for each in made])
    shape = filled.shape[1:]
    height_m, sigma_m, code = np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    suspect = shifted_alone(pairs.values())
    # Cells of the same sources and the same contradictions are treated at once.
    facts = np.concatenate([filled, np.stack([*apart.values()])]).reshape(-1, code.size)
    patterns, pattern_of = np.unique(facts, axis=1, return_inverse=True)
    for number, pattern in enumerate(patterns.T):
        present = np.flatnonzero(pattern[: len(made)]).tolist()
        against = {pair for pair, fact in zip(apart, pattern[len(made) :], strict=True) if fact}
        chosen = majority(present, against) or majority([n for n in present if made[n].name != suspect], against)
        if not chosen:
            continue
        cells = (pattern_of.ravel() == number).reshape(shape)
        covariance = np.empty((int(cells.sum()), len(chosen), len(chosen)))
        for i, n in enumerate(chosen):
            covariance[:, i, i] = made[n].variance_m2[cells]
            for j, other in enumerate(chosen[:i]):
                both = shared.covariance_m2(made[other].sigma_m[cells], made[n].sigma_m[cells])
                covariance[:, i, j] = covariance[:, j, i] = both
        weight = np.linalg.solve(covariance, np.ones((*covariance.shape[:2], 1)))[..., 0]
        heights = np.stack([made[n].dem.height_m[cells] for n in chosen], axis=1)
        height_m[cells] = np.sum(weight * heights, axis=1) / weight.sum(axis=1)
        scatter = max((pairs[pair].scatter for pair in combinations(chosen, 2)), default=1.0)
        sigma_m[cells] = scatter / np.sqrt(weight.sum(axis=1))
        code[cells] = sum(2**n for n in chosen)
    return height_m, sigma_m, code


def shifted_alone(pairs: Iterable[Pair]) -> str | None:
    """Return the source that is shifted against two others or more, which agree; None without one."""
    shifted = [{pair.first, pair.second} for pair in pairs if pair.significant]
    common = set.intersection(*shifted) if len(shifted) > 1 else set()
    return common.pop() if len(common) == 1 else None


def majority(present: Sequence[int], against: set[Numbers]) -> tuple[int, ...]:
    """Return the only largest set of sources that agree, more than half of those present; empty without one.

    against: pairs, in increasing order, that contradict each other.
    """
    for size in range(len(present), len(present) // 2, -1):
        agreeing = [each for each in combinations(present, size) if against.isdisjoint(combinations(each, 2))]
        if agreeing:
            return agreeing[0] if len(agreeing) == 1 else ()
    return ()
