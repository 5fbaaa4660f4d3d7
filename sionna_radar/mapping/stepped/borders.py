"""Assignment of cells near borders to regions of a stepped map, by the likelihood of range profiles.

Echoes of both sides of a border fall into the same profiles, and each range cell holds the sum of what all of the
beam sees. So a cell cannot be judged by itself: the profiles of all pulses that see it are predicted with the cell in
either region, everything else as the map has it, and the likelier one stays (iterated conditional modes; Besag 1986,
"On the statistical analysis of dirty pictures", J. R. Stat. Soc. B 48, 259-302).

Cells are columns with plane tops, and their sides are walls. Each region has two reflectivities, of its tops and of its
walls: the likeliest ones given the map, found by the multiplicative updates for exponential powers (Fevotte and
Idier 2011, "Algorithms for nonnegative matrix factorization with the beta-divergence", Neural Comput. 23, 2421-2456).
Where much less power came back than the top of a raised region would return, the ground around is tried as well, so
that courtyards open that the coarse map has missed.
"""

from dataclasses import dataclass, fields
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Int, Int32
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter, minimum_filter
from scipy.spatial import KDTree

from sionna_radar.detection.ranging.plane_fit import PEDESTAL
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import chunks, equal_chunks, in_threads
from sionna_radar.mapping.echo_model.beam import beam_samples
from sionna_radar.mapping.echo_model.model import Sightings, mean_ranges
from sionna_radar.mapping.stepped.border_kernels import NOTHING, CellColumns, CellViews, PulseEchoes

# Beam samples per map cell in the main lobe, and their lower and upper limit.
SAMPLES_PER_CELL, MIN_SAMPLES, MAX_SAMPLES = 12, 300, 1500
# Reference range of reflectivities, m.
UNIT_M = 50.0
# Prior: gain for each of a cell's eight neighbours in the same region, Np.
NEIGHBOUR_GAIN_NEPERS = 4.0
SWEEPS, FIRST_UPDATES, UPDATES = 4, 25, 3
# Weight of the previous reflectivity, in expected echoes: regions seen by few pulses keep theirs.
PRIOR_ECHOES = 5.0
# A cell that returns less than this fraction of its region's expected power may be a hole; fewest expected echoes.
HOLLOW_FRACTION, MIN_EXPECTED = 0.5, 1.0
# Width of the band along borders in which the assignment of tops is checked, cells.
BORDER_BAND_CELLS = 4
# A top is doubtful if its expected power is less than this fraction of the usual one,
MIN_VISIBILITY = 0.2
# if it returns less than this fraction of its expected power, of at least that many echoes,
MIN_RETURNED_POWER, MIN_RETURN_ECHOES = 0.4, 3.0
# or if its region is likelier than another by less than this, Np: the column model overstates likelihoods.
MIN_MARGIN_NEPERS = 8.0
# The same where the nearest echo lies a step away, Np.
MIN_STEP_MARGIN_NEPERS = 64.0
# Most cells by which a region may grow, and cells beyond a lowered cell whose rays are cast again.
GROWTH_CELLS, BEYOND_CELLS = 10, 6
PULSES_AT_ONCE = 64
# Capacity for the map cells near the rays of a pulse; more than usual.
ENTRIES = 160
# Side of the blocks processed one after another, and margin that their pulses reach, cells.
BLOCK_CELLS, MARGIN_CELLS = 200, 24


@dataclass(frozen=True)
class StepMap:
    """A stepped map: heights of the cells, and the region that each belongs to.

    expected, returned: power expected from each cell's top at its region's reflectivity, in units of the mean power of
    its range cells, summed over pulses; and the measured power relative to it.
    margin: log-likelihood ratio (Np) between the region of each cell and the best region a step away; infinite away
        from borders.
    """

    height_m: Float[np.ndarray, "row column"]
    region: Int[np.ndarray, "row column"]
    expected: Float[np.ndarray, "row column"]
    returned: Float[np.ndarray, "row column"]
    margin: Float[np.ndarray, "row column"]

    def doubtful(
        self, elsewhere: Bool[np.ndarray, "row column"], contradicted: Bool[np.ndarray, "row column"]
    ) -> Bool[np.ndarray, "row column"]:
        """Return the cells near borders whose tops were rarely visible, too weak, or may belong to another region.

        Away from borders no profiles were compared: there, those that the echoes around them contradict.

        elsewhere: cells whose nearest echo is of another level; see `nearest_echo_off_level`.
        contradicted: see `contradicted_by_echoes`.
        """
        near = distance_transform_edt(~border_cells(self.region)) < BORDER_BAND_CELLS
        seen = self.expected > 0
        typical = float(np.median(self.expected[seen])) if seen.any() else 0.0
        unseen = self.expected < MIN_VISIBILITY * typical
        hollow = (self.returned < MIN_RETURNED_POWER) & (self.expected > MIN_RETURN_ECHOES)
        checked = np.isfinite(self.margin) & (self.margin >= MIN_STEP_MARGIN_NEPERS)
        near_border = unseen | hollow | (self.margin < MIN_MARGIN_NEPERS) | (elsewhere & ~checked)
        return np.where(near, near_border, contradicted)


