"""The complete scenario, in user units (degrees, dB), and the consistency checks between its tables.

Each table's own module checks its values and its internal consistency. Checks that need the terrain
or the flight are made when the survey is prepared (`sionna_radar.survey.preparation`).
"""

from __future__ import annotations

import copy
import math
import unicodedata
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, ValidationError, model_validator

from sionna_radar.foundation.errors import UNNAMED, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.bases import CoveredTerrain, MaterialParameters
from sionna_radar.scenario.camera import CameraTable
from sionna_radar.scenario.choice import NameIn, ParametersOf
from sionna_radar.scenario.compatibility import exclusions
from sionna_radar.scenario.cover import VegetationTable
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.materials import DEFAULT_MATERIALS, Material
from sionna_radar.scenario.objects import Building, Footprints, MeshObject, PointTarget
from sionna_radar.scenario.overrides import apply_overrides, drop_conflicting_keys, resolve_paths
from sionna_radar.scenario.parts import SENSORS
from sionna_radar.scenario.platform import Platform
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.processing import DemTable, ProcessingTable
from sionna_radar.scenario.radar import AntennaTable, RadarTable, ScanTable, conflicts_of_angle, conflicts_of_array
from sionna_radar.scenario.receiver import Interferer
from sionna_radar.scenario.table import Conflicts, Seed, Table, refuse
from sionna_radar.scenario.terrain import (
    KEEP_SIONNA,
    CityTerrain,
    FlatTerrain,
    FractalTerrain,
    HillsTerrain,
    MeshTerrain,
    Terrain,
)
from sionna_radar.scenario.thin import FenceTable, PoleTable, WireTable
from sionna_radar.scenario.tracing import TracingTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.weather.fog import FOG_MAX_FREQUENCY_HZ, FOG_SOURCE

# Precipitation: its echo fills the beam and would be mistaken for roofs.
FALLING = ("rain_rate_mm_per_h", "rain_cell", "rain_field", "snowfall_mm_per_h")
# Largest line spacing, in footprints: a two-way main lobe is hardly wider than two half-power widths. Strips between
# more distant lines are not illuminated, and walls there are seen from at most one side.
FARTHEST_FOOTPRINTS = 2.0


