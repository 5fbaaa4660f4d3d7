"""What a scenario may say: frozen models of every table, in the units a person writes (degrees, dB).

The models check each value alone and the contradictions visible within one table. What needs the
terrain or the flight to judge is checked when the survey is prepared (`sionna_radar.survey.prepare`).
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Discriminator, Field, Tag, field_validator, model_validator
from scipy.constants import speed_of_light

from sionna_radar.scenario.cover import CoverPolygon, CoverRaster, MaterialField
from sionna_radar.scenario.materials import DEFAULT_MATERIALS, Material
from sionna_radar.scenario.table import (
    Count,
    NonNegative,
    Point2,
    Point3,
    Positive,
    Real,
    Seed,
    Table,
    refuse,
)
from sionna_radar.weather.fog import HIGHEST_FREQUENCY_HZ as FOG_HIGHEST_FREQUENCY_HZ
from sionna_radar.weather.fog import SOURCE as FOG_SOURCE
from sionna_radar.weather.fog import FogClass
from sionna_radar.weather.water import HIGHEST_TEMPERATURE_K, LOWEST_TEMPERATURE_K

SIONNA_CITIES = ("san_francisco", "munich", "florence", "etoile")
KEEP_SIONNA = "sionna"

# ----------------------------------------------------------------------------------------- terrain


class CoveredTerrain(Table):
    """Ground of one material, with others over it: classes of a raster, then polygons in the order given."""

    material: str = "ground"
    cover_raster: CoverRaster | None = None
    cover: tuple[CoverPolygon, ...] = ()


class FlatTerrain(CoveredTerrain):
    """A horizontal plane."""

    kind: Literal["flat"]
    size_m: tuple[Positive, Positive] = (300.0, 300.0)
    spacing_m: Positive = 5.0
    fields: tuple[MaterialField, ...] = ()


class HillsTerrain(CoveredTerrain):
    """A seeded Gaussian random surface: white noise, Gaussian filter, scaled to a largest height."""

    kind: Literal["hills"]
    size_m: tuple[Positive, Positive] = (320.0, 320.0)
    spacing_m: Positive = 0.5
    filter_sigma_m: Positive = 25.0
    height_m: Positive = 8.0
    seed: Seed = 1
    fields: tuple[MaterialField, ...] = ()


class SampleTerrain(CoveredTerrain):
    """The SRTM tile of Jacksboro, Tennessee, from matplotlib's sample data."""

    kind: Literal["jacksboro"]
    centre_lonlat_deg: Point2 | None = None
    spacing_m: Positive | None = None


class RasterTerrain(CoveredTerrain):
    """The user's own elevation raster: GeoTIFF, Esri ASCII grid, SRTM .hgt or anything GDAL reads."""

    kind: Literal["raster"]
    path: Path
    crs: str | None = None
    centre_lonlat_deg: Point2 | None = None
    spacing_m: Positive | None = None


class CityTerrain(Table):
    """A whole scene that Sionna ships; its materials are mapped to 77 GHz ones by name.

    A material mapped to "sionna" stays Sionna's own, where that is defined at the carrier and scatters.
    """

    kind: Annotated[str, Field(pattern=rf"^sionna:({'|'.join(SIONNA_CITIES)})$")]
    materials: dict[str, str] = {}

    @property
    def city(self) -> str:
        """Name of the Sionna scene."""
        return self.kind.removeprefix("sionna:")


TERRAIN_KINDS = ("flat", "hills", "jacksboro", "raster", *(f"sionna:{name}" for name in SIONNA_CITIES))


def _terrain_tag(value: Any) -> str | None:
    kind = value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)
    if not isinstance(kind, str):
        return None
    return "sionna" if kind.startswith("sionna:") else kind


Terrain = Annotated[
    Annotated[FlatTerrain, Tag("flat")]
    | Annotated[HillsTerrain, Tag("hills")]
    | Annotated[SampleTerrain, Tag("jacksboro")]
    | Annotated[RasterTerrain, Tag("raster")]
    | Annotated[CityTerrain, Tag("sionna")],
    Discriminator(
        _terrain_tag,
        custom_error_type="scenario",
        custom_error_message=f"unknown terrain kind; give one of {', '.join(TERRAIN_KINDS)}",
    ),
]


class Building(Table):
    """A box that stands on the lowest ground under it; heading 0 puts its length along north."""

    position_m: Point2
    size_m: tuple[Positive, Positive, Positive]
    heading_deg: Real = 0.0
    material: str = "building"


class PointTarget(Table):
    """A point of given mean radar cross-section, constant or by Swerling's cases, at a height above the ground."""

    position_m: Point2
    height_m: NonNegative = 0.0
    rcs_dbsm: Annotated[Real, Field(ge=-100, le=100)]
    swerling: Annotated[int, Field(strict=True, ge=0, le=4)] = 0


