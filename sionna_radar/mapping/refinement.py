"""A DEM with the beam modelled: the most probable terrain given the whole echoes, found by iteration.

1. The mean range of each echo gives a first surface, the covariance of the terrain, and the noise (`echo_heights`).
2. The forward model (`echo_model`) predicts every echo from the current surface. Fisher scoring moves the
   surface to the maximum of the posterior of measured profiles and terrain model, until it rests (`settling`).

A range cell of a pulse counts as many looks as its speckle is new in it: neighbouring cells overlap, and so do the
footprints of neighbouring pulses (`speckle`).

Only the measured poses, the antenna and the measured profiles are used. A large survey is mapped in square
overlapping tiles; each has its own terrain model, and their surfaces are blended.
"""

from functools import partial

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.echo_heights import ROUGH, SURFACES, echo_surface
from sionna_radar.mapping.echo_model import EchoModel, Linearised, Sightings
from sionna_radar.mapping.mean_ranges import MeanRanges
from sionna_radar.mapping.scoring import MOST_SCORING_STEPS, most_probable
from sionna_radar.mapping.speckle import repeats
from sionna_radar.mapping.tiles import (
    EachPiece,
    Mapped,
    Tiles,
    TileSurface,
    Tiling,
    pieces_here,
    tile_count,
)
from sionna_radar.mapping.whole_echo import information_of


def refinement_steps(grid: Grid) -> int:
    """Return how many steps `refine` takes over a grid."""
    return REFINING.steps * tile_count(grid)


def smoothing_steps(grid: Grid) -> int:
    """Return how many steps `smooth_echoes` takes over a grid."""
    return SMOOTHING.steps * tile_count(grid)


def refine(sightings: Sightings, grid: Grid, step: Step = no_step, each: EachPiece = pieces_here) -> Mapped:
    """Return the most probable surface over a grid given whole echoes.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    grid:
        Cells of the DEM.
    step:
        Called after each of `refinement_steps`.
    each:
        Has the pieces of all tiles made.

    """
    return Tiles(sightings, grid, REFINING).mapped(each, step)


def smooth_echoes(sightings: Sightings, grid: Grid, step: Step = no_step, each: EachPiece = pieces_here) -> Mapped:
    """Return the most probable surface over a grid given the mean ranges of whole echoes; see `refine`."""
    return Tiles(sightings, grid, SMOOTHING).mapped(each, step)


def _smoothed(sightings: Sightings, echoes: MeanRanges, grid: Grid, step: Step) -> TileSurface:
    """Return the surface through the mean ranges of echoes."""
    first = echo_surface(sightings, echoes, grid, step)
    return first.smoothed, first, None


def _refined(sightings: Sightings, echoes: MeanRanges, grid: Grid, step: Step) -> TileSurface:
    """Return the surface that fits the whole echoes best, from one through their mean ranges."""
    first = echo_surface(sightings, echoes, grid, step, ROUGH)
    looks = sightings.looks_per_cell / repeats(sightings.repeated(echoes.range_m))
    fitted = most_probable(sightings, looks, first.smoothed, first.heights.place_m, step)
    linearised = partial(_some_linearised, sightings, fitted.surface, looks)
    return fitted, first, information_of(first.heights, linearised, sightings.looks_per_cell)


def _some_linearised(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    chosen: Int[np.ndarray, " chosen"],
) -> Linearised:
    keep = np.isin(np.arange(len(sightings)), chosen)
    return EchoModel(sightings.rows(keep), surface).linearise(looks[keep])


SMOOTHING = Tiling(_smoothed, SURFACES)
REFINING = Tiling(_refined, SURFACES + MOST_SCORING_STEPS)
