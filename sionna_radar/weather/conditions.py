"""Weather at one carrier: specific attenuation, reflectivity and fall speeds of precipitation and obscurants."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.drops import FLOATING, EchoSpeeds, SpeedMixture, marshall_palmer
from sionna_radar.weather.fog import fog_attenuation_db_per_km
from sionna_radar.weather.gases import Air, gas_attenuation_db_per_km
from sionna_radar.weather.obscurants import fog_droplets, obscurant
from sionna_radar.weather.path import wet_radome_loss_db
from sionna_radar.weather.rain import MAX_MM_PER_H, MIN_MM_PER_H, RainMap, drop_echo, rain_attenuations_db_per_km
from sionna_radar.weather.scattering import Aerosol
from sionna_radar.weather.snow import snow_attenuation_db_per_km, snow_reflectivity_per_m, snow_speeds
from sionna_radar.weather.validity import Obscurant, Precipitation

NO_PRECIPITATION: Mapping[Precipitation, float] = {}
NO_OBSCURANTS: Mapping[Obscurant, float] = {}


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Precipitation and obscurants along every path, at the carrier.

    rain_rate_mm_per_h: rate of uniform rain; the mean if `rain_map` is given.
    rain_map: rain that varies with position, instead of `rain_rate_mm_per_h`; None for uniform rain.
    snowfall_mm_per_h: of dry and of wet snow, as water.
    liquid_water_g_per_m3: of fog; its visibility is in `visibility_m`, by default that of a mean fog.
    visibility_m: of each obscurant alone.
    air: None to neglect the attenuation by gases.
    temperature_k: of drops and droplets; ice is at most at its melting point.
    wet_radome_m: radius of a wet radome; None if there is none.
    wind_mps: toward east, north and up; all particles move with it.
    """

    carrier_hz: float
    rain_rate_mm_per_h: float = 0.0
    rain_map: RainMap | None = None
    snowfall_mm_per_h: Mapping[Precipitation, float] = field(default_factory=lambda: NO_PRECIPITATION)
    liquid_water_g_per_m3: float = 0.0
    visibility_m: Mapping[Obscurant, float] = field(default_factory=lambda: NO_OBSCURANTS)
    air: Air | None = None
    temperature_k: float = 288.15
    wet_radome_m: float | None = None
    wind_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def rains(self) -> bool:
        """Whether it rains anywhere."""
        return self.rain_rate_mm_per_h > 0 or self.rain_map is not None

    @property
    def clear(self) -> bool:
        """Whether there is neither attenuation nor echo."""
        return self.air is None and not self.fills_the_beam

    @property
    def fills_the_beam(self) -> bool:
        """Whether anything in the air returns an echo."""
        return self.rains or bool(self.snowfall_mm_per_h) or bool(self._aerosols)

    @cached_property
    def gas_attenuation_db_per_km(self) -> float:
        """One-way specific attenuation of the air (ITU-R P.676)."""
        return 0.0 if self.air is None else gas_attenuation_db_per_km(self.carrier_hz, self.air)

    @cached_property
    def fog_attenuation_db_per_km(self) -> float:
        """One-way specific attenuation of fog (ITU-R P.840)."""
        if self.liquid_water_g_per_m3 == 0:
            return 0.0
        return fog_attenuation_db_per_km(
            self.carrier_hz, liquid_water_g_per_m3=self.liquid_water_g_per_m3, temperature_k=self.temperature_k
        )

    @cached_property
    def _aerosols(self) -> dict[Obscurant, Aerosol]:
        """The particles of the obscurants."""
        aerosols: dict[Obscurant, Aerosol] = {
            kind: obscurant(kind, self.carrier_hz, visibility_m=range_m, temperature_k=self.temperature_k)
            for kind, range_m in self.visibility_m.items()
            if kind is not Obscurant.FOG
        }
        if self.liquid_water_g_per_m3 > 0:
            aerosols[Obscurant.FOG] = fog_droplets(
                self.carrier_hz,
                liquid_water_g_per_m3=self.liquid_water_g_per_m3,
                visibility_m=self.visibility_m.get(Obscurant.FOG),
                temperature_k=self.temperature_k,
            )
        return aerosols

    @cached_property
    def static_attenuation_db_per_km(self) -> float:
        """One-way specific attenuation of everything but rain, which is isotropic."""
        total = self.gas_attenuation_db_per_km + self.fog_attenuation_db_per_km
        for kind, aerosol in self._aerosols.items():
            if kind is not Obscurant.FOG:
                total += aerosol.attenuation_db_per_km(self.carrier_hz)
        for snow, rate in self.snowfall_mm_per_h.items():
            total += snow_attenuation_db_per_km(
                self.carrier_hz, snowfall_mm_per_h=rate, kind=snow, temperature_k=self.temperature_k
            )
        return total

    def attenuation_db_per_km(self, mix: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the total one-way specific attenuation in uniform rain.

        mix: as in `rain_attenuations_db_per_km`.
        """
        still = self.static_attenuation_db_per_km
        if self.rain_rate_mm_per_h == 0:
            return np.full(mix.shape, still)
        rain = rain_attenuations_db_per_km(self.carrier_hz, rain_rate_mm_per_h=self.rain_rate_mm_per_h, mix=mix)
        return still + rain

    def wet_radome_loss_db(self, rain_rate_mm_per_h: float) -> float:
        """Return the two-way loss in the radome's water film for a rain rate at the antenna.

        Wet snow is assumed to melt on it and run off like rain (sticking snow is not modelled); dry snow
        does not wet it.
        """
        if self.wet_radome_m is None:
            return 0.0
        return wet_radome_loss_db(
            self.carrier_hz,
            rain_rate_mm_per_h=rain_rate_mm_per_h + self.snowfall_mm_per_h.get(Precipitation.WET_SNOW, 0.0),
            radius_m=self.wet_radome_m,
            temperature_k=self.temperature_k,
        )

    @cached_property
    def rain_reflectivity_per_m(self) -> float:
        """Radar cross-section of a cubic metre of rain (m2/m3)."""
        return self.rain_echo(self.rain_rate_mm_per_h)[0] if self.rain_rate_mm_per_h else 0.0

    def rain_speeds(self) -> EchoSpeeds:
        """Return the echo-weighted fall speeds of the drops; the rain rate must be positive."""
        return self.rain_echo(self.rain_rate_mm_per_h)[1]

    def rain_echo(self, rain_rate_mm_per_h: float) -> tuple[float, EchoSpeeds]:
        """Return the reflectivity (m2/m3) and fall speeds of rain at a rate, which must be positive."""
        drops = marshall_palmer(rain_rate_mm_per_h)
        return drop_echo(self.carrier_hz, drops=drops, temperature_k=self.temperature_k)

    @cached_property
    def static_echoes(self) -> tuple[tuple[float, EchoSpeeds], ...]:
        """Reflectivity (m2/m3) and fall speeds of everything but rain that returns an echo."""
        snow = [
            (
                snow_reflectivity_per_m(
                    self.carrier_hz, snowfall_mm_per_h=rate, kind=kind, temperature_k=self.temperature_k
                ),
                snow_speeds(self.carrier_hz, snowfall_mm_per_h=rate, kind=kind, temperature_k=self.temperature_k),
            )
            for kind, rate in self.snowfall_mm_per_h.items()
        ]
        floating = [(aerosol.reflectivity_per_m(self.carrier_hz), FLOATING) for aerosol in self._aerosols.values()]
        return (*snow, *floating)


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

    def fall_mps(
        self, position_m: Float[np.ndarray, "tone 2"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        """Return fall speeds at positions, by quantiles below 1 of the reflectivity."""


class UniformVolume:
    """A uniform volume."""

    def __init__(self, weather: Weather) -> None:
        rain = [(weather.rain_reflectivity_per_m, weather.rain_speeds())] if weather.rain_rate_mm_per_h > 0 else []
        kinds = [*rain, *weather.static_echoes]
        self.reflectivity_per_m = float(sum(reflectivity for reflectivity, _ in kinds))
        fraction = tuple(reflectivity / self.reflectivity_per_m for reflectivity, _ in kinds)
        self._speeds = SpeedMixture(fraction=fraction, kinds=[speeds for _, speeds in kinds])

    def relative(self, position_m: Float[np.ndarray, "tone 2"]) -> Float[np.ndarray, " tone"]:
        """Return ones."""
        return np.ones(len(position_m))

    def fall_mps(
        self, position_m: Float[np.ndarray, "tone 2"], quantile: Float[np.ndarray, " tone"]
    ) -> Float[np.ndarray, " tone"]:
        """Return fall speeds, the same everywhere."""
        return self._speeds.at(quantile)


class NonUniformVolume:
    """Rain that varies with position, in an otherwise uniform volume."""

    def __init__(self, weather: Weather, rain: RainMap) -> None:
        self._weather, self._rain = weather, rain
        self._log_rate = np.linspace(np.log(MIN_MM_PER_H), np.log(MAX_MM_PER_H), RATES)
        still = weather.static_echoes
        self._still_per_m = float(sum(reflectivity for reflectivity, _ in still))
        fraction = tuple(reflectivity / self._still_per_m for reflectivity, _ in still)
        self._still_speeds = SpeedMixture(fraction=fraction, kinds=[speeds for _, speeds in still]) if still else None
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
        """Return fall speeds at positions: drops up to the rain's fraction, other particles above."""
        rate = self._rain.rate_mm_per_h(position_m)
        rain_per_m = self._rain_per_m(rate)
        total = rain_per_m + self._still_per_m
        rain_fraction = np.divide(rain_per_m, total, out=np.ones_like(total), where=total > 0)
        drops = quantile < rain_fraction
        speed = np.empty_like(quantile)
        speed[drops] = self._drop_mps(rate[drops], quantile[drops] / rain_fraction[drops])
        if self._still_speeds is not None:
            others = ~drops
            speed[others] = self._still_speeds.at(
                (quantile[others] - rain_fraction[others]) / (1 - rain_fraction[others])
            )
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
        return (1 - u) * lower + u * upper


def volume_of(weather: Weather) -> Volume | None:
    """Return the scattering volume; None if nothing in the air returns an echo.

    Parameters
    ----------
    weather:
        The weather at the carrier of the radar.

    Returns
    -------
    The scattering volume; None if nothing in the air returns an echo.
    """
    if weather.rain_map is not None:
        return NonUniformVolume(weather, weather.rain_map)
    return UniformVolume(weather) if weather.fills_the_beam else None