# ---------------------------------------------------------------------------------------- platform


Axes = Real | Point3
SpreadAxes = NonNegative | tuple[NonNegative, NonNegative, NonNegative]


class NavigationTable(Table):
    """Errors of the measured pose; one number for all three axes, or one for each.

    Position and velocity count east, north, up; attitude counts roll, pitch, heading. A part named markov is a
    first-order Gauss-Markov process with a correlation time. The lever arm leads from the navigation system to
    the antenna (nose, right, down) and is believed to be longer by its error; the mount of the antenna is
    believed to be turned by boresight_error_deg about the same axes.
    """

    position_constant_m: Axes = 0.0
    position_white_m: SpreadAxes = 0.0
    position_markov_m: SpreadAxes = 0.0
    position_correlation_s: Positive = 60.0
    velocity_constant_mps: Axes = 0.0
    velocity_white_mps: SpreadAxes = 0.0
    velocity_markov_mps: SpreadAxes = 0.0
    velocity_correlation_s: Positive = 10.0
    attitude_constant_deg: Axes = 0.0
    attitude_white_deg: SpreadAxes = 0.0
    attitude_markov_deg: SpreadAxes = 0.0
    attitude_correlation_s: Positive = 60.0
    time_offset_s: Real = 0.0
    lever_arm_m: Point3 = (0.0, 0.0, 0.0)
    lever_arm_error_m: Axes = 0.0
    boresight_error_deg: Axes = 0.0

    @property
    def has_errors(self) -> bool:
        """Whether the measured pose differs from the true one."""
        harmless = {"lever_arm_m"} | {name for name in type(self).model_fields if name.endswith("_correlation_s")}
        values = (getattr(self, name) for name in type(self).model_fields if name not in harmless)
        return any(np.any(np.asarray(value) != 0) for value in values)


class Platform(Table):
    """The flight: straight legs, level or following the terrain, with or without take-off and landing."""

    altitude_m: Positive
    speed_mps: Positive
    start_m: Point2 | None = None
    heading_deg: Real = 90.0
    length_m: Positive = 100.0
    waypoints_m: tuple[Point2, ...] = ()
    height: Literal["level", "terrain_following"] = "level"
    follow_length_m: Positive = 50.0
    profile: Literal["cruise", "full"] = "cruise"
    climb_rate_mps: Positive = 2.0
    descent_rate_mps: Positive = 2.0
    acceleration_mps2: Positive = 2.0
    takeoff_height_m: Positive = 5.0
    navigation: NavigationTable = NavigationTable()

    @model_validator(mode="after")
    def _one_track(self) -> Platform:
        fields = type(self).model_fields
        given = [k for k in ("start_m", "length_m", "heading_deg") if getattr(self, k) != fields[k].default]
        if self.waypoints_m and given:
            raise refuse("waypoints_m", f"contradicts {', '.join(given)}; give the one or the other")
        if len(self.waypoints_m) == 1:
            raise refuse("waypoints_m", "one point is no leg; give at least two")
        for a, b in zip(self.waypoints_m[:-1], self.waypoints_m[1:], strict=True):
            if a == b:
                raise refuse("waypoints_m", f"{a} follows itself; remove the repeated point")
        if self.profile == "full" and self.takeoff_height_m >= self.altitude_m:
            raise refuse(
                "takeoff_height_m",
                f"{self.takeoff_height_m:g} is not below altitude_m = {self.altitude_m:g}; lower it",
            )
        return self


# ------------------------------------------------------------------------------------------- radar


class AntennaTable(Table):
    """A planar array with a Taylor taper, sized from its half-power beamwidth in each plane."""

    beamwidth_deg: (
        Annotated[Real, Field(ge=0.2, le=60)]
        | tuple[Annotated[Real, Field(ge=0.2, le=60)], Annotated[Real, Field(ge=0.2, le=60)]]
    ) = 2.0
    side_lobe_db: Annotated[Real, Field(ge=-50, le=-15)] = -20.0
    polarization: Literal["V", "H"] = "V"
    receive_polarization: Literal["co", "cross"] = "co"

    @property
    def beamwidths_rad(self) -> tuple[float, float]:
        """Half-power beamwidth in azimuth and elevation."""
        widths = self.beamwidth_deg if isinstance(self.beamwidth_deg, tuple) else (self.beamwidth_deg,) * 2
        return float(np.deg2rad(widths[0])), float(np.deg2rad(widths[1]))