def assign_border_cells(
    sightings: Sightings,
    axis_m: Float[np.ndarray, "pulse 3"],
    height_m: Float[np.ndarray, "row column"],
    region: Int[np.ndarray, "row column"],
    low: Bool[np.ndarray, "row column"],
    step_m: float,
    grid: Grid,
) -> StepMap:
    """Return the map with border cells assigned to their most likely regions given the profiles.

    sightings, axis_m: profiles, measured poses, and where on their axes the echoes of the pulses are.
    height_m, region: the map, and the number of the region that each cell belongs to.
    low: cells of regions not raised above their surroundings: ground.
    step_m: smallest height difference that counts as a step.
    grid: cells of the map.
    """
    nothing = np.zeros(grid.shape)
    result = StepMap(height_m.copy(), region.copy(), nothing, nothing.copy(), np.full(grid.shape, np.inf))
    for row in range(0, grid.rows, BLOCK_CELLS):
        for column in range(0, grid.columns, BLOCK_CELLS):
            window = _span(row, grid.rows), _span(column, grid.columns)
            core = np.zeros(grid.shape, dtype=bool)
            core[row : row + BLOCK_CELLS, column : column + BLOCK_CELLS] = True
            cells = grid.cut(*window)
            near = _near(axis_m, cells)
            if near.any():
                block = _Block(sightings.rows(near), result.height_m[window], result.region[window], cells)
                assigned = block.improved(core[window], low[window], step_m)
                inner = core[window]
                for field in fields(StepMap):
                    getattr(result, field.name)[window][inner] = getattr(assigned, field.name)[inner]
    return result


def nearest_echo_off_level(
    height_m: Float[np.ndarray, "row column"], point_m: Float[np.ndarray, "n 3"], step_m: float, grid: Grid
) -> Bool[np.ndarray, "row column"]:
    """Return the cells whose nearest located echo lies a step above or below them."""
    if len(point_m) == 0:
        return np.zeros(grid.shape, dtype=bool)
    nearest = KDTree(point_m[:, :2]).query(grid.centres_m)[1]
    return np.asarray((np.abs(point_m[nearest, 2] - height_m.ravel()) > step_m).reshape(grid.shape))


def contradicted_by_echoes(
    height_m: Float[np.ndarray, "row column"], point_m: Float[np.ndarray, "n 3"], step_m: float, grid: Grid
) -> Bool[np.ndarray, "row column"]:
    """Return the cells of whose three nearest located echoes most lie a step above or below the map, each at its place.

    So few echoes return from the tip of a roof at the end of a survey that the map takes it for the street.
    """
    row, column, inside = grid.cell_of(point_m)
    point_m, row, column = point_m[inside], row[inside], column[inside]
    if len(point_m) < 3:
        return np.zeros(grid.shape, dtype=bool)
    off = np.abs(point_m[:, 2] - height_m[row, column]) > step_m
    nearest = KDTree(point_m[:, :2]).query(grid.centres_m, k=3)[1]
    return np.asarray((off[nearest].sum(axis=1) > 1).reshape(grid.shape))


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


