"""The forward model of echoes pulse by pulse, with NumPy and SciPy alone: the slow oracle of `inference.echo`."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, RegularGridInterpolator
from scipy.ndimage import convolve1d, gaussian_filter1d

from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.inference.echo.kernels import (
    BEYOND,
    FADING_LEVEL,
    LEVEL_ITERATIONS,
    LEVEL_PEDESTAL,
    LEVEL_TOLERANCE,
    MIN_CELLS,
    MIN_SPREAD_CELLS,
)
from sionna_radar.inference.echo.likelihood import Sightings, footprints, spline_taps
from sionna_radar.inference.echo.power_kernels import OUT_OF_NOISE

SPLINE = BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)


@dataclass(frozen=True)
class _Spread:
    """The samples of one pulse that fall inside its range cells, with cell and power.

    slope: of the power by the place of the sample, east and north.
    share_before: share of the beam that meets the surface before the first cell.
    """

    sample: np.ndarray
    cell: np.ndarray
    power: np.ndarray
    slope: np.ndarray
    stretch: np.ndarray
    share_before: float


class PlainEchoes:
    """Predicted echoes, one pulse after the other, with sparse and dense matrices."""

    def __init__(self, sightings: Sightings, surface) -> None:
        self._sightings = sightings
        self._feet = footprints(sightings, surface)
        self._shift = sightings.shift_m(sightings.direction())
        self._taps = spline_taps(sightings.response)
        self._beyond = len(self._taps) // 2 + BEYOND - 1

    def centroid_m(self):
        """Return the power-weighted mean range of every predicted echo; NaN without an echo."""
        mean = np.full(len(self._sightings), np.nan)
        for pulse in range(len(mean)):
            spread = self._spread(pulse, -np.inf, np.inf)
            total = spread.power.sum()
            if total > 0:
                mean[pulse] = spread.power @ spread.cell / total * self._sightings.profiles.cell_m
        return mean

    def pulse(self, pulse: int, looks: float):
        """Return score and factor of one pulse."""
        profiles = self._sightings.profiles
        power, first = profiles.values(pulse), int(profiles.first[pulse])
        spread = self._spread(pulse, float(first), float(first + len(power) - 1))
        shape = self._mean(spread, len(power))
        nodes = self._sightings.beam.direction.shape[0]
        volume, by_height = self._volume(pulse) if profiles.volume is not None else (np.zeros(len(power)), None)
        noise = float(profiles.noise[pulse])
        top = echo_level(power, noise, noise + volume)
        if not shape.any() or top == 0:
            return np.zeros(nodes), np.zeros((0, nodes))
        level, mean, weight = _fit_level(power, shape, volume, noise + LEVEL_PEDESTAL * top, top)
        used = np.flatnonzero(weight > 1e-4)
        power, mean, weight = power[used], mean[used], weight[used]
        moved = self._moved(pulse, spread, spread.power, len(shape)) + self._passed(pulse, spread, len(shape))
        moved = self._responded(moved, len(shape))
        if by_height is not None:
            moved += by_height / level
        jacobian = moved[used] * (level / mean)[:, None]
        of_level = level * shape[used] / mean
        if len(used) < MIN_CELLS:
            return np.zeros(nodes), np.zeros((0, nodes))
        jacobian -= np.outer(of_level, (weight * of_level) @ jacobian / (weight @ of_level**2))
        residual = np.minimum(power / mean, MAX_SPECKLE) - 1
        root = np.sqrt(looks * weight)[:, None] * jacobian
        return looks * (weight * residual) @ jacobian, root

    def expected(self, pulse: int):
        """Return the profile of one pulse at unit level, without noise."""
        first, cells = float(self._sightings.profiles.first[pulse]), len(self._sightings.profiles.values(pulse))
        return self._mean(self._spread(pulse, first, first + cells - 1), cells)

    def _volume(self, pulse: int):
        """Return the mean power of a volume in front of the ground, and its derivative by the nodes' heights."""
        profiles = self._sightings.profiles
        inside = slice(profiles.start[pulse], profiles.start[pulse + 1])
        cells, first = inside.stop - inside.start, float(profiles.first[pulse])
        assert profiles.volume is not None
        power = profiles.volume.power[inside].astype(np.float64)
        spread = self._spread(pulse, first, first + cells - 1, float(profiles.volume.drift_m[pulse]))
        share, pad = self._sightings.beam.power[spread.sample], self._beyond + 1
        hit = self._hits(spread, share, cells)
        air = 1 - spread.share_before - _up_to_middle(hit[:, None])
        moved = -_up_to_middle(self._moved(pulse, spread, share, cells))
        sigma = profiles.volume.spread_m / profiles.cell_m
        response = self._taps / self._taps.sum()
        both = np.concatenate([air, moved], axis=1)
        if sigma > MIN_SPREAD_CELLS:
            both = gaussian_filter1d(both, sigma, axis=0, mode="nearest")
        both = convolve1d(both, response, axis=0, mode="nearest")[pad : pad + cells]
        return power * both[:, 0], power[:, None] * both[:, 1:]

    def _spread(self, pulse: int, first: float, last: float, drift_m: float = 0.0) -> _Spread:
        """Return the samples of a pulse between two range cells, numbered from the first.

        drift_m: by how much they appear farther than the ground's echoes.
        """
        beam = self._sightings.beam
        range_m = self._feet.range_m[pulse]
        met = np.isfinite(range_m)
        inverse = np.where(met, 1 / np.maximum(range_m, 1.0), 0.0)
        whole = beam.between @ (~met).astype(float) == 0
        sample_range = 1 / np.maximum(beam.between @ inverse, 1e-6)
        cell = (sample_range + beam.between @ self._shift[pulse] + drift_m) / self._sightings.profiles.cell_m
        origin = first if np.isfinite(first) else 0.0
        inside = whole & (cell > first - self._beyond) & (cell < last + self._beyond)
        before = float(beam.power[whole & (cell <= first - self._beyond)].sum())
        cell = cell[inside] - origin
        level, slope = self._levels(pulse)
        share = beam.power[inside] * (np.nanmean(range_m[met]) / sample_range[inside]) ** 2 if met.any() else cell
        power, slope = share * level[inside], share * slope[:, inside]
        return _Spread(np.flatnonzero(inside), cell, power, slope, sample_range[inside] ** 2, before)

    def _levels(self, pulse: int):
        """Return the power of the ground under each sample over that of the brightest cover, and its slopes."""
        cover, samples = self._sightings.cover, len(self._sightings.beam.power)
        if cover is None:
            return np.ones(samples), np.zeros((2, samples))
        incidence_deg = np.degrees(np.arccos(-self._sightings.pose.boresight[pulse, 2]))
        level = cover.gamma[:, round(incidence_deg)] / cover.gamma[:, round(incidence_deg)].max()
        between = RegularGridInterpolator((cover.grid.y_m, cover.grid.x_m), level[cover.cover])
        north_east = (self._sightings.beam.between @ self._feet.place_m[pulse])[:, ::-1]
        by = np.array([[0.0, 1e-6], [1e-6, 0.0]])
        return between(north_east), np.array([(between(north_east + d) - between(north_east - d)) / 2e-6 for d in by])

    def _mean(self, spread: _Spread, cells: int):
        """Return the profile of the samples at unit level."""
        pad = self._beyond + 1
        hit = self._hits(spread, spread.power, cells)
        return np.maximum(np.convolve(hit, self._taps, "same")[pad : pad + cells], 0.0)

    def _hits(self, spread: _Spread, power, cells: int):
        """Return the power of the samples on cells, with a margin for the window's response."""
        pad = self._beyond + 1
        away = np.arange(cells + 2 * pad)[:, None] - pad - spread.cell
        return np.asarray(np.nan_to_num(SPLINE(away)) @ power)

    def _moved(self, pulse: int, spread: _Spread, power, cells: int):
        """Return the derivative of the hits with respect to the heights under the nodes."""
        sightings = self._sightings
        pad = self._beyond + 1
        moved = power * spread.stretch / sightings.profiles.cell_m
        away = np.arange(cells + 2 * pad)[:, None] - pad - spread.cell
        onto = -np.nan_to_num(SPLINE.derivative()(away)) * moved
        inverse = 1 / np.maximum(np.nan_to_num(self._feet.range_m[pulse], nan=np.inf), 1.0)
        raw = onto @ sightings.beam.between[spread.sample]
        return np.asarray(raw * (inverse**2 * self._feet.range_per_height[pulse]))

    def _passed(self, pulse: int, spread: _Spread, cells: int):
        """Return the derivative of the hits by nodes that rise and are met elsewhere, where other covers are."""
        away = np.arange(cells + 2 * self._beyond + 2)[:, None] - self._beyond - 1 - spread.cell
        onto = [np.nan_to_num(SPLINE(away)) * slope for slope in spread.slope]
        ray = self._sightings.direction()[pulse]
        between = self._sightings.beam.between[spread.sample]
        passed = sum((each @ between) * ray[:, axis] for axis, each in enumerate(onto))
        return np.asarray(passed * self._feet.range_per_height[pulse])

    def _responded(self, raw, cells: int):
        """Return values on cells, convolved with the window's response."""
        pad = self._beyond + 1
        spread = np.zeros((cells, raw.shape[1]))
        for offset, response in enumerate(self._taps):
            start = pad + len(self._taps) // 2 - offset
            spread += response * raw[start : start + cells]
        return spread