class ScanTable(Table):
    """How the antenna moves: across track, around the vertical, or not at all."""

    mode: Literal["whisk_broom", "conical", "fixed"] = "whisk_broom"
    incidence_deg: Annotated[Real, Field(ge=0, lt=90)] = 45.0
    half_swath_deg: Annotated[Real, Field(gt=0, le=180)] = 50.0
    rotation_rpm: Positive = 120.0
    start_deg: Real = 0.0
    stabilised: bool = Field(default=True, strict=True)

    @model_validator(mode="after")
    def _below_the_horizon(self) -> ScanTable:
        if self.mode == "whisk_broom" and self.half_swath_deg >= 90:
            raise refuse(
                "half_swath_deg",
                f"{self.half_swath_deg:g} lifts the beam to the horizon; a whisk-broom scan stays below 90",
            )
        return self


class RadarTable(Table):
    """A linear FMCW radar; noise from a signal-to-noise ratio, or from transmit power and noise figure."""

    carrier_hz: Annotated[Real, Field(ge=1e9, le=300e9)] = 77e9
    bandwidth_hz: Positive = 500e6
    chirp_rate_hz: Positive = 360.0
    samples_per_chirp: Annotated[int, Field(strict=True, ge=32, le=2**20)] = 1024
    sweep: Literal["up", "down", "triangular"] = "up"
    sampling: Literal["real", "iq"] = "real"
    snr_db: Annotated[Real, Field(ge=-100, le=200)] | None = None
    transmit_power_dbm: Annotated[Real, Field(ge=-60, le=60)] | None = None
    noise_figure_db: Annotated[Real, Field(ge=0, le=60)] | None = None
    temperature_k: Positive = 290.0
    antenna: AntennaTable = AntennaTable()
    scan: ScanTable = ScanTable()

    @model_validator(mode="after")
    def _consistent(self) -> RadarTable:
        if self.bandwidth_hz >= 0.5 * self.carrier_hz:
            raise refuse(
                "bandwidth_hz",
                f"{self.bandwidth_hz:g} is not small against carrier_hz = {self.carrier_hz:g}; lower it",
            )
        physical = [self.transmit_power_dbm, self.noise_figure_db]
        if self.snr_db is not None and any(value is not None for value in physical):
            raise refuse(
                "snr_db",
                "contradicts transmit_power_dbm and noise_figure_db; describe the noise one way only",
            )
        if self.snr_db is None and any(value is None for value in physical):
            raise refuse("snr_db", "missing; give snr_db, or both transmit_power_dbm and noise_figure_db")
        return self

    @property
    def max_range_m(self) -> float:
        """Range whose beat lies at the highest frequency the sampling can tell."""
        cells = self.samples_per_chirp / (2 if self.sampling == "real" else 1)
        return float(cells * speed_of_light / (2 * self.bandwidth_hz))


# ----------------------------------------------------------------------------------------- weather


class WeatherTable(Table):
    """The weather, the same everywhere; the default is clear air that takes nothing."""

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


# -------------------------------------------------------------------------- tracing and processing


class TracingTable(Table):
    """How the scene is turned into paths.

    engine: sionna (Sionna RT's fields inside the beam), gamma (the paper's facet model, independent of Sionna), or
        path_solver (Sionna's stock solver, slow, for checks).
    speckle: per_pulse draws new phases each pulse; persistent keeps scatterers on the surface, so that phase from
        chirp to chirp is that of a real scene.
    """

    engine: Literal["sionna", "gamma", "path_solver"] = "sionna"
    speckle: Literal["per_pulse", "persistent"] = "per_pulse"
    scatterers_per_m2: Annotated[Real, Field(gt=0, le=10_000)] = 20.0
    paths_per_pulse: Annotated[int, Field(strict=True, ge=16, le=10**7)] = 512
    side_lobe_share: Annotated[Real, Field(ge=0.01, le=0.5)] = 0.05

    @model_validator(mode="after")
    def _speckle_of_the_engine(self) -> TracingTable:
        if self.engine == "path_solver" and self.speckle == "persistent":
            raise refuse("speckle", "path_solver draws new paths each pulse; set engine = 'sionna' or 'gamma'")
        return self


class CfarTable(Table):
    """Constant false-alarm rate detection; guard and training count range cells on each side."""

    kind: Literal["CA", "GO", "SO", "OS"] = "SO"
    guard: Annotated[int, Field(strict=True, ge=0)] = 48
    training: Count = 32
    rank: Annotated[Real, Field(gt=0, le=1)] = 0.75
    false_alarm_probability: Annotated[Real, Field(ge=1e-12, le=0.1)] = 1e-6


