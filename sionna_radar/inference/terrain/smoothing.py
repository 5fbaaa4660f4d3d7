"""Gaussian-process smoothing: the most probable terrain given scattered heights, noise and a covariance.

A terrain is a plane plus a Gaussian field, z = trend + root * white, on a padded periodic grid where `root` acts by
the fast Fourier transform. Where relief varies, long and short waves have fields of their own, the latter times the
local amplitude. In terms of the white field the posterior is

    |white|^2 / 2 + sum over data of (data - prediction)^2 / (2 sigma^2).

Scattered heights are fewer than cells, and the equations are solved for theirs: kriging with noise, where a covariance
is applied by Fourier transforms and conjugate gradients know nearly its inverse (`Kriging.near_inverse`). Whole echoes
tell more of each place than one height; there the normal equations of the white field, identity plus data, are solved
(`TerrainModel.solve`).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft
from jaxtyping import Float, Int
from scipy.sparse.linalg import LinearOperator, cg

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import cores_of_thread
from sionna_radar.inference.terrain.covariance import Covariance, FittedCovariance
from sionna_radar.inference.terrain.covariance_fit import GROUPS, fit_covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.local_relief import LocalRelief, local_relief, low_relief_mask

# Padding in covariance lengths: the periodic field must not couple opposite borders.
PADDING_LENGTHS = 1.0
PADDING_M = 20.0
# Tolerance at which one iteration more or less, which rounding may decide, has no visible effect.
MAX_ITERATIONS = 1000
# Of the residual; heights are then within 0.1 mm of the exact solution.
TOLERANCE = 1e-6
# Cells below which a Fourier transform on several cores takes longer than on one; no result depends on it.
FEW_CELLS = 40_000


@dataclass(frozen=True)
class TerrainModel:
    """Prior of a terrain: trend, covariance, and their grid.

    trend: height at the horizontal origin, slope toward east, slope toward north.
    local: amplitude of short waves; None where it is one.
    """

    grid: Grid
    trend: Float[np.ndarray, "3"]
    covariance: Covariance
    local: LocalRelief | None = None

    @cached_property
    def trend_m(self) -> Float[np.ndarray, "row column"]:
        """Heights of the trend."""
        return self.trend[0] + self.trend[1] * self.grid.x_m[None] + self.trend[2] * self.grid.y_m[:, None]

    @cached_property
    def root(self) -> Float[np.ndarray, "field row frequency"]:
        """Filters that colour white noise, on the grid's real Fourier frequencies: one, or of long and short waves."""
        root = self.covariance.spectrum_root(self.grid)
        if self.local is None:
            return root[None]
        north = 2 * np.pi * np.fft.fftfreq(self.grid.rows, self.grid.spacing_m)[:, None]
        east = 2 * np.pi * np.fft.rfftfreq(self.grid.columns, self.grid.spacing_m)[None]
        long = self.local.long_fraction(np.hypot(east, north))
        return np.stack([root * np.sqrt(long), root * np.sqrt(1 - long)])

    @cached_property
    def amplitude(self) -> Float[np.ndarray, "field row column"]:
        """The local amplitude of each filtered field."""
        one = np.ones(self.grid.shape)
        return np.stack([one] if self.local is None else [one, self.local.on(self.grid)])

    def coloured(self, white: Float[np.ndarray, " n"]) -> Float[np.ndarray, " cell"]:
        """Return the field of the terrain's covariance that white fields, one for each filter, stand for."""
        workers = _cores_for(self.grid)
        spectrum = self.root * scipy.fft.rfft2(white.reshape(self.amplitude.shape), workers=workers)
        fields = scipy.fft.irfft2(spectrum, s=self.grid.shape, overwrite_x=True, workers=workers)
        return np.sum(self.amplitude * fields, axis=0).ravel()

    def adjoint(self, field: Float[np.ndarray, " cell"]) -> Float[np.ndarray, " n"]:
        """Return the transpose of `coloured`, applied to a field."""
        workers = _cores_for(self.grid)
        spectrum = self.root * scipy.fft.rfft2(self.amplitude * field.reshape(self.grid.shape), workers=workers)
        return scipy.fft.irfft2(spectrum, s=self.grid.shape, overwrite_x=True, workers=workers).ravel()

    def covaried(self, field: Float[np.ndarray, " cell"]) -> Float[np.ndarray, " cell"]:
        """Return `coloured` of the `adjoint` of a field: the covariance of all heights with the sum that it weighs."""
        workers = _cores_for(self.grid)
        spectrum = scipy.fft.rfft2(self.amplitude * field.reshape(self.grid.shape), workers=workers)
        fields = scipy.fft.irfft2(self.root**2 * spectrum, s=self.grid.shape, overwrite_x=True, workers=workers)
        return np.sum(self.amplitude * fields, axis=0).ravel()

    def coarser(self, times: int) -> Grid:
        """Return the grid of every second, or so, cell in both directions; the numbers of cells are multiples of 4."""
        grid = self.grid
        return Grid(
            west_m=grid.west_m,
            south_m=grid.south_m,
            spacing_m=grid.spacing_m * times,
            columns=grid.columns // times,
            rows=grid.rows // times,
        )

    def left_out(self, times: int) -> float:
        """Return the largest variance of a wave, per cell, that a coarser grid leaves out."""
        inside = np.zeros(self.root.shape[1:], dtype=bool)
        inside[_low(self.grid.rows, self.grid.rows // times), : self.grid.columns // times // 2] = True
        square = np.sum(self.root**2 * np.max(self.amplitude, axis=(1, 2), keepdims=True) ** 2, axis=0)
        return float(np.max(square, where=~inside, initial=0.0))

    def solve(
        self,
        information: Callable[[Float[np.ndarray, " cell"]], Float[np.ndarray, " cell"]],
        right: Float[np.ndarray, " n"],
        iterations: int,
        tolerance: float,
        times: int = 1,
    ) -> Float[np.ndarray, " n"]:
        """Return the white fields w with w + R^T A R w = right, R being `coloured`.

        information: applies A, symmetric and positive, to the heights of the cells, or of the `coarser` ones.
        times: how much coarser. Waves that are too short for it are solved as if A had no information on them.

        The unknowns are the coefficients of an orthonormal Fourier transform, in which the filters are diagonal: that
        halves the number of transforms.
        """
        shape, twice = self.grid.shape, np.full(self.root.shape[2], np.sqrt(2 / self.grid.rows / self.grid.columns))
        # Of a real field, the other half of the spectrum is the conjugate, except of these columns.
        twice[0] /= np.sqrt(2)
        if self.grid.columns % 2 == 0:
            twice[-1] /= np.sqrt(2)
        workers, few_workers = _cores_for(self.grid), _cores_for(self.grid, times)
        every = twice * scipy.fft.rfft2(right.reshape(self.amplitude.shape), workers=workers)
        few = self.grid.rows // times, self.grid.columns // times
        low = np.ix_(np.arange(len(every)), _low(self.grid.rows, few[0]), np.arange(few[1] // 2 + 1))
        root = self.root[low].copy()
        if times > 1:
            # A wave of two cells is indistinguishable from its mirror.
            root[:, few[0] // 2], root[:, :, -1] = 0.0, 0.0
        down, up = root * twice[low[2]], root / twice[low[2]] / times**2
        amplitude = self.amplitude[:, ::times, ::times]

        def normal(flat: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
            """Return the product of the scaled normal matrix with a spectrum."""
            spectrum = up * flat.view(complex).reshape(down.shape)
            fields = amplitude * scipy.fft.irfft2(spectrum, s=few, overwrite_x=True, workers=few_workers)
            field = fields[0] if len(fields) == 1 else fields[0] + fields[1]
            informed = scipy.fft.rfft2(amplitude * information(field.ravel()).reshape(few), workers=few_workers)
            informed *= down
            return flat + informed.ravel().view(float)

        start = np.ascontiguousarray(every[low])
        right_side = start.ravel().view(float)
        system = LinearOperator((len(right_side), len(right_side)), matvec=normal, dtype=float)
        solution, _ = cg(system, right_side, rtol=tolerance, maxiter=iterations)
        every[low] = solution.view(complex).reshape(down.shape)
        return scipy.fft.irfft2(every / twice, s=shape, overwrite_x=True, workers=workers).ravel()

    @staticmethod
    def flat(grid: Grid, trend: Float[np.ndarray, "3"]) -> Heightfield:
        """Return a plane over a grid."""
        return Heightfield(grid=grid, height_m=trend[0] + trend[1] * grid.x_m[None] + trend[2] * grid.y_m[:, None])

    def surface(self, white: Float[np.ndarray, " n"]) -> Heightfield:
        """Return the terrain that white fields represent."""
        return Heightfield(grid=self.grid, height_m=self.trend_m + self.coloured(white).reshape(self.grid.shape))


@dataclass(frozen=True)
class Smoothed:
    """A smoothing surface: the model, the white fields, and the factor on the noise variance that fits."""

    model: TerrainModel
    white: Float[np.ndarray, " n"]
    noise_factor: float

    @property
    def surface(self) -> Heightfield:
        """Return the surface."""
        return self.model.surface(self.white)


def smooth(
    heights: Heights,
    grid: Grid,
    groups: int = GROUPS,
    *,
    window_heights: int,
    microrelief_m: float = 0.0,
) -> Smoothed:
    """Fit trend, covariance and noise to heights, and return the most probable surface.

    heights: the measured heights.
    grid: cells that the surface must cover; it extends beyond them.
    groups: of neighbouring heights that the covariance is learned from.
    window_heights: that tell how rough the ground is around a place.
    microrelief_m: what is usual on such ground; see `Covariance`.
    """
    trend = heights.trend()
    measured = heights.above(trend, microrelief_m)
    fitted = fit_covariance(measured.rows(low_relief_mask(measured, window_heights)), groups)
    return smooth_with(heights, grid, trend, fitted, local_relief(measured, fitted, window_heights))


def smooth_with(
    heights: Heights,
    grid: Grid,
    trend: Float[np.ndarray, "3"],
    fitted: FittedCovariance,
    local: LocalRelief | None = None,
) -> Smoothed:
    """Return the most probable surface under a known trend and covariance.

    Errors that repeat over several pulses are taken for independent ones of as many times the variance: over the many
    pulses that decide about a cell the sum of their correlations is all that counts.
    """
    model = TerrainModel(_padded(grid, fitted.covariance.length_m), trend, fitted.covariance, local)
    weights = heights.weights(model.grid)
    transposed = weights.T.tocsr()
    sigma = np.sqrt(heights.variance_m2(fitted.noise_factor))

    def covaried(errors: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return errors + weights @ model.covaried(transposed @ (errors / sigma)) / sigma

    inverse, shape = Kriging(fitted.covariance, heights, fitted.noise_factor, local).near_inverse(), (len(sigma),) * 2
    system = LinearOperator(shape, matvec=covaried, dtype=float)
    nearly = LinearOperator(shape, matvec=lambda errors: sigma * inverse(sigma * errors), dtype=float)
    excess = (heights.height_m - weights @ model.trend_m.ravel()) / sigma
    errors, _ = cg(system, excess, rtol=TOLERANCE, maxiter=MAX_ITERATIONS, M=nearly)
    return Smoothed(model, model.adjoint(transposed @ (errors / sigma)), fitted.noise_factor)


def _cores_for(grid: Grid, times: int = 1) -> int:
    """Return the number of cores for the Fourier transforms of a grid, or of a coarser one."""
    return cores_of_thread() if grid.rows * grid.columns >= FEW_CELLS * times**2 else 1


def _low(rows: int, few: int) -> Int[np.ndarray, " row"]:
    """Return the rows of the `few` lowest Fourier frequencies among `rows`."""
    row = np.arange(few)
    return np.where(row <= few // 2, row, rows - few + row)


def _padded(grid: Grid, length_m: float) -> Grid:
    cells = int(np.ceil((PADDING_M + PADDING_LENGTHS * min(length_m, 100.0)) / grid.spacing_m))
    return Grid(
        west_m=grid.west_m - cells * grid.spacing_m,
        south_m=grid.south_m - cells * grid.spacing_m,
        spacing_m=grid.spacing_m,
        columns=4 * scipy.fft.next_fast_len(-(-(grid.columns + 2 * cells) // 4), real=True),
        rows=4 * scipy.fft.next_fast_len(-(-(grid.rows + 2 * cells) // 4), real=True),
    )
