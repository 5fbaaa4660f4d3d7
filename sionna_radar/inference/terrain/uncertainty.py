"""Uncertainty of a DEM: standard deviation of cells, and of means over windows.

A whole echo has more information about the ground than its mean range: the gain of `refined` over `smooth`. On ground
that looks alike everywhere, each wave of the terrain is known by itself. Of a wave of the prior power S(k), observed
with the information I(k) per area, 1 / (1 / S + I) remains (Wiener). The mean range of an echo sees a wave as its
footprint does; the whole echo shows how the wave moves power between range cells. With rows f of the linearised model,
whitened as if neighbouring cells were independent but for a factor, and the correlation C of their residuals really,
the information of the weights that are used is (sum |f e|^2)^2 / sum (f e)^H C (f e), e being the wave, over many
echoes. All echoes are given the median information: rugged profiles, of footprints with shadows in them, appear to
carry a hundred times as much on a wave, but respond to many waves at once, and to waves that no model of cells holds.

At long wavelengths a whole echo carries the information of a mean range with lower noise; this holds beyond the last
echoes, too, where the surface continues them. What remains of all waves, or of those that a window averages, is the
variance on ground that is covered evenly: by how much it differs from that of such mean ranges changes the variance of
a place.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.foundation.threads import chunks, in_background, in_threads
from sionna_radar.inference.echo.likelihood import Linearised
from sionna_radar.inference.terrain.covariance import FittedCovariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.inference.terrain.kriging import Kriging
from sionna_radar.inference.terrain.local_relief import LocalRelief, misfit_between_lines

LONGEST_M, SHORTEST_M, LENGTHS, DIRECTIONS = 250.0, 0.5, 26, 8
SAMPLED_PULSES = 40
# Number of amplitudes of local relief for which the posterior variance is computed; it is interpolated in between.
AMPLITUDES = 24


@dataclass(frozen=True)
class Information:
    """Fisher information of a survey on each wave of the terrain, per area, from mean ranges and from whole echoes.

    wavenumber: of the waves, rad/m; weight: of each in the variance of a height.
    by_means: if the noise is as the model says; by_echoes: 0 where only the means are used.
    """

    wavenumber: Float[np.ndarray, " wave"]
    weight: Float[np.ndarray, " wave"]
    by_means: Float[np.ndarray, " wave"]
    by_echoes: Float[np.ndarray, " wave"]

    def gain(self, noise_factor: float) -> float:
        """Return the information ratio of whole echoes to mean ranges in the longest waves, at least 1."""
        longest = self.wavenumber == self.wavenumber.min()
        by_means = float(self.by_means[longest].sum()) / noise_factor
        return max(1.0, float(self.by_echoes[longest].sum()) / by_means)

    def posterior_variance_m2(
        self,
        variance_m2: Float[np.ndarray, " n"],
        by_means: FittedCovariance,
        by_echoes: FittedCovariance,
        local: LocalRelief | None,
        place_m: Float[np.ndarray, "n 2"],
        window_m: float = 0.0,
    ) -> Float[np.ndarray, " n"]:
        """Return the posterior variance given whole echoes.

        Beyond the last echoes whole echoes add no information: there the variance changes by no more than where echoes
        lie.

        variance_m2: of heights, or of means over a square of the side `window_m`, given mean ranges.
        by_means: the terrain, and the factor on the noise of mean ranges that it was computed for.
        by_echoes: the same with the factor that was fitted.
        local, place_m: amplitude of short waves, and where the variance is wanted.
        window_m: side of the square; 0 for heights.
        """
        # A square averages waves in all directions nearly as a Gaussian of its standard deviation does.
        passed = self.weight * np.exp(-((self.wavenumber * window_m) ** 2) / 12)
        amplitude = np.ones(len(place_m)) if local is None else local.at(place_m)
        tried = np.geomspace(amplitude.min(), amplitude.max(), AMPLITUDES if np.ptp(amplitude) > 0 else 1)
        long = np.ones(len(self.wavenumber)) if local is None else local.long_fraction(self.wavenumber)
        means, left = np.zeros((2, len(tried)))
        for number, a in enumerate(tried):
            relief = long + a**2 * (1 - long)
            means[number] = passed @ self._posterior_power(by_means, relief, whole=False)
            left[number] = passed @ self._posterior_power(by_echoes, relief, whole=True)
        ratio, means = np.interp(amplitude, tried, left / means), np.interp(amplitude, tried, means)
        return np.asarray(variance_m2 + (ratio - 1) * np.minimum(variance_m2, means))

    def _posterior_power(
        self, terrain: FittedCovariance, relief: Float[np.ndarray, " wave"], whole: bool
    ) -> Float[np.ndarray, " wave"]:
        """Return the posterior power of each wave; relief: factor on its prior power."""
        prior = np.maximum(relief * terrain.covariance.power(self.wavenumber), np.finfo(float).tiny)
        by_means = self.by_means / terrain.noise_factor
        return 1 / (1 / prior + (np.maximum(by_means, self.by_echoes) if whole else by_means))


def information_of(
    heights: Heights,
    linearised: Callable[[Int[np.ndarray, " chosen"]], Linearised] | None = None,
    looks_per_cell: float = 1.0,
) -> Information:
    """Return the information of mean ranges and of whole echoes about the waves of a terrain.

    heights: mean ranges as heights over footprints; one for each pulse, if there is a linearised model.
    linearised: returns the model of the echoes of some pulses, by their rows, linearised about the surface; None if
        only the means are used.
    looks_per_cell: independent looks in a range cell, from the overlap of neighbouring cells.
    """
    length = np.geomspace(SHORTEST_M, LONGEST_M, LENGTHS)[::-1]
    heading = (np.arange(DIRECTIONS) + 0.5) * np.pi / DIRECTIONS
    radial = 2 * np.pi / length
    wave = (radial[:, None, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)).reshape(-1, 2)
    wavenumber = np.repeat(radial, DIRECTIONS)
    pulses = spread_indices(SAMPLED_PULSES, len(heights))
    variance = heights.variance_m2(1.0)
    means, (power, noise) = np.zeros(len(wave)), np.zeros((2, len(pulses), len(wave)))
    for pulse in pulses:
        means += np.exp(-np.sum((wave @ heights.footprint_m[pulse].T) ** 2, axis=1)) / variance[pulse]
    if linearised is not None:
        linear = linearised(pulses)

        def of_echo(row: int, _: int) -> None:
            rows = linear.rows_of(row)
            phase = (linear.place_m[row] - heights.place_m[pulses[row]]) @ wave.T
            turned = linear.factor[rows] @ np.cos(phase) + 1j * (linear.factor[rows] @ np.sin(phase))
            power[row] = np.sum(np.abs(turned) ** 2, axis=0)
            noise[row] = _noise(turned, linear.weight[rows], looks_per_cell)

        list(in_threads(of_echo, chunks(len(pulses), 1)))
    density = len(heights) / np.prod(np.maximum(np.ptp(heights.place_m, axis=0), 1.0))
    power, noise = np.median(power, axis=0), np.maximum(np.median(noise, axis=0), np.finfo(float).tiny)
    return Information(
        wavenumber=wavenumber,
        # Opposite waves are one; an integral over wave vectors is one over heights times (2 pi)^2.
        weight=2 * wavenumber * np.repeat(np.gradient(radial), DIRECTIONS) * np.pi / DIRECTIONS / (2 * np.pi) ** 2,
        by_means=density / len(pulses) * means,
        by_echoes=density * power**2 / noise,
    )


def _noise(
    turned: Complex[np.ndarray, "row wave"], weight: Float[np.ndarray, " row"], looks_per_cell: float
) -> Float[np.ndarray, " wave"]:
    """Return the variance of an echo's score along waves, of weighted residuals whose neighbours are correlated."""
    # A residual of the weight w has the variance w, in units of that of a look: the faint cells, which count for
    # little, are known better than they count for.
    turned = np.sqrt(weight)[:, None] * turned
    neighbour_correlation = (1 / looks_per_cell - 1) / 2
    neighbours = 2 * neighbour_correlation * np.real(np.sum(turned[1:] * np.conj(turned[:-1]), axis=0))
    # Where all cells say the same, their residuals are as uncertain as the likelihood takes them to be.
    return (np.sum(np.abs(turned) ** 2, axis=0) + neighbours) * looks_per_cell


