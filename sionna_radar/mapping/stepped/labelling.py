"""The region that each cell of a stepped map belongs to: a labelling, by the likelihood of whole range profiles.

Echoes of both sides of a border fall into the same profiles, and each range cell holds the sum of what all of the
beam sees. So neither a cell nor a region can be judged by itself: the profiles of all pulses that see it are predicted
with it changed, everything else as the map has it. One energy decides, in nepers:

    E = - sum of the log-likelihoods of all profiles + `pair_nepers` x (pairs of neighbours in different regions)

the neighbours of a cell being eight (a Potts prior). It is lowered by changing single cells (iterated conditional
modes; Besag 1986, "On the statistical analysis of dirty pictures", J. R. Stat. Soc. B 48, 259-302) and whole regions,
which join one beside them or are taken from another map.

Such a search ends in local minima, in towns far above the deepest. So it starts from several maps; the one of least
energy takes from the others, its rivals, each region that lowers it further. What is left open is told by two things:

* Labels are drawn, cell by cell, given all others (Geman and Geman 1984, "Stochastic relaxation, Gibbs distributions,
  and the Bayesian restoration of images", IEEE PAMI 6, 721-741): p is how often a cell is a step off the map.
* s is the share of the rivals that are a step off. A rival counts by 1 / dE, dE being its energy above that of the map:
  the mean of exp(-d dE) over the unknown factor d by which the model overstates likelihoods. One more rival is the
  located echo nearest to a cell, which counts as the mean of the others. Both of two rivals differ with probability
  s^2, and the cell belongs to the other side with probability 1 - (1 - p) (1 - s^2).

Cells are columns with plane tops, and their sides are walls. Each region has two reflectivities, of its tops and of its
walls: the likeliest ones given the map, found by the multiplicative updates for exponential powers (Fevotte and
Idier 2011, "Algorithms for nonnegative matrix factorization with the beta-divergence", Neural Comput. 23, 2421-2456).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, Int32
from scipy.ndimage import binary_dilation, find_objects, maximum_filter
from scipy.spatial import KDTree

from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks, chunks_of_bytes, equal_chunks, in_threads, over_rows
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.mapping.stepped.labelling_arrays import echoes_of, slopes_within, views_of
from sionna_radar.mapping.stepped.labelling_kernels import CellColumns
from sionna_radar.mapping.stepped.planes import FilledBeams, Plane
from sionna_radar.mapping.stepped.regions import (
    AROUND,
    adjacent_regions,
    border_cells,
    connected_parts,
    unlike_pairs,
    window_around,
)
from sionna_radar.mapping.stepped.uncertainty import doubt_of_rivals

# Most sweeps that take the likeliest label of each cell, and sweeps that draw it.
SWEEPS, DRAWS = 4, 10
# Factor of log-likelihoods when labels are drawn: neighbouring pulses see the same speckle, and columns are a model.
DISCOUNT = 0.3
FIRST_UPDATES, UPDATES = 25, 3
# Weight of the previous reflectivity, in expected echoes: regions seen by few pulses keep theirs.
PRIOR_ECHOES = 5.0
# Most cells by which a region may grow, and cells beyond a lowered cell whose rays are cast again.
GROWTH_CELLS, BEYOND_CELLS = 10, 6
# Capacity for the map cells near the rays of a pulse; more than usual.
ENTRIES = 160
NO_RAYS = np.empty((0, 0))


@dataclass(frozen=True)
class LabelledMap:
    """A stepped map: heights of the cells, and the region that each belongs to.

    other_side: probability that a cell belongs to another region, whose height there is another by a step or more.
    other_side_m2: mean square of how far off that is, times the probability.
    refitted_sigma_m: standard deviation of cells whose plane was fitted again; NaN of others.
    """

    height_m: Float[np.ndarray, "row column"]
    region: Int[np.ndarray, "row column"]
    other_side: Float[np.ndarray, "row column"]
    other_side_m2: Float[np.ndarray, "row column"]
    refitted_sigma_m: Float[np.ndarray, "row column"]


@dataclass(frozen=True)
class Start:
    """A map from which a search starts: heights of the cells, and the region that each belongs to.

    planes: of regions that were fitted as such, by their numbers.
    """

    height_m: Float[np.ndarray, "row column"]
    region: Int[np.ndarray, "row column"]
    planes: Mapping[int, Plane] = field(default_factory=dict)


def labelled_map(
    sightings: Sightings,
    axis_m: Float[np.ndarray, "pulse 3"],
    starts: Sequence[Start],
    echo_m: Float[np.ndarray, "row column"],
    step_m: float,
    grid: Grid,
    pair_nepers: float,
    beams: FilledBeams,
) -> LabelledMap:
    """Return the likeliest stepped map given the profiles.

    sightings, axis_m: profiles, measured poses, and where on their axes the echoes of the pulses are.
    starts: maps; no two have a region's number in common.
    echo_m: height of the located echo nearest to each cell.
    step_m: smallest height difference that counts as a step.
    grid: cells of the map.
    pair_nepers: energy of two neighbours in different regions.
    beams: fits planes again, once their cells are known.
    """
    seen = sightings.rows(grid.cell_of(axis_m)[2])
    highest_m = np.max([start.height_m for start in starts], axis=0)

    def searched(number: int, _: int) -> Labelling:
        start = starts[number]
        labelling = Labelling(seen, start.height_m, start.region, grid, highest_m, pair_nepers)
        labelling.search()
        return labelling

    found: list[Labelling] = []
    with stage("labels", len(starts) + 1 + DRAWS):
        for labelling in in_threads(searched, chunks(len(starts), 1)):
            advance()
            found = sorted([*found, labelling], key=Labelling.energy)
            for rival in found[1:]:
                rival.forget_rays()
        best, rivals = found[0], found[1:]
        for rival in rivals:
            best.take(rival, step_m)
        best.search()
        planes = {number: plane for start in starts for number, plane in start.planes.items()}
        sigma_m = best.refit(planes, beams, grid, step_m)
        advance()
        excess = np.array([max(rival.energy() - best.energy(), 1.0) for rival in rivals])
        off_m = np.stack([*(rival.height_m for rival in rivals), echo_m]) - best.height_m
        off_m[~(np.abs(off_m) > step_m)] = 0.0
        doubt, doubt_m2 = doubt_of_rivals(excess, off_m)
        drawn = best.drawn(step_m)
    apart = 1 - drawn.other_side
    other_side_m2 = drawn.other_side_m2 + apart * doubt_m2
    return LabelledMap(drawn.height_m, drawn.region, 1 - apart * (1 - doubt), other_side_m2, sigma_m)


def nearest_echo_m(point_m: Float[np.ndarray, "n 3"], grid: Grid) -> Float[np.ndarray, "row column"]:
    """Return the height of the located echo nearest to each cell; NaN without any."""
    if len(point_m) == 0:
        return np.full(grid.shape, np.nan)
    nearest = KDTree(point_m[:, :2]).query(grid.centres_m)[1]
    return np.asarray(point_m[nearest, 2].reshape(grid.shape))


@dataclass(frozen=True)
class Crossing:
    """Pulses whose rays come near each cell of a map, and where those of each cell begin.

    tile_cells: side of tiles of which no pulse sees two that are not neighbours, in cells.
    """

    first: Int[np.ndarray, " edge"]
    pulse: Int[np.ndarray, " entry"]
    tile_cells: int

    def over(self, cells: Bool[np.ndarray, "row column"]) -> Int[np.ndarray, " pulse"]:
        """Return the pulses whose rays come near some of the cells."""
        return np.unique(self.pulse[np.repeat(cells.ravel(), np.diff(self.first))])

    def over_some(self, cells: Int[np.ndarray, " cell"]) -> Int[np.ndarray, " pulse"]:
        """Return the pulses whose rays come near a few cells, by their running numbers."""
        return np.unique(np.concatenate([self.pulse[self.first[cell] : self.first[cell + 1]] for cell in cells]))


class Labelling:
    """Cells of a map as columns, the regions that they belong to, and the pulses that see them.

    sightings: profiles and measured poses; height_m, region: the map; grid: its cells.
    highest_m: heights that the cells may get.
    pair_nepers: energy of two neighbours in different regions.
    """

    def __init__(
        self,
        sightings: Sightings,
        height_m: Float[np.ndarray, "row column"],
        region: Int[np.ndarray, "row column"],
        grid: Grid,
        highest_m: Float[np.ndarray, "row column"],
        pair_nepers: float,
    ) -> None:
        self._numbers, inverse = np.unique(region, return_inverse=True)
        number = inverse.reshape(region.shape).astype(np.int64)
        spacing = grid.spacing_m
        ceiling = maximum_filter(highest_m, 2 * GROWTH_CELLS + 1, mode="nearest") + spacing
        self._columns = CellColumns(
            height_m.copy(),
            *slopes_within(height_m, number, spacing),
            number,
            ceiling,
            float(ceiling.max()),
            float(grid.x_m[0]) - spacing / 2,
            float(grid.y_m[0]) - spacing / 2,
            spacing,
        )
        self._pair_nepers = pair_nepers
        self._farthest = float(sightings.reach_m)
        self._views = views_of(sightings, spacing)
        self._echoes = echoes_of(sightings)
        until = np.concatenate([[0.0], np.cumsum(self._echoes.power)])[self._echoes.start]
        self._level = np.full(2 * len(self._numbers), max(float(np.median(np.diff(until))), np.finfo(float).tiny) / 10)
        # Cells that have changed since single cells, and since regions, were searched.
        self._unsettled, self._unmerged = np.ones((2, *region.shape), dtype=bool)
        # Pulses over regions that have changed.
        self._changed = np.zeros(len(sightings), dtype=bool)
        self._cast(np.arange(len(sightings)))
        self._update(FIRST_UPDATES)

    @property
    def height_m(self) -> Float[np.ndarray, "row column"]:
        """The height of each cell."""
        return self._columns.height

    @property
    def region(self) -> Int[np.ndarray, "row column"]:
        """The number of each cell's region."""
        return self._numbers[self._columns.region]

    def energy(self) -> float:
        """Return the energy of the map, Np."""
        echoes, region = self._echoes, self._columns.region
        ratio = echoes.power / echoes.mean
        loss = np.minimum(ratio, MAX_SPECKLE) + np.log(np.maximum(ratio / MAX_SPECKLE, 1.0)) + np.log(echoes.mean)
        until = np.concatenate([[0.0], np.cumsum(loss)])[echoes.start]
        return float(echoes.looks @ np.diff(until)) + self._pair_nepers * unlike_pairs(region)

    def forget_rays(self) -> None:
        """Free the memory of the rays, most of all; the map, its reflectivities and its energy stay."""
        self._views = self._views._replace(enters=NO_RAYS, meets=NO_RAYS, what=NO_RAYS.astype(np.int32))

    def search(self) -> None:
        """Lower the energy by changes of regions, then of cells."""
        self._merge()
        self._improve()

    def take(self, rival: "Labelling", step_m: float) -> None:
        """Take from another map of the same cells the regions, where they are a step off, that lower the energy."""
        columns, other = self._columns, rival._columns
        offset = len(self._numbers)
        self._numbers = np.concatenate([self._numbers, rival._numbers])
        self._level = np.concatenate([self._level, rival._level])
        crossing = self._crossing()
        differs = np.abs(columns.height - other.height) > step_m
        for cells in connected_parts(np.where(differs, other.region, -1)):
            at = np.divmod(cells, differs.shape[1])
            tops = other.height[at], other.slope_x[at], other.slope_y[at], offset + other.region[at]
            self._propose(*at, tops, crossing)
        self._settle()

    def refit(
        self, planes: Mapping[int, Plane], beams: FilledBeams, grid: Grid, step_m: float
    ) -> Float[np.ndarray, "row column"]:
        """Fit planes of regions again to the beams that they fill, where that lowers the energy.

        Returns the standard deviations of their cells; NaN elsewhere.
        """
        sigma_m, crossing = np.full(grid.shape, np.nan), self._crossing()
        for number in np.intersect1d(self.region, list(planes)).tolist():
            cells = self.region == number
            row, column = np.nonzero(cells)
            window = find_objects(cells.astype(np.int8))[0]
            cut = grid.cut(*window)
            plane = beams.refitted(planes[number], cells[window], cut, step_m)
            place_m = cut.centres_m[cells[window].ravel()]
            fixed = *plane.coefficients[1:], self._columns.region[row[0], column[0]]
            if self._propose(row, column, (plane.at(place_m), *(np.full(len(row), each) for each in fixed)), crossing):
                sigma_m[row, column] = plane.sigma_m(place_m)
        self._settle()
        return sigma_m

    def drawn(self, step_m: float) -> LabelledMap:
        """Return the map, and how probable it is that its cells are a step off; afterwards labels are others."""
        crossing, shape = self._crossing(), self._columns.region.shape
        uniform = np.random.default_rng(0).random((DRAWS, *shape))
        nothing, unknown = np.zeros(shape), np.full(shape, np.nan)
        result = LabelledMap(self._columns.height.copy(), self.region, nothing, nothing.copy(), unknown)
        moved = np.zeros(shape, dtype=bool)
        for numbers in uniform:
            wanted = border_cells(self._columns.region)
            off_m = self._columns.height - result.height_m
            off_m[np.abs(off_m) <= step_m] = 0.0
            sums = np.zeros((2, *shape))
            changed = self._sweep(wanted, crossing, DISCOUNT, numbers, result.height_m, step_m, sums)
            result.other_side[:] += np.where(wanted, sums[0], off_m != 0)
            result.other_side_m2[:] += np.where(wanted, sums[1], off_m**2)
            moved |= binary_dilation(changed)
            self._cast(crossing.over(moved))
            self._update(UPDATES)
            advance()
        result.other_side[:] /= len(uniform)
        result.other_side_m2[:] /= len(uniform)
        return result

    def _improve(self) -> None:
        """Give cells beside borders their likeliest labels."""
        crossing, shape = self._crossing(), self._columns.region.shape
        moved = np.zeros(shape, dtype=bool)
        none, height = np.empty((0, 0)), self._columns.height.copy()
        for _ in range(SWEEPS):
            wanted = border_cells(self._columns.region) & binary_dilation(self._unsettled, iterations=2)
            self._unsettled[:] = False
            if not wanted.any():
                return
            changed = self._sweep(wanted, crossing, 1.0, none, height, np.inf, np.zeros((2, *shape)))
            self._unsettled |= changed
            self._unmerged |= changed
            # A ray over a lowered cell may meet cells that it was not listed for, which may change after that cell.
            moved |= binary_dilation(changed)
            self._cast(crossing.over(moved))
            self._update(UPDATES)

    def _merge(self) -> None:
        """Let connected parts of regions join regions beside them that are no smaller, the smallest first."""
        columns, crossing = self._columns, self._crossing()
        size = np.bincount(columns.region.ravel(), minlength=len(self._numbers))
        changed = binary_dilation(self._unmerged, AROUND)
        self._unmerged[:] = False
        for cells in connected_parts(columns.region):
            row, column = np.divmod(cells, changed.shape[1])
            if not changed[row, column].any():
                continue
            for into in adjacent_regions(columns.region, row, column).tolist():
                if size[into] >= len(cells) and self._join(row, column, into, crossing):
                    size[into] += len(cells)
                    break
        self._settle()

    def _join(
        self, row: Int[np.ndarray, " cell"], column: Int[np.ndarray, " cell"], into: int, crossing: Crossing
    ) -> bool:
        """Continue a region over some cells if that lowers the energy; return whether it did."""
        columns = self._columns
        window = window_around(row, column, columns.region.shape)
        beside = np.argwhere(columns.region[window] == into) + np.array([window[0].start, window[1].start])
        nearest = beside[KDTree(beside).query(np.column_stack([row, column]))[1]]
        at = nearest[:, 0], nearest[:, 1]
        east, north = columns.slope_x[at], columns.slope_y[at]
        height = columns.height[at] + (east * (column - at[1]) + north * (row - at[0])) * columns.spacing
        return self._propose(row, column, (height, east, north, np.full(len(row), into)), crossing)

    def _propose(
        self,
        row: Int[np.ndarray, " cell"],
        column: Int[np.ndarray, " cell"],
        tops: tuple[np.ndarray, ...],
        crossing: Crossing,
    ) -> bool:
        """Change heights, slopes and regions of some cells if that lowers the energy; return whether it did."""
        from sionna_radar.mapping.stepped.labelling_kernels import region_gains

        columns = self._columns
        highest = tops[0] + (np.abs(tops[1]) + np.abs(tops[2])) * columns.spacing
        pulses = crossing.over_some(row * columns.region.shape[1] + column)
        if np.any(highest > columns.ceiling[row, column]) or len(pulses) == 0:
            return False
        arrays = columns.height, columns.slope_x, columns.slope_y, columns.region
        around = window_around(row, column, columns.region.shape)
        before, pairs = [array[row, column] for array in arrays], unlike_pairs(columns.region[around])
        for array, values in zip(arrays, tops, strict=True):
            array[row, column] = values
        window, gain = np.array([row.min(), row.max() + 1, column.min(), column.max() + 1]), np.empty(len(pulses))
        arguments = columns, self._views, self._echoes, self._level, self._farthest, window, pulses

        def compare(accept: bool) -> None:
            over_rows(partial(region_gains, *arguments, accept, gain), len(pulses))

        compare(False)
        if gain.sum() > self._pair_nepers * (unlike_pairs(columns.region[around]) - pairs):
            compare(True)
            self._unsettled[row, column] = self._unmerged[row, column] = self._changed[pulses] = True
            return True
        for array, values in zip(arrays, before, strict=True):
            array[row, column] = values
        return False

    def _settle(self) -> None:
        """Cast the rays over regions that have changed, and update reflectivities and profiles."""
        self._cast(np.flatnonzero(self._changed))
        self._changed[:] = False
        self._update(UPDATES)

    def _cast(self, pulses: Int[np.ndarray, " chosen"]) -> None:
        """Cast the rays of some pulses."""
        from sionna_radar.mapping.stepped.labelling_kernels import cast_all

        arguments = self._columns, self._views, self._echoes, self._farthest, pulses
        over_rows(partial(cast_all, *arguments), len(pulses))

    def _update(self, rounds: int) -> None:
        """Update the reflectivities, and the predicted profiles."""
        from sionna_radar.mapping.stepped.labelling_kernels import predict

        bounds = equal_chunks(len(self._echoes.first))
        sums = np.empty((len(bounds), 2, len(self._level)))
        numbers = {low: number for number, (low, _) in enumerate(bounds)}

        def some(regions: slice, low: int, high: int) -> None:
            predict(self._views, self._echoes, self._level, *sums[numbers[low], :, regions], low, high)

        for _ in range(rounds):
            sums[:] = 0.0
            list(in_threads(partial(some, slice(None)), bounds))
            returned, expected = sums.sum(axis=0)
            self._level *= np.sqrt((returned + PRIOR_ECHOES) / (expected + PRIOR_ECHOES))
        list(in_threads(partial(some, slice(0)), bounds))

    def _crossing(self) -> Crossing:
        """Return the pulses whose rays come near each cell."""
        from sionna_radar.mapping.stepped.labelling_kernels import cells_crossed

        beyond_m = BEYOND_CELLS * self._columns.spacing
        sides = self._columns.region.shape

        def some(low: int, high: int) -> Int32[np.ndarray, "2 entry"]:
            """Return the cells that rays of some pulses cross, each with its pulse."""
            into = np.empty((2, ENTRIES * (high - low)), dtype=np.int64)
            used = cells_crossed(self._columns, self._views, beyond_m, *into, low, high)
            if used > into.shape[1]:
                into = np.empty((2, used), dtype=np.int64)
                cells_crossed(self._columns, self._views, beyond_m, *into, low, high)
            return into[:, :used].astype(np.int32)

        bounds = chunks_of_bytes(len(self._echoes.first), 2 * 8 * ENTRIES)
        cell, pulse = np.concatenate(list(in_threads(some, bounds)), axis=1)
        order = np.argsort(cell, kind="stable")
        first, widest = np.searchsorted(cell[order], np.arange(np.prod(sides) + 1)), 1
        # Entries are in the order of pulses.
        begin = np.flatnonzero(np.diff(pulse, prepend=-1))
        for place in (cell // sides[1], cell % sides[1]) if len(begin) else ():
            spread = np.maximum.reduceat(place, begin) - np.minimum.reduceat(place, begin)
            widest = max(widest, int(spread.max()))
        return Crossing(first, pulse[order].astype(np.int64), widest + 4 * BEYOND_CELLS)

    def _sweep(
        self,
        wanted: Bool[np.ndarray, "row column"],
        crossing: Crossing,
        discount: float,
        uniform: Float[np.ndarray, "_ _"],
        reference_m: Float[np.ndarray, "row column"],
        step_m: float,
        sums: Float[np.ndarray, "2 row column"],
    ) -> Bool[np.ndarray, "row column"]:
        """Change the labels of cells, see `visit_cells`, and return the changed ones.

        Tiles that no pulse sees together are processed concurrently.
        """
        from sionna_radar.mapping.stepped.labelling_kernels import visit_cells

        cells, count = np.flatnonzero(wanted), wanted.shape[1]
        across = count // crossing.tile_cells + 1
        row, column = cells // count // crossing.tile_cells, cells % count // crossing.tile_cells
        tile, changed = row * across + column, np.zeros(wanted.shape, dtype=bool)
        arguments = self._columns, self._views, self._echoes, self._level, self._farthest, self._pair_nepers, discount

        def one_tile(groups: list[Int[np.ndarray, "_"]], number: int, _: int) -> None:
            of = groups[number], crossing.first, crossing.pulse
            visit_cells(*arguments, *of, uniform, reference_m, step_m, changed, *sums)

        for parity in ((0, 0), (0, 1), (1, 0), (1, 1)):
            turn = (row % 2 == parity[0]) & (column % 2 == parity[1])
            groups = [cells[tile == one] for one in np.unique(tile[turn])]
            groups.sort(key=len, reverse=True)  # largest first, to balance the threads
            list(in_threads(partial(one_tile, groups), chunks(len(groups), 1)))
        return changed
