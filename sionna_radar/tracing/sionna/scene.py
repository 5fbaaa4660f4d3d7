"""A scene of ours inside Sionna RT."""

from copy import copy

import numpy as np
from jaxtyping import Int

from sionna_radar.radar.antenna import Antenna
from sionna_radar.raytracer.backend import load_mitsuba
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import mitsuba_mesh
from sionna_radar.tracing.sionna.material import sionna_material
from sionna_radar.tracing.sionna.pattern import SionnaPattern

mi = load_mitsuba()

import sionna.rt as rt  # noqa: E402  (libLLVM and the variant must be chosen before it loads)


class SionnaScene:
    """A scene of ours inside Sionna RT.

    pattern, receive_pattern: the antenna in transmission and in reception.
    shape_of_surface: Mitsuba's shape pointer, as an integer, of each surface of ours.
    surface_of_shape: the inverse; -1 where there is none.
    """

    def __init__(self, scene: Scene, antenna: Antenna, carrier_hz: float) -> None:
        # Sionna keeps materials and objects in one list of names: the user's names stay out of it.
        materials = {
            name: sionna_material(f"material-{number}", model)
            for number, (name, model) in enumerate(scene.materials.items())
        }
        self.rt_scene = rt.Scene()
        # Set before adding materials, some of which are undefined at Sionna's default frequency.
        self.rt_scene.frequency = carrier_hz
        objects = [
            rt.SceneObject(mi_mesh=mitsuba_mesh(s), name=f"surface-{i}", radio_material=materials[s.material])
            for i, s in enumerate(scene.surfaces)
        ]
        self.rt_scene.edit(add=objects)
        self._point(antenna)
        shapes = [self.rt_scene.objects[f"surface-{i}"].object_id for i in range(len(objects))]
        self.shape_of_surface: Int[np.ndarray, " surface"] = np.array(shapes)
        self.surface_of_shape: Int[np.ndarray, " shape"] = np.full(max(shapes) + 1, -1)
        self.surface_of_shape[shapes] = np.arange(len(shapes))

    def with_antenna(self, antenna: Antenna) -> "SionnaScene":
        """Return the same scene with another antenna."""
        other = copy(self)
        other._point(antenna)
        return other

    def _point(self, antenna: Antenna) -> None:
        self.pattern = SionnaPattern(antenna)
        # Sionna receives with the conjugate of the pattern, which cancels the conjugation for its axes.
        self.receive_pattern = SionnaPattern(antenna, antenna.jones[1])