@runtime_checkable
class Uncertainty(Protocol):
    """The uncertainty of a DEM, as its method states it."""

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        ...

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return the standard deviation of the mean height over the cells of a window; NaN where it is unknown."""
        ...


@dataclass(frozen=True)
class TileUncertainty:
    """The uncertainty within a tile of the map.

    bounds_m: west, east, south and north of the tile.
    kriging: of the mean ranges of its echoes.
    information: of these and of the whole echoes on the waves of the terrain.
    noise_factor: of the mean ranges, as it was fitted; that of `kriging` is smaller where whole echoes tell more.
    outstanding: echoes that the surface does not explain, such as those of poles and walls: place, radius of the
        footprint, and how far they are from the surface, m.
    misfit: how many times larger than stated errors between scan lines are; see `misfit_between_lines`.
    """

    bounds_m: tuple[float, float, float, float]
    kriging: Kriging
    information: Information
    noise_factor: float
    outstanding: Float[np.ndarray, "echo 4"] | None = None
    misfit: float = 1.0

    @classmethod
    def of(
        cls,
        bounds_m: tuple[float, float, float, float],
        kriging: Kriging,
        information: Information | None = None,
        outstanding: Float[np.ndarray, "echo 4"] | None = None,
        *,
        window_heights: int,
        microrelief_m: float = 0.0,
    ) -> "TileUncertainty":
        """Return the uncertainty of a tile; without information, mean ranges alone were used."""
        heights = kriging.heights
        measured = heights.above(heights.trend(), microrelief_m)
        misfit = in_background(lambda: misfit_between_lines(measured, kriging.terrain, kriging.local, window_heights))
        information = information or information_of(heights)
        scaled = replace(kriging, noise_factor=kriging.noise_factor / information.gain(kriging.noise_factor))
        return cls(bounds_m, scaled, information, kriging.noise_factor, outstanding, misfit())

    def contains(self, x: Float[np.ndarray, "..."], y: Float[np.ndarray, "..."]) -> Bool[np.ndarray, "..."]:
        """Return True where places lie in the tile."""
        west, east, south, north = self.bounds_m
        return np.asarray((x >= west) & (x < east) & (y >= south) & (y < north))

    def posterior_sigma_m(
        self, sigma_m: Float[np.ndarray, " n"], place_m: Float[np.ndarray, "n 2"], window_m: float = 0.0
    ) -> Float[np.ndarray, " n"]:
        """Return the posterior standard deviation of heights, or of their means over a window, given whole echoes."""
        kriging = self.kriging
        fitted = replace(kriging.terrain, noise_factor=self.noise_factor)
        variance_m2 = self.information.posterior_variance_m2(
            sigma_m**2, kriging.terrain, fitted, kriging.local, place_m, window_m
        )
        return np.asarray(self.misfit * np.sqrt(variance_m2))

    def unexplained_m(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the largest residual, m, of unexplained echoes whose footprints hold each place; 0 for none."""
        farthest = np.zeros(len(place_m))
        for x, y, radius, residual in () if self.outstanding is None else self.outstanding:
            near = np.hypot(place_m[:, 0] - x, place_m[:, 1] - y) < radius
            farthest[near] = np.maximum(farthest[near], residual)
        return farthest


