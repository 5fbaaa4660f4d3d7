"""The ground of a survey and the objects on it, cached for the next survey of the same scene."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.kept_values import KeptValues
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.parts import TERRAINS
from sionna_radar.scenario.registry import PACKAGE, require
from sionna_radar.scene.footprints import build_box, build_footprints
from sionna_radar.scene.landscape import (
    Landscape,
    TerrainInputs,
    build_landscape,
    landscape_of_raster,
)
from sionna_radar.scene.model import Surface
from sionna_radar.scene.objects import build_objects
from sionna_radar.scene.raycast import RayCaster

Window = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A landscape with the objects on it, and rays against its surfaces; immutable."""

    land: Landscape
    surfaces: tuple[Surface, ...]
    caster: RayCaster


def build_ground(
    scenario: Scenario,
    given: TerrainInputs,
    terrain: Callable[[TerrainInputs], Landscape] | Raster | None = None,
    *,
    shared: bool = False,
) -> Ground:
    """Return the ground of a scenario, or a custom one, with the objects on it.

    Raises
    ------
    ScenarioError, InputFileError
        It has no surface; a building is beyond it; an input file cannot be used.

    """
    if isinstance(terrain, Raster):
        land = landscape_of_raster(terrain, scenario.terrain, given)
    else:
        land = terrain(given) if terrain else build_landscape(scenario.terrain, given)
    require(land, Landscape, "terrain")
    if not land.surfaces or not all(len(s.faces) and np.all(np.isfinite(s.vertices_m)) for s in land.surfaces):
        message = "it has no surface, or a vertex that is not a place; check the heights it is made from"
        raise ScenarioError([Problem("terrain", message)])
    boxes = tuple(build_box(b, i, land.ground_m) for i, b in enumerate(scenario.buildings))
    surfaces = land.surfaces + _objects(scenario, land) + _footprints(scenario, land, given) + boxes
    return Ground(land=land, surfaces=surfaces, caster=RayCaster(surfaces, shared=shared))


_LAST = KeptValues(1)


def shared_ground(scenario: Scenario, given: TerrainInputs) -> Ground:
    """Return the ground of a scenario, the same object for consecutive surveys with equal inputs.

    Its key is the content of all its inputs, including the identity of files and, if it depends on them, the survey's
    window, carrier and channel. Only the last one is cached; custom registered terrains, with unknown dependencies,
    are not.
    """
    kind = scenario.terrain.kind
    if TERRAINS.entry(kind).origin != PACKAGE:
        return build_ground(scenario, given)
    # Footprints are read within the window.
    fields = set(TERRAINS.entry(kind).facts.uses) | ({"window_m"} if scenario.footprints else set())
    key = content_key(
        {name: getattr(scenario, name) for name in ("terrain", "buildings", "objects", "footprints")}
        | {name: getattr(given, name) for name in sorted(fields)}
    )
    if key is None:
        return build_ground(scenario, given)
    return _LAST.once(key, lambda: build_ground(scenario, given, shared=True))


def _objects(scenario: Scenario, land: Landscape) -> tuple[Surface, ...]:
    datum_m = land.georeference.origin_m[2] if land.georeference else 0.0
    return build_objects(scenario.objects, land.ground_m, datum_m)


def _footprints(scenario: Scenario, land: Landscape, inputs: TerrainInputs) -> tuple[Surface, ...]:
    if not scenario.footprints:
        return ()
    frame = frame_of(land.georeference)
    built = [build_footprints(f, i, frame, inputs.window_m, land.ground_m) for i, f in enumerate(scenario.footprints)]
    return tuple(surface for surfaces in built for surface in surfaces)
