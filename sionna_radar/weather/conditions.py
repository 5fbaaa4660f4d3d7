"""The weather of a survey, the same everywhere: what it takes from a wave at one carrier, and what it sends back."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from sionna_radar.weather.drops import marshall_palmer
from sionna_radar.weather.fog import fog_attenuation_db_per_km
from sionna_radar.weather.gases import Air, gas_attenuation_db_per_km
from sionna_radar.weather.rain import (
    EchoSpeeds,
    echo_speeds,
    rain_attenuations_db_per_km,
    rain_reflectivity_per_m,
)


@dataclass(frozen=True, kw_only=True)
class Weather:
    """Rain, fog and air along every path, at the carrier.

    air: None where the loss in the air itself is left out.
    temperature_k: of drops and droplets.
    """

    carrier_hz: float
    rain_rate_mm_per_h: float = 0.0
    liquid_water_g_per_m3: float = 0.0
    air: Air | None = None
    temperature_k: float = 288.15

    @property
    def clear(self) -> bool:
        """Whether nothing at all is taken or sent back."""
        return self.rain_rate_mm_per_h == 0 and self.liquid_water_g_per_m3 == 0 and self.air is None

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

    def attenuation_db_per_km(self, mix: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the one-way specific attenuation of all together; `mix` as in `rain_attenuations_db_per_km`."""
        still = self.gas_attenuation_db_per_km + self.fog_attenuation_db_per_km
        if self.rain_rate_mm_per_h == 0:
            return np.full(mix.shape, still)
        rain = rain_attenuations_db_per_km(self.carrier_hz, rain_rate_mm_per_h=self.rain_rate_mm_per_h, mix=mix)
        return still + rain

    @cached_property
    def rain_reflectivity_per_m(self) -> float:
        """Radar cross-section of a cubic metre of rain (m2/m3)."""
        return rain_reflectivity_per_m(
            self.carrier_hz, rain_rate_mm_per_h=self.rain_rate_mm_per_h, temperature_k=self.temperature_k
        )

    def rain_speeds(self) -> EchoSpeeds:
        """Return how fast the drops fall that send the echo; the rain rate must be positive."""
        drops = marshall_palmer(self.rain_rate_mm_per_h)
        return echo_speeds(self.carrier_hz, drops=drops, temperature_k=self.temperature_k)
