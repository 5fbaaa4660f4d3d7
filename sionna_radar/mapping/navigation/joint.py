"""Errors of navigation or instrument, and the heights of unknown ground, estimated together from whole echoes.

The heights h = B u of the ground are unknowns beside the errors. B holds a plane and the real Fourier waves of the
terrain's covariance, which is learned from echoes as a map does (`terrain.smoothing`), each as high as its standard
deviation: the coefficients u have unit variance beforehand. Errors that vary are e = C a, of coefficients a of unit
variance as well: those of a line's own error, or of a process in time (`refinement.Wandering`). With F the factor of
the echoes' information about the heights under the beams, W the interpolation of heights there, G = F W B, and
J = F H, H being the heights that stand for an error, a step of scoring solves

    [ I + G'G      G'J C       ] [du]   [ s_u - u      ]
    [ C'J'G    I + C'J'J C     ] [da] = [ C' s_e - a   ]

with s the scores. Further errors theta, constant over the flight, are left out of the system: what the ground and the
varying errors could explain as well is taken from their information (Schur complement).

The information is divided by the scatter of the scores of speckle beforehand, so that echoes and terrain have the
weights of their variances.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import cho_solve, cholesky
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, cg

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import InstrumentErrors
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.inference.terrain.smoothing import TerrainModel
from sionna_radar.mapping.echo_heights import echo_surface, reaching
from sionna_radar.mapping.navigation.echo_errors import ErrorsLinearised, RangeProfiles, Stage

# Prior sigmas of the plane, which the echoes determine far better: height, m, and slopes.
PLANE = (100.0, 1.0, 1.0)
# Truncate the spectrum: drop the smallest waves whose summed variance is below LEFT_OUT of the total; keep at most
# MOST_WAVES, so that the system fits the memory.
LEFT_OUT, MOST_WAVES = 1e-5, 2500
FITTED_M = 1e-2
# Factors by which the grid may be coarser, and cells of its shortest wave at least: between these, linear interpolation
# misses a seventh of such a wave, which is the smallest of all.
COARSER, CELLS_PER_WAVE = (8, 4, 2, 1), 6


@dataclass(frozen=True)
class Waves:
    """Ground as a plane and waves: heights of the cells per unit of each coefficient.

    left_out_m2: variance of the waves that are too short or too many.
    """

    grid: Grid
    height_m: Float[np.ndarray, "cell wave"]
    left_out_m2: float

    def surface(self, ground: Float[np.ndarray, " wave"]) -> Heightfield:
        """Return the ground of given coefficients."""
        return Heightfield(
            grid=self.grid, height_m=np.ascontiguousarray((self.height_m @ ground).reshape(self.grid.shape))
        )

    def coefficients(self, surface: Heightfield) -> Float[np.ndarray, " wave"]:
        """Return the coefficients of a surface: the smallest that fit it to centimetres."""
        # Waves are nearly orthogonal: scaled to the same size they take few iterations.
        size = np.einsum("cw,cw->w", self.height_m, self.height_m) + FITTED_M**2
        count = (len(size),) * 2
        normal = LinearOperator(count, lambda u: self.height_m.T @ (self.height_m @ u) + FITTED_M**2 * u, dtype=float)
        scaled = LinearOperator(count, lambda u: u / size, dtype=float)
        right = self.height_m.T @ surface.at(*self.grid.centres_m.T)
        return cg(normal, right, rtol=1e-10, M=scaled)[0]

    @classmethod
    def of(cls, terrain: TerrainModel, left_out_m2: float = 0.0) -> "Waves":
        """Return a plane and the waves of a terrain, filtered white noise, each as high as its standard deviation.

        left_out_m2: variance that may be left out, where it is more than is left out in any case.
        """
        fine = terrain.grid
        kept = []
        for field, root in enumerate(terrain.root):
            amplitude = float(np.mean(terrain.amplitude[field] ** 2))
            twice = np.full(root.shape, 2.0)
            twice[:, 0] = 1.0
            power = amplitude * root**2 * twice
            kept += [(float(power[i, j]), field, int(i), int(j)) for i, j in np.argwhere(power > 0)]
        kept.sort(reverse=True)
        share = np.cumsum([power for power, *_ in kept])
        enough = share[-1] - max(LEFT_OUT * share[-1], left_out_m2 * fine.rows * fine.columns)
        count = min(int(np.searchsorted(share, enough)) + 1, MOST_WAVES // 2)
        waves = [(field, i if i <= fine.rows // 2 else i - fine.rows, j) for _, field, i, j in kept[:count]]
        most = max(max(abs(i) / fine.rows, j / fine.columns) for _, i, j in waves)
        times = next(times for times in COARSER if times * CELLS_PER_WAVE * most <= 1 or times == 1)
        grid = terrain.coarser(times)
        every = np.empty((len(PLANE) + 2 * count, *grid.shape))
        every[0], every[1], every[2] = PLANE[0], PLANE[1] * grid.x_m, PLANE[2] * grid.y_m[:, None]
        row, column = np.arange(grid.rows)[:, None] / grid.rows, np.arange(grid.columns) / grid.columns
        for k, (field, i, j) in enumerate(waves):
            wave = np.exp(2j * np.pi * i * row) * np.exp(2j * np.pi * j * column)
            amplitude_m = terrain.amplitude[field][::times, ::times]
            height = terrain.root[field, i, j] * amplitude_m * np.sqrt(2 / (fine.rows * fine.columns))
            # Rows of frequencies that are their own mirrors stand twice, as i and -i, each with half of the variance.
            half = np.sqrt(0.5) if j == 0 or (fine.columns % 2 == 0 and j == fine.columns // 2) else 1.0
            first = len(PLANE) + 2 * k
            every[first], every[first + 1] = half * height * wave.real, half * height * wave.imag
        left_out = float(share[-1] - share[count - 1]) / (fine.rows * fine.columns)
        return cls(grid, every.reshape(len(every), -1).T, left_out)


@dataclass(frozen=True)
class FirstGround:
    """Where a joint estimate begins.

    ground: coefficients of the surface through mean ranges. speckle_scatter: by which the information is divided.
    """

    waves: Waves
    ground: Float[np.ndarray, " wave"]
    speckle_scatter: float

    @classmethod
    def of(
        cls,
        echoes: RangeProfiles,
        grid: Grid,
        left_out: float = 0.0,
        *,
        errors: InstrumentErrors | None = None,
        lines_agree: bool = False,
    ) -> "FirstGround":
        """Learn the terrain from echoes without known errors; the grid need not reach all footprints.

        left_out: variance of the ground that waves may leave out, as a share of that of one echo's range.
        lines_agree: whether the terrain's covariance is that of all lines. Those that contradict each other pass for
            rough ground: it is then learned from a single one.
        """
        errors = errors or InstrumentErrors()
        sightings, line = echoes.without(errors)[0], echoes.motion.line
        ranges = mean_ranges(sightings)
        reached = reaching(grid, sightings, ranges)
        together = learned = echo_surface(sightings, ranges, reached).smoothed
        if not lines_agree and np.ptp(line) > 0:
            own = sightings.rows(line == np.bincount(line).argmax())
            learned = echo_surface(own, mean_ranges(own), reached).smoothed
        variance_m2 = float(np.median(ranges.sigma_m) ** 2 * repeats(echoes.reach).mean())
        waves = Waves.of(replace(learned.model, local=None), left_out * variance_m2)
        rough = echoes.step(errors, together.surface, (), Stage.FINE)
        return cls(waves, waves.coefficients(together.surface), float(np.nanmean(rough.spread)) * echoes.repeated)


def ground_grid(extent: Grid, echoes: RangeProfiles, spacing_m: float) -> Grid:
    """Return cells over an extent that are no smaller than half of a footprint: an echo holds nothing of shorter waves.

    spacing_m: least size of a cell. A footprint reaches two standard deviations of the beam's power to each side.
    """
    range_m = float(np.median(mean_ranges(echoes.sightings).range_m))
    west, south, east, north = (float(axis[k]) for k in (0, -1) for axis in (extent.x_m, extent.y_m))
    cell_m = max(spacing_m, 2 * min(echoes.sightings.beam.spread) * range_m)
    return replace(Grid.covering(west, south, east, north, cell_m), georeference=extent.georeference)


@dataclass(frozen=True, kw_only=True)
class Varying:
    """An error that differs from pulse to pulse: its name, and what each coefficient, of unit variance, adds to it."""

    name: str
    basis: Float[np.ndarray, "pulse coefficient"]


@dataclass(frozen=True, kw_only=True)
class MeasuredPlaces:
    """Heights of single places, as surveyed: local metres, and their standard deviations."""

    place_m: Float[np.ndarray, "n 2"]
    height_m: Float[np.ndarray, " n"]
    sigma_m: Float[np.ndarray, " n"]

    def onto(self, surface: Heightfield) -> tuple[csr_matrix, Float[np.ndarray, " cell"]]:
        """Return information and score of the heights of a surface."""
        at = surface.weights(*self.place_m.T)
        precision = csr_matrix((1 / self.sigma_m**2, (np.arange(len(self.sigma_m)),) * 2))
        return (at.T @ precision @ at).tocsr(), at.T @ (precision @ (self.height_m - at @ surface.height_m.ravel()))


@dataclass(frozen=True, kw_only=True)
class JointSystem:
    """The linear system of a step, in the coefficients of the ground and of errors that vary.

    normal, right: its matrix, and its right side. coupled: with the errors that are constant.
    information, score: of those, before anything else is taken to explain the echoes as well.
    """

    normal: Float[np.ndarray, "coefficient coefficient"]
    right: Float[np.ndarray, " coefficient"]
    coupled: Float[np.ndarray, "coefficient error"]
    information: Float[np.ndarray, "error error"]
    score: Float[np.ndarray, " error"]

    @cached_property
    def _root(self) -> Float[np.ndarray, "coefficient coefficient"]:
        return cholesky(self.normal, lower=True)

    def solved(self, right: Float[np.ndarray, "coefficient *n"]) -> Float[np.ndarray, "coefficient *n"]:
        """Return the solution for right sides."""
        return cho_solve((self._root, True), right)

    def in_sigmas(self, change: Float[np.ndarray, " coefficient"]) -> Float[np.ndarray, " coefficient"]:
        """Return a change of the coefficients as independent ones, in units of their posterior standard deviations."""
        return self._root.T @ change


def joint_system(
    linear: ErrorsLinearised,
    surface: Heightfield,
    waves: Waves,
    ground: Float[np.ndarray, " wave"],
    names: Sequence[str],
    varying: Sequence[Varying],
    coefficients: Sequence[Float[np.ndarray, " coefficient"]],
    constant: int = 0,
    places: MeasuredPlaces | None = None,
) -> JointSystem:
    """Return the system of a step at an estimate.

    linear: the likelihood of all pulses, in the errors `names`, of which the first so many are `constant`.
    surface, ground: the heights reached, and their coefficients.
    varying, coefficients: errors that vary, and their coefficients reached.
    places: heights that are known otherwise.
    """
    cells = surface.weights(*np.nan_to_num(linear.heights.place_m).reshape(-1, 2).T)
    factor, first_row = _by_pulses(linear)
    onto = (factor @ cells).tocsr()
    by_error = factor @ linear.per_error.reshape(-1, linear.per_error.shape[2])
    height_information, height_score = (onto.T @ onto).tocsr(), cells.T @ linear.node_score.ravel()
    if places is not None:
        more, score = places.onto(surface)
        height_information, height_score = height_information + more, height_score + score
    # Of a long flight most cells of the padded grid are under no beam.
    under = np.flatnonzero(np.diff(height_information.indptr))
    lit, onto, by_wave = height_information[under][:, under], onto[:, under], waves.height_m[under]
    first, sizes = len(ground), [each.basis.shape[1] for each in varying]
    ends = np.cumsum([first, *sizes])
    normal, coupled, right = np.zeros((ends[-1], ends[-1])), np.zeros((ends[-1], constant)), np.zeros(ends[-1])
    normal[:first, :first] = by_wave.T @ (lit @ by_wave)
    right[:first] = waves.height_m.T @ height_score - ground
    coupled[:first] = by_wave.T @ (onto.T @ by_error[:, :constant])
    said, score = linear.information, linear.score
    column = [names.index(each.name) for each in varying]
    for k, (each, j) in enumerate(zip(varying, column, strict=True)):
        rows = slice(ends[k], ends[k + 1])
        of_pulses = csr_matrix((by_error[:, j], np.arange(len(by_error)), first_row)) @ onto
        normal[:first, rows] = by_wave.T @ (of_pulses.T @ each.basis)
        normal[rows, :first] = normal[:first, rows].T
        right[rows] = each.basis.T @ score[:, j] - coefficients[k]
        coupled[rows] = each.basis.T @ said[:, j, :constant]
        for other, i, begin, end in zip(varying, column, ends[:-1], ends[1:], strict=True):
            normal[rows, begin:end] = each.basis.T @ (said[:, j, i, None] * other.basis)
    normal[np.diag_indices_from(normal)] += 1.0
    return JointSystem(
        normal=normal,
        right=right,
        coupled=coupled,
        information=said[:, :constant, :constant].sum(axis=0),
        score=score[:, :constant].sum(axis=0),
    )


def _by_pulses(linear: ErrorsLinearised) -> tuple[csr_matrix, np.ndarray]:
    """Return the factors of all pulses as one matrix on the nodes of all pulses, and the first row of each pulse."""
    heights = linear.heights
    pulses, nodes = heights.place_m.shape[:2]
    count = heights.last - heights.first
    kept = np.concatenate([np.arange(heights.first[p], heights.last[p]) for p in range(pulses)])
    pulse = np.repeat(np.arange(pulses), count)
    column = (pulse[:, None] * nodes + np.arange(nodes)).ravel()
    values = heights.factor[kept].astype(np.float64).ravel()
    starts = np.arange(len(kept) + 1) * nodes
    factor = csr_matrix((values, column, starts), shape=(len(kept), pulses * nodes))
    return factor, np.concatenate([[0], np.cumsum(count)])
