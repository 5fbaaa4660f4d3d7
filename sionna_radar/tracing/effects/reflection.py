"""Plane mirrors of a scene, and what they do to a ray: Fresnel's coefficients at its own angle, less the roughness.

A wave of direction k meets a plane of normal n. With h across the plane of incidence, the reflected field is

    E' = sqrt(c) [ R_h h (h . E)  +  R_v (h x k') ((h x k) . E) ],      k' = k - 2 (k . n) n,

R_h and R_v as in `rough_surface.fresnel_reflection`, c = exp(-(2 k s cos t)^2) the share that a roughness s leaves
coherent, at the incidence t of the ray.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.surfaces.radar_material import Mirror, as_radar_material
from sionna_radar.surfaces.rough_surface import coherent_power_factor, fresnel_reflection
from sionna_radar.tracing.effects.mirrors import LEAST_WAVELENGTHS, Patch, patches_of


@dataclass(frozen=True, kw_only=True)
class PlaneMirror:
    """A plane patch of a surface, and what it is made of."""

    patch: Patch
    mirror: Mirror

    def height_m(self, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the heights of points over the plane, positive in front of it."""
        height: Float[np.ndarray, " n"] = (point_m - self.patch.centre_m) @ self.patch.normal
        return height

    def image_m(self, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Return the images of points behind the plane."""
        return point_m - 2 * self.height_m(point_m)[:, None] * self.patch.normal

    def reflected(
        self, direction: Float[np.ndarray, "n 3"], field: Inexact[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Inexact[np.ndarray, "n 3"]]:
        """Return direction and field of waves after the mirror; see the module docstring."""
        normal = self.patch.normal
        along = direction @ normal
        after = direction - 2 * along[:, None] * normal
        cosine = np.minimum(np.abs(along), 1.0)
        across = across_incidence(direction, np.broadcast_to(normal, direction.shape))
        horizontal, vertical = (fresnel_reflection(self.mirror.permittivity, cosine, p) for p in ("H", "V"))
        kept = np.ones(len(cosine))
        if self.mirror.rms_height_m > 0:
            kept = np.sqrt(coherent_power_factor(self.mirror.rms_height_m, self.mirror.frequency_hz, np.arccos(cosine)))
        of_h = kept * horizontal * np.einsum("ni,ni->n", across, field)
        of_v = kept * vertical * np.einsum("ni,ni->n", np.cross(across, direction), field)
        return after, of_h[:, None] * across + of_v[:, None] * np.cross(across, after)


def across_incidence(direction: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Return unit vectors across planes of incidence; any across the direction at normal incidence."""
    across = np.cross(direction, normal)
    size = np.linalg.norm(across, axis=1)
    level = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction), axis=1)])
    across = np.where((size > 1e-6)[:, None], across, level)
    unit: Float[np.ndarray, "n 3"] = across / np.linalg.norm(across, axis=1)[:, None]
    return unit


def plane_mirrors(scene: Scene, chirp: Chirp) -> list[PlaneMirror]:
    """Return the plane patches of all surfaces whose material reflects as a mirror."""
    least_m = LEAST_WAVELENGTHS * chirp.wavelength_m
    found = []
    for number, surface in enumerate(scene.surfaces):
        mirror = as_radar_material(scene.materials[surface.material]).mirror
        if mirror is not None:
            found += [PlaneMirror(patch=p, mirror=mirror) for p in patches_of(surface, number, 1 + 0j, least_m)]
    return found
