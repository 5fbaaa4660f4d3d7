"""Conversion of a `Scene` to a Sionna RT scene."""

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Int
from scipy.constants import speed_of_light

from sionna_radar.radar.antenna import Antenna
from sionna_radar.raytracer.backend import flushed_denormals, load_mitsuba, load_sionna
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster, mitsuba_mesh
from sionna_radar.tracing.sionna.material import sionna_material
from sionna_radar.tracing.sionna.pattern import SionnaPattern

mi = load_mitsuba()
load_sionna()

import drjit as dr  # noqa: E402  (libLLVM and the variant must be chosen before these load)
import sionna.rt as rt  # noqa: E402  (libLLVM and the variant must be chosen before these load)


class SionnaScene:
    """A `Scene` as Sionna RT objects.

    pattern, receive_pattern: the antenna in transmission and in reception.
    shape_of_surface: Mitsuba's shape pointer of each surface, as an integer.
    surface_of_shape: the inverse; -1 where there is none.
    caster: ray caster of the surfaces. Its acceleration structure is reused: building another takes longer than
    tracing thousands of pulses.
    """

    @flushed_denormals()
    def __init__(self, scene: Scene, antenna: Antenna, carrier_hz: float, caster: RayCaster | None = None) -> None:
        self.caster = caster or RayCaster(scene.surfaces)
        # Materials and objects share one namespace in Sionna: use generated names, not the user's.
        materials = {
            name: sionna_material(f"material-{number}", model)
            for number, (name, model) in enumerate(scene.materials.items())
        }
        self._carrier_hz = carrier_hz
        self._material = [materials[s.material] for s in scene.surfaces]
        self._mesh = [mitsuba_mesh(s) for s in scene.surfaces]
        for mesh, material in zip(self._mesh, self._material, strict=True):
            mesh.set_bsdf(material)
        self._point(antenna)
        shapes = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(mesh))[0]) for mesh in self._mesh]
        self.shape_of_surface: Int[np.ndarray, " surface"] = np.array(shapes)
        self.surface_of_shape: Int[np.ndarray, " shape"] = np.full(max(shapes) + 1, -1)
        self.surface_of_shape[shapes] = np.arange(len(shapes))

    @cached_property
    def rt_scene(self) -> Any:
        """The scene for Sionna's own solvers, with an acceleration structure of its own."""
        scene_rt = rt.Scene()
        # Set before adding materials, some of which are undefined at Sionna's default frequency.
        scene_rt.frequency = self._carrier_hz
        objects = [
            rt.SceneObject(mi_mesh=mesh, name=f"surface-{number}", radio_material=material)
            for number, (mesh, material) in enumerate(zip(self._mesh, self._material, strict=True))
        ]
        scene_rt.edit(add=objects)
        return scene_rt

    @property
    def wavelength(self) -> Any:
        """Wavelength, m."""
        return mi.Float(speed_of_light) / mi.Float(self._carrier_hz)

    @property
    def tables(self) -> list[Any]:
        """Tables of the antenna's pattern and of the materials, by which fields are differentiable."""
        materials = [table for material in dict.fromkeys(self._material) for table in material.tables]
        return [*self.pattern.tables, *self.receive_pattern.tables, *materials]

    def shape_of_hit(self, hit: Any) -> Any:
        """Return this scene's shape pointer of a hit by the caster, as an integer; 0 for a miss."""
        return dr.gather(mi.UInt32, self._shape_of_hit, dr.reinterpret_array(mi.UInt32, hit.shape), hit.is_valid())

    @cached_property
    def _shape_of_hit(self) -> Any:
        surface = self.caster.surface_of_shape
        return mi.UInt32(np.where(surface < 0, 0, self.shape_of_surface[surface]).astype(np.uint32))

    def with_antenna(self, antenna: Antenna) -> "SionnaScene":
        """Return the same scene with another antenna."""
        other = copy(self)
        other._point(antenna)
        return other

    def _point(self, antenna: Antenna) -> None:
        self.pattern = SionnaPattern(antenna)
        # Sionna receives with the conjugate of the pattern, which cancels the conjugation for its axes.
        self.receive_pattern = SionnaPattern(antenna, antenna.jones[1])


def sionna_scene(scene: Scene, antenna: Antenna, carrier_hz: float, caster: RayCaster | None) -> SionnaScene:
    """Return a scene as Sionna RT objects with an antenna; cached by a shared caster.

    Not for Sionna's own solvers, which modify the scene they are given.
    """
    if caster is None:
        return SionnaScene(scene, antenna, carrier_hz)
    kept = caster.once("scene of Sionna", (scene, carrier_hz), lambda: SionnaScene(scene, antenna, carrier_hz, caster))
    return kept.with_antenna(antenna)
