"""Table `[weather]`: rain, snow, fog, dust, wind, gases and a wet radome."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sionna_radar.scenario.table import Conflicts, NoneOrSome, Point2, Point3, Positive, Real, Seed, Table
from sionna_radar.weather.fog import FogClass, liquid_water_of_visibility_g_per_m3
from sionna_radar.weather.permittivity import HIGHEST_TEMPERATURE_K, WATER_MIN_TEMPERATURE_K
from sionna_radar.weather.validity import Obscurant, Precipitation

RainRate = Annotated[NoneOrSome, Field(le=300)]
# As water on the ground: 10 mm/h is some 10 cm of new snow in an hour.
Snowfall = Annotated[NoneOrSome, Field(le=10)]
Visibility = Annotated[Real, Field(ge=5, le=1e5)]
FASTEST_WIND_MPS = 60.0


class RainCellTable(Table):
    """A shower: its rate falls off as peak exp(-distance / radius) from its centre (EXCELL)."""

    centre_m: Point2
    """Centre of the rain cell: east and north."""
    radius_m: Annotated[Positive, Field(ge=1)]
    """Distance over which the rain rate falls to 1/e."""
    peak_mm_per_h: RainRate
    """Rain rate in the middle of the cell."""


class RainFieldTable(Table):
    """Rain that varies from place to place: a seeded log-normal field, whose mean is `rain_rate_mm_per_h`."""

    correlation_m: Annotated[Positive, Field(ge=1)]
    """Distance at which the correlation of the rate in dB has fallen to 1/e."""
    spread_db: Annotated[Real, Field(ge=0, le=10)]
    """Standard deviation of the rate in dB."""
    seed: Seed = 1
    """Seed of the field."""


class WetRadomeTable(Table):
    """A spherical radome with a water film in rain; a dry one does not attenuate."""

    radius_m: Annotated[Real, Field(ge=0.01, le=50)]
    """Radius of curvature of the radome."""


class WeatherTable(Table):
    """The weather; the default is clear air without attenuation."""

    rain_rate_mm_per_h: RainRate = 0.0
    """Uniform rain rate."""
    rain_cell: RainCellTable | None = None
    """A single rain cell."""
    rain_field: RainFieldTable | None = None
    """Rain that varies from place to place."""
    wet_radome: WetRadomeTable | None = None
    """Water film on the radome."""
    snowfall_mm_per_h: Snowfall = 0.0
    """Snowfall rate as melted water."""
    snow: Literal["dry", "wet"] = "dry"
    """Whether snowfall is dry or wet."""
    fog: Literal["none", "medium", "thick"] = "none"
    """Class of fog."""
    liquid_water_g_per_m3: Annotated[NoneOrSome, Field(le=10)] = 0.0
    """Liquid water content of a fog."""
    fog_visibility_m: Visibility | None = None
    """Visibility in the fog alone; it also gives its liquid water, unless that is given."""
    haze_visibility_m: Visibility | None = None
    """Visibility in the haze alone."""
    dust_visibility_m: Visibility | None = None
    """Visibility in the dust alone."""
    smoke_visibility_m: Visibility | None = None
    """Visibility in the smoke alone."""
    wind_mps: Point3 = (0.0, 0.0, 0.0)
    """Wind toward east, north and up, the same everywhere; precipitation and suspended particles move with it."""
    gases: bool = Field(default=False, strict=True)
    """Whether oxygen and water vapour attenuate the wave."""
    temperature_k: Annotated[Real, Field(ge=WATER_MIN_TEMPERATURE_K, le=HIGHEST_TEMPERATURE_K)] = 288.15
    """Temperature of the air, and of fog and rain."""
    dry_pressure_hpa: Annotated[Real, Field(gt=0, le=1100)] = 1013.25
    """Pressure of the dry air."""
    vapour_g_per_m3: Annotated[Real, Field(ge=0, le=60)] = 7.5
    """Density of the water vapour."""

    def _conflicts(self) -> Conflicts:
        if self.fog != "none" and self.liquid_water_g_per_m3 > 0:
            yield "liquid_water_g_per_m3", f"contradicts fog = {self.fog!r}; give the one or the other"
        if self.fog != "none" and self.fog_visibility_m is not None:
            yield (
                "fog_visibility_m",
                f"contradicts fog = {self.fog!r}, whose visibility is {FogClass[self.fog.upper()].visibility_m:g} m; "
                "give the one or the other",
            )
        if any(abs(v) > FASTEST_WIND_MPS for v in self.wind_mps):
            yield (
                "wind_mps",
                f"{list(self.wind_mps)} has more than {FASTEST_WIND_MPS:g} m/s; give metres per second toward east, "
                "north and up",
            )
        fields = type(self).model_fields
        gas_keys = [k for k in ("dry_pressure_hpa", "vapour_g_per_m3") if getattr(self, k) != fields[k].default]
        if gas_keys and not self.gases:
            yield "gases", f"false, so {', '.join(gas_keys)} would go unused; set gases = true or remove them"

    @property
    def water_in_air_g_per_m3(self) -> float:
        """Liquid water of the fog: by value, by its class, or by its visibility."""
        if self.liquid_water_g_per_m3 > 0:
            return self.liquid_water_g_per_m3
        if self.fog != "none":
            return FogClass[self.fog.upper()].liquid_water_g_per_m3
        return 0.0 if self.fog_visibility_m is None else liquid_water_of_visibility_g_per_m3(self.fog_visibility_m)

    @property
    def precipitation_mm_per_h(self) -> dict[Precipitation, float]:
        """What falls, and how much of it as water; a rain cell comes on top, where it is."""
        snow = Precipitation.DRY_SNOW if self.snow == "dry" else Precipitation.WET_SNOW
        rates = {Precipitation.RAIN: self.rain_rate_mm_per_h, snow: self.snowfall_mm_per_h}
        return {kind: rate for kind, rate in rates.items() if rate > 0}

    @property
    def snow_mm_per_h(self) -> dict[Precipitation, float]:
        """Snow by its kind, as water."""
        return {kind: rate for kind, rate in self.precipitation_mm_per_h.items() if kind is not Precipitation.RAIN}

    @property
    def falling(self) -> str:
        """What falls anywhere, in words: "rain", "rain and dry snow"; empty where nothing does."""
        shower = self.rain_cell is not None and self.rain_cell.peak_mm_per_h > 0
        kinds = [kind for kind in Precipitation if kind in self.precipitation_mm_per_h]
        if shower and Precipitation.RAIN not in kinds:
            kinds.insert(0, Precipitation.RAIN)
        return " and ".join(kind.value for kind in kinds)

    @property
    def filling(self) -> str:
        """What falls or hangs in the air, in words: "rain and fog"; empty for clear air."""
        hanging = [kind for kind in Obscurant if kind in self.visibility_m]
        if self.water_in_air_g_per_m3 > 0 and Obscurant.FOG not in hanging:
            hanging.insert(0, Obscurant.FOG)
        return " and ".join(filter(None, [self.falling, *(kind.value for kind in hanging)]))

    @property
    def visibility_m(self) -> dict[Obscurant, float]:
        """What hangs in the air, and how far one sees through it alone.

        Fog that is given by its liquid water alone is left out: water does not give a visibility without droplet sizes.
        """
        fog = self.fog_visibility_m if self.fog == "none" else FogClass[self.fog.upper()].visibility_m
        visibilities = {
            Obscurant.FOG: fog,
            Obscurant.HAZE: self.haze_visibility_m,
            Obscurant.DUST: self.dust_visibility_m,
            Obscurant.SMOKE: self.smoke_visibility_m,
        }
        return {kind: visibility for kind, visibility in visibilities.items() if visibility is not None}
