"""Transformation of a scenario's map positions into the local frame of its terrain."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from pyproj import CRS
from pyproj.exceptions import ProjError

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import horizontal_crs
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import CoveredTerrain
from sionna_radar.scenario.scenario import NO_PLACE_ON_THE_MAP
from sionna_radar.scenario.table import Point2, Table
from sionna_radar.scene.terrains.build import map_frame

AnyTable = TypeVar("AnyTable", bound=Table)
# Arrays of tables with places in one of their keys: a point, with or without a height, or a sequence of points.
PLACED = (
    ("vegetation", "polygon_m"),
    ("targets", "waypoints_m"),
    ("wires", "points_m"),
    ("fences", "points_m"),
    *((name, "position_m") for name in ("buildings", "objects", "targets", "interferers", "poles")),
)


def in_local_frame(scenario: Scenario) -> Scenario:
    """Return a scenario with all of its positions in local metres.

    Raises ScenarioError, InputFileError if there is no such CRS, a position is not valid in it, or the terrain cannot
        be read.
    """
    if scenario.coordinates == "local":
        return scenario
    frame = map_frame(scenario.terrain)
    if frame is None:
        message = f"{shown(scenario.coordinates)} {NO_PLACE_ON_THE_MAP.format(scenario.terrain.kind)}"
        raise ScenarioError.of("coordinates", message)
    moving = _Moving(_crs(scenario.coordinates), frame)
    platform, terrain = scenario.platform, scenario.terrain
    waypoints = [moving(f"platform.waypoints_m.{i}", point) for i, point in enumerate(platform.waypoints_m)]
    platform = platform.model_copy(update={"waypoints_m": tuple(waypoints)})
    platform = moving.table("platform", platform, "start_m")
    if platform.lines is not None:
        lines = moving.table("platform.lines", platform.lines, "centre_m")
        platform = platform.model_copy(update={"lines": lines})
    if isinstance(terrain, CoveredTerrain):
        cover = moving.tables("terrain.cover", terrain.cover, "polygon_m")
        terrain = terrain.model_copy(update={"cover": cover})
    for name, key in PLACED:
        tables = moving.tables(name, getattr(scenario, name), key)
        scenario = scenario.model_copy(update={name: tables})
    if moving.problems:
        raise ScenarioError(moving.problems)
    return scenario.model_copy(update={"coordinates": "local", "platform": platform, "terrain": terrain})


def _crs(name: str) -> CRS:
    try:
        crs = horizontal_crs(CRS.from_user_input(4326 if name == "lonlat" else name))
    except ProjError as error:
        message = f"{shown(name)} is not a coordinate reference system; give 'local', 'lonlat' or one like 'EPSG:32632'"
        raise ScenarioError.of("coordinates", message) from error
    if not (crs.is_projected or crs.is_geographic):
        message = f"{crs.name!r} is neither projected nor geographic; give one that is, such as 'EPSG:32632'"
        raise ScenarioError.of("coordinates", message)
    return crs


class _Moving:
    """Transforms map positions into the local frame, and collects those that cannot be transformed."""

    def __init__(self, crs: CRS, frame: MapFrame) -> None:
        self._crs, self._frame = crs, frame
        self.problems: list[Problem] = []

    def __call__(self, key: str, position: Point2) -> Point2:
        try:
            x, y = self._frame.local_of(self._crs, *(np.array([c]) for c in position))
        except ProjError as error:
            message = f"{self._crs.name!r} cannot be transformed to the terrain's {self._frame.crs.name!r} ({error})"
            raise ScenarioError.of("coordinates", f"{message}; give another") from error
        if not (np.isfinite(x[0]) and np.isfinite(y[0])):
            order = "longitude and latitude" if self._crs.is_geographic else "easting and northing"
            message = f"{position} is not valid in {self._crs.name!r}; give {order}, in this order"
            self.problems.append(Problem(key, message))
        return float(x[0]), float(y[0])

    def table(self, name: str, table: AnyTable, key: str) -> AnyTable:
        """Return a table with the places of a key in the local frame, if it has any; heights stay as they are."""
        places = getattr(table, key)
        if not places:
            return table
        moved = (
            self._with_height(f"{name}.{key}", places)
            if isinstance(places[0], float)
            else tuple(self._with_height(f"{name}.{key}", place) for place in places)
        )
        return table.model_copy(update={key: moved})

    def tables(self, name: str, tables: Sequence[AnyTable], key: str) -> tuple[AnyTable, ...]:
        """Return an array of tables, each as `table` returns it."""
        return tuple(self.table(f"{name}.{i}", table, key) for i, table in enumerate(tables))

    def _with_height(self, name: str, place: tuple[float, ...]) -> tuple[float, ...]:
        return (*self(name, (place[0], place[1])), *place[2:])
