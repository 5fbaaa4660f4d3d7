"""The city scenes that Sionna RT ships, with materials that exist at 77 GHz.

Their ITU materials (concrete, marble, brick, ...) are slabs with a specular reflection, and most end far below
77 GHz. Here each object scatters diffusely instead: the ground as `ground`, all else as `building`, unless the
scenario maps a Sionna material to one of its own.
"""

import logging

import numpy as np

from sionna_radar.errors import Problem, ScenarioError
from sionna_radar.scenario.models import CityTerrain
from sionna_radar.scene.backend import load_mitsuba
from sionna_radar.scene.model import Surface

logger = logging.getLogger("sionna_radar")

GROUND_OBJECTS = ("ground", "terrain")


def load_city(terrain: CityTerrain) -> tuple[Surface, ...]:
    """Return the surfaces of a Sionna city, and log which material each of Sionna's became.

    Raises
    ------
    ScenarioError
        The scenario maps a material that the city does not have.

    """
    load_mitsuba()
    import sionna.rt as rt

    scene = rt.load_scene(getattr(rt.scene, terrain.city))
    surfaces, mapped = [], {}
    for name, thing in scene.objects.items():
        theirs = thing.radio_material.name
        default = "ground" if name.lower().startswith(GROUND_OBJECTS) else "building"
        ours = terrain.materials.get(theirs, default)
        mapped[theirs] = ours
        mesh = thing.mi_mesh
        vertices = mesh.vertex_positions_buffer().numpy().reshape(-1, 3)
        faces = mesh.faces_buffer().numpy().reshape(-1, 3)
        surfaces.append(
            Surface(
                name=name,
                vertices_m=vertices.astype(np.float64),
                faces=faces.astype(np.int64),
                material=ours,
            )
        )
    unknown = sorted(set(terrain.materials) - set(mapped))
    if unknown:
        message = f"{terrain.kind} has no {', '.join(unknown)}; map any of {', '.join(sorted(mapped))}"
        raise ScenarioError([Problem("terrain.materials", message)])
    logger.warning(
        "%s: Sionna's materials are replaced by 77 GHz ones: %s",
        terrain.kind,
        ", ".join(f"{theirs} -> {ours}" for theirs, ours in sorted(mapped.items())),
    )
    return tuple(surfaces)
