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
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Complex, Float
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scenario.objects import TargetMesh
from sionna_radar.scene.body import Body
from sionna_radar.scene.body_file import body_of
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
        lit[place, face] = ~self._caster.hides(radar_m, place, self.middle_m[face], SHORT)
        return lit

    @cached_property
    def sphere(self) -> tuple[Float[np.ndarray, " 3"], float]:
        """A sphere around the body, in its axes: middle and radius."""
        low, high = self.body.vertices_m.min(axis=0), self.body.vertices_m.max(axis=0)
        return (low + high) / 2, float(np.linalg.norm(high - low)) / 2

    def hides(self, start_m: Float[np.ndarray, "n 3"], end_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return whether the body is between places, in its axes."""
        return self._caster.hides(start_m, np.arange(len(start_m)), end_m, 0.0)

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


@lru_cache(maxsize=16)
def scatterer_of(body: Body, wavelength_m: float) -> Scatterer:
    """Return a body as it scatters; the last ones are kept."""
    return Scatterer(body, wavelength_m)


def rcs_of_mesh(
    mesh: TargetMesh,
    carrier_hz: float,
    azimuth_rad: Float[np.ndarray, " azimuth"],
    elevation_rad: Float[np.ndarray, " elevation"],
    range_m: float = 1000.0,
) -> Float[np.ndarray, "elevation azimuth"]:
    """Return the cross-section of a shape from all sides, in square metres, by physical optics.

    Parameters
    ----------
    mesh:
        Its file, as in `[[targets]]`.
    carrier_hz:
        Of the radar.
    azimuth_rad, elevation_rad:
        Direction from which it is seen: clockwise from its front, and above its horizon.
    range_m:
        From which it is seen.

    Raises
    ------
    InputFileError, ScenarioError
        The file cannot be used, or is too large for the wavelength; the carrier or the range is no positive number.

    Examples
    --------
    >>> import numpy as np
    >>> import trimesh
    >>> from sionna_radar.scenario import TargetMesh
    >>> _ = trimesh.creation.icosphere(subdivisions=6, radius=0.05).export("ball.ply")
    >>> rcs_m2 = rcs_of_mesh(TargetMesh(path="ball.ply"), 77e9, np.zeros(1), np.zeros(1))
    >>> bool(abs(10 * np.log10(rcs_m2[0, 0] / (np.pi * 0.05**2))) < 1)
    True

    """
    for name, value in {"carrier_hz": carrier_hz, "range_m": range_m}.items():
        if not 0 < value < np.inf:
            raise ScenarioError([Problem(name, f"{value:g} is not positive and finite; give it in SI units")])
    wavelength_m = speed_of_light / carrier_hz
    seen = Scatterer(body_of(mesh, "mesh", wavelength_m), wavelength_m)
    elevation, azimuth = np.meshgrid(elevation_rad, azimuth_rad, indexing="ij")
    level = np.cos(elevation)
    toward = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)
    found: Float[np.ndarray, "elevation azimuth"] = seen.rcs_m2(toward.reshape(-1, 3), range_m).reshape(azimuth.shape)
    return found
