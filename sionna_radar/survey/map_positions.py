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
    platform = scenario.platform

    def outlines(name: str, tables: Sequence[AnyTable], key: str) -> tuple[AnyTable, ...]:
        """Return entries of the scenario's array `name` with the places of their `key` moved, where they have any."""
        return tuple(
            table.model_copy(update={key: tuple(moving(f"{name}.{i}.{key}", p) for p in getattr(table, key))})
            if getattr(table, key)
            else table
            for i, table in enumerate(tables)
        )

    waypoints = [moving(f"platform.waypoints_m.{i}", point) for i, point in enumerate(platform.waypoints_m)]
    start = platform.start_m and moving("platform.start_m", platform.start_m)
    lines = platform.lines
    if lines is not None and lines.centre_m is not None:
        lines = lines.model_copy(update={"centre_m": moving("platform.lines.centre_m", lines.centre_m)})
    terrain = scenario.terrain
    if isinstance(terrain, CoveredTerrain):
        terrain = terrain.model_copy(update={"cover": outlines("terrain.cover", terrain.cover, "polygon_m")})
    vegetation = outlines("vegetation", scenario.vegetation, "polygon_m")
    scenario = scenario.model_copy(update={"targets": outlines("targets", scenario.targets, "waypoints_m")})
    wires = tuple(
        wire.model_copy(
            update={
                "points_m": tuple((*moving(f"wires.{i}.points_m", p[:2]), p[2]) for p in wire.points_m),
            }
        )
        for i, wire in enumerate(scenario.wires)
    )
    fences = outlines("fences", scenario.fences, "points_m")
    objects = {
        name: tuple(
            entry.model_copy(
                update={"position_m": moving(f"{name}.{i}.position_m", entry.position_m[:2]) + entry.position_m[2:]}
            )
            for i, entry in enumerate(getattr(scenario, name))
        )
        for name in ("buildings", "objects", "targets", "interferers", "poles")
    }
    if moving.problems:
        raise ScenarioError(moving.problems)
    return scenario.model_copy(
        update={
            "coordinates": "local",
            "platform": platform.model_copy(update={"start_m": start, "waypoints_m": tuple(waypoints), "lines": lines}),
            "terrain": terrain,
            "vegetation": vegetation,
            "wires": wires,
            "fences": fences,
            **objects,
        }
    )


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
