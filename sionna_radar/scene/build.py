"""Building the scene of a scenario: terrain or city, buildings, targets, materials."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import distance_transform_edt

from sionna_radar.foundation.decibel import from_db
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.terrain import CityTerrain
from sionna_radar.scene.buildings import build_box
from sionna_radar.scene.city import load_city
from sionna_radar.scene.ground_cover import cover_ground
from sionna_radar.scene.materials import build_materials, channel_of
from sionna_radar.scene.model import Scene, Surface, Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.terrain import load_elevation, mesh_of
from sionna_radar.surfaces.backscatter import Backscatter

Ground = Callable[[Float[np.ndarray, "n 2"]], Float[np.ndarray, " n"]]


@dataclass(frozen=True, kw_only=True)
class BuiltScene:
    """A scene with what the rest of the survey asks of it.

    ground_m: height of the bare ground at points of the plan, holes bridged; NaN beyond the terrain.
    caster: rays against all surfaces.
    """

    scene: Scene
    ground_m: Ground
    caster: RayCaster


def build_scene(scenario: Scenario, window_m: tuple[float, float, float, float]) -> BuiltScene:
    """Build the scene of a scenario.

    Parameters
    ----------
    scenario:
        What to build.
    window_m:
        What the survey can see (west, south, east, north); no more of a file is read.

    Raises
    ------
    ScenarioError, InputFileError
        A building or target lies beyond the terrain; a material is undefined at the carrier; an input file
        cannot be used.

    """
    materials: dict[str, Backscatter] = dict(build_materials(scenario.all_materials, scenario.radar))
    terrain = scenario.terrain
    if isinstance(terrain, CityTerrain):
        surfaces, kept = load_city(terrain, scenario.radar.carrier_hz, channel_of(scenario.radar))
        materials |= kept
        ground_m, georeference = _under_city(surfaces), None
    else:
        raster, georeference = load_elevation(terrain, window_m)
        surfaces, ground_m = cover_ground(*mesh_of(raster), terrain, georeference), _bridged(raster).at
    boxes = tuple(build_box(b, i, ground_m) for i, b in enumerate(scenario.buildings))
    scene = Scene(
        surfaces=surfaces + boxes,
        materials=materials,
        targets=_targets(scenario, ground_m, surfaces),
        ground_material=getattr(terrain, "material", "ground"),
        georeference=georeference,
    )
    return BuiltScene(scene=scene, ground_m=ground_m, caster=RayCaster(scene.surfaces))


def _under_city(surfaces: tuple[Surface, ...]) -> Ground:
    caster = RayCaster(surfaces)
    bottom = min(float(s.vertices_m[:, 2].min()) for s in surfaces) - 10.0
    return lambda point: caster.from_below(point, bottom)


def _bridged(raster: Raster) -> Raster:
    """Return a raster whose holes hold the nearest height, so that a flight can be planned across a lake."""
    if raster.filled.all():
        return raster
    nearest = distance_transform_edt(~raster.filled, return_distances=False, return_indices=True)
    return Raster(grid=raster.grid, height_m=raster.height_m[tuple(nearest)])


def _targets(scenario: Scenario, ground_m: Ground, surfaces: tuple[Surface, ...]) -> tuple[Target, ...]:
    if not scenario.targets:
        return ()
    place = np.array([target.position_m for target in scenario.targets])
    height = ground_m(place)
    if not isinstance(scenario.terrain, CityTerrain):
        # On the mesh itself: between the posts of a coarse raster the bilinear ground lies metres above or
        # below the triangles, which would bury the target.
        mesh = RayCaster(surfaces).from_above(place, max(float(s.vertices_m[:, 2].max()) for s in surfaces) + 10.0)
        height = np.where(np.isnan(mesh), height, mesh)
    targets = []
    for index, target in enumerate(scenario.targets):
        ground = float(height[index])
        if not np.isfinite(ground):
            message = f"{target.position_m} lies beyond the terrain; move it or enlarge the terrain"
            raise ScenarioError([Problem(f"targets.{index}.position_m", message)])
        position = (*target.position_m, ground + target.height_m)
        targets.append(Target(position_m=position, rcs_m2=from_db(target.rcs_dbsm), swerling=target.swerling))
    return tuple(targets)
