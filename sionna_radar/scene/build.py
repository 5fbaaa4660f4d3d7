"""Building the scene of a scenario: terrain or city, buildings, targets, materials."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.kept_values import KeptValues, Same
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.parts import MATERIALS
from sionna_radar.scenario.registry import PACKAGE
from sionna_radar.scene.canopy_heights import plant_heights
from sionna_radar.scene.ground import build_ground, shared_ground
from sionna_radar.scene.landscape import Heights, Landscape, TerrainInputs
from sionna_radar.scene.model import Scene, Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.targets import target_of
from sionna_radar.scene.vegetation import vegetation_of
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.build import build_materials, channel_of, check_backscatter, motions_of

# Progress steps reported by `build_scene`.
BUILDING_STEPS = 3


@dataclass(frozen=True, kw_only=True)
class BuiltScene:
    """A scene and its derived quantities for a survey.

    ground_m: height of the bare ground at horizontal positions, voids filled; NaN beyond the terrain.
    caster: rays against all surfaces.
    may_overhang: whether there may be air under some of them.
    posting_m: posting of the terrain's file; see `Landscape`.
    """

    scene: Scene
    ground_m: Heights
    caster: RayCaster
    may_overhang: bool = False
    posting_m: float | None = None


def build_scene(
    scenario: Scenario,
    window_m: tuple[float, float, float, float],
    terrain: Callable[[TerrainInputs], Landscape] | Raster | None = None,
    materials: Mapping[str, Backscatter] | None = None,
) -> BuiltScene:
    """Build the scene of a scenario, or reuse parts of the last survey's scene; see `shared_ground`.

    Parameters
    ----------
    scenario:
        The scenario.
    window_m:
        Extent visible to the survey (west, south, east, north); files are read only within it.
    terrain, materials:
        A custom terrain and custom materials instead of the scenario's.

    Raises
    ------
    ScenarioError, InputFileError
        A building or target is beyond the terrain; a material is undefined at the carrier; an input file
        cannot be used.

    """
    radar = scenario.radar
    inputs = TerrainInputs(window_m=window_m, carrier_hz=radar.carrier_hz, channel=channel_of(radar))
    scene_materials = _materials(scenario, materials or {})
    share = terrain is None and not materials
    ground = shared_ground(scenario, inputs) if share else build_ground(scenario, inputs, terrain)
    land = ground.land
    _check_materials(land, scene_materials)
    advance()
    motions = motions_of(scenario.all_materials)
    # Includes the identity of the tables' files: a rewritten mesh is another target.
    contents_key = content_key({"targets": scenario.targets, "vegetation": scenario.vegetation})

    def build() -> Scene:
        return Scene(
            surfaces=ground.surfaces,
            materials=scene_materials | land.materials,
            targets=_targets(scenario, land),
            ground_material=land.ground_material,
            georeference=land.georeference,
            vegetation=vegetation_of(
                scenario.vegetation, land.ground_m, window_m, partial(plant_heights, land.georeference, land.ground_m)
            ),
            motions=motions,
        )

    if contents_key is None:
        scene = build()
    else:
        key = (contents_key, repr((window_m if scenario.vegetation else (), motions)), Same(scene_materials))
        scene = ground.caster.once("scene", key, build)
    advance()
    advance()
    return BuiltScene(
        scene=scene,
        ground_m=land.ground_m,
        caster=ground.caster,
        may_overhang=land.may_overhang or bool(scenario.objects),
        posting_m=land.posting_m,
    )


def _materials(scenario: Scenario, custom: Mapping[str, Backscatter]) -> dict[str, Backscatter]:
    """Return the materials of a scenario and custom ones; those of the last scenario are cached."""
    for name, model in custom.items():
        if name not in scenario.all_materials:
            message = (
                f"no material of the scenario has this name; give one of {', '.join(sorted(scenario.all_materials))}"
            )
            raise ScenarioError([Problem(f"materials.{name}", message)])
        check_backscatter(model, f"materials.{name}")
    tables = {name: table for name, table in scenario.all_materials.items() if name not in custom}
    radar = scenario.radar
    key = None
    if not custom and all(MATERIALS.entry(table.model).origin == PACKAGE for table in tables.values()):
        key = content_key({"materials": tables, "carrier": radar.carrier_hz, "channel": channel_of(radar)})
    if key is None:
        return {**build_materials(tables, radar), **custom}
    return _MATERIALS.once(key, lambda: {**build_materials(tables, radar)})


_MATERIALS = KeptValues(1)


def _check_materials(land: Landscape, defined: Mapping[str, Backscatter]) -> None:
    used = {land.ground_material, *(surface.material for surface in land.surfaces)}
    missing = sorted(used - set(defined) - set(land.materials))
    if missing:
        message = f"its material {missing[0]!r} is not defined; add [materials.{missing[0]}]"
        raise ScenarioError([Problem("terrain", message)])


def _targets(scenario: Scenario, land: Landscape) -> tuple[Target, ...]:
    if not scenario.targets:
        return ()
    wavelength_m = speed_of_light / scenario.radar.carrier_hz
    height = land.standing_m(np.array([target.position_m for target in scenario.targets]))
    return tuple(
        target_of(table, f"targets.{index}", float(height[index]), land.standing_m, wavelength_m)
        for index, table in enumerate(scenario.targets)
    )
