"""The weather of a survey: its attenuation and its echo at one carrier."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.drops import FLOATING, EchoSpeeds, marshall_palmer
from sionna_radar.weather.gases import Air, gas_attenuation_db_per_km
from sionna_radar.weather.obscurants import fog_attenuation_db_per_km, fog_droplets, obscurant
from sionna_radar.weather.path import wet_radome_loss_db
from sionna_radar.weather.rain import RainMap, drop_echo, rain_attenuations_db_per_km
from sionna_radar.weather.scattering import Aerosol
from sionna_radar.weather.snow import snow_attenuation_db_per_km, snow_reflectivity_per_m, snow_speeds
from sionna_radar.weather.validity import Obscurant, Precipitation

NONE_FALLS: Mapping[Precipitation, float] = {}
NONE_HANGS: Mapping[Obscurant, float] = {}


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
    snowfall_mm_per_h: Mapping[Precipitation, float] = field(default_factory=lambda: NONE_FALLS)
    liquid_water_g_per_m3: float = 0.0
    visibility_m: Mapping[Obscurant, float] = field(default_factory=lambda: NONE_HANGS)
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
    def still_attenuation_db_per_km(self) -> float:
        """One-way specific attenuation of everything but rain, the same in every direction."""
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
        still = self.still_attenuation_db_per_km
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
        return _rain_echo(self.carrier_hz, rain_rate_mm_per_h, self.temperature_k)

    @cached_property
    def still_echoes(self) -> tuple[tuple[float, EchoSpeeds], ...]:
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


@lru_cache(maxsize=16)
def _rain_echo(carrier_hz: float, rain_rate_mm_per_h: float, temperature_k: float) -> tuple[float, EchoSpeeds]:
    """Return the echo of rain, which a survey needs several times, summed in 50 ms."""
    return drop_echo(carrier_hz, drops=marshall_palmer(rain_rate_mm_per_h), temperature_k=temperature_k)
