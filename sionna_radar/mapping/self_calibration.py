"""Errors of an instrument from overlapping lines over ground that is not known, or known at a few places.

The heights h = B u of the ground are unknowns beside the errors theta. B holds a plane and the real Fourier waves of
the terrain's covariance, which is learned from the echoes of one line as a map does (`terrain.smoothing`), each as high
as its standard deviation: the coefficients u have unit variance beforehand. With F the factor of the echoes'
information about the heights under the beams, W the interpolation of heights there, G = F W B, and J = F H, H being
the heights that stand for an error, a step of scoring solves

    [ I + G'G     G'J        ] [du]       [ s_u - u              ]
    [ J'G         J'J + P^-1 ] [dtheta] = [ s_theta - P^-1 theta ]

with s the scores. The ground is eliminated: what is left for theta is its information less what the ground could
explain as well (Schur complement), so that the standard deviations hold what the terrain does not tell. Heights of
single places, measured otherwise, are further rows of G.

The information is divided by the scatter of the scores of speckle beforehand, so that echoes and terrain have the
weights of their variances (see `calibration`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_matrix

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.calibration import Knowledge, Solution
from sionna_radar.mapping.echo_model.model import mean_ranges
from sionna_radar.mapping.instrument_echoes import ErrorsLinearised, Nearness, WholeEchoes
from sionna_radar.mapping.terrain.echo_heights import ROUGH, echo_surface, reaching
from sionna_radar.mapping.terrain.smoothing import TerrainModel

STEPS = 6
# Steps end below this share of the standard deviations.
SETTLED = 0.05
# Standard deviations of the plane beforehand, which the echoes tell far better: height, m, and slopes.
PLANE = (100.0, 1.0, 1.0)
# Waves that are left out: the smallest of all, that together hold this share of the variance; and at most so many are
# kept, that the system fits the memory.
LEFT_OUT, MOST_WAVES = 1e-5, 2500
FITTED_M = 1e-2


@dataclass(frozen=True, kw_only=True)
class MeasuredPlaces:
    """Heights of single places, as surveyed: local metres, and their standard deviations."""

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]


def solve_over_unknown_ground(
    echoes: WholeEchoes,
    grid: Grid,
    names: Sequence[str],
    prior: Mapping[str, float] | None = None,
    places: MeasuredPlaces | None = None,
) -> tuple[Solution, Heightfield]:
    """Estimate errors of an instrument together with the heights of the ground, and return both.

    Parameters
    ----------
    echoes:
        Whole echoes with the reported motion.
    grid:
        Cells of the ground; it need not reach all footprints.
    names, prior:
        Errors to estimate, and their standard deviations beforehand, SI.
    places:
        Heights that are known otherwise.

    """
    sigma0 = np.array([(prior or {}).get(name, UNKNOWNS[name].prior * UNKNOWNS[name].si) for name in names])
    value, before = np.zeros(len(names)), None
    # Lines that contradict each other pass for rough ground: the terrain's covariance is that of a single one.
    line = echoes.motion.line
    own = echoes.sightings.rows(line == np.bincount(line).argmax())
    reached = reaching(grid, echoes.sightings, mean_ranges(echoes.sightings))
    alone = echo_surface(own, mean_ranges(own), reached, tolerance=ROUGH).smoothed
    terrain = replace(alone.model, local=None)
    waves = _waves(terrain)
    first = echo_surface(echoes.sightings, mean_ranges(echoes.sightings), reached).smoothed.surface
    places_m = terrain.grid.centres_m
    ground = _coefficients(waves, first.at(*places_m.T))
    rough = echoes.step(InstrumentErrors(), first, (), Nearness.SETTLED)
    less = float(np.nanmean(rough.spread)) * echoes.repeated
    for free in (np.ones(len(names), dtype=bool), None):
        for _ in range(STEPS):
            surface = _surface(terrain.grid, waves, ground)
            linear = echoes.linearise(_errors(names, value), surface, names, less)
            known, moved, change = _step(linear, surface, waves, ground, sigma0, names, value, places, free)
            before, told = before or known, known.told
            value, ground = value + moved, ground + change
            if np.abs(moved / known.sigma).max(initial=0.0) < SETTLED:
                break
    surface = _surface(terrain.grid, waves, ground)
    step = echoes.step(_errors(names, value), surface, names, Nearness.SETTLED)
    assert before is not None
    solution = Solution(
        before=before,
        knowledge=known,
        told=told,
        value=value,
        covariance=known.considered(told),
        scatter=less,
        excess=1.0,
        surprise=1.0,
        misfit=float(np.nanmean(step.misfit)),
        step=step,
    )
    return solution, surface


def _errors(names: Sequence[str], value: Float[np.ndarray, " error"]) -> InstrumentErrors:
    return InstrumentErrors.of(dict(zip(names, map(float, value), strict=True)))


def _surface(grid: Grid, waves: Float[np.ndarray, "cell wave"], ground: Float[np.ndarray, " wave"]) -> Heightfield:
    return Heightfield(grid=grid, height_m=np.ascontiguousarray((waves @ ground).reshape(grid.shape)))


def _coefficients(
    waves: Float[np.ndarray, "cell wave"], height_m: Float[np.ndarray, " cell"]
) -> Float[np.ndarray, " wave"]:
    """Return the coefficients of heights: the smallest that fit them to centimetres."""
    square = waves.T @ waves
    square[np.diag_indices_from(square)] += FITTED_M**2
    return cho_solve(cho_factor(square, overwrite_a=True), waves.T @ height_m)


def _waves(terrain: TerrainModel) -> Float[np.ndarray, "cell wave"]:
    """Return a plane and the waves of the terrain over its grid, each as high as its standard deviation.

    Of white noise of unit variance in an orthonormal Fourier basis, the filter of the terrain makes the covariance.
    """
    grid = terrain.grid
    columns = [PLANE[0] * np.ones(grid.shape), PLANE[1] * np.broadcast_to(grid.x_m, grid.shape)]
    columns.append(PLANE[2] * np.broadcast_to(grid.y_m[:, None], grid.shape))
    row, column = np.arange(grid.rows)[:, None], np.arange(grid.columns)
    kept = []
    for field, root in enumerate(terrain.root):
        amplitude = float(np.mean(terrain.amplitude[field] ** 2))
        twice = np.full(root.shape, 2.0)
        twice[:, 0] = 1.0
        power = amplitude * root**2 * twice
        kept += [(float(power[i, j]), field, int(i), int(j)) for i, j in np.argwhere(power > 0)]
    kept.sort(reverse=True)
    share = np.cumsum([power for power, *_ in kept])
    count = min(int(np.searchsorted(share, (1 - LEFT_OUT) * share[-1])) + 1, MOST_WAVES // 2)
    for _, field, i, j in kept[:count]:
        phase = 2 * np.pi * (i * row / grid.rows + j * column / grid.columns)
        height = terrain.root[field, i, j] * terrain.amplitude[field] * np.sqrt(2 / (grid.rows * grid.columns))
        # Rows of frequencies that are their own mirrors stand twice, as i and -i, each with half of the variance.
        half = np.sqrt(0.5) if j == 0 or (grid.columns % 2 == 0 and j == grid.columns // 2) else 1.0
        columns += [half * height * np.cos(phase), half * height * np.sin(phase)]
    return np.stack([each.ravel() for each in columns], axis=1)


def _step(
    linear: ErrorsLinearised,
    surface: Heightfield,
    waves: Float[np.ndarray, "cell wave"],
    ground: Float[np.ndarray, " wave"],
    sigma0: Float[np.ndarray, " error"],
    names: Sequence[str],
    value: Float[np.ndarray, " error"],
    places: MeasuredPlaces | None = None,
    free: Bool[np.ndarray, " error"] | None = None,
) -> tuple[Knowledge, Float[np.ndarray, " error"], Float[np.ndarray, " wave"]]:
    """Return what is known of the errors, their step, and that of the ground's coefficients.

    free: errors that are estimated; None for those that are told.
    """
    heights = linear.heights
    count = linear.per_error.shape[2]
    between = surface.weights(*np.nan_to_num(heights.place_m).reshape(-1, 2).T)
    factor = _by_pulses(linear)
    onto = factor @ between
    by_error = factor @ linear.per_error.reshape(-1, count)
    told = (onto.T @ onto).tocsr()
    height_score = between.T @ linear.node_score.ravel()
    if places is not None:
        own = surface.weights(*places.place_m.T)
        precision = csr_matrix((1 / places.sigma_m**2, (np.arange(len(places.sigma_m)),) * 2))
        told = told + own.T @ precision @ own
        height_score = height_score + own.T @ (precision @ (places.height_m - own @ surface.height_m.ravel()))
    normal = waves.T @ (told @ waves)
    normal[np.diag_indices_from(normal)] += 1.0
    coupled = waves.T @ (onto.T @ by_error)
    system = cho_factor(normal, lower=True, overwrite_a=True)
    explained = cho_solve(system, waves.T @ height_score - ground)
    solved = cho_solve(system, coupled)
    information = by_error.T @ by_error - coupled.T @ solved
    known = Knowledge(names=tuple(names), prior=sigma0, information=(information + information.T) / 2)
    following, is_told = np.zeros(count), known.told if free is None else free
    if is_told.any():
        score = linear.score.sum(axis=0) - coupled.T @ explained
        right = score[is_told] + known.information[is_told] @ value
        own_prior = sigma0[is_told]
        scaled = own_prior[:, None] * known.information[np.ix_(is_told, is_told)] * own_prior + np.eye(is_told.sum())
        following[is_told] = own_prior * np.linalg.solve(scaled, own_prior * right)
    moved = following - value
    return known, moved, explained - solved @ moved


def _by_pulses(linear: ErrorsLinearised) -> csr_matrix:
    """Return the factors of all pulses as one matrix on the nodes of all pulses."""
    heights = linear.heights
    pulses, nodes = heights.place_m.shape[:2]
    kept = np.concatenate([np.arange(heights.first[p], heights.last[p]) for p in range(pulses)])
    pulse = np.repeat(np.arange(pulses), heights.last - heights.first)
    column = (pulse[:, None] * nodes + np.arange(nodes)).ravel()
    values = heights.factor[kept].astype(np.float64).ravel()
    starts = np.arange(len(kept) + 1) * nodes
    return csr_matrix((values, column, starts), shape=(len(kept), pulses * nodes))