@dataclass(frozen=True)
class TiledUncertainty:
    """The uncertainty of a map of tiles."""

    tiles: tuple[TileUncertainty, ...]

    def sigma_m(self, grid: Grid, wanted: Bool[np.ndarray, "row column"]) -> Float[np.ndarray, "row column"]:
        """Return the standard deviation of the wanted cells of a grid; NaN elsewhere."""
        sigma = np.full(grid.shape, np.nan)
        x, y = np.meshgrid(grid.x_m, grid.y_m)
        for tile in self.tiles:
            here = wanted & tile.contains(x, y)
            if here.any():
                place_m = np.column_stack([x[here], y[here]])
                explained = tile.posterior_sigma_m(tile.kriging.sigma_m(grid, here)[here], place_m)
                sigma[here] = np.hypot(explained, tile.unexplained_m(place_m))
        return sigma

    def mean_sigma_m(self, place_m: Float[np.ndarray, "cell 2"], window_m: float) -> float:
        """Return the standard deviation of the mean height over the cells of a window; NaN where it is unknown."""
        x, y = np.median(place_m, axis=0)[:, None]
        for tile in self.tiles:
            if tile.contains(x, y).all():
                # A window may reach beyond all echoes that the tile in its middle was mapped from.
                kriging = replace(tile.kriging, heights=self._heights)
                alone = np.array([kriging.mean_sigma_m(place_m)])
                return float(tile.posterior_sigma_m(alone, np.column_stack([x, y]), window_m)[0])
        return float("nan")

    @property
    def misfit(self) -> float:
        """The largest of the tiles'."""
        return max((tile.misfit for tile in self.tiles), default=1.0)

    @property
    def unexplained(self) -> int:
        """Number of echoes that the surface does not explain."""
        by_tile = ((tile, tile.outstanding) for tile in self.tiles)
        return sum(int(tile.contains(*out[:, :2].T).sum()) for tile, out in by_tile if out is not None)

    @cached_property
    def _heights(self) -> Heights:
        """The heights of all tiles, each from the tile that it lies in."""
        by_tile = (tile.kriging.heights for tile in self.tiles)
        inside = [
            heights.rows(tile.contains(*heights.place_m.T)) for tile, heights in zip(self.tiles, by_tile, strict=True)
        ]
        return Heights.concatenate(inside)
