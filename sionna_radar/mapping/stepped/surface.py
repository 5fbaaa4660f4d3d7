"""The DEM method "stepped": segmentation at steps such as walls, and a separate surface for each region.

1. A coarse map by the evidence of all echoes may have jumps (`coarse_map`). It is split into regions where neighbours
   differ by more than a step.
2. A region that alone fills enough main lobes is mapped from their whole echoes: as a plane, or, if another surface
   fits them better, as terrain (`refinement`). This shows how far coarse heights scatter; a smaller region whose
   heights scatter about a plane no more than twice as far becomes that plane, fitted to the echoes on it.
3. Cells beside borders join the region under which whole profiles are likeliest (`borders`). Cells near borders that no
   pulse really saw, or that may as well be of the other side, as where a wall crosses them, are left empty; so are
   those whose nearest echo is a step away, unless the profiles clearly say otherwise, and, far from borders, those
   that most of the three nearest echoes contradict.

A cell may be of the other side of a step: a border is misplaced, or an alley closed. Then it is wrong by the whole step
h; its variance is that of a mixture, larger by p (1 - p) h^2. The odds of p are prior ones, inverse to the distance
from the nearest step of the map, times the likelihood ratio of a level a step away (`coarse_map`). The margins of
`borders` do not serve here: they try a cell by itself, while whole walls are misplaced.

Segmentation: within a region neighbours differ by less than a step. Where a wall is crossed by a ramp of in-between
heights, a cell or two wide, roof and ground would be one region. So regions are first grown from cells in whose
neighbourhood no step is (a morphological opening of the links between cells), and take in what they touch. What no
such region touches, narrower than three cells, joins the nearest.

A map longer than three blocks of levels is made in tiles, each from what its echoes and those of a strip around it say.
They are not blended, as heights beside a step would be of neither side.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import (
    binary_dilation,
    binary_erosion,
    distance_transform_edt,
    find_objects,
    label,
    maximum_filter,
    median_filter,
    minimum_filter,
)
from scipy.spatial import KDTree

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.columns import columns_of, packed
from sionna_radar.foundation.progress import advance, expect_steps, release_memory
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import equal_chunks, several_at_once
from sionna_radar.mapping.coverage import closed
from sionna_radar.mapping.echo_model.model import MeanRanges, Sightings, mean_ranges
from sionna_radar.mapping.mapper import Estimate, MapInputs
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refined.refinement import refine, refining
from sionna_radar.mapping.seen import empty, visible_surface
from sionna_radar.mapping.stepped.borders import assign_border_cells, contradicted_by_echoes, nearest_echo_off_level
from sionna_radar.mapping.stepped.coarse_map import CoarseMap, coarse_map, looking_at
from sionna_radar.mapping.stepped.planes import FilledBeams, Plane, plane_of_echoes, plane_of_points, spread
from sionna_radar.mapping.terrain.tiles import MIN_PULSES, EachPiece, pieces_here

# Blocks of levels along the longest side of a tile.
TILE_BLOCKS = 3
# Width of the ring around a region, cells, and the fraction of it that a raised region exceeds by a step.
RING_CELLS, MIN_RAISED_FRACTION = 2, 0.75
AROUND = tuple((down, right) for down in (-1, 0, 1) for right in (-1, 0, 1))


def regions_of(
    height_m: Float[np.ndarray, "row column"], step_m: float, min_cells: int
) -> Int[np.ndarray, "row column"]:
    """Return connected regions without steps: the number of each cell's region, from zero without gaps.

    height_m: heights of the cells.
    step_m: least difference between neighbours in different regions.
    min_cells: smaller regions join the nearest.
    """
    along, across = (np.abs(np.diff(height_m, axis=axis)) <= step_m for axis in (1, 0))
    inner = _fully_linked(along, across)
    region = label(inner)[0] - 1
    extended = _extend_to_adjacent_cells(region, height_m, step_m)
    return _remove_small_regions(extended, min_cells)


def region_windows(region: Int[np.ndarray, "row column"]) -> list[tuple[slice, slice]]:
    """Return the rows and columns that contain each region, by their numbers."""
    return [(rows, columns) for rows, columns in find_objects(region + 1)]


def raised_cells(
    height_m: Float[np.ndarray, "row column"], region: Int[np.ndarray, "row column"], step_m: float
) -> Bool[np.ndarray, "row column"]:
    """Return the cells of raised regions: a step above most adjacent cells."""
    raised = np.zeros(region.shape, dtype=bool)
    for number, window_of_region in enumerate(region_windows(region)):
        window = tuple(slice(max(side.start - RING_CELLS, 0), side.stop + RING_CELLS) for side in window_of_region)
        cells, height = region[window] == number, height_m[window]
        ring = binary_dilation(cells, iterations=RING_CELLS) & ~cells
        if ring.any() and np.mean(np.median(height[cells]) - height[ring] > step_m) > MIN_RAISED_FRACTION:
            raised[window] |= cells
    return raised


def distance_to_border_m(region: Int[np.ndarray, "row column"], spacing_m: float) -> Float[np.ndarray, "row column"]:
    """Return the distance of each cell from the border of its region, m; infinite if there is only one region."""
    border = np.zeros(region.shape, dtype=bool)
    along, across = region[:, 1:] != region[:, :-1], region[1:] != region[:-1]
    border[:, 1:] |= along
    border[:, :-1] |= along
    border[1:] |= across
    border[:-1] |= across
    distance: Float[np.ndarray, "row column"] = distance_transform_edt(~border) * spacing_m
    return distance if border.any() else np.full(region.shape, np.inf)


def _fully_linked(
    along: Bool[np.ndarray, "row beside"], across: Bool[np.ndarray, "above column"]
) -> Bool[np.ndarray, "row column"]:
    """Return the cells in whose 3 x 3 neighbourhood all neighbours are linked."""
    right = np.pad(along, ((0, 0), (0, 1)), constant_values=True)
    below = np.pad(across, ((0, 1), (0, 0)), constant_values=True)
    # The links of a square of three: along rows between its first two columns, and across, likewise.
    of_row = binary_erosion(right, np.ones((3, 2)), origin=(0, 0), border_value=1)
    of_column = binary_erosion(below, np.ones((2, 3)), origin=(0, 0), border_value=1)
    return np.asarray(of_row & of_column)


def _extend_to_adjacent_cells(
    region: Int[np.ndarray, "row column"], height_m: Float[np.ndarray, "row column"], step_m: float
) -> Int[np.ndarray, "row column"]:
    """Return regions extended to adjacent cells: each joins the region of the nearest height, if within a step."""
    rows, columns = region.shape
    padded, heights = np.pad(region, 1, constant_values=-1), np.pad(height_m, 1, mode="edge")
    best, extended = np.full(region.shape, step_m), region.copy()
    for down, right in AROUND:
        window = slice(1 + down, 1 + down + rows), slice(1 + right, 1 + right + columns)
        difference_m = np.abs(heights[window] - height_m)
        nearer = (region < 0) & (padded[window] >= 0) & (difference_m <= best)
        extended[nearer], best[nearer] = padded[window][nearer], difference_m[nearer]
    return extended


def _remove_small_regions(region: Int[np.ndarray, "row column"], min_cells: int) -> Int[np.ndarray, "row column"]:
    """Return regions numbered from zero; cells of no region, or of one of fewer than `min_cells`, join the nearest."""
    crumb = (np.bincount(region.ravel() + 1)[region + 1] < min_cells) | (region < 0)
    if crumb.all():
        return np.zeros(region.shape, dtype=np.int64)
    row, column = distance_transform_edt(crumb, return_distances=False, return_indices=True)
    return np.asarray(np.unique(region[row, column], return_inverse=True)[1].reshape(region.shape))


# Prior odds that a cell belongs to the other side of a step are these lengths (m) over the distance from the step: for
# a cell mapped above that it is of the ground below, and for one mapped below that it is of what stands above. The map
# takes the highest of equal levels, so that it errs upward more often. Fitted to the frequencies of six surveys of San
# Francisco and Florence, as are the decrease with distance and with the margin, which errs by about one neper
# (`docs/theory/uncertainty.md`).
BELOW_M, ABOVE_M = 0.23, 0.13
# Largest distance at which steps are searched, m, and the radii tried, cells; none was found to matter beyond.
FARTHEST_M, DISTANCES_CELLS = 24.0, (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
# Radius of the neighbourhood in which the depth of a step is measured: in distances of the step, with a minimum in m.
DEPTH_RADIUS_DISTANCES, MIN_DEPTH_RADIUS_M = 2, 4.0


@dataclass(frozen=True)
class SteppedUncertainty:
    """Standard deviations of the cells of a stepped map.

    other_side: probability that a cell belongs to the other side of a step, and is wrong by the whole step.
    step_sigma_m: contribution of that error; without it remains the standard deviation of cells on the right side.
    """

    cell_sigma_m: Float[np.ndarray, "row column"]
    other_side: Float[np.ndarray, "row column"]
    step_sigma_m: Float[np.ndarray, "row column"]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells; NaN elsewhere. The grid is that of the map."""
        return np.where(wanted, self.cell_sigma_m, np.nan)

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return NaN: correlations of border errors are not modelled."""
        return float("nan")


def sigma_after_reassignment(
    sigma_m: Float[np.ndarray, "row column"],
    before: Int[np.ndarray, "row column"],
    after: Int[np.ndarray, "row column"],
) -> Float[np.ndarray, "row column"]:
    """Return standard deviations in which a cell that changed its region takes that of the nearest cell that did not.

    sigma_m: standard deviations within the regions that the cells belonged to before.
    before, after: numbers of the regions of the cells.
    """
    result, moved = sigma_m.copy(), before != after
    for number in np.unique(after[moved]):
        stayed, came = np.argwhere((after == number) & ~moved), np.argwhere((after == number) & moved)
        if len(stayed):
            nearest = stayed[KDTree(stayed).query(came)[1]]
            result[came[:, 0], came[:, 1]] = sigma_m[nearest[:, 0], nearest[:, 1]]
    return result


def stepped_uncertainty(
    sigma_m: Float[np.ndarray, "row column"],
    height_m: Float[np.ndarray, "row column"],
    coarse: CoarseMap,
    step_m: float,
    spacing_m: float,
) -> SteppedUncertainty:
    """Return the uncertainty of a map: that inside its regions, and that of the sides of steps.

    The other side of a step is as far away as the deepest foot nearby, or as the levels that the echoes leave open.

    sigma_m: standard deviations within the regions.
    height_m: the map.
    coarse: margins of the echoes against other levels, and their distances from its own heights.
    step_m, spacing_m: smallest height difference that counts as a step, and size of the cells.
    """
    moved_m = height_m - coarse.height_m
    away_m, drop_m = nearest_step_below(height_m, step_m, spacing_m)
    down, drop_m = BELOW_M / away_m * np.exp(-(coarse.below**2) / 2), np.maximum(drop_m, coarse.depth_m + moved_m)
    away_m, rise_m = nearest_step_below(-height_m, step_m, spacing_m)
    up, rise_m = ABOVE_M / away_m * np.exp(-(coarse.above**2) / 2), np.maximum(rise_m, coarse.rise_m - moved_m)
    down, up = down / (1 + down + up), up / (1 + down + up)
    step_sigma_m = np.sqrt(down * drop_m**2 + up * rise_m**2 - (up * rise_m - down * drop_m) ** 2)
    return SteppedUncertainty(np.hypot(sigma_m, step_sigma_m), down + up, step_sigma_m)


def nearest_step_below(
    height_m: Float[np.ndarray, "row column"], step_m: float, spacing_m: float
) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
    """Return the distance of each cell from the nearest foot of a step below it, and the depth of the step, m.

    The distance is that of the ring of cells, one of `DISTANCES_CELLS`; infinite without such a foot.
    """
    foot = maximum_filter(height_m, 3, mode="nearest") - height_m > step_m
    foot_m = np.where(foot, height_m, np.inf)
    away_m, depth_m = np.full(height_m.shape, np.inf), np.zeros(height_m.shape)
    for cells in DISTANCES_CELLS:
        reach_m = cells * spacing_m
        if cells > 1 and reach_m > FARTHEST_M:
            break
        below_m = height_m - minimum_filter(foot_m, 2 * cells + 1, mode="nearest")
        lower = below_m > step_m
        away_m[lower] = np.minimum(away_m[lower], reach_m)
        around = lower & (reach_m <= np.maximum(DEPTH_RADIUS_DISTANCES * away_m, MIN_DEPTH_RADIUS_M))
        depth_m[around] = below_m[around]
    return away_m, depth_m


@dataclass(frozen=True)
class SteppedMap:
    """A stepped surface, the cells supported by echoes, and its uncertainty."""

    surface: Heightfield
    supported: Bool[np.ndarray, "row column"]
    uncertainty: SteppedUncertainty

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """Its values in each cell, by name."""
        return {"height_m": self.surface.height_m, "supported": self.supported, **vars(self.uncertainty)}


def step_surface(
    sightings: Sightings, points: Points, grid: Grid, gap_m: float, options: SteppedParameters = STEPPED
) -> SteppedMap:
    """Return the most probable stepped surface.

    sightings: profiles and measured poses.
    points: located echoes.
    grid: cells of the DEM.
    gap_m: widest gap, within a region, that is filled between cells supported by echoes.
    options: of the method.
    """
    echoes = mean_ranges(sightings)
    axis_m = sightings.places(echoes.range_m)
    coarse = coarse_map(sightings, points, grid, axis_m, options)
    step_m = max(options.step_levels * coarse.level_m, grid.spacing_m)
    region = regions_of(coarse.height_m, step_m, options.min_cells(grid.spacing_m))
    surfaces = _Surfaces(sightings, echoes, points, grid, coarse, step_m, options)
    height, sigma, roofs = surfaces.of(region)
    filled = coarse.supported.copy()
    for number, window in enumerate(region_windows(region)):
        inside = region[window] == number
        filled[window] |= inside & closed(coarse.supported[window] & inside, gap_m, grid.spacing_m)
    release_memory()
    bordered = assign_border_cells(
        sightings, axis_m, height, region, ~raised_cells(height, region, step_m), step_m, grid
    )
    height, region_sigma = bordered.height_m, sigma_after_reassignment(sigma, region, bordered.region)
    echoes_of = height, points.position_m, step_m, grid
    doubtful = bordered.doubtful(nearest_echo_off_level(*echoes_of), contradicted_by_echoes(*echoes_of))
    beams = FilledBeams(points, sightings, options.outlier_sigmas)
    for number, plane in roofs.items():
        _refit(plane, (bordered.region == number) & ~doubtful, beams, height, region_sigma, grid, step_m)
    # Steps do not contribute inside a region; a weakly constrained covariance could exceed the step's sigma.
    uncertainty = stepped_uncertainty(np.minimum(region_sigma, step_m), height, coarse, step_m, grid.spacing_m)
    return SteppedMap(Heightfield(grid=grid, height_m=height), filled & ~doubtful, uncertainty)


@dataclass(frozen=True)
class _Surfaces:
    """Inputs from which the surfaces of the regions are made."""

    sightings: Sightings
    echoes: MeanRanges
    points: Points
    grid: Grid
    coarse: CoarseMap
    step_m: float
    options: SteppedParameters

    def of(
        self, region: Int[np.ndarray, "row column"]
    ) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], dict[int, Plane]]:
        """Return the heights of all cells, their standard deviations, and the planes through located echoes."""
        whole, grid = self.whole_region(region), self.grid
        height, sigma = self.coarse.height_m.copy(), np.full(grid.shape, np.nan)
        windows = region_windows(region)
        pulses = np.bincount(whole[whole >= 0], minlength=len(windows))
        alone = pulses >= MIN_PULSES
        tiling = refining(self.options)
        steps = [tiling.steps_over(grid.cut(*window)) for window in windows]
        expect_steps(sum(steps[number] for number in np.flatnonzero(alone)))

        def map_region(number: int) -> None:
            window = windows[number]
            inside, pulses_alone = region[window] == number, whole == number
            mapped_m, mapped_sigma_m = self._from_echoes(
                pulses_alone, grid.cut(*window), self.coarse.height_m[window], inside
            )
            height[window][inside], sigma[window][inside] = mapped_m[inside], mapped_sigma_m[inside]

        # A region larger than all others together uses all cores; the others run concurrently, largest first.
        largest = np.argsort(-pulses, kind="stable")[: int(alone.sum())]
        first = int(2 * pulses.max(initial=0) > pulses.sum())
        for numbers in (largest[:first], largest[first:]):
            for _ in several_at_once(map_region, numbers.tolist(), [steps[number] for number in numbers]):
                pass
        mapped = np.isfinite(sigma) & self.coarse.supported
        spread_m = max(spread((self.coarse.height_m - height)[mapped]), self.coarse.level_m / 2)
        beam_rad = self.sightings.beam.spread[1]
        planes: dict[int, Plane] = {}
        for number in np.flatnonzero(~alone):
            window = windows[number]
            inside, cells, coarse_m = region[window] == number, grid.cut(*window), self.coarse.height_m[window]
            plane = plane_of_points(coarse_m, inside, self.points, cells, spread_m, self.step_m, beam_rad, self.options)
            if plane is not None:
                place = cells.centres_m[inside.ravel()]
                height[window][inside], sigma[window][inside] = plane.at(place), plane.sigma_m(place)
                planes[int(number)] = plane
        return height, np.where(np.isfinite(sigma), sigma, spread_m), planes

    def _from_echoes(
        self,
        own: Bool[np.ndarray, " pulse"],
        cells: Grid,
        coarse_m: Float[np.ndarray, "row column"],
        inside: Bool[np.ndarray, "row column"],
    ) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
        """Return heights and standard deviations of a region from the echoes that see nothing else."""
        sightings = self.sightings.rows(own)
        plane = plane_of_echoes(sightings, self.echoes.rows(own), cells, self.options)
        if plane is None:
            mapped = refine(sightings, cells, self.options)
            height, sigma = mapped.surface.height_m, mapped.uncertainty.sigma_m(cells, inside)
            # Far from the echoes the coarse map is better: it is wrong by a step only in single cells.
            size = max(1, round(self.options.single_m / cells.spacing_m))
            far = median_filter(np.abs(height - coarse_m), size, mode="nearest") >= self.step_m
            return np.where(far, coarse_m, height), np.where(far, np.nan, sigma)
        advance(refining(self.options).steps_over(cells))
        place = cells.centres_m
        return plane.at(place).reshape(cells.shape), plane.sigma_m(place).reshape(cells.shape)

    def whole_region(self, region: Int[np.ndarray, "row column"]) -> Int[np.ndarray, " pulse"]:
        """Return the part of the map that contains the main lobe of each pulse.

        -1 if it is in more than one, or if the echo is a step above or below the coarse map.
        """
        pose, range_m = self.sightings.pose, self.echoes.range_m
        reach_m = range_m * self.sightings.beam.elevation.max() / np.maximum(-pose.boresight[:, 2], 0.05)
        echo_m = self.sightings.places(range_m)
        row, column, inside = self.grid.cell_of(echo_m)
        inside &= distance_to_border_m(region, self.grid.spacing_m)[row, column] > reach_m
        inside &= np.abs(echo_m[:, 2] - self.coarse.height_m[row, column]) <= self.step_m
        return np.where(inside, region[row, column], -1)


def _refit(
    plane: Plane,
    cells: Bool[np.ndarray, "row column"],
    beams: FilledBeams,
    height_m: Float[np.ndarray, "row column"],
    sigma_m: Float[np.ndarray, "row column"],
    grid: Grid,
    step_m: float,
) -> None:
    """Refit a plane to the echoes from the parts of their beams that it fills, and move its cells."""
    if not cells.any():
        return
    window = region_windows(cells.astype(np.int64) - 1)[0]
    inside, cut = cells[window], grid.cut(*window)
    refitted = beams.refitted(plane, inside, cut, step_m)
    place = cut.centres_m[inside.ravel()]
    height_m[window][inside] += refitted.at(place) - plane.at(place)
    sigma_m[window][inside] = refitted.sigma_m(place)


@dataclass(frozen=True)
class SteppedPiece:
    """What is mapped of a tile: see `SteppedMap.layers`."""

    layers: dict[str, np.ndarray]

    def packed(self) -> bytes:
        """Return its bytes."""
        return packed(**self.layers)


@dataclass(frozen=True)
class SteppedTiles:
    """The tiles of a stepped map, without common cells.

    sightings, points: profiles and measured poses, and located echoes.
    grid, gap_m, options: see `step_surface`.
    """

    sightings: Sightings
    points: Points
    grid: Grid
    gap_m: float
    options: SteppedParameters = STEPPED

    def __len__(self) -> int:
        return len(self.windows)

    @property
    def steps(self) -> int:
        """One, and none of a map of one tile, which counts steps of its own."""
        return int(len(self) > 1)

    @cached_property
    def windows(self) -> list[tuple[slice, slice]]:
        """Rows and columns of each tile: as few as are no longer than `TILE_BLOCKS` blocks."""
        size = TILE_BLOCKS * self.options.block_m / self.grid.spacing_m
        rows, columns = (equal_chunks(count, int(np.ceil(count / size))) for count in self.grid.shape)
        return [(slice(*some), slice(*others)) for some in rows for others in columns]

    def piece(self, number: int) -> SteppedPiece | None:
        """Return the map of a tile; None with too few echoes."""
        margin = round(self.options.overlap_m / self.grid.spacing_m)
        core = self.windows[number]
        reach = tuple(
            slice(max(side.start - margin, 0), min(side.stop + margin, count))
            for side, count in zip(core, self.grid.shape, strict=True)
        )
        cells, sightings, points = self.grid.cut(*reach), self.sightings, self.points
        if len(self) > 1:
            points = points.rows(np.flatnonzero(cells.cell_of(points.position_m)[2]))
            if len(points) < MIN_PULSES:
                return None
            height_m, margin_m = points.position_m[:, 2], self.options.level_margin_m
            span_m = float(height_m.min()) - margin_m, float(height_m.max()) + margin_m
            sightings = sightings.rows(looking_at(sightings, cells, span_m, self.options.overlap_m))
        made = step_surface(sightings, points, cells, self.gap_m, self.options)
        core_window = tuple(slice(c.start - r.start, c.stop - r.start) for c, r in zip(core, reach, strict=True))
        return SteppedPiece({name: layer[core_window] for name, layer in made.layers.items()})

    def unpacked(self, content: bytes) -> SteppedPiece:
        """Return the piece of some bytes."""
        return SteppedPiece(columns_of(content))

    def mapped(self, each: EachPiece = pieces_here) -> SteppedMap:
        """Return the map of all tiles; of those with too few echoes nothing is supported."""
        pieces: Iterable[SteppedPiece | None] = each(self)
        made = [(window, piece.layers) for window, piece in zip(self.windows, pieces, strict=True) if piece]
        # What is not mapped lies low and hides nothing.
        lowest_m = min((float(tile_map["height_m"].min()) for _, tile_map in made), default=0.0)
        sigma_layers = ("cell_sigma_m", "other_side", "step_sigma_m")
        layers = {name: np.zeros(self.grid.shape) for name in ("height_m", "supported", *sigma_layers)}
        layers["height_m"] += lowest_m
        for window, tile_map in made:
            for name, layer in tile_map.items():
                layers[name][window] = layer
        surface = Heightfield(grid=self.grid, height_m=layers["height_m"])
        return SteppedMap(
            surface, layers["supported"] > 0, SteppedUncertainty(*(layers[name] for name in sigma_layers))
        )


class Stepped:
    """Fits a surface with steps to the whole echoes."""

    profiles: Literal["required"] = "required"

    def __init__(self, parameters: SteppedParameters = STEPPED) -> None:
        self.options = parameters

    def __call__(self, inputs: MapInputs) -> Estimate:
        """Return the DEM and its uncertainty."""
        assert inputs.sightings is not None
        if len(inputs.sightings) < MIN_PULSES:
            return Estimate(dem=empty(inputs.grid))
        tiles = self.tiles(inputs)
        expect_steps(len(tiles) * tiles.steps)
        stepped = tiles.mapped(inputs.each_piece)
        sigma_m = np.hypot(stepped.uncertainty.cell_sigma_m, inputs.microrelief_m)
        uncertainty = replace(stepped.uncertainty, cell_sigma_m=sigma_m)
        return Estimate.with_sigma(visible_surface(stepped.surface, inputs).within(stepped.supported), uncertainty)

    def tiles(self, inputs: MapInputs) -> SteppedTiles:
        """Return the tiles of a map."""
        assert inputs.sightings is not None
        # Fields and planes alike: relief below the footprint is no part of either.
        sightings = replace(inputs.sightings, microrelief_m=0.0)
        return SteppedTiles(sightings, inputs.points, inputs.grid, inputs.max_gap_m, self.options)
