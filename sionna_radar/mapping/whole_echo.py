"""How much more a whole echo tells of the ground than its mean range: the gain of `refined` over `smooth`.

On ground that looks alike everywhere, each wave of the terrain is known by itself. Of a wave of the prior power S(k),
observed with the information I(k) per area, 1 / (1 / S + I) remains (Wiener). The mean range of an echo sees a wave as
its footprint does; the whole echo sees how the wave moves power between range cells. With rows f of the linearised
model, whitened as if neighbouring cells were independent but for a factor, and the correlation C of their residuals
really, the information of the weights that are used is (sum |f e|^2)^2 / sum (f e)^H C (f e), e being the wave, over
many echoes: the few that seem to tell most are weighted no better than others. In their place stands the median echo,
as often as there are echoes: rugged profiles, of footprints with shadows in them, seem to tell a hundred times as much
of a wave, but tell of many at once, and of waves that no model of cells holds.

Long waves are told of as by mean ranges of less noise, which holds beyond the last echoes, too, where the surface goes
on as they say. What remains of all waves, or of those that a window averages, is the variance on ground that is
covered evenly: by how much it differs from that of such mean ranges changes the variance of a place.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int

from sionna_radar.mapping.covariance import FittedCovariance
from sionna_radar.mapping.echo_model import Linearised
from sionna_radar.mapping.heights import Heights
from sionna_radar.mapping.local_relief import LocalRelief
from sionna_radar.mapping.plausible import Plausible

LONGEST_M, SHORTEST_M, LENGTHS, DIRECTIONS = 250.0, 0.5, 26, 8
SAMPLED_PULSES = 40
# Amplitudes of local relief for which the variance that is left is computed; between them it is interpolated.
AMPLITUDES = 24


@dataclass(frozen=True)
class Information:
    """What a survey tells of each wave of the terrain, per area, by mean ranges and by whole echoes.

    wavenumber: of the waves, rad/m; weight: of each in the variance of a height.
    by_means: if the noise is as the model says; by_echoes: 0 where only the means are used.
    """

    wavenumber: Float[np.ndarray, " wave"]
    weight: Float[np.ndarray, " wave"]
    by_means: Float[np.ndarray, " wave"]
    by_echoes: Float[np.ndarray, " wave"]

    def gain(self, noise_factor: float) -> float:
        """Return how much more whole echoes tell of the longest waves than mean ranges do; 1 if only these are used."""
        longest = self.wavenumber == self.wavenumber.min()
        told = float(self.by_means[longest].sum()) / noise_factor
        return max(1.0, float(self.by_echoes[longest].sum()) / told)

    def after(
        self,
        variance_m2: Float[np.ndarray, " n"],
        taken: FittedCovariance,
        plausible: Sequence[Plausible],
        local: LocalRelief | None,
        place_m: Float[np.ndarray, "n 2"],
        window_m: float = 0.0,
    ) -> Float[np.ndarray, " n"]:
        """Return the variance that is left by all that the echoes tell, averaged over the terrains they allow.

        Beyond the last echoes, more is known neither by whole ones nor of what the terrain is like: there the variance
        changes by no more than where echoes lie.

        Parameters
        ----------
        variance_m2:
            Of heights, or of means over a square of the side `window_m`, given mean ranges.
        taken:
            The terrain that it was computed for, and the factor on the noise of mean ranges.
        plausible:
            Those that the echoes allow.
        local, place_m:
            Amplitude of short waves, and where the variance is wanted.
        window_m:
            Side of the square; 0 for heights.

        """
        # A square averages waves in all directions nearly as a Gaussian of its standard deviation does.
        passed = self.weight * np.exp(-((self.wavenumber * window_m) ** 2) / 12)
        amplitude = np.ones(len(place_m)) if local is None else local.at(place_m)
        tried = np.geomspace(amplitude.min(), amplitude.max(), AMPLITUDES if np.ptp(amplitude) > 0 else 1)
        long = np.ones(len(self.wavenumber)) if local is None else local.long_share(self.wavenumber)
        means, left = np.zeros((2, len(tried)))
        for number, a in enumerate(tried):
            share = long + a**2 * (1 - long)
            means[number] = passed @ self._left(taken, share, whole=False)
            for each in plausible:
                left[number] += each.probability * float(passed @ self._left(each.terrain, share, whole=True))
        ratio, means = np.interp(amplitude, tried, left / means), np.interp(amplitude, tried, means)
        return np.asarray(variance_m2 + (ratio - 1) * np.minimum(variance_m2, means))

    def _left(
        self, terrain: FittedCovariance, share: Float[np.ndarray, " wave"], whole: bool
    ) -> Float[np.ndarray, " wave"]:
        """Return what is left of each wave; share: of its power in the terrain."""
        prior = np.maximum(share * terrain.covariance.power(self.wavenumber), np.finfo(float).tiny)
        told = self.by_means / terrain.noise_factor
        left: Float[np.ndarray, " wave"] = 1 / (1 / prior + (np.maximum(told, self.by_echoes) if whole else told))
        return left


def information_of(
    heights: Heights,
    linearised: Callable[[Int[np.ndarray, " chosen"]], Linearised] | None = None,
    looks_per_cell: float = 1.0,
) -> Information:
    """Return what mean ranges and whole echoes tell of the waves of a terrain.

    Parameters
    ----------
    heights:
        Mean ranges as heights over footprints; one for each pulse, if there is a linearised model.
    linearised:
        Returns the model of the echoes of some pulses, by their rows, linearised about the surface; None if only the
        means are used.
    looks_per_cell:
        Independent looks in a range cell, from the overlap of neighbouring cells.

    """
    length = np.geomspace(SHORTEST_M, LONGEST_M, LENGTHS)[::-1]
    heading = (np.arange(DIRECTIONS) + 0.5) * np.pi / DIRECTIONS
    radial = 2 * np.pi / length
    wave = (radial[:, None, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)).reshape(-1, 2)
    wavenumber = np.repeat(radial, DIRECTIONS)
    pulses = np.unique(np.linspace(0, len(heights) - 1, SAMPLED_PULSES).astype(int))
    variance = heights.variance_m2(1.0)
    means, (power, noise) = np.zeros(len(wave)), np.zeros((2, len(pulses), len(wave)))
    linear = None if linearised is None else linearised(pulses)
    for row, pulse in enumerate(pulses):
        means += np.exp(-np.sum((wave @ heights.footprint_m[pulse].T) ** 2, axis=1)) / variance[pulse]
        if linear is None:
            continue
        own = linear.rows_of(row)
        phase = (linear.place_m[row] - heights.place_m[pulse]) @ wave.T
        turned = linear.factor[own] @ np.cos(phase) + 1j * (linear.factor[own] @ np.sin(phase))
        power[row] = np.sum(np.abs(turned) ** 2, axis=0)
        noise[row] = _noise(turned, linear.weight[own], looks_per_cell)
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
    beside = (1 / looks_per_cell - 1) / 2
    neighbours = 2 * beside * np.real(np.sum(turned[1:] * np.conj(turned[:-1]), axis=0))
    # Where all cells say the same, their residuals are as uncertain as the likelihood takes them to be.
    noise: Float[np.ndarray, " wave"] = (np.sum(np.abs(turned) ** 2, axis=0) + neighbours) * looks_per_cell
    return noise
