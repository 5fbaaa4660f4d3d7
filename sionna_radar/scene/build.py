"""Building the scene of a scenario: terrain or city, buildings, targets, materials."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from sionna_radar.elevation.map_frame import frame_of
from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.registry import require
from sionna_radar.scene.buildings import build_box
from sionna_radar.scene.footprints import build_footprints
from sionna_radar.scene.landscape import Heights, Landscape, TerrainInputs, build_landscape
from sionna_radar.scene.model import Scene, Surface, Target
from sionna_radar.scene.objects import build_objects
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.material import build_materials, channel_of, check_backscatter

# After each of them `build_scene` reports.
BUILDING_STEPS = 3


@dataclass(frozen=True, kw_only=True)
class BuiltScene:
    """A scene with what the survey needs from it.

    ground_m: height of the bare ground at horizontal positions, voids filled; NaN beyond the terrain.
    caster: rays against all surfaces.
    may_overhang: there may be air under some of them.
    """

    scene: Scene
    ground_m: Heights
    caster: RayCaster
    may_overhang: bool = False


def build_scene(
    scenario: Scenario,
    window_m: tuple[float, float, float, float],
    terrain: Callable[[TerrainInputs], Landscape] | None = None,
    materials: Mapping[str, Backscatter] | None = None,
    step: Step = no_step,
) -> BuiltScene:
    """Build the scene of a scenario.

    Parameters
    ----------
    scenario:
        The scenario.
    window_m:
        Extent that the survey can see (west, south, east, north); no more of a file is read.
    terrain, materials:
        A custom terrain and custom materials instead of the scenario's.
    step:
        Called after each of `BUILDING_STEPS`: the ground, what stands on it, and the search for what rays hit.

    Raises
    ------
    ScenarioError, InputFileError
        A building or target is beyond the terrain; a material is undefined at the carrier; an input file
        cannot be used.

    """
    radar = scenario.radar
    given = TerrainInputs(window_m=window_m, carrier_hz=radar.carrier_hz, channel=channel_of(radar))
    custom = dict(materials or {})
    for name, model in custom.items():
        if name not in scenario.all_materials:
            message = (
                f"no material of the scenario has this name; give one of {', '.join(sorted(scenario.all_materials))}"
            )
            raise ScenarioError([Problem(f"materials.{name}", message)])
        check_backscatter(model, f"materials.{name}")
    tables = {name: table for name, table in scenario.all_materials.items() if name not in custom}
    known: dict[str, Backscatter] = {**build_materials(tables, radar), **custom}
    land = terrain(given) if terrain else build_landscape(scenario.terrain, given)
    _check_landscape(land, known)
    step()
    boxes = tuple(build_box(b, i, land.ground_m) for i, b in enumerate(scenario.buildings))
    scene = Scene(
        surfaces=land.surfaces + _objects(scenario, land) + _footprints(scenario, land, window_m) + boxes,
        materials=known | land.materials,
        targets=_targets(scenario, land),
        ground_material=land.ground_material,
        georeference=land.georeference,
    )
    step()
    caster = RayCaster(scene.surfaces)
    step()
    return BuiltScene(
        scene=scene,
        ground_m=land.ground_m,
        caster=caster,
        may_overhang=land.may_overhang or bool(scenario.objects),
    )


def _check_landscape(land: Landscape, known: Mapping[str, Backscatter]) -> None:
    require(land, Landscape, "terrain")
    if not land.surfaces or not all(len(s.faces) and np.all(np.isfinite(s.vertices_m)) for s in land.surfaces):
        message = "it has no surface, or a vertex that is not a place; check the heights it is made from"
        raise ScenarioError([Problem("terrain", message)])
    used = {land.ground_material, *(surface.material for surface in land.surfaces)}
    missing = sorted(used - set(known) - set(land.materials))
    if missing:
        message = f"its material {missing[0]!r} is not defined; add [materials.{missing[0]}]"
        raise ScenarioError([Problem("terrain", message)])


def _objects(scenario: Scenario, land: Landscape) -> tuple[Surface, ...]:
    datum_m = land.georeference.origin_m[2] if land.georeference else 0.0
    return build_objects(scenario.objects, land.ground_m, datum_m)


def _footprints(
    scenario: Scenario, land: Landscape, window_m: tuple[float, float, float, float]
) -> tuple[Surface, ...]:
    if not scenario.footprints:
        return ()
    frame = frame_of(land.georeference)
    built = [build_footprints(f, i, frame, window_m, land.ground_m) for i, f in enumerate(scenario.footprints)]
    return tuple(surface for surface in built if surface is not None)


def _targets(scenario: Scenario, land: Landscape) -> tuple[Target, ...]:
    if not scenario.targets:
        return ()
    height = land.standing_m(np.array([target.position_m for target in scenario.targets]))
    targets = []
    for index, target in enumerate(scenario.targets):
        ground = float(height[index])
        if not np.isfinite(ground):
            message = f"{target.position_m} is beyond the terrain; move it or enlarge the terrain"
            raise ScenarioError([Problem(f"targets.{index}.position_m", message)])
        position = (*target.position_m, ground + target.height_m)
        targets.append(Target(position_m=position, rcs_m2=from_db(target.rcs_dbsm), swerling=target.swerling))
    return tuple(targets)