class ProcessingTable(Table):
    """From beat signals to ranges."""

    window: str = "hann"
    zero_padding: Annotated[int, Field(strict=True, ge=1, le=16)] = 2
    cfar: CfarTable = CfarTable()
    echoes: Literal["first", "strongest", "all"] = "strongest"
    merge_gap_m: NonNegative = 3.0
    dynamic_range_db: Annotated[Real, Field(gt=0)] = 20.0
    ranging: Literal["peak", "centroid"] = "centroid"
    min_range_m: NonNegative = 3.0
    doppler_correction: bool = Field(default=True, strict=True)

    @field_validator("window")
    @classmethod
    def _known_window(cls, value: str) -> str:
        from scipy.signal import get_window

        try:
            get_window(value, 32)
        except ValueError as error:
            message = f"{value!r} is no window of scipy.signal.get_window; try 'hann' or 'blackman'"
            raise refuse("", message) from error
        return value


class LidarTable(Table):
    """An ideal range sensor on the radar's scan: the exact range along the beam axis, with white noise."""

    range_noise_m: NonNegative = 0.0


class DemTable(Table):
    """The grid of the elevation model."""

    spacing_m: Positive = 1.0
    max_gap_m: Positive | None = None
    shadow_incidence_deg: Annotated[Real, Field(gt=0, le=90)] = 85.0


# ---------------------------------------------------------------------------------------- scenario


class Scenario(Table):
    """A whole survey: what is flown, over what, with which radar, and how the echoes are processed."""

    description: str = ""
    seed: Seed = 1
    sensor: Literal["radar", "lidar"] = "radar"
    terrain: Terrain
    buildings: tuple[Building, ...] = ()
    targets: tuple[PointTarget, ...] = ()
    materials: dict[str, Material] = {}
    platform: Platform
    radar: RadarTable
    weather: WeatherTable = WeatherTable()
    lidar: LidarTable = LidarTable()
    tracing: TracingTable = TracingTable()
    processing: ProcessingTable = ProcessingTable()
    dem: DemTable = DemTable()

    @model_validator(mode="after")
    def _materials_exist(self) -> Scenario:
        known = self.all_materials
        for field, name in self._used_materials():
            if name not in known:
                raise refuse(field, f"{name!r} is not defined; add [materials.{name}] or use {sorted(known)}")
        return self

    @model_validator(mode="after")
    def _cfar_fits(self) -> Scenario:
        radar, cfar = self.radar, self.processing.cfar
        cells = radar.samples_per_chirp // (2 if radar.sampling == "real" else 1)
        if 2 * (cfar.guard + cfar.training) >= cells:
            raise refuse(
                "processing.cfar.guard",
                f"guard + training = {cfar.guard + cfar.training} cells on each side do not fit "
                f"{cells} range cells; lower them or raise radar.samples_per_chirp",
            )
        return self

    @model_validator(mode="after")
    def _fog_is_known(self) -> Scenario:
        if self.weather.water_in_air_g_per_m3 > 0 and self.radar.carrier_hz > FOG_HIGHEST_FREQUENCY_HZ:
            raise refuse(
                "weather.fog",
                f"{FOG_SOURCE} ends at {FOG_HIGHEST_FREQUENCY_HZ:g} Hz, below radar.carrier_hz = "
                f"{self.radar.carrier_hz:g}; remove the fog or lower the carrier",
            )
        return self

    @model_validator(mode="after")
    def _sweeps_pair(self) -> Scenario:
        if self.radar.sweep == "triangular" and self.processing.echoes == "all":
            raise refuse(
                "processing.echoes",
                "'all' leaves it open which echoes of an up- and a down-sweep belong together; "
                "give 'strongest' or 'first' with radar.sweep = 'triangular'",
            )
        return self

    def _used_materials(self) -> list[tuple[str, str]]:
        used = [(f"buildings.{i}.material", b.material) for i, b in enumerate(self.buildings)]
        if isinstance(self.terrain, CityTerrain):
            mapped = self.terrain.materials.items()
            used += [(f"terrain.materials.{key}", name) for key, name in mapped if name != KEEP_SIONNA]
        else:
            used += [("terrain.material", self.terrain.material)]
            used += [(f"terrain.cover.{i}.material", c.material) for i, c in enumerate(self.terrain.cover)]
            raster = self.terrain.cover_raster
            classes = raster.classes.items() if raster else ()
            used += [(f"terrain.cover_raster.classes.{key}", name) for key, name in classes]
        if isinstance(self.terrain, FlatTerrain | HillsTerrain):
            used += [(f"terrain.fields.{i}.material", f.material) for i, f in enumerate(self.terrain.fields)]
        return used

    @property
    def all_materials(self) -> dict[str, Material]:
        """The scenario's materials and the built-in ones they do not replace."""
        return {**DEFAULT_MATERIALS, **self.materials}
