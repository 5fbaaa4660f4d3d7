"""Where a DEM errs, and how: checkpoints, classes of terrain and view, and the variogram of the error."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from sionna_radar.accuracy.checkpoints import NOTHING_COVERED, CheckpointTest, checkpoint_test
from sionna_radar.accuracy.classes import (
    DISTANCES_M,
    INCIDENCES_DEG,
    SLOPES_DEG,
    ErrorClass,
    by_class,
    incidence_deg,
)
from sionna_radar.accuracy.edges import Walls
from sionna_radar.accuracy.slope import slope_deg
from sionna_radar.accuracy.variogram import Variogram, variogram
from sionna_radar.foundation.randomness import Stream, pulse_generator
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points

# Distances and incidence angles are looked up at this many cells of a larger map.
MOST_CELLS = 100_000


@dataclass(frozen=True, kw_only=True)
class Breakdown:
    """The error of lit cells by what may explain it; see `sionna_radar.accuracy` for each.

    by_slope: classes of the true slope, degrees.
    by_incidence: classes of the angle between the true surface's normal and the direction to the radar, degrees.
    by_wall_distance: classes of the distance from the nearest wall, metres; None without walls.
    variogram: None with too few cells.
    """

    checkpoints: CheckpointTest
    by_slope: tuple[ErrorClass, ...]
    by_incidence: tuple[ErrorClass, ...]
    by_wall_distance: tuple[ErrorClass, ...] | None
    variogram: Variogram | None


def break_down(
    error: Raster,
    truth: Raster,
    lit: Bool[np.ndarray, "row column"],
    points: Points,
    walls: Walls,
    seed: int,
    covered: Mapping[str, float] = NOTHING_COVERED,
) -> Breakdown:
    """Return where a DEM errs.

    Parameters
    ----------
    error, truth, lit:
        DEM minus truth, the truth, and the cells that the main beam reached.
    points:
        From where the radar looked.
    walls:
        Of the scene.
    seed:
        Of the scenario; it draws checkpoints and pairs.
    covered:
        See `checkpoint_test`.

    """
    cells = error.filled & lit
    some = _some(cells, seed)
    error_m = error.height_m[some]
    distances = None
    if walls:
        place = error.grid.centres_m[some.ravel()]
        distances = by_class(error_m, walls.distance_m(place, DISTANCES_M[-2]), DISTANCES_M)
    return Breakdown(
        checkpoints=checkpoint_test(error, truth, lit, seed, covered),
        by_slope=by_class(error.height_m[cells], slope_deg(truth)[cells], SLOPES_DEG),
        by_incidence=by_class(error_m, incidence_deg(truth, points, some), INCIDENCES_DEG),
        by_wall_distance=distances,
        variogram=variogram(error, cells, seed),
    )


def _some(cells: Bool[np.ndarray, "row column"], seed: int) -> Bool[np.ndarray, "row column"]:
    """Return the cells, or so many of them, drawn, that looking each up stays cheap."""
    found = np.flatnonzero(cells)
    if len(found) <= MOST_CELLS:
        return cells
    chosen = np.zeros(cells.size, dtype=bool)
    chosen[pulse_generator(seed, Stream.CELLS, 0).choice(found, MOST_CELLS, replace=False)] = True
    return chosen.reshape(cells.shape)
