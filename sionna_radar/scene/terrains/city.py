"""The city scenes shipped with Sionna RT, with materials defined at 77 GHz.

Their ITU materials (concrete, marble, brick, ...) are slabs with a specular reflection, most of them defined only far
below 77 GHz. Here each object scatters diffusely instead: the ground as `ground`, everything else as `building`, unless
the scenario maps a Sionna material to one of its own.
"""

import hashlib
import logging
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.memory import release_memory
from sionna_radar.raytracer.backend import load_sionna, release_arrays
from sionna_radar.scene.landscape import Landscape
from sionna_radar.scene.model import Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.radar_material import Channel, RadarMaterial
from sionna_radar.surfaces.sionna_slab import SionnaSlab, slab_material

logger = logging.getLogger("sionna_radar")

# Prefix of the names of materials that stay Sionna's own.
KEPT = "sionna"
GROUND_OBJECTS = ("ground", "terrain")


def load_city(
    city: str, chosen: Mapping[str, str | None], carrier_hz: float, channel: Channel
) -> tuple[tuple[Surface, ...], dict[str, RadarMaterial]]:
    """Return the surfaces of a Sionna city and its kept materials; log the replacement of the others.

    chosen: materials of the scenario by the names of Sionna's; None keeps Sionna's own.

    Raises ScenarioError if the scenario maps a material that the city does not have, or keeps one that is undefined at
        the carrier or does not scatter.
    """
    load_sionna()
    import sionna.rt as rt

    scene = rt.load_scene(getattr(rt.scene, city))
    surfaces, mapped, kept_materials = [], {}, {}
    for index, (name, item) in enumerate(sorted(scene.objects.items(), key=_place)):
        sionna_name = item.radio_material.name
        default = "ground" if _is_ground(name) else "building"
        material = chosen.get(sionna_name, default)
        if material is None:
            material = f"{KEPT}:{sionna_name}"
            kept_materials[material] = item.radio_material
        mapped[sionna_name] = material
        mesh = item.mi_mesh
        vertices = mesh.vertex_positions_buffer().numpy().reshape(-1, 3)
        faces = mesh.faces_buffer().numpy().reshape(-1, 3)
        surfaces.append(
            Surface(
                name=name if _is_ground(name) else f"{city}-{index}",
                vertices_m=vertices.astype(np.float64),
                faces=faces.astype(np.int64),
                material=material,
            )
        )
    missing = sorted(set(chosen) - set(mapped))
    if missing:
        message = f"sionna:{city} has no {', '.join(missing)}; map any of {', '.join(sorted(mapped))}"
        raise ScenarioError.of("terrain.materials", message)
    logger.warning(
        "sionna:%s: Sionna's materials are replaced by 77 GHz ones: %s",
        city,
        ", ".join(f"{sionna_name} -> {material}" for sionna_name, material in sorted(mapped.items())),
    )
    return tuple(surfaces), _kept(kept_materials, carrier_hz, channel)


def _is_ground(name: str) -> bool:
    return name.lower().startswith(GROUND_OBJECTS)


def _place(entry: tuple[str, Any]) -> tuple[bool, str, bytes]:
    """Return a stable sort key of a city's objects, which Mitsuba's threads name in order of arrival."""
    name, item = entry
    vertices = item.mi_mesh.vertex_positions_buffer().numpy()
    return not _is_ground(name), item.radio_material.name, hashlib.sha256(vertices.tobytes()).digest()


def _kept(sionna_materials: dict[str, Any], carrier_hz: float, channel: Channel) -> dict[str, RadarMaterial]:
    materials, problems = {}, []
    for name, material in sionna_materials.items():
        slab = SionnaSlab(
            itu_type=getattr(material, "itu_type", material.name),
            thickness_m=float(material.thickness[0]),
            scattering_coefficient=float(material.scattering_coefficient[0]),
            xpd_coefficient=float(material.xpd_coefficient[0]),
        )
        try:
            materials[name] = slab_material(slab, carrier_hz, channel)
        except ValueError as error:
            problems.append(Problem(f"terrain.materials.{name.removeprefix(f'{KEPT}:')}", str(error)))
    if problems:
        raise ScenarioError(problems)
    return materials


def city_landscape(city: str, chosen: Mapping[str, str | None], carrier_hz: float, channel: Channel) -> Landscape:
    """Return one of Sionna's cities."""
    surfaces, materials = load_city(city, chosen, carrier_hz, channel)
    # Sionna's own scene is gone by now, but its memory (a tenth of what a survey of a city takes) is still cached.
    release_arrays()
    release_memory()
    caster = RayCaster(surfaces)
    bottom = min(float(s.vertices_m[:, 2].min()) for s in surfaces) - 10.0

    def ground_m(place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        return caster.from_below(place_m, bottom)

    return Landscape(
        surfaces=surfaces, ground_m=ground_m, standing_m=ground_m, materials=dict(materials), caster=caster
    )