class _Block:
    """Cells of a map as columns, and the pulses that see them."""

    def __init__(
        self,
        sightings: Sightings,
        height_m: Float[np.ndarray, "row column"],
        region: Int[np.ndarray, "row column"],
        grid: Grid,
    ) -> None:
        self._numbers, inverse = np.unique(region, return_inverse=True)
        number = inverse.reshape(region.shape).astype(np.int64)
        spacing = grid.spacing_m
        ceiling = maximum_filter(height_m, 2 * GROWTH_CELLS + 1, mode="nearest") + spacing
        self._columns = CellColumns(
            height_m.copy(),
            *_slopes(height_m, number, spacing),
            number,
            ceiling,
            float(ceiling.max()),
            float(grid.x_m[0]) - spacing / 2,
            float(grid.y_m[0]) - spacing / 2,
            spacing,
        )
        self._farthest = float(sightings.reach_m)
        self._views = _views(sightings, spacing)
        self._echoes = _echoes(sightings)
        until = np.concatenate([[0.0], np.cumsum(self._echoes.power)])[self._echoes.start]
        self._level = np.full(2 * len(self._numbers), max(float(np.median(np.diff(until))), np.finfo(float).tiny) / 10)
        self._cast(np.arange(len(sightings)))

    def improved(
        self, core: Bool[np.ndarray, "row column"], low: Bool[np.ndarray, "row column"], step_m: float
    ) -> StepMap:
        """Return the map with the most likely regions of the core's cells."""
        region = self._columns.region
        found, expected = self._update(FIRST_UPDATES)
        hollow = (found < HOLLOW_FRACTION * expected) & (expected > MIN_EXPECTED) & ~low
        ground, ground_m = self._ground(hollow, low)
        crossing = self._crossing()
        changed, margin = np.ones(region.shape, dtype=bool), np.full(region.shape, np.inf)
        moved = np.zeros(region.shape, dtype=bool)
        for _ in range(SWEEPS):
            wanted = (border_cells(region) | hollow) & core & binary_dilation(changed, iterations=2)
            changed[:] = False
            if not wanted.any():
                break
            self._sweep(np.flatnonzero(wanted), crossing, ground, ground_m, changed, margin, step_m)
            if not changed.any():
                break
            # A ray over a lowered cell may meet cells that it was not listed for, which may change after that cell.
            moved |= binary_dilation(changed)
            self._cast(crossing.over(moved))
            found, expected = self._update(UPDATES)
        returned = found / np.maximum(expected, np.finfo(float).tiny)
        return StepMap(self._columns.height, self._numbers[region], expected, returned, margin)

    def _cast(self, pulses: Int[np.ndarray, " chosen"]) -> None:
        """Cast the rays of some pulses."""
        from sionna_radar.mapping.stepped.border_kernels import cast_all

        arguments = self._columns, self._views, self._echoes, self._farthest, pulses
        list(in_threads(partial(cast_all, *arguments), chunks(len(pulses), PULSES_AT_ONCE)))

    def _update(self, rounds: int) -> Float[np.ndarray, "2 row column"]:
        """Update the reflectivities; return the power found of each cell's top, and that expected; see `predict`."""
        from sionna_radar.mapping.stepped.border_kernels import predict

        bounds = equal_chunks(len(self._echoes.first))
        cells = np.zeros((len(bounds), 2, self._columns.region.size))
        sums = np.empty((len(bounds), 2, len(self._level)))
        numbers = {low: number for number, (low, _) in enumerate(bounds)}

        def some(regions: slice, tops: slice, low: int, high: int) -> None:
            into = *sums[numbers[low], :, regions], *cells[numbers[low], :, tops]
            predict(self._columns, self._views, self._echoes, self._level, *into, low, high)

        every, none = slice(None), slice(0)
        for left in reversed(range(rounds)):
            sums[:] = 0.0
            list(in_threads(partial(some, every, none if left else every), bounds))
            returned, expected = sums.sum(axis=0)
            self._level *= np.sqrt((returned + PRIOR_ECHOES) / (expected + PRIOR_ECHOES))
        list(in_threads(partial(some, none, none), bounds))
        return np.asarray(cells.sum(axis=0).reshape(2, *self._columns.region.shape))

    def _ground(
        self, hollow: Bool[np.ndarray, "row column"], low: Bool[np.ndarray, "row column"]
    ) -> tuple[Int[np.ndarray, " cell"], Float[np.ndarray, " cell"]]:
        """Return for each hollow cell the region of the nearest low one, NOTHING for others, and the height there."""
        if not low.any():
            return np.full(low.size, NOTHING), np.zeros(low.size)
        row, column = distance_transform_edt(~low, return_distances=False, return_indices=True)
        region = np.where(hollow, self._columns.region[row, column], NOTHING)
        return region.ravel(), self._columns.height[row, column].ravel()

    def _crossing(self) -> Crossing:
        """Return the pulses whose rays come near each cell."""
        from sionna_radar.mapping.stepped.border_kernels import cells_crossed

        beyond_m = BEYOND_CELLS * self._columns.spacing
        sides = self._columns.region.shape

        def some(low: int, high: int) -> Int32[np.ndarray, "2 entry"]:
            into = np.empty((2, ENTRIES * (high - low)), dtype=np.int64)
            used = cells_crossed(self._columns, self._views, beyond_m, *into, low, high)
            if used > into.shape[1]:
                into = np.empty((2, used), dtype=np.int64)
                cells_crossed(self._columns, self._views, beyond_m, *into, low, high)
            return into[:, :used].astype(np.int32)

        cell, pulse = np.concatenate(list(in_threads(some, chunks(len(self._echoes.first), PULSES_AT_ONCE))), axis=1)
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
        cells: Int[np.ndarray, " wanted"],
        crossing: Crossing,
        ground: Int[np.ndarray, " cell"],
        ground_m: Float[np.ndarray, " cell"],
        changed: Bool[np.ndarray, "row column"],
        margin: Float[np.ndarray, "row column"],
        step_m: float,
    ) -> None:
        """Assign cells to their most likely regions, and mark the changed ones.

        Tiles that no pulse sees together are processed concurrently.
        """
        from sionna_radar.mapping.stepped.border_kernels import assign_cells

        count = changed.shape[1]
        across = count // crossing.tile_cells + 1
        row, column = cells // count // crossing.tile_cells, cells % count // crossing.tile_cells
        tile = row * across + column
        arguments = self._columns, self._views, self._echoes, self._level, self._farthest, NEIGHBOUR_GAIN_NEPERS

        def one_tile(groups: list[Int[np.ndarray, "_"]], number: int, _: int) -> None:
            assign_cells(
                *arguments, groups[number], crossing.first, crossing.pulse, ground, ground_m, changed, margin, step_m
            )

        for parity in ((0, 0), (0, 1), (1, 0), (1, 1)):
            turn = (row % 2 == parity[0]) & (column % 2 == parity[1])
            groups = [cells[tile == one] for one in np.unique(tile[turn])]
            groups.sort(key=len, reverse=True)  # largest first, to balance the threads
            list(in_threads(partial(one_tile, groups), chunks(len(groups), 1)))


