"""The DEM method "stepped": segmentation at steps such as walls, and a separate surface for each region.

1. Coarse maps by the evidence of all echoes may have jumps (`coarse_map`). Each is split into regions where neighbours
   differ by more than a step.
2. A region of the first that alone fills enough main lobes is mapped from their whole echoes: as a plane, or, if
   another surface fits them better, as terrain (`refinement`). This shows how far coarse heights scatter; a smaller
   region whose heights scatter about a plane no more than twice as far becomes that plane, fitted to the echoes on it.
   So do those of the other maps, where they are a step off the first.
3. The likeliest map is searched from each of them, by the likelihood of whole profiles (`labelling`), which also says
   how probable it is that a cell belongs to the other side of a step. Cells where that is likelier than
   `max_other_side` are left empty.

A cell of the other side, as where a border is misplaced or an alley closed, is wrong by the whole step. Its variance is
that of a mixture: of its region, and of the heights that it may have instead.

Segmentation: within a region neighbours differ by less than a step. Where a wall is crossed by a ramp of in-between
heights, a cell or two wide, roof and ground would be one region. So regions are first grown from cells in whose
neighbourhood no step is (a morphological opening of the links between cells), and take in what they touch. What no
such region touches, narrower than three cells, joins the nearest.

A map longer than `tile_m` is made in tiles, each from what its echoes and those of a strip around it say.
They are not blended, as heights beside a step would be of neither side.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.columns import columns_of, packed
from sionna_radar.foundation.memory import release_memory
from sionna_radar.foundation.progress import advance, expect_steps
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import equal_chunks, several_at_once
from sionna_radar.inference.echo.likelihood import MeanRanges, Sightings, mean_ranges
from sionna_radar.mapping.coverage import closed
from sionna_radar.mapping.mapper import Estimate, MapInputs
from sionna_radar.mapping.options import STEPPED, SteppedParameters
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refined.refinement import refine, refining
from sionna_radar.mapping.seen import empty, visible_surface
from sionna_radar.mapping.stepped.coarse_map import CoarseMap, coarse_map
from sionna_radar.mapping.stepped.evidence import windows_of
from sionna_radar.mapping.stepped.labelling import Start, labelled_map, nearest_echo_m
from sionna_radar.mapping.stepped.planes import FilledBeams, Plane, plane_of_echoes, plane_of_points, spread
from sionna_radar.mapping.stepped.regions import distance_to_border_m, region_windows, regions_of
from sionna_radar.mapping.stepped.uncertainty import SteppedUncertainty, sigma_after_reassignment, unseen_steps
from sionna_radar.mapping.tiles import MIN_PULSES, EachPiece, pieces_here


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
) -> SteppedMap | None:
    """Return the most probable stepped surface; None with too few echoes on it.

    sightings: profiles and measured poses.
    points: located echoes.
    grid: cells of the DEM.
    gap_m: widest gap, within a region, that is filled between cells supported by echoes.
    options: of the method.
    """
    points = points.rows(np.flatnonzero(grid.cell_of(points.position_m)[2]))
    if len(points) < MIN_PULSES:
        return None
    height_m = points.position_m[:, 2]
    top, bottom, left, right = windows_of(sightings, grid, (float(height_m.min()), float(height_m.max()))).T
    seen = (top < bottom) & (left < right) | np.isin(sightings.profiles.pulse, points.pulse)
    sightings = sightings.rows(seen)
    echoes = mean_ranges(sightings)
    coarse = coarse_map(sightings, points, grid, options)
    step_m = max(options.step_levels * coarse.level_m, grid.spacing_m)
    surfaces = _Surfaces(sightings, echoes, points, grid, coarse, step_m, options)
    region = surfaces.regions(coarse.height_m)
    start, sigma, spread_m = surfaces.first(region)
    filled = coarse.supported.copy()
    for number, window in enumerate(region_windows(region)):
        inside = region[window] == number
        filled[window] |= inside & closed(coarse.supported[window] & inside, gap_m, grid.spacing_m)
    release_memory()
    starts = [start, *(surfaces.rival(rival_m, start, spread_m) for rival_m in coarse.rivals_m)]
    starts = _numbered(starts)
    axis_m, echo_m = sightings.places(echoes.range_m), nearest_echo_m(points.position_m, grid)
    beams = FilledBeams(points, sightings, options.outlier_sigmas)
    labelled = labelled_map(sightings, axis_m, starts, echo_m, step_m, grid, options.pair_nepers, beams)
    region_sigma = sigma_after_reassignment(sigma, region, labelled.region)
    region_sigma = np.where(np.isnan(labelled.refitted_sigma_m), region_sigma, labelled.refitted_sigma_m)
    probable = labelled.other_side > options.max_other_side
    open_m = np.sqrt(np.where(probable, labelled.other_side_m2 / np.where(probable, labelled.other_side, 1.0), 0.0))
    unseen, unseen_m2 = unseen_steps(labelled.height_m, open_m, step_m)
    step_sigma = np.sqrt(labelled.other_side_m2 + unseen_m2)
    # Steps do not contribute inside a region; a weakly constrained covariance could exceed the step's sigma.
    cell_sigma = np.hypot(np.minimum(region_sigma, step_m), step_sigma)
    other_side = 1 - (1 - labelled.other_side) * (1 - unseen)
    supported = filled & (other_side <= options.max_other_side)
    uncertainty = SteppedUncertainty(cell_sigma, other_side, step_sigma)
    return SteppedMap(Heightfield(grid=grid, height_m=labelled.height_m), supported, uncertainty)


def _numbered(starts: list[Start]) -> list[Start]:
    """Return maps whose regions have numbers of their own."""
    result, first = [], 0
    for start in starts:
        planes = {first + number: plane for number, plane in start.planes.items()}
        result.append(Start(start.height_m, start.region + first, planes))
        first += int(start.region.max()) + 1
    return result


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

    def first(self, region: Int[np.ndarray, "row column"]) -> tuple[Start, Float[np.ndarray, "row column"], float]:
        """Return the first map, the standard deviations of its cells, and how far coarse heights scatter, m."""
        whole, grid = self.whole_region(region), self.grid
        height, sigma = self.coarse.height_m.copy(), np.full(grid.shape, np.nan)
        windows = region_windows(region)
        pulses = np.bincount(whole[whole >= 0], minlength=len(windows))
        alone = pulses >= MIN_PULSES
        tiling = refining(self.options)
        steps = [tiling.steps_over(grid.cut(*window)) for window in windows]
        expect_steps(sum(steps[number] for number in np.flatnonzero(alone)))

        def map_region(number: int) -> None:
            """Write heights and errors of one region, from the pulses that see it alone."""
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
        planes: dict[int, Plane] = {}
        for number in np.flatnonzero(~alone):
            window = windows[number]
            inside = region[window] == number
            plane = self._plane(window, inside, self.coarse.height_m[window], spread_m)
            if plane is not None:
                place = grid.cut(*window).centres_m[inside.ravel()]
                height[window][inside], sigma[window][inside] = plane.at(place), plane.sigma_m(place)
                planes[int(number)] = plane
        return Start(height, region, planes), np.where(np.isfinite(sigma), sigma, spread_m), spread_m

    def regions(self, height_m: Float[np.ndarray, "row column"]) -> Int[np.ndarray, "row column"]:
        """Return the regions of a coarse map."""
        return regions_of(height_m, self.step_m)

    def rival(self, coarse_m: Float[np.ndarray, "row column"], first: Start, spread_m: float) -> Start:
        """Return another coarse map, on the surfaces of the first one where it is within a step of them."""
        region, same = self.regions(coarse_m), np.abs(coarse_m - first.height_m) <= self.step_m
        result, planes = np.where(same, first.height_m, coarse_m), {}
        for number, window in enumerate(region_windows(region)):
            inside = region[window] == number
            on_first = inside & same[window]
            if 2 * np.count_nonzero(on_first) > np.count_nonzero(inside):
                plane = first.planes.get(int(np.argmax(np.bincount(first.region[window][on_first]))))
            else:
                plane = self._plane(window, inside, coarse_m[window], spread_m)
                if plane is not None:
                    result[window][inside] = plane.at(self.grid.cut(*window).centres_m[inside.ravel()])
            if plane is not None:
                planes[number] = plane
        return Start(result, region, planes)

    def _plane(
        self,
        window: tuple[slice, slice],
        inside: Bool[np.ndarray, "row column"],
        coarse_m: Float[np.ndarray, "row column"],
        spread_m: float,
    ) -> Plane | None:
        """Return the plane through the located echoes of a region; None if they are not planar."""
        cells, beam_rad = self.grid.cut(*window), self.sightings.beam.spread[1]
        return plane_of_points(coarse_m, inside, self.points, cells, spread_m, self.step_m, beam_rad, self.options)

    def _from_echoes(
        self,
        exclusive: Bool[np.ndarray, " pulse"],
        cells: Grid,
        coarse_m: Float[np.ndarray, "row column"],
        inside: Bool[np.ndarray, "row column"],
    ) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
        """Return heights and standard deviations of a region from the echoes that see nothing else."""
        sightings = self.sightings.rows(exclusive)
        plane = plane_of_echoes(sightings, self.echoes.rows(exclusive), cells, self.options)
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
        """Rows and columns of each tile: as few as are no longer than `tile_m`."""
        size = self.options.tile_m / self.grid.spacing_m
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
        made = step_surface(self.sightings, self.points, self.grid.cut(*reach), self.gap_m, self.options)
        if made is None:
            return None
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