def _up_to_middle(values):
    """Return the cumulative sums of values up to the middle of each cell."""
    total = np.cumsum(values, axis=0)
    return np.asarray(total - values / 2)


def echo_level(power, noise: float, background) -> float:
    """Return the level of a box with the echo's power, from E[P^2] = 2 E[P]^2; 0 if nothing exceeds the noise.

    noise: receiver noise power; background: that plus the mean of a volume in front of the ground.
    """
    above = np.maximum(power - (background - noise) - OUT_OF_NOISE * noise, 0.0)
    return float(above @ above / above.sum() / 2) if above.any() else 0.0


def _fit_level(
    power,
    shape,
    volume,
    noise: float,
    top: float,
):
    """Return the most likely level of an echo, with the mean powers and weights of the cells at that level."""
    level = float(power.sum() / shape.sum())
    for _ in range(LEVEL_ITERATIONS):
        mean, weight = _at_level(level, shape, volume, noise, top)
        share = weight * level * shape / mean
        excess = np.minimum(power / mean, MAX_SPECKLE) - 1
        step = float(share @ excess / max(share.sum(), np.finfo(float).tiny))
        level *= float(np.exp(np.clip(step, -1.0, 1.0)))
        if abs(step) < LEVEL_TOLERANCE:
            break
    return level, *_at_level(level, shape, volume, noise, top)


def _at_level(level: float, shape, volume, noise: float, top: float):
    signal = level * shape + volume
    return signal + noise, (signal / (signal + FADING_LEVEL * top)) ** 2