def _views(sightings: Sightings, spacing_m: float) -> CellViews:
    """Return the poses and samples of the beam, not yet cast."""
    pose, beam = sightings.pose, sightings.beam
    # Area of the main lobe on ground as far as the nearest half of all echoes, seen at 45 deg.
    range_m = float(np.median(mean_ranges(sightings).range_m))
    area_m2 = range_m**2 * float(np.ptp(beam.azimuth) * np.ptp(beam.elevation)) * np.sqrt(2)
    count = int(np.clip(SAMPLES_PER_CELL * area_m2 / spacing_m**2, MIN_SAMPLES, MAX_SAMPLES))
    direction, power = beam_samples(beam, count)
    shape = len(pose), len(power)
    return CellViews(
        position=np.ascontiguousarray(pose.position_m),
        velocity=np.ascontiguousarray(pose.velocity_mps),
        R_world_antenna=np.ascontiguousarray(pose.R_world_antenna),
        direction=np.ascontiguousarray(direction.T),
        power=power,
        enters=np.full(shape, np.nan),
        meets=np.empty(shape),
        what=np.empty(shape, dtype=np.int32),
        entries=np.zeros(len(pose), dtype=np.int64),
        surface=np.empty(shape[::-1], dtype=np.int32),
        cell=np.empty(shape[::-1], dtype=np.int32),
        nearer=np.empty(shape[::-1]),
        farther=np.empty(shape[::-1]),
    )


def _echoes(sightings: Sightings) -> PulseEchoes:
    """Return the measured profiles, not yet predicted."""
    profiles = sightings.profiles
    power, start = profiles.power.astype(np.float64), profiles.start
    strongest = np.zeros(len(profiles))
    some = np.diff(start) > 0
    strongest[some] = np.maximum.reduceat(power, start[:-1][some])
    return PulseEchoes(
        first=profiles.first,
        start=start,
        power=power,
        floor=profiles.noise + PEDESTAL * strongest,
        response=sightings.response,
        doppler=sightings.doppler * float(sightings.chirp.doppler_range_m(np.ones(1))[0]),
        cell_m=float(profiles.cell_m),
        unit_m=UNIT_M,
        mean=np.empty(len(power)),
        looks=np.full(len(profiles), sightings.looks_per_cell),
    )


def _slopes(
    height_m: Float[np.ndarray, "row column"], region: Int[np.ndarray, "row column"], spacing_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the slopes of each cell toward its neighbours in the same region, along x and y."""

    def along(axis: int) -> Float[np.ndarray, "row column"]:
        rise, same = np.diff(height_m, axis=axis) / spacing_m, np.diff(region, axis=axis) == 0
        total, count = np.zeros(height_m.shape), np.zeros(height_m.shape)
        for side in (slice(None, -1), slice(1, None)):
            where = (slice(None),) * axis + (side,)
            total[where] += np.where(same, rise, 0.0)
            count[where] += same
        return np.asarray(total / np.maximum(count, 1))

    return along(1), along(0)


def border_cells(region: Int[np.ndarray, "row column"]) -> Bool[np.ndarray, "row column"]:
    """Return the cells with a neighbour in another region."""
    return np.asarray(maximum_filter(region, 3, mode="nearest") != minimum_filter(region, 3, mode="nearest"))


def _span(start: int, count: int) -> slice:
    return slice(max(start - MARGIN_CELLS, 0), min(start + BLOCK_CELLS + MARGIN_CELLS, count))


def _near(place_m: Float[np.ndarray, "n 3"], grid: Grid) -> Bool[np.ndarray, " n"]:
    west, east, south, north = grid.extent_m
    x, y = place_m[:, 0], place_m[:, 1]
    return np.asarray((x > west) & (x < east) & (y > south) & (y < north))
