"""What the air holds: `[weather]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.table import Real, Table, refuse
from sionna_radar.weather.fog import FogClass
from sionna_radar.weather.water import HIGHEST_TEMPERATURE_K, LOWEST_TEMPERATURE_K


class WeatherTable(Table):
    """The weather, the same everywhere; the default is clear air without attenuation."""

    rain_rate_mm_per_h: Annotated[Real, Field(ge=0, le=300)] = 0.0
    fog: Literal["none", "medium", "thick"] = "none"
    liquid_water_g_per_m3: Annotated[Real, Field(ge=0, le=10)] = 0.0
    gases: bool = Field(default=False, strict=True)
    temperature_k: Annotated[Real, Field(ge=LOWEST_TEMPERATURE_K, le=HIGHEST_TEMPERATURE_K)] = 288.15
    dry_pressure_hpa: Annotated[Real, Field(gt=0, le=1100)] = 1013.25
    vapour_g_per_m3: Annotated[Real, Field(ge=0, le=60)] = 7.5

    @model_validator(mode="after")
    def _consistent(self) -> WeatherTable:
        if self.fog != "none" and self.liquid_water_g_per_m3 > 0:
            raise refuse("liquid_water_g_per_m3", f"contradicts fog = {self.fog!r}; give the one or the other")
        fields = type(self).model_fields
        given = [k for k in ("dry_pressure_hpa", "vapour_g_per_m3") if getattr(self, k) != fields[k].default]
        if given and not self.gases:
            raise refuse("gases", f"false, so {', '.join(given)} would go unused; set gases = true or remove them")
        return self

    @property
    def water_in_air_g_per_m3(self) -> float:
        """Liquid water of the fog, by its class or by value."""
        return self.liquid_water_g_per_m3 if self.fog == "none" else FogClass[self.fog.upper()].liquid_water_g_per_m3
