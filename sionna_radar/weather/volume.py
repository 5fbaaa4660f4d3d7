"""The scattering volume in the air of a survey: its reflectivity and fall speeds by position."""

from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.drops import SpeedMixture
from sionna_radar.weather.rain import MAX_MM_PER_H, MIN_MM_PER_H, RainMap

# Numbers of rates and of fall-speed quantiles at which non-uniform rain is computed, interpolated in between.
RATES = 21
QUANTILES = 257


@runtime_checkable
class Volume(Protocol):
    """A scattering volume in the air.

    reflectivity_per_m: that of the whole volume (m2/m3), or the reference of `relative`.
    """

    reflectivity_per_m: float

    def relative(self, position_m: Float[np.ndarray, "tone 2"]) -> Float[np.ndarray, " tone"]:
        """Return the reflectivity at positions east and north over `reflectivity_per_m`."""
        ...

    def fall_mps(
        self, position_m: Float[np.ndarray, "tone 2"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        """Return fall speeds at positions, by quantiles below 1 of the reflectivity."""
        ...


class EvenVolume:
    """A uniform volume."""

    def __init__(self, weather: Weather) -> None:
        rain = [(weather.rain_reflectivity_per_m, weather.rain_speeds())] if weather.rain_rate_mm_per_h > 0 else []
        kinds = [*rain, *weather.still_echoes]
        self.reflectivity_per_m = float(sum(reflectivity for reflectivity, _ in kinds))
        share = tuple(reflectivity / self.reflectivity_per_m for reflectivity, _ in kinds)
        self._speeds = SpeedMixture(share=share, kinds=[speeds for _, speeds in kinds])

    def relative(self, position_m: Float[np.ndarray, "tone 2"]) -> Float[np.ndarray, " tone"]:
        """Return ones."""
        return np.ones(len(position_m))

    def fall_mps(
        self, position_m: Float[np.ndarray, "tone 2"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        """Return fall speeds, the same everywhere."""
        return self._speeds.at(quantile)


class UnevenVolume:
    """Rain that varies with position, in an otherwise uniform volume."""

    def __init__(self, weather: Weather, rain: RainMap) -> None:
        self._weather, self._rain = weather, rain
        self._log_rate = np.linspace(np.log(MIN_MM_PER_H), np.log(MAX_MM_PER_H), RATES)
        still = weather.still_echoes
        self._still_per_m = float(sum(reflectivity for reflectivity, _ in still))
        share = tuple(reflectivity / self._still_per_m for reflectivity, _ in still)
        self._still_speeds = SpeedMixture(share=share, kinds=[speeds for _, speeds in still]) if still else None
        self.reflectivity_per_m = weather.rain_echo(MAX_MM_PER_H)[0] + self._still_per_m

    @cached_property
    def _tables(self) -> tuple[Float[np.ndarray, " rate"], Float[np.ndarray, "rate quantile"]]:
        """Logarithm of the reflectivity by rain rate, and fall speeds by rain rate and quantile."""
        echoes = [self._weather.rain_echo(float(rate)) for rate in np.exp(self._log_rate)]
        quantile = np.linspace(0.0, 1.0, QUANTILES)
        reflectivity = np.log([reflectivity for reflectivity, _ in echoes])
        return reflectivity, np.stack([speeds.at(quantile) for _, speeds in echoes])

    def _rain_per_m(self, rate_mm_per_h: Float[np.ndarray, " tone"]) -> Float[np.ndarray, " tone"]:
        raining = rate_mm_per_h >= MIN_MM_PER_H
        log_rate = np.log(np.maximum(rate_mm_per_h, MIN_MM_PER_H))
        return np.where(raining, np.exp(np.interp(log_rate, self._log_rate, self._tables[0])), 0.0)

    def relative(self, position_m: Float[np.ndarray, "tone 2"]) -> Float[np.ndarray, " tone"]:
        """Return the reflectivity at positions east and north over that of the heaviest rain."""
        rain_per_m = self._rain_per_m(self._rain.rate_mm_per_h(position_m))
        return (rain_per_m + self._still_per_m) / self.reflectivity_per_m

    def fall_mps(
        self, position_m: Float[np.ndarray, "tone 2"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        """Return fall speeds at positions: quantiles up to the rain's share are drops, larger ones other particles."""
        rate = self._rain.rate_mm_per_h(position_m)
        rain_per_m = self._rain_per_m(rate)
        total = rain_per_m + self._still_per_m
        share = np.divide(rain_per_m, total, out=np.ones_like(total), where=total > 0)
        drops = quantile < share
        speed = np.empty_like(quantile)
        speed[drops] = self._drop_mps(rate[drops], quantile[drops] / share[drops])
        if self._still_speeds is not None:
            others = ~drops
            speed[others] = self._still_speeds.at((quantile[others] - share[others]) / (1 - share[others]))
        return speed

    def _drop_mps(
        self, rate_mm_per_h: Float[np.ndarray, " tone"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        first_log, last_log = self._log_rate[0], self._log_rate[-1]
        row = (np.log(np.maximum(rate_mm_per_h, MIN_MM_PER_H)) - first_log) / (last_log - first_log) * (RATES - 1)
        column = quantile * (QUANTILES - 1)
        i, j = np.minimum(row.astype(np.int64), RATES - 2), np.minimum(column.astype(np.int64), QUANTILES - 2)
        u, v = row - i, column - j
        table = self._tables[1]
        lower = (1 - v) * table[i, j] + v * table[i, j + 1]
        upper = (1 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
        speed: Float[np.ndarray, " tone"] = (1 - u) * lower + u * upper
        return speed


def volume_of(weather: Weather) -> Volume | None:
    """Return the scattering volume; None if nothing in the air returns an echo."""
    if weather.rain_map is not None:
        return UnevenVolume(weather, weather.rain_map)
    return EvenVolume(weather) if weather.fills_the_beam else None
