"""Ground and scenes to look at."""

from collections.abc import Callable, Mapping

import numpy as np

from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.scenario.bases import TerrainParameters
from sionna_radar.scene.landscape import TerrainInputs
from sionna_radar.scene.model import Scene, Surface, mesh_of
from sionna_radar.scene.terrains.build import build_landscape
from sionna_radar.surfaces.backscatter import Backscatter, ConstantGammaBackscatter
from sionna_radar.surfaces.radar_material import RadarMaterial

GAMMA = 0.01


def make_surface(
    height: Callable[[np.ndarray, np.ndarray], np.ndarray],
    *,
    size_m: float = 400.0,
    spacing_m: float = 2.0,
    centre_m: tuple[float, float] = (0.0, 0.0),
    name: str = "ground",
) -> Surface:
    """Return a square of ground with a height for each place of the plan."""
    count = round(size_m / spacing_m) + 1
    west, south = np.array(centre_m) - size_m / 2
    grid = Grid(west_m=west, south_m=south, spacing_m=spacing_m, columns=count, rows=count)
    x, y = grid.centres_m.T
    heights = np.broadcast_to(height(x, y), x.shape).astype(float).reshape(grid.shape)
    vertices, faces = mesh_of(Raster(grid=grid, height_m=heights))
    return Surface(name=name, vertices_m=vertices, faces=faces, material="ground")


def make_scene(
    *surfaces: Surface,
    materials: Mapping[str, Backscatter | RadarMaterial] | None = None,
    gamma: float = GAMMA,
    targets: tuple = (),
) -> Scene:
    """Return a scene whose ground is its first surface."""
    return Scene(
        surfaces=surfaces,
        materials=materials or {"ground": ConstantGammaBackscatter(gamma)},
        targets=targets,
        ground_material=surfaces[0].material,
        georeference=None,
    )


def plane_of(material: Backscatter | RadarMaterial, **place: object) -> Scene:
    """Return a plane of a material, 2 km wide unless given otherwise."""
    ground = make_surface(lambda x, y: 0 * x, **({"size_m": 2000.0, "spacing_m": 20.0} | place))
    return make_scene(ground, materials={"ground": material})


def load_ground(
    terrain: TerrainParameters, window_m: tuple[float, float, float, float]
) -> tuple[Raster, Georeference | None]:
    """Return the heights of a terrain within a window, and its place on the Earth."""
    land = build_landscape(terrain, TerrainInputs(window_m=window_m, carrier_hz=77e9, channel="VV"))
    return land.heights, land.georeference
