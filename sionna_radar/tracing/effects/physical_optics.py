"""Physical-optics scattering of a body: field of the surface currents on each visible face.

A face of a perfect conductor, lit along the unit vector u from a place so far away that the wave is plane over it,
returns by the radar equation with the amplitude (Ruck and others 1970, "Radar Cross Section Handbook")

    sqrt(sigma) = (2 sqrt(pi) / lambda) |n . u| * integral over the face of exp(-2 j k u . (p - c)) dp

relative to the phase of its middle c. Over a triangle the integral is 2 A times the divided difference of the
exponential at three values, those of its exponent at the corners (Hermite and Genocchi), which is evaluated without
loss near their coincidences. The sum over faces with the phase of each one's range holds for near fields of the body,
too. Faces in a small step of range are one path. Bodies that see themselves return further reflections, see
`bouncing_rays`.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.spatial import ConvexHull, QhullError

from sionna_radar.foundation.compiled import compiled
from sionna_radar.scene.model import Body, Surface
from sionna_radar.scene.raycast import RayCaster

# Points of a face that decide whether it is partly hidden, in barycentric coordinates: the middle, and the corners
# drawn in by a thousandth, which keeps them off the faces beside.
PROBES = np.vstack([np.full(3, 1 / 3), np.eye(3) + 1e-3 * (1 / 3 - np.eye(3))])
# A partly hidden face is sampled at the middles of the triangles that divide its sides by this number. Twice as many
# halve the error of the lit area, at most a sixteenth of it for a straight shadow, and take four times as many rays.
SHADOW_CUTS = 8
# Faces whose unit normals, and offsets over the body's radius, are this near lie in one plane.
SAME_PLANE = 1e-4
# A closed body whose volume is so near to that of its hull is convex.
SAME_VOLUME = 1e-3


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

    def seen(self, radar_m: Float[np.ndarray, "place 3"]) -> Float[np.ndarray, "place face"]:
        """Return the visible fraction of each face's area from places, given in the body's axes.

        Either side of an open sheet counts, the back of a closed surface never. What hides a face is sought from the
        face toward the place, whatever their distance: the opposite side of a thin pipe, too.
        """
        facing = np.einsum("pfi,fi->pf", radar_m[:, None] - self.middle_m, self.normal_m2)
        share = np.where(self.body.two_sided, facing != 0, facing > 0).astype(np.float64)
        if not self.sees_itself:
            return share
        place, face = np.nonzero(share)
        share[place, face] = self._visible(radar_m, place, face, PROBES)
        partly = (share[place, face] > 0) & (share[place, face] < 1)
        place, face = place[partly], face[partly]
        share[place, face] = self._visible(radar_m, place, face, _subdivided_middles(SHADOW_CUTS))
        return share

    def _visible(
        self,
        radar_m: Float[np.ndarray, "place 3"],
        place: Int[np.ndarray, " n"],
        face: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "point 3"],
    ) -> Float[np.ndarray, " n"]:
        """Return the fraction of points of faces that the body does not hide from places."""
        count = len(barycentric)
        point_m = np.einsum("qk,nki->nqi", barycentric, self.corner_m[face]).reshape(-1, 3)
        return 1.0 - self.hidden(radar_m, np.repeat(place, count), point_m).reshape(-1, count).mean(axis=1)

    @cached_property
    def plane(self) -> Int[np.ndarray, " face"]:
        """Number of the plane that each face lies in."""
        return self._planes[0]

    @cached_property
    def plane_normal(self) -> Float[np.ndarray, "plane 3"]:
        """Unit normals of the planes."""
        return self._planes[1]

    @cached_property
    def _planes(self) -> tuple[Int[np.ndarray, " face"], Float[np.ndarray, "plane 3"]]:
        middle_m, radius_m = self.sphere
        unit = self.normal_m2 / np.linalg.norm(self.normal_m2, axis=1)[:, None]
        offset = np.einsum("fi,fi->f", self.middle_m - middle_m, unit) / radius_m
        key = np.round(np.column_stack([unit, offset]) / SAME_PLANE).astype(np.int64)
        _, first, plane = np.unique(key, axis=0, return_index=True, return_inverse=True)
        return plane.reshape(-1), unit[first]

    @cached_property
    def sees_itself(self) -> bool:
        """Whether a wave may go from one face to another: not on a single plane, nor on a closed convex body."""
        if len(self.plane_normal) < 2:
            return False
        try:
            hull_m3 = float(ConvexHull(self.body.vertices_m).volume)
        except QhullError:  # thin as a sheet
            return False
        volume_m3 = float(np.einsum("fi,fi->", self.middle_m - self.sphere[0], self.normal_m2)) / 3
        return bool(self.body.two_sided.any()) or abs(volume_m3 - hull_m3) > SAME_VOLUME * hull_m3

    def hidden(
        self, radar_m: Float[np.ndarray, "place 3"], row: Int[np.ndarray, " n"], point_m: Float[np.ndarray, "n 3"]
    ) -> Bool[np.ndarray, " n"]:
        """Return True where the body hides points on it from the places in given rows, in its axes."""
        # From the body on: places far away are no place of single precision.
        away = radar_m[row] - point_m
        toward = self.sphere[1] * away / np.linalg.norm(away, axis=1)[:, None]
        return self.hides(point_m + SAME_PLANE * toward, point_m + 3 * toward)

    def first_hit(
        self, start_m: Float[np.ndarray, "n 3"], direction: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Return the distance along rays to the first face, m, infinite for none, and its number."""
        hits = self._caster.cast(start_m, direction)
        return hits.distance_m, hits.face

    @cached_property
    def sphere(self) -> tuple[Float[np.ndarray, " 3"], float]:
        """A sphere around the body, in its axes: middle and radius."""
        low, high = self.body.vertices_m.min(axis=0), self.body.vertices_m.max(axis=0)
        return (low + high) / 2, float(np.linalg.norm(high - low)) / 2

    def hides(self, start_m: Float[np.ndarray, "n 3"], end_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return True where the body is between places, in its axes."""
        return self._caster.hides(start_m, np.arange(len(start_m)), end_m, 0.0)

    def amplitude(self, radar_m: Float[np.ndarray, "place 3"]) -> Complex[np.ndarray, "place face"]:
        """Return the square root of the cross-section of each face, complex relative to the phase of its middle.

        Zero for faces that are not seen from a place.
        """
        out = np.zeros((len(radar_m), len(self.body.faces)), dtype=np.complex128)
        radar_m = np.ascontiguousarray(radar_m, dtype=np.float64)
        face_amplitudes(
            radar_m, self.corner_m, self.middle_m, self.normal_m2, self.wavelength_m, self.seen(radar_m), out
        )
        return np.sqrt(self.body.reflectivity) * out


@lru_cache(maxsize=1)
def _subdivided_middles(cuts: int) -> Float[np.ndarray, "part 3"]:
    """Return the middles of the cuts^2 equal triangles of a triangle, in barycentric coordinates."""
    first, second = np.meshgrid(np.arange(cuts), np.arange(cuts), indexing="ij")
    third = cuts - 1 - first - second
    upright, turned = third >= 0, third >= 1
    corner = np.stack([first, second, third], axis=-1)
    return np.vstack([corner[upright] + 1 / 3, corner[turned] + [2 / 3, 2 / 3, -1 / 3]]) / cuts


@lru_cache(maxsize=16)
def scatterer_of(body: Body, wavelength_m: float) -> Scatterer:
    """Return a body as it scatters; the last ones are kept."""
    return Scatterer(body, wavelength_m)


# Exponents nearer to each other than this are taken by the series about their mean.
NEAR = 0.5
TERMS = 12


@compiled
@no_type_check
def first_difference(a, b):
    """Return (exp(j b) - exp(j a)) / (j (b - a))."""
    half = (b - a) / 2
    share = 1.0 - half * half / 6 if abs(half) < 1e-4 else np.sin(half) / half
    middle = (a + b) / 2
    return complex(np.cos(middle), np.sin(middle)) * share


@compiled
@no_type_check
def second_difference(a, b, c):
    """Return the divided difference of the exponential at j a, j b and j c: 1 / 2 where they are all zero."""
    low, high = min(a, b, c), max(a, b, c)
    between = a + b + c - low - high
    if high - low > NEAR:
        return (first_difference(between, high) - first_difference(low, between)) / (1j * (high - low))
    # exp(j m) times the sum over n of h_n / (n + 2)!, h_n the complete symmetric polynomials of the distances.
    middle = (a + b + c) / 3
    x, y, z = 1j * (low - middle), 1j * (between - middle), 1j * (high - middle)
    one, two, three = 1.0 + 0j, 1.0 + 0j, 1.0 + 0j
    total, factorial = 0.5 + 0j, 2.0
    for n in range(1, TERMS):
        one *= x
        two = one + y * two
        three = two + z * three
        factorial *= n + 2
        total += three / factorial
    return total * complex(np.cos(middle), np.sin(middle))


@compiled
@no_type_check
def second_differences(phase):
    """Return the divided differences of the exponential at rows of three phases."""
    out = np.empty(len(phase), dtype=np.complex128)
    for row in range(len(phase)):
        out[row] = second_difference(phase[row, 0], phase[row, 1], phase[row, 2])
    return out


@compiled
@no_type_check
def face_amplitudes(radar, corner, middle, normal, wavelength, seen, out):
    """Write the amplitude of each face seen from each place, relative to the phase of its middle."""
    twice = 4.0 * np.pi / wavelength
    phase = np.empty(3)
    for place in range(len(radar)):
        for face in range(len(corner)):
            if seen[place, face] == 0.0:
                continue
            x, y, z = (
                middle[face, 0] - radar[place, 0],
                middle[face, 1] - radar[place, 1],
                middle[face, 2] - radar[place, 2],
            )
            distance = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / distance, y / distance, z / distance
            for k in range(3):
                phase[k] = -twice * (
                    x * (corner[face, k, 0] - middle[face, 0])
                    + y * (corner[face, k, 1] - middle[face, 1])
                    + z * (corner[face, k, 2] - middle[face, 2])
                )
            across = abs(x * normal[face, 0] + y * normal[face, 1] + z * normal[face, 2])
            out[place, face] = (
                seen[place, face]
                * (2.0 * np.sqrt(np.pi) / wavelength * across * 2.0)
                * second_difference(phase[0], phase[1], phase[2])
            )
