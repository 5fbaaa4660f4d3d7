"""The most probable surface given whole echoes: Fisher scoring from one near it, with Anderson mixing.

Each step needs the score of all echoes on the surface reached, and solves for the step with the expected curvature of
the likelihood. The score decides where the iteration ends, and is exact. The curvature only says by which way: it is
computed on the first two surfaces alone, from some of the range cells of each pulse, and the system is solved on a
coarser grid where the terrain is so smooth that shorter waves are nothing that an echo could tell.

The iteration is brought to convergence by Anderson mixing of its last steps. Fisher scoring steps by the expected
curvature of the likelihood. Where few echoes decide, as at the end of a swath, the real curvature is several times the
expected one or a fraction of it, and plain steps oscillate about the maximum or creep. Of all mixtures of the last
steps the one is taken whose step would be the shortest if steps were linear in their starting point (Anderson 1965;
Walker and Ni 2011, "Anderson acceleration for fixed-point iterations").
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.threads import equal_parts, in_threads
from sionna_radar.mapping.echo_model.model import BeamFootprints, EchoModel, Sightings
from sionna_radar.mapping.refined.curvature import Information, curvature_on_cells
from sionna_radar.mapping.terrain.smoothing import MAX_ITERATIONS, Smoothed, TerrainModel

# Number of mixed steps, and the relative threshold of singular values.
DEPTH, MIN_SINGULAR = 4, 1e-10

Vector = Float[np.ndarray, " n"]


class Mixing:
    """Anderson acceleration: the next iterate from the last iterates and their proposed steps."""

    def __init__(self) -> None:
        self._past: list[tuple[Vector, Vector, Float[np.ndarray, " seen"]]] = []

    def next(self, place: Vector, step: Vector, seen: Float[np.ndarray, " seen"]) -> Vector:
        """Return the next iterate from a place, by Anderson mixing of the last steps.

        step, seen: the step proposed there, and what it changes, by which its length is measured.
        """
        proposed = place + step
        if self._past:
            by_seen = np.stack([seen - other for _, _, other in self._past])
            # By eigenvectors: of nearly equal steps, none tells much more than the other.
            value, vector = np.linalg.eigh(by_seen @ by_seen.T)
            kept = value > MIN_SINGULAR * value[-1]
            share = vector[:, kept] @ ((vector[:, kept].T @ (by_seen @ seen)) / value[kept])
            for part, (past_place, past_step, _) in zip(share, self._past, strict=True):
                proposed -= part * (place + step - past_place - past_step)
        self._past = [*self._past[1 - DEPTH :], (place, step, seen)]
        return proposed


# Convergence: RMS step over the places of the echoes, m.
SETTLED_M = 1e-3
# Below this step, ray intersections start from the previous ones, m.
COARSE_M = 0.05
MAX_SCORING_STEPS = 12
# Relative CG tolerance per step; the next step corrects the remainder.
STEP_TOLERANCE = 2e-2
# Iterations that recompute the curvature.
CURVED = 2
# Rows that the curvature of a pulse keeps, about, and how many times coarser the grid of the steps may be, with the
# most that echoes may tell of a wave that it leaves out, over what is known of it beforehand.
ROWS, COARSER, LEFT_OUT = 24, (4, 2, 1), 0.02


def most_probable(
    sightings: Sightings,
    looks: Float[np.ndarray, " pulse"],
    first: Smoothed,
    place_m: Float[np.ndarray, "pulse 2"],
) -> Smoothed:
    """Return the most probable surface given whole echoes.

    Parameters
    ----------
    sightings, looks:
        Profiles and measured poses, and the independent looks in each range cell of each pulse.
    first:
        A surface near it.
    place_m:
        Where the echoes come from: there the surface must settle.

    """
    fitted, mixing, middle = first, Mixing(), first.surface.weights(*place_m.T)
    near: BeamFootprints | None = None
    nearest, least_m, settled = first, np.inf, False
    for number in range(MAX_SCORING_STEPS):
        advance()
        if settled:
            continue
        # What comes to hide what is looked for as long as the surface still moves much.
        model = EchoModel(sightings, fitted.surface, near if least_m < COARSE_M else None)
        near = model.footprints
        if number < CURVED:
            times, curvature = _curvature(model, looks, fitted.model)
        score = fitted.model.adjoint(_on_cells(near, model.score(looks), fitted.surface)) - fitted.white
        change = fitted.model.solve(curvature, score, MAX_ITERATIONS, STEP_TOLERANCE, times)
        seen_m = middle @ fitted.model.coloured(change)
        by_m = float(np.sqrt(np.mean(seen_m**2)))
        if by_m < least_m:
            nearest, least_m = fitted, by_m
        fitted, settled = replace(fitted, white=mixing.next(fitted.white, change, seen_m)), by_m <= SETTLED_M
    # Where echoes do not fit the terrain model, the place is taken from which the least remained to go.
    return fitted if settled else nearest


def _curvature(model: EchoModel, looks: Float[np.ndarray, " pulse"], terrain: TerrainModel) -> tuple[int, Information]:
    """Return the expected curvature on the cells of a coarser grid, and how much coarser it is."""
    linear = model.linearise(looks, ROWS)
    for times in COARSER:
        grid = terrain.coarser(times)
        curvature = curvature_on_cells(linear, grid)
        told = float(curvature(np.ones(grid.rows * grid.columns, dtype=np.float32)).max()) / times**2
        if terrain.left_out(times) * told <= LEFT_OUT:
            break
    return times, curvature


def _on_cells(
    feet: BeamFootprints, score: Float[np.ndarray, "pulse node"], surface: Heightfield
) -> Float[np.ndarray, " cell"]:
    """Return the score of the heights of cells, from that of the heights under the nodes."""
    from sionna_radar.mapping.refined.curvature import add_to_cells

    grid = surface.grid

    def part(low: int, high: int) -> Float[np.ndarray, " cell"]:
        result = np.zeros(grid.shape)
        add_to_cells(feet.place_m, score, grid.west_m, grid.south_m, grid.spacing_m, result, low, high)
        return result.ravel()

    first, *others = in_threads(part, equal_parts(len(score)))
    for other in others:
        first += other
    return first
