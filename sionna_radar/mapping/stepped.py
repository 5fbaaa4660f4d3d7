"""A DEM of ground with steps: walls stay steep, and each level between them is mapped separately.

1. A coarse map by the evidence of all echoes may have jumps (`coarse_map`). It is split into parts where neighbours
   differ by more than a step (`map_parts`).
2. A part that alone fills enough main lobes is mapped from their whole echoes: as a plane, or, if another surface fits
   them better, as terrain (`refinement`). This shows how far coarse heights scatter; a smaller part whose heights
   scatter about a plane no more than twice as far becomes that plane, fitted to the echoes on it.
3. Cells beside borders join the part under which whole profiles are likeliest (`borders`). Cells near borders that no
   pulse really saw, or that may as well be of the other side, as where a wall crosses them, are left empty; so are
   those whose nearest echo is a step away, unless the profiles clearly say otherwise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import Progress, Step, Steps, silent
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import several_at_once
from sionna_radar.mapping.borders import nearer_elsewhere, with_borders
from sionna_radar.mapping.coarse_map import CoarseMap, coarse_map
from sionna_radar.mapping.coverage import closed
from sionna_radar.mapping.echo_heights import on_axis
from sionna_radar.mapping.echo_model import Sightings
from sionna_radar.mapping.filled import FilledBeams
from sionna_radar.mapping.map_parts import parts_of, raised_cells, to_border_m, windows_of
from sionna_radar.mapping.mean_ranges import MeanRanges, mean_ranges
from sionna_radar.mapping.planes import Plane, plane_of_echoes, plane_of_points, spread
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.refinement import refine, refinement_steps
from sionna_radar.mapping.stepped_uncertainty import SteppedUncertainty, moved_with, with_steps
from sionna_radar.mapping.tiles import FEWEST_PULSES

# A step is more than this many levels, and steeper than 45 deg.
STEP_LEVELS = 4
# Windows of this many cells hold single wrong cells by a minority.
ALONE_CELLS = 5


@dataclass(frozen=True)
class SteppedMap:
    """A surface with steps, the cells supported by an echo, and how well they are known."""

    surface: Heightfield
    supported: Bool[np.ndarray, "row column"]
    uncertainty: SteppedUncertainty


def step_surface(
    sightings: Sightings, points: Points, grid: Grid, gap_m: float, progress: Progress = silent
) -> SteppedMap:
    """Return the most probable surface, with steps.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    points:
        Located echoes.
    grid:
        Cells of the DEM.
    gap_m:
        Widest gap, within a part, that is filled between cells supported by echoes.
    progress:
        Called for the pulses of the coarse map ("levels"), and for the steps in its parts ("mapping").

    """
    echoes = mean_ranges(sightings)
    axis_m = on_axis(sightings.pose, echoes.range_m)
    coarse = coarse_map(sightings, points, grid, axis_m, progress)
    step_m = max(STEP_LEVELS * coarse.level_m, grid.spacing_m)
    part = parts_of(coarse.height_m, step_m)
    surfaces = _Surfaces(sightings, echoes, points, grid, coarse, step_m)
    height, sigma, roofs = surfaces.of(part, progress)
    filled = coarse.supported.copy()
    for number, window in enumerate(windows_of(part)):
        inside = part[window] == number
        filled[window] |= inside & closed(coarse.supported[window] & inside, gap_m, grid.spacing_m)
    bordered = with_borders(sightings, axis_m, height, part, ~raised_cells(height, part, step_m), step_m, grid)
    height, own_sigma = bordered.height_m, moved_with(sigma, part, bordered.part)
    doubtful = bordered.doubtful(nearer_elsewhere(height, points.position_m, step_m, grid))
    beams = FilledBeams(points, sightings)
    for number, plane in roofs.items():
        _refit(plane, (bordered.part == number) & ~doubtful, beams, height, own_sigma, grid, step_m)
    uncertainty = with_steps(own_sigma, height, bordered.margin)
    return SteppedMap(Heightfield(grid=grid, height_m=height), filled & ~doubtful, uncertainty)


@dataclass(frozen=True)
class _Surfaces:
    """What the surfaces of the parts of a map are made from."""

    sightings: Sightings
    echoes: MeanRanges
    points: Points
    grid: Grid
    coarse: CoarseMap
    step_m: float

    def of(
        self, part: Int[np.ndarray, "row column"], progress: Progress
    ) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"], dict[int, Plane]]:
        """Return the heights of all cells, their standard deviations, and the planes through located echoes."""
        whole, grid = self._whole_part(part), self.grid
        height, sigma = self.coarse.height_m.copy(), np.full(grid.shape, np.nan)
        windows = windows_of(part)
        pulses = np.bincount(whole[whole >= 0], minlength=len(windows))
        alone = pulses >= FEWEST_PULSES
        steps = [refinement_steps(grid.cut(*window)) for window in windows]
        step = Steps(progress, "mapping", sum(steps[number] for number in np.flatnonzero(alone)))

        def map_part(number: int, step: Step) -> None:
            window = windows[number]
            inside, own = part[window] == number, whole == number
            found, known = self._from_echoes(own, grid.cut(*window), self.coarse.height_m[window], inside, step)
            height[window][inside], sigma[window][inside] = found[inside], known[inside]

        # A part as large as all others together keeps all cores busy; those others go side by side, the largest first.
        largest = np.argsort(-pulses, kind="stable")[: int(alone.sum())]
        first = int(2 * pulses.max(initial=0) > pulses.sum())
        for numbers in (largest[:first], largest[first:]):
            for _ in several_at_once(map_part, numbers.tolist(), [steps[number] for number in numbers], step):
                pass
        step.finish()
        mapped = np.isfinite(sigma) & self.coarse.supported
        spread_m = max(spread((self.coarse.height_m - height)[mapped]), self.coarse.level_m / 2)
        beam_rad = self.sightings.beam.spread[1]
        planes: dict[int, Plane] = {}
        for number in np.flatnonzero(~alone):
            window = windows[number]
            inside, cells, coarse_m = part[window] == number, grid.cut(*window), self.coarse.height_m[window]
            plane = plane_of_points(coarse_m, inside, self.points, cells, spread_m, self.step_m, beam_rad)
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
        step: Step,
    ) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
        """Return heights and standard deviations of a part from the echoes that see nothing else."""
        sightings = self.sightings.rows(own)
        plane = plane_of_echoes(sightings, self.echoes.rows(own), cells)
        if plane is None:
            mapped = refine(sightings, cells, step)
            height, sigma = mapped.surface.height_m, mapped.uncertainty.sigma_m(cells, inside)
            # Far from the echoes the coarse map knows better, which is not wrong by a step but in single cells.
            far = median_filter(np.abs(height - coarse_m), ALONE_CELLS, mode="nearest") >= self.step_m
            return np.where(far, coarse_m, height), np.where(far, np.nan, sigma)
        for _ in range(refinement_steps(cells)):
            step()
        place = cells.centres_m
        return plane.at(place).reshape(cells.shape), plane.sigma_m(place).reshape(cells.shape)

    def _whole_part(self, part: Int[np.ndarray, "row column"]) -> Int[np.ndarray, " pulse"]:
        """Return the part of the map that contains the main lobe of each pulse; -1 if in more than one."""
        pose, range_m = self.sightings.pose, self.echoes.range_m
        reach_m = range_m * self.sightings.beam.elevation.max() / np.maximum(-pose.boresight[:, 2], 0.05)
        row, column, inside = self.grid.cell_of(on_axis(pose, range_m))
        within_one = inside & (to_border_m(part, self.grid.spacing_m)[row, column] > reach_m)
        return np.where(within_one, part[row, column], -1)


def _refit(
    plane: Plane,
    cells: Bool[np.ndarray, "row column"],
    beams: FilledBeams,
    height_m: Float[np.ndarray, "row column"],
    sigma_m: Float[np.ndarray, "row column"],
    grid: Grid,
    step_m: float,
) -> None:
    """Move the cells of a plane to where it is by the echoes from what it fills of their beams."""
    if not cells.any():
        return
    window = windows_of(cells.astype(np.int64) - 1)[0]
    inside, cut = cells[window], grid.cut(*window)
    found = beams.refitted(plane, inside, cut, step_m)
    place = cut.centres_m[inside.ravel()]
    height_m[window][inside] += found.at(place) - plane.at(place)
    sigma_m[window][inside] = found.sigma_m(place)