def with_map(scenario: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of a scenario with defaults of `dem.method` and `processing.echoes`.

    Over buildings `dem.method` is "stepped", with all echoes of a pulse, if whole echoes are available and the lines of
    the scan are close enough; elsewhere "linear".
    """
    tables = dict(scenario)
    method = _value(tables, "dem", "method")
    if method in (None, "auto"):
        method = "stepped" if _built_up(tables) and _whole_echoes(tables) and _dense(tables) else "linear"
        tables = _with(tables, "dem", "method", method)
    if method in ("stepped", "canopy") and not _has(tables, "processing", "echoes"):
        tables = _with(tables, "processing", "echoes", "all")
    return tables


def _built_up(tables: Mapping[str, Any]) -> bool:
    kind = _value(tables, "terrain", "kind")
    return bool(tables.get("buildings") or tables.get("footprints")) or str(kind).startswith("sionna:")


def _whole_echoes(tables: Mapping[str, Any]) -> bool:
    sensor = tables.get("sensor", "radar")
    if sensor not in SENSORS or not SENSORS.entry(sensor).facts.provides_profiles:
        return False
    if _value(tables, "processing", "angle") not in (None, "off"):
        return False
    mode, chirps = (_value(tables, "processing", "average", key) for key in ("mode", "chirps"))
    if mode == "incoherent" and chirps not in (None, 1):
        return False
    return _value(tables, "radar", "sweep") != "triangular" and not any(_value(tables, "weather", k) for k in FALLING)


def _dense(tables: Mapping[str, Any]) -> bool:
    """Return True if the lines of a whisk-broom scan are at most two footprints apart; True if unknown.

    The footprint is the length along the track of the elevation beam on level ground in the middle of the scan.
    """
    scan = ScanTable.model_fields
    if (_value(tables, "radar", "scan", "mode") or scan["mode"].default) != "whisk_broom":
        return True
    if (_value(tables, "radar", "antenna", "kind") or "taylor") != "taylor":
        return True
    beam_deg = _value(tables, "radar", "antenna", "beamwidth_deg") or AntennaTable.model_fields["beamwidth_deg"].default
    numbers = (
        _value(tables, "platform", "speed_mps"),
        _value(tables, "platform", "altitude_m"),
        _value(tables, "radar", "scan", "rotation_rpm") or scan["rotation_rpm"].default,
        _value(tables, "radar", "scan", "incidence_deg") or scan["incidence_deg"].default,
        beam_deg[-1] if isinstance(beam_deg, (list, tuple)) and beam_deg else beam_deg,
    )
    if not all(isinstance(value, (int, float)) and 0 < value < math.inf for value in numbers):
        return True
    speed_mps, altitude_m, rotation_rpm, incidence_deg, elevation_deg = numbers
    footprint_m = math.radians(elevation_deg) * altitude_m / math.cos(math.radians(min(incidence_deg, 89.0))) ** 2
    return bool(speed_mps * 60 / rotation_rpm <= FARTHEST_FOOTPRINTS * footprint_m)


def _value(tables: Any, *keys: str) -> Any:
    """Return a value in nested tables, mappings or models; None for anything else."""
    for key in keys:
        tables = tables.get(key) if isinstance(tables, Mapping) else getattr(tables, key, None)
    return tables


def _has(tables: Mapping[str, Any], table: str, key: str) -> bool:
    entry = tables.get(table)
    return key in entry.model_fields_set if isinstance(entry, BaseModel) else _value(tables, table, key) is not None


def _with(tables: Mapping[str, Any], table: str, key: str, value: str) -> dict[str, Any]:
    """Return the tables with a value changed; an invalid table is left to validation."""
    entry = tables.get(table, {})
    if isinstance(entry, BaseModel):
        return {**tables, table: entry.model_copy(update={key: value})}
    return {**tables, table: {**entry, key: value}} if isinstance(entry, Mapping) else dict(tables)


# In wider beams the nearest point of a plane may lie inside the beam rather than at its edge.
WIDEST_FITTED_DEG = 30.0
NO_PLACE_ON_THE_MAP = (
    "needs terrain with a place on the map, which {!r} does not have; set terrain.centre_lonlat_deg, or coordinates = "
    "'local' with positions in metres"
)
# Longer than any WKT of a CRS.
LONGEST_CRS = 100_000


def _literal(text: str) -> str:
    control = next((c for c in text if unicodedata.category(c) == "Cc" and c not in "\n\t"), None)
    if control is not None:
        raise refuse("", f"holds the control character {control!r}, which a terminal would obey; remove it")
    return text


def _known_version(version: Any) -> Any:
    if isinstance(version, int) and not isinstance(version, bool) and version > 1:
        raise refuse("", f"{version} is newer than this program, which reads version 1; update sionna-radar")
    return version


class Scenario(Table):
    """A whole survey: scene, flight, radar, processing of the echoes, and DEM.

    Raises
    ------
    ScenarioError
        With every problem, for values that do not fit.

    Examples
    --------
    >>> from sionna_radar.scenario import FlatTerrain, Platform, RadarTable
    >>> scenario = Scenario(
    ...     terrain=FlatTerrain(size_m=(200.0, 200.0)),
    ...     platform=Platform(altitude_m=30.0, speed_mps=5.0, length_m=20.0),
    ...     radar=RadarTable(snr_db=30.0),
    ... )
    >>> scenario.radar.carrier_hz
    77000000000.0
    """

    version: Annotated[Literal[1], BeforeValidator(_known_version)] = 1
    """Version of the file format; a program that does not know it rejects the file."""
    description: Annotated[str, AfterValidator(_literal)] = ""
    """Description in one line; it heads tables and figures."""
    seed: Seed = 1
    """Seed of all random streams."""
    coordinates: Annotated[str, Field(min_length=1, max_length=LONGEST_CRS)] = "local"
    """Coordinates of the horizontal positions of platform, cover polygons, buildings, objects, targets, wires, poles,
    fences and vegetation: "local" for metres east and north of the local origin; "lonlat" for WGS 84 longitude and
    latitude in degrees; or a CRS such as "EPSG:32632", easting (or longitude) first. All but "local" need terrain with
    a place on the map. Headings count from the grid north of the map."""
    sensor: Annotated[str, NameIn(SENSORS)] = "radar"
    """Sensor on the platform: a radar, a lidar, a camera (`sionna-radar camera`), or a custom sensor."""
    sensor_parameters: Annotated[Table | None, ParametersOf("sensor", SENSORS)] = None
    """Parameters of a custom sensor."""
    terrain: Terrain
    """Ground surface."""
    buildings: tuple[Building, ...] = ()
    """Box-shaped buildings on the ground."""
    objects: tuple[MeshObject, ...] = ()
    """Meshes in the scene."""
    footprints: tuple[Footprints, ...] = ()
    """Buildings from a file of outlines."""
    targets: tuple[PointTarget, ...] = ()
    """Targets of given radar cross-section."""
    wires: tuple[WireTable, ...] = ()
    """Wires and power lines."""
    poles: tuple[PoleTable, ...] = ()
    """Poles, lattice masts and branches."""
    fences: tuple[FenceTable, ...] = ()
    """Fences of posts and wires."""
    interferers: tuple[Interferer, ...] = ()
    """Other radars that transmit into ours."""
    vegetation: tuple[VegetationTable, ...] = ()
    """Stands of plants."""
    materials: dict[str, Material] = {}
    """Materials by name, as surfaces refer to them."""
    platform: Platform
    """Flight of the platform."""
    radar: RadarTable
    """Radar."""
    weather: WeatherTable = WeatherTable()
    """Weather along the wave's path."""
    lidar: LidarTable = LidarTable()
    """Lidar."""
    camera: CameraTable = CameraTable()
    """Camera."""
    # Their parameters are checked by the parts themselves, whose modules import this package.
    tracing: TracingTable = Field(default_factory=TracingTable)
    """Tracing of the scene into paths."""
    processing: ProcessingTable = Field(default_factory=ProcessingTable)
    """Processing of beat signals to ranges."""
    dem: DemTable = Field(default_factory=DemTable)
    """Mapping of echoes to heights."""

    @cached_property
    def source(self) -> str:
        """Its file or shipped name, which begins its errors; "scenario" without one."""
        return UNNAMED

    @property
    def measured_ground(self) -> bool:
        """Whether the terrain comes from a file, as ground with relief finer than any footprint."""
        return self.terrain.kind in ("raster", "points", "mesh")

    def read_from(self, source: str) -> Scenario:
        """Return the scenario with the name of its file, which is ignored in comparisons."""
        copied = self.model_copy()
        copied.__dict__["source"] = source  # as `cached_property` keeps it: no field, so neither compared nor written
        return copied

    def replace(self, changes: Mapping[str, Any]) -> Scenario:
        """Return a copy with values of dotted keys replaced, validated anew.

        changes: values by dotted key, as `load_scenario` takes them: None takes a key out, a table replaces the whole
        table, and what they contradict in this scenario gives way. Relative paths count from the working folder.

        Raises ScenarioError, with every problem, for values that do not fit.

        Examples
        --------
        >>> from sionna_radar import load_scenario
        >>> wide = load_scenario("hills").replace({"radar.antenna.beamwidth_deg": 4.0})
        >>> wide.radar.antenna.beamwidth_deg
        4.0
        """
        # A copy: the caller's tables must not change.
        changes, data = copy.deepcopy(dict(changes)), self.model_dump(mode="json", exclude_none=True)
        apply_overrides(data, changes)
        drop_conflicting_keys(data, changes)
        resolve_paths(data, Path())
        try:
            return Scenario.model_validate(data).read_from(self.source)
        except ValidationError as error:
            raise ScenarioError(translate(error.errors(), Scenario), self.source) from error

    @model_validator(mode="before")
    @classmethod
    def _map_is_chosen(cls, tables: Any) -> Any:
        return with_map(tables) if isinstance(tables, dict) else tables

    def _conflicts(self) -> Conflicts:
        defined = self.all_materials
        for field, name in self._used_materials():
            if name not in defined:
                suggestion = nearest(name, sorted(defined))
                message = f"{shown(name)} is not defined; add [materials.{shown(name)[1:-1]}] or use one of "
                yield field, f"{message}{', '.join(sorted(defined))}.{suggestion}"
        nowhere = isinstance(self.terrain, FlatTerrain | HillsTerrain | FractalTerrain | CityTerrain)
        nowhere = nowhere or (isinstance(self.terrain, MeshTerrain) and self.terrain.crs is None)
        if self.coordinates != "local" and nowhere and self.terrain.centre_lonlat_deg is None:
            yield "coordinates", f"{shown(self.coordinates)} {NO_PLACE_ON_THE_MAP.format(self.terrain.kind)}"
        if self.interferers and self.radar.transmit_power_dbm is None:
            yield (
                "interferers",
                "their powers are absolute, and radar.snr_db gives no absolute power; give radar.transmit_power_dbm "
                "and radar.noise_figure_db instead",
            )
        start, stop = self.radar.used_samples
        cells = (stop - start) // (2 if self.radar.sampling == "real" else 1)
        if misfit := self.processing.cfar.misfit(cells):
            yield "processing.cfar.guard", f"{misfit}; lower them or raise radar.samples_per_chirp"
        yield from self._conflicts_of_weather()
        yield from self._conflicts_of_echoes()

    def _conflicts_of_weather(self) -> Conflicts:
        weather, carrier_hz = self.weather, self.radar.carrier_hz
        if weather.water_in_air_g_per_m3 > 0 and carrier_hz > FOG_MAX_FREQUENCY_HZ:
            yield (
                "weather.fog",
                f"{FOG_SOURCE} ends at {FOG_MAX_FREQUENCY_HZ:g} Hz, below radar.carrier_hz = "
                f"{carrier_hz:g}; remove the fog or lower the carrier",
            )
        obscurants = [key for key in ("haze", "dust", "smoke") if getattr(weather, f"{key}_visibility_m") is not None]
        keys = ["snowfall_mm_per_h"] * (weather.snowfall_mm_per_h > 0) + [f"{key}_visibility_m" for key in obscurants]
        if not keys:
            return
        # Models of scattering load SciPy, which takes as long as all tables of a scenario.
        from sionna_radar.weather.snow import HIGHEST_FREQUENCY_HZ, LOWEST_FREQUENCY_HZ

        if not LOWEST_FREQUENCY_HZ <= carrier_hz <= HIGHEST_FREQUENCY_HZ:
            yield (
                f"weather.{keys[0]}",
                f"is modelled from {LOWEST_FREQUENCY_HZ:g} to {HIGHEST_FREQUENCY_HZ:g} Hz, and "
                f"radar.carrier_hz = {carrier_hz:g}; remove it or change the carrier",
            )

    def _conflicts_of_echoes(self) -> Conflicts:
        radar, processing, antenna = self.radar, self.processing, self.radar.antenna
        uneven = [k for k in ("rain_cell", "rain_field") if getattr(self.weather, k) is not None]
        if uneven and self.sensor == "lidar" and self.lidar.wavelength_nm is not None:
            yield (
                f"weather.{uneven[0]}",
                ("rain that varies from place to place is not modelled for a lidar; remove it, or lidar.wavelength_nm"),
            )
        yield from exclusions(self)
        yield from conflicts_of_array(radar, self.sensor)
        yield from conflicts_of_angle(processing.angle, radar)
        width_deg = float(np.rad2deg(antenna.beamwidths_rad[1])) if isinstance(antenna, AntennaTable) else 0.0
        if processing.ranging == "model_fit" and width_deg > WIDEST_FITTED_DEG:
            yield (
                "processing.ranging",
                f"'model_fit' takes ranges to grow along the beam, as they do over at most {WIDEST_FITTED_DEG:g} deg; "
                f"radar.antenna.beamwidth_deg is {width_deg:g} in elevation; set 'centroid' or narrow it",
            )

    def _used_materials(self) -> list[tuple[str, str]]:
        references = [(f"buildings.{i}.material", b.material) for i, b in enumerate(self.buildings)]
        references += [(f"lidar.reflectivities.{name}", name) for name in self.lidar.reflectivities]
        references += [(f"camera.albedos.{name}", name) for name in self.camera.albedos]
        placed: list[tuple[str, MeshObject | Footprints]] = [(f"objects.{i}", o) for i, o in enumerate(self.objects)]
        placed += [(f"footprints.{i}", file) for i, file in enumerate(self.footprints)]
        for place, item in placed:
            references.append((f"{place}.material", item.material))
            references += [(f"{place}.materials.{key}", name) for key, name in item.materials.items()]
        if isinstance(self.terrain, MeshTerrain):
            references += [(f"terrain.materials.{key}", name) for key, name in self.terrain.materials.items()]
        if isinstance(self.terrain, CityTerrain):
            mapped = self.terrain.materials.items()
            references += [(f"terrain.materials.{key}", name) for key, name in mapped if name != KEEP_SIONNA]
        if isinstance(self.terrain, CoveredTerrain):
            references += [("terrain.material", self.terrain.material)]
            references += [(f"terrain.cover.{i}.material", c.material) for i, c in enumerate(self.terrain.cover)]
            covers = {"cover_raster": self.terrain.cover_raster, "cover_vector": self.terrain.cover_vector}
            for table, file in covers.items():
                classes = file.classes.items() if file else ()
                references += [(f"terrain.{table}.classes.{key}", name) for key, name in classes]
        if isinstance(self.terrain, FlatTerrain | HillsTerrain | FractalTerrain):
            references += [(f"terrain.fields.{i}.material", f.material) for i, f in enumerate(self.terrain.fields)]
        return references

    @property
    def all_materials(self) -> dict[str, MaterialParameters]:
        """The scenario's materials and the built-in ones not replaced by them."""
        return {**DEFAULT_MATERIALS, **self.materials}
