"""Builder of the scene of a scenario: terrain, buildings, meshes, targets, vegetation and materials."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light

from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.foundation.build_cache import BuildCache
from sionna_radar.foundation.decibels import from_db, to_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Heights, Raster
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.cover import VegetationTable
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.objects import Building, PointTarget, RotorTable, TargetMesh
from sionna_radar.scenario.parts import MATERIALS, TERRAINS
from sionna_radar.scenario.registry import PACKAGE, require
from sionna_radar.scene.canopy_heights import plant_heights
from sionna_radar.scene.crops import Planting
from sionna_radar.scene.footprints import Box, OutlineFile, build_box, build_footprints
from sionna_radar.scene.landscape import Landscape, TerrainInputs
from sionna_radar.scene.model import Body, Scene, Surface, Target
from sionna_radar.scene.motion import Rotor
from sionna_radar.scene.objects import StandingMesh, body_of, build_objects, read_rcs, way_over
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.terrains.build import build_landscape, landscape_of_raster, mesh_source
from sionna_radar.scene.thin.build import build_thin
from sionna_radar.scene.vegetation import NEPERS, Stand, vegetation_of
from sionna_radar.scene.wires import ThinObstacle
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.build import build_materials, channel_of, check_backscatter, motions_of
from sionna_radar.surfaces.foliage import Foliage
from sionna_radar.surfaces.radar_material import as_radar_material

# Progress steps reported by `build_world`.
BUILDING_STEPS = 3
# Vertical rays start this far above the highest surface.
CLEAR_M = 10.0
# What stands on the ground is no taller, m: its units were misread.
TALLEST_M = 10_000.0


@dataclass(frozen=True, kw_only=True)
class World:
    """What there is to see: a scene, the ground under it, and rays against it.

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

    def top_m(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the height of the highest surface at horizontal positions; plants do not count, NaN without one."""
        return self.caster.from_above(place_m, float(self.scene.bounds_m[1, 2]) + CLEAR_M)


def build_world(
    scenario: Scenario,
    window_m: tuple[float, float, float, float],
    terrain: Callable[[TerrainInputs], Landscape] | Raster | None = None,
    materials: Mapping[str, Backscatter] | None = None,
    cache: BuildCache | None = None,
) -> World:
    """Build the world of a scenario.

    scenario: the scenario.
    window_m: extent visible to the survey (west, south, east, north); files are read only within it.
    terrain, materials: a custom terrain and custom materials instead of the scenario's.
    cache: of an earlier survey, for what is the same in this one.

    Raises ScenarioError, InputFileError if a building or target is beyond the terrain; a material is undefined at the
        carrier; nothing in it reflects a second bounce; an input file cannot be used.
    """
    radar = scenario.radar
    inputs = TerrainInputs(window_m=window_m, carrier_hz=radar.carrier_hz, channel=channel_of(radar))
    cache = cache or BuildCache()
    materials_key = None if materials else _materials_key(scenario, inputs)
    scene_materials = cache.once("materials", materials_key, lambda: _materials(scenario, materials or {}))
    ground_key = None if terrain is not None or materials else _ground_key(scenario, inputs)
    ground = cache.once("ground", ground_key, lambda: build_ground(scenario, inputs, terrain))
    land = ground.land
    _check_materials(land, scene_materials)
    advance()
    motions = motions_of(scenario.all_materials)
    # Includes the identity of the tables' files: a rewritten mesh is another target.
    contents = ("targets", "vegetation", "wires", "poles", "fences")
    contents_key = content_key({name: getattr(scenario, name) for name in contents})

    def build() -> Scene:
        """Return the scene of the ground, with its plants, targets and wires."""
        return Scene(
            surfaces=ground.surfaces,
            materials=scene_materials | land.materials,
            targets=_targets(scenario, land),
            ground_material=land.ground_material,
            georeference=land.georeference,
            vegetation=vegetation_of(
                [_stand(table, number, scenario) for number, table in enumerate(scenario.vegetation)],
                land.ground_m,
                window_m,
                partial(plant_heights, land.georeference, land.ground_m),
            ),
            motions=motions,
            thin=_thin(scenario, ground, window_m),
        )

    window = repr((window_m if scenario.vegetation or scenario.wires else (), motions))
    if any(table.kind == "crop" for table in scenario.vegetation):
        window += repr((scenario.seed, radar.carrier_hz))
    keys = (ground_key, materials_key, contents_key)
    scene = cache.once("scene", None if None in keys else (*keys, window), build)
    _check_bounces(scenario, scene)
    advance()
    advance()
    return World(
        scene=scene,
        ground_m=land.ground_m,
        caster=ground.caster,
        may_overhang=land.may_overhang or bool(scenario.objects),
        posting_m=land.posting_m,
    )


def _materials(scenario: Scenario, custom: Mapping[str, Backscatter]) -> dict[str, Backscatter]:
    for name, model in custom.items():
        if name not in scenario.all_materials:
            message = (
                f"no material of the scenario has this name; give one of {', '.join(sorted(scenario.all_materials))}"
            )
            raise ScenarioError.of(f"materials.{name}", message)
        check_backscatter(model, f"materials.{name}")
    tables = {name: table for name, table in scenario.all_materials.items() if name not in custom}
    return {**build_materials(tables, scenario.radar), **custom}


def _materials_key(scenario: Scenario, inputs: TerrainInputs) -> str | None:
    """Return the content that the materials are built from; None for custom models, whose inputs are unknown."""
    tables = scenario.all_materials
    if any(MATERIALS.entry(table.model).origin != PACKAGE for table in tables.values()):
        return None
    return content_key({"materials": tables, "carrier": inputs.carrier_hz, "channel": inputs.channel})


def _check_materials(land: Landscape, defined: Mapping[str, Backscatter]) -> None:
    used = {land.ground_material, *(surface.material for surface in land.surfaces)}
    missing = sorted(used - set(defined) - set(land.materials))
    if missing:
        raise ScenarioError.of("terrain", f"its material {missing[0]!r} is not defined; add [materials.{missing[0]}]")


def _check_bounces(scenario: Scenario, scene: Scene) -> None:
    """Raise ScenarioError for second bounces without mirrors in the scene, or with vegetation."""
    if scenario.tracing.bounces == 1 or scenario.sensor == "lidar":
        return
    if scene.vegetation is not None:
        raise ScenarioError.of("tracing.bounces", "2 is not traced through [[vegetation]]; set 1, or remove the plants")
    used = {surface.material for surface in scene.surfaces}
    if all(as_radar_material(scene.materials[name]).mirror is None for name in used):
        message = (
            "2 needs a surface that reflects as a mirror, and there is none; set 1, or give one of "
            f"{', '.join(f'materials.{name}' for name in sorted(used))} specular = true"
        )
        raise ScenarioError.of("tracing.bounces", message)


def _stand(table: VegetationTable, number: int, scenario: Scenario) -> Stand:
    """Return a stand of plants; extinction and backscatter of a crop are those of its leaves at the carrier."""
    if table.kind == "stand":
        return table.to(Stand)
    crop, stage = table.planted, table.grown
    planting = Planting(
        height_m=stage.height_m,
        base_height_m=stage.base_height_m,
        row_spacing_m=crop.row_spacing_m,
        row_width_m=stage.row_width_m,
        row_heading_rad=float(np.deg2rad(table.row_heading_deg)),
        plant_spacing_m=crop.plant_spacing_m,
        missing=table.missing,
        height_spread=crop.height_spread,
        crowned=crop.form == "crowns",
        seed=scenario.seed,
        number=number,
    )
    foliage = Foliage(
        leaf_area_per_m=stage.leaf_area_index / planting.foliage_depth_m,
        leaf_thickness_m=crop.leaf_thickness_mm / 1e3,
        water_content=stage.water_content,
    )
    light_db = table.light_extinction_db_per_m
    extinction_db, backscatter_db = table.extinction_db_per_m, table.backscatter_db_per_m
    carrier_hz = scenario.radar.carrier_hz
    return table.to(
        Stand,
        planting=planting,
        # Of opaque leaves that face all directions alike.
        light_extinction_db_per_m=foliage.leaf_area_per_m / 2 / NEPERS if light_db is None else light_db,
        extinction_db_per_m=foliage.extinction_per_m(carrier_hz) / NEPERS if extinction_db is None else extinction_db,
        backscatter_db_per_m=(
            to_db(foliage.backscatter_per_m(carrier_hz)) if backscatter_db is None else backscatter_db
        ),
    )


def _targets(scenario: Scenario, land: Landscape) -> tuple[Target, ...]:
    if not scenario.targets:
        return ()
    wavelength_m = speed_of_light / scenario.radar.carrier_hz
    height = land.standing_m(np.array([target.position_m for target in scenario.targets]))
    return tuple(
        target_of(table, f"targets.{index}", float(height[index]), land.standing_m, wavelength_m)
        for index, table in enumerate(scenario.targets)
    )


def _thin(
    scenario: Scenario, ground: "Ground", window_m: tuple[float, float, float, float]
) -> tuple[ThinObstacle, ...]:
    if not (scenario.wires or scenario.poles or scenario.fences):
        return ()
    place = ground.land.georeference
    datum_m = place.origin_m[2] if place else 0.0
    return build_thin(scenario, ground.land.ground_m, datum_m, frame_of(place), window_m, ground.caster)


@dataclass(frozen=True, kw_only=True)
class Ground:
    """A landscape with the objects on it, and rays against its surfaces; immutable."""

    land: Landscape
    surfaces: tuple[Surface, ...]
    caster: RayCaster


def build_ground(
    scenario: Scenario,
    inputs: TerrainInputs,
    terrain: Callable[[TerrainInputs], Landscape] | Raster | None = None,
) -> Ground:
    """Return the ground of a scenario, or a custom one, with the objects on it.

    Raises ScenarioError, InputFileError if it has no surface; a building is beyond it; an input file cannot be used.
    """
    if isinstance(terrain, Raster):
        land = landscape_of_raster(terrain, scenario.terrain, inputs)
    else:
        land = terrain(inputs) if terrain else build_landscape(scenario.terrain, inputs)
    require(land, Landscape, "terrain")
    if not land.surfaces or not all(len(s.faces) and np.all(np.isfinite(s.vertices_m)) for s in land.surfaces):
        message = "it has no surface, or a vertex that is not finite; check its heights"
        raise ScenarioError.of("terrain", message)
    boxes = tuple(build_box(box_of(b), i, land.ground_m) for i, b in enumerate(scenario.buildings))
    standing = _objects(scenario, land) + _footprints(scenario, land, inputs) + boxes
    _check_heights(standing)
    surfaces = land.surfaces + standing
    bare = len(surfaces) == len(land.surfaces)
    return Ground(land=land, surfaces=surfaces, caster=(land.caster if bare else None) or RayCaster(surfaces))


def _check_heights(standing: Iterable[Surface]) -> None:
    """Raise ScenarioError for what is so tall that the scatterers on its faces could not be divided among cells."""
    problems = []
    for surface in standing:
        low_m, high_m = surface.bounds_m[:, 2]
        if not high_m - low_m <= TALLEST_M:
            message = f"is {high_m - low_m:g} m tall, more than {TALLEST_M:,.0f} m; lower it, or correct its units"
            problems.append(Problem(surface.name, message))
    if problems:
        raise ScenarioError(problems)


def _ground_key(scenario: Scenario, inputs: TerrainInputs) -> str | None:
    """Return the content that the ground is built from, with the identity of files.

    The survey's window, carrier and channel are part of it where the terrain depends on them. None for a custom
    registered terrain, whose inputs are unknown, and for files without an identity.
    """
    entry = TERRAINS.entry(scenario.terrain.kind)
    if entry.origin != PACKAGE:
        return None
    # Footprints are read within the window.
    fields = set(entry.facts.uses) | ({"window_m"} if scenario.footprints else set())
    return content_key(
        {name: getattr(scenario, name) for name in ("terrain", "buildings", "objects", "footprints")}
        | {name: getattr(inputs, name) for name in sorted(fields)}
    )


def _objects(scenario: Scenario, land: Landscape) -> tuple[Surface, ...]:
    datum_m = land.georeference.origin_m[2] if land.georeference else 0.0
    items = [item.to(StandingMesh, source=mesh_source(item)) for item in scenario.objects]
    return build_objects(items, land.ground_m, datum_m)


def _footprints(scenario: Scenario, land: Landscape, inputs: TerrainInputs) -> tuple[Surface, ...]:
    if not scenario.footprints:
        return ()
    frame = frame_of(land.georeference)
    files = [table.to(OutlineFile) for table in scenario.footprints]
    built = [build_footprints(file, i, frame, inputs.window_m, land.ground_m) for i, file in enumerate(files)]
    return tuple(surface for surfaces in built for surface in surfaces)


AXES = {"forward": (1.0, 0.0, 0.0), "right": (0.0, 1.0, 0.0), "up": (0.0, 0.0, 1.0)}


def target_of(
    table: PointTarget,
    key: str,
    ground_m: float,
    standing_m: Heights,
    wavelength_m: float,
) -> Target:
    """Return a target over the ground.

    table, key: the target in the scenario, and its dotted key.
    ground_m: height of the ground at its position.
    standing_m: returns the ground height at horizontal positions.
    wavelength_m: of the carrier; sets the subdivision of a body.

    Raises ScenarioError if it stands, or moves, beyond the terrain.
    Raises InputFileError if its table of cross-sections, or its mesh, cannot be read.
    """
    if not np.isfinite(ground_m):
        message = f"{table.position_m} is beyond the terrain; move it or enlarge the terrain"
        raise ScenarioError.of(f"{key}.position_m", message)
    return Target(
        position_m=(*table.position_m, ground_m + table.height_m),
        rcs_m2=0.0 if table.rcs_dbsm is None else from_db(table.rcs_dbsm),
        swerling=table.swerling,
        way=None
        if table.speed_mps is None
        else way_over(
            (table.position_m, *table.waypoints_m),
            table.height_m,
            table.speed_mps,
            key,
            standing_m,
            closed=table.closed,
        ),
        heading_rad=float(np.deg2rad(table.heading_deg)),
        rcs_table=None if table.rcs_table is None else read_rcs(table.rcs_table),
        rotors=tuple(_rotor(rotor) for rotor in table.rotors),
        body=None if table.mesh is None else build_body(table.mesh, f"{key}.mesh", wavelength_m),
    )


def _rotor(table: RotorTable) -> Rotor:
    turns_per_s, rcs_m2 = table.rotation_rpm / 60, from_db(table.rcs_dbsm)
    return table.to(Rotor, axis=AXES[table.axis], turns_per_s=turns_per_s, rcs_m2=rcs_m2)


def build_body(table: TargetMesh, key: str, wavelength_m: float) -> Body:
    """Return the body of a target; raises as `body_of` does."""
    return body_of(mesh_source(table), key, wavelength_m, from_db(table.reflectivity_db))


def box_of(table: Building) -> Box:
    """Return the box of a building: an entry of a scenario's `buildings`.

    Parameters
    ----------
    table:
        Table of the building.

    Returns
    -------
    The box in local metres, its heading in radians.
    """
    return table.to(Box, heading_rad=float(np.deg2rad(table.heading_deg)))
