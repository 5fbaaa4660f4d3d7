"""The echo of a body by physical optics: of each face that the radar sees, the field of its currents.

A face of a perfect conductor, lit along the unit vector u from a place so far away that the wave is plane over it,
returns by the radar equation with the amplitude (Ruck and others 1970, "Radar Cross Section Handbook")

    sqrt(sigma) = (2 sqrt(pi) / lambda) |n . u| * integral over the face of exp(-2 j k u . (p - c)) dp

relative to the phase of its middle c. Over a triangle the integral is 2 A times the divided difference of the
exponential at three values, those of its exponent at the corners (Hermite and Genocchi), which is evaluated without
loss near their coincidences. The sum over faces with the phase of each one's range holds for near fields of the body,
too. Faces in a small step of range are one path.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float

from sionna_radar.scene.body import Body
from sionna_radar.scene.model import Surface
from sionna_radar.scene.raycast import RayCaster

# Share of the way to a face that is not looked at for what hides it.
SHORT = 1e-3


@dataclass(frozen=True)
class Scatterer:
    """A body as it scatters a wavelength."""

    body: Body
    wavelength_m: float

    @cached_property
    def corner_m(self) -> Float[np.ndarray, "face 3 3"]:
        """Corners of the faces, in the body's axes."""
        return self.body.vertices_m[self.body.faces]

    @cached_property
    def middle_m(self) -> Float[np.ndarray, "face 3"]:
        """Middles of the faces."""
        return self.corner_m.mean(axis=1)

    @cached_property
    def normal_m2(self) -> Float[np.ndarray, "face 3"]:
        """Outward normals, as long as the areas."""
        corner = self.corner_m
        return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2

    @cached_property
    def _caster(self) -> RayCaster:
        body = Surface(name="body", vertices_m=self.body.vertices_m, faces=self.body.faces, material="")
        return RayCaster([body])

    def seen(self, radar_m: Float[np.ndarray, "place 3"]) -> Bool[np.ndarray, "place face"]:
        """Return which faces are seen from places, given in the body's axes."""
        facing = np.einsum("pfi,fi->pf", radar_m[:, None] - self.middle_m, self.normal_m2)
        lit = np.where(self.body.two_sided, facing != 0, facing > 0)
        place, face = np.nonzero(lit)
        lit[place, face] = ~self._caster.hides(radar_m[place], self.middle_m[face], SHORT)
        return lit

    def amplitude(self, radar_m: Float[np.ndarray, "place 3"]) -> Complex[np.ndarray, "place face"]:
        """Return the square root of the cross-section of each face, complex relative to the phase of its middle.

        Zero for faces that are not seen from a place.
        """
        # Numba takes half a second to import.
        from sionna_radar.tracing.effects.physical_optics_kernels import face_amplitudes

        out = np.zeros((len(radar_m), len(self.body.faces)), dtype=np.complex128)
        radar_m = np.ascontiguousarray(radar_m, dtype=np.float64)
        face_amplitudes(
            radar_m, self.corner_m, self.middle_m, self.normal_m2, self.wavelength_m, self.seen(radar_m), out
        )
        return np.sqrt(self.body.reflectivity) * out

    def rcs_m2(self, toward: Float[np.ndarray, "n 3"], range_m: float) -> Float[np.ndarray, " n"]:
        """Return the cross-section seen from a range, in directions from the body (unit vectors in its axes)."""
        found = np.empty(len(toward))
        for number, one in enumerate(toward):
            place = one[None] * range_m
            away_m = np.linalg.norm(self.middle_m - place, axis=1)
            phase = np.exp(-4j * np.pi / self.wavelength_m * (away_m - range_m))
            # The radar equation with the range of each face.
            found[number] = np.abs(np.sum(self.amplitude(place)[0] * phase * (range_m / away_m) ** 2)) ** 2
        return found
