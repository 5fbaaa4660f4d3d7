"""Coherent mirror reflections of plane surface patches, by physical optics.

An infinite plane is a mirror: its echo is that of the radar's own image, twice as far away as the plane, so
|gain| = G |R| lambda / (4 pi 2 h), with R the coherent reflection at normal incidence and h the distance to the foot of
the perpendicular from the radar onto the plane. For a patch, the border adds edge waves.

                radar            Adjacent coplanar faces form a patch. Its echo relative to that of the infinite
                  |              plane is the Kirchhoff integral over the patch, which radial integration turns into
                  | h            one along the border:
      ------------+---------
                foot                 F = w - 1/(2 pi) * integral of (h / r)^2 exp(-2 j k (r - h)) dphi,

with w = 1 when the foot lies inside and 0 when outside, r the distance from the radar to the border, and phi the
angle about the foot (following Maggi 1888 and Rubinowicz 1917; the obliquity and the spread h / r vary slowly).
A patch much larger than the first Fresnel zone (radius sqrt(lambda h / 2), 0.3 m at 50 m) has F = 1 inside, 1/2 on
its edge and ripples between; a small one becomes a plate in the far field, with cross-section 4 pi A^2 / lambda^2.
Along an edge at the distance d from the foot, r in the phase is expanded to second order about its nearest point: the
integrand is d / (d^2 + t^2) (h / r)^2, piecewise linear, times a Fresnel phase, which is exact.

A ray is reflected at a plane mirror of the scene by Fresnel's coefficients at its own angle, less the roughness. A wave
of direction k meets a plane of normal n. With h across the plane of incidence, the reflected field is

    E' = sqrt(c) [ R_h h (h . E)  +  R_v (h x k') ((h x k) . E) ],      k' = k - 2 (k . n) n,

R_h and R_v as in `surfaces.rough_surface.fresnel_reflection`, c = exp(-(2 k s cos t)^2) the share that a roughness s
leaves coherent, at the incidence t of the ray.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import fresnel

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.radar_material import Mirror, as_radar_material
from sionna_radar.surfaces.rough_surface import coherent_power_factor, fresnel_reflection
from sionna_radar.tracing.paths import Paths

# Corners closer than this are merged, and faces whose normals differ by less are coplanar (1e-9: 0.003 deg).
SAME_CORNER_M = 1e-3
SAME_PLANE = 1e-9
# The float32 precision of the ray caster.
TOUCHING_M = 0.02
# Physical optics is valid for patches of several wavelengths; smaller ones are left to the diffuse echo.
MIN_WAVELENGTHS = 2.0
# The echo of a patch fades out (at -25 to -30 dB) as its foot moves from the first to the second distance outside,
# in Fresnel radii; gradually, since on a curved surface of many facets a sudden end would appear as an edge.
OUTSIDE_RADII = 3.0, 6.0
# An edge this many Fresnel radii away does not affect an echo.
EDGE_RADII = 12.0
MIN_DISTANCE_M = 1e-4
# Nodes of an edge between which dphi is linear.
EDGE_NODES = 129


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A plane piece of a surface.

    border_m: segments of its outline, in the plane's own two coordinates about `centre_m`; the patch on their left.
    """

    surface: int
    normal: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "2 3"]
    centre_m: Float[np.ndarray, " 3"]
    border_m: Float[np.ndarray, "edge 2 2"]

    @property
    def radius_m(self) -> float:
        """Distance from the centre to the farthest corner."""
        return float(np.linalg.norm(self.border_m, axis=2).max())

    def nearest_m(self, point_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Return the point of the border nearest to each point of the plane."""
        start, along = self.border_m[:, 0], self.border_m[:, 1] - self.border_m[:, 0]
        fraction = np.clip(((point_m[:, None] - start) * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        place = start + fraction[:, :, None] * along
        nearest = np.argmin(((place - point_m[:, None]) ** 2).sum(axis=2), axis=1)
        return place[np.arange(len(point_m)), nearest]

    def holds(self, point_m: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        """Return True where points of the plane lie inside: the border winds around them once."""
        return _turns(*self._seen_from(point_m)) > 0

    def _seen_from(
        self, point_m: Float[np.ndarray, "n 2"]
    ) -> tuple[Float[np.ndarray, "n edge"], Float[np.ndarray, "n edge"], Float[np.ndarray, "n edge"]]:
        """Return the distance of each edge's line, positive to its left, and the positions of its ends along it."""
        start, end = self.border_m[:, 0], self.border_m[:, 1]
        along = (end - start) / np.linalg.norm(end - start, axis=1)[:, None]
        x, y = np.moveaxis(start - point_m[:, None], 2, 0)
        distance = x * along[:, 1] - y * along[:, 0]
        first = x * along[:, 0] + y * along[:, 1]
        # Exactly on an edge's line the sign selects the side of a point; a tenth of a millimetre changes no echo.
        distance = np.where(np.abs(distance) < MIN_DISTANCE_M, MIN_DISTANCE_M, distance)
        return distance, first, first + np.linalg.norm(end - start, axis=1)

    def factor(
        self, foot_m: Float[np.ndarray, "n 2"], height_m: Float[np.ndarray, " n"], wavelength_m: float
    ) -> Complex[np.ndarray, " n"]:
        """Return the echo of the patch relative to that of the infinite plane, F in the module docstring.

        foot_m, height_m: feet of the perpendiculars from the radar, in the coordinates of the plane, and their lengths.
        wavelength_m: wavelength of the carrier.
        """
        distance, first, last = self._seen_from(foot_m)
        factor = _turns(distance, first, last).astype(np.complex128)
        nearest = np.hypot(distance, np.maximum(np.maximum(first, -last), 0.0))
        row, edge = np.nonzero(nearest < EDGE_RADII * lobe_m(height_m, wavelength_m, self.radius_m)[:, None])
        waves = _edge_wave(
            distance[row, edge], first[row, edge], last[row, edge], height_m[row], 2 * np.pi / wavelength_m
        )
        np.subtract.at(factor, row, waves / (2 * np.pi))
        return factor


def _turns(
    distance_m: Float[np.ndarray, "n edge"], first_m: Float[np.ndarray, "n edge"], last_m: Float[np.ndarray, "n edge"]
) -> Float[np.ndarray, " n"]:
    """Return the winding number of a border around each point: 1 inside, 0 outside."""
    angle = (np.arctan(last_m / distance_m) - np.arctan(first_m / distance_m)).sum(axis=1)
    return np.round(angle / (2 * np.pi))


def lobe_m(
    height_m: Float[np.ndarray, " n"], wavelength_m: float, radius_m: Float[np.ndarray, " n"] | float
) -> Float[np.ndarray, " n"]:
    """Return the Fresnel radius, from which a path to a plane and back is half a wavelength longer, for a patch.

    The lobes of a patch smaller than that extend farther, by the ratio.
    """
    fresnel_m = np.sqrt(wavelength_m * height_m / 2)
    return fresnel_m * np.maximum(1.0, fresnel_m / radius_m)


def _edge_wave(
    distance_m: Float[np.ndarray, " n"],
    first_m: Float[np.ndarray, " n"],
    last_m: Float[np.ndarray, " n"],
    height_m: Float[np.ndarray, " n"],
    wavenumber: float,
) -> Complex[np.ndarray, " n"]:
    """Return the integral of (h / r)^2 exp(-2 j k (r - h)) dphi along edges."""
    size = np.abs(distance_m)
    # Nodes are dense where dphi/dt is high; there dphi = du / cosh u with t = |d| sinh u.
    fraction = np.linspace(0.0, 1.0, EDGE_NODES)
    low, high = np.arcsinh(first_m / size), np.arcsinh(last_m / size)
    place = size[:, None] * np.sinh(low[:, None] + (high - low)[:, None] * fraction)
    squared_range = distance_m[:, None] ** 2 + place**2
    weight = distance_m[:, None] / squared_range / (1 + squared_range / height_m[:, None] ** 2)
    # r is expanded about the edge's nearest point, where it is exact, so that the corners of small patches match.
    nearest = np.clip(0.0, first_m, last_m)
    line_m = np.hypot(height_m, distance_m)
    slant = np.hypot(line_m, nearest)
    bend = (wavenumber * line_m**2 / slant**3)[:, None]
    # Completing the square: the phase is bend * x^2 with x = t - centre, and a constant.
    centre = (nearest - nearest * slant**2 / line_m**2)[:, None]
    x = place - centre
    sine, cosine = fresnel(x * np.sqrt(2 * bend / np.pi))
    swept = np.sqrt(np.pi / (2 * bend)) * (cosine - 1j * sine)
    moment = 0.5j / bend * np.exp(-1j * bend * x**2)
    slope = np.diff(weight, axis=1) / np.maximum(np.diff(place, axis=1), 1e-300)
    level = weight[:, :-1] - slope * x[:, :-1]
    wave = (level * np.diff(swept, axis=1) + slope * np.diff(moment, axis=1)).sum(axis=1)
    # slant - height without cancellation, minus the value of the square at the nearest point.
    longer = (distance_m**2 + nearest**2) / (slant + height_m)
    return wave * np.exp(1j * (bend[:, 0] * (nearest - centre[:, 0]) ** 2 - 2 * wavenumber * longer))


def patches_of(surface: Surface, number: int, least_m: float) -> list[Patch]:
    """Return the plane patches of a surface that are at least `least_m` long."""
    corners, faces = _welded(surface)
    corner = corners[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1)
    # A degenerate face has no plane.
    faces, corner, normal = faces[area > 0], corner[area > 0], normal[area > 0] / area[area > 0][:, None]
    border, owner, first_face = _borders(faces, normal)
    patches: list[Patch] = []
    if len(owner) == 0:
        return patches  # no face has an area
    by_owner = np.argsort(owner, kind="stable")
    for edges in np.split(by_owner, np.flatnonzero(np.diff(owner[by_owner])) + 1):
        outline = corners[border[edges]]
        if np.ptp(outline.reshape(-1, 3), axis=0).max() < least_m / np.sqrt(3):
            continue
        patches.append(_patch(number, normal[first_face[owner[edges[0]]]], outline))
    return patches


def _borders(
    faces: Int[np.ndarray, "face 3"], normal: Float[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, "edge 2"], Int[np.ndarray, " edge"], Int[np.ndarray, " patch"]]:
    """Return the border edges of all patches as their faces wind, the patch of each, and one face of each patch."""
    edge = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edge_number = np.unique(np.sort(edge, axis=1), axis=0, return_inverse=True)[1].ravel()
    label = _planes(edge_number, normal)
    # An edge between two faces of the same patch is not on the border.
    owner = np.repeat(label, 3)
    order = np.lexsort([owner, edge_number])
    twice = np.zeros(len(order), dtype=bool)
    same = (np.diff(edge_number[order]) == 0) & (np.diff(owner[order]) == 0)
    twice[order[:-1][same]] = twice[order[1:][same]] = True
    border, owner = edge[~twice], owner[~twice]
    return border, owner, np.unique(label, return_index=True)[1]


def _patch(surface: int, normal: Float[np.ndarray, " 3"], outline: Float[np.ndarray, "edge 2 3"]) -> Patch:
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    low, high = outline.reshape(-1, 3).min(axis=0), outline.reshape(-1, 3).max(axis=0)
    # The centre of the box may be off the plane of a slanted patch.
    centre = (low + high) / 2
    centre = centre - (centre - outline[0, 0]) @ normal * normal
    return Patch(
        surface=surface,
        normal=normal,
        axes=axes,
        centre_m=centre,
        border_m=(outline - centre) @ axes.T,
    )


def _welded(surface: Surface) -> tuple[Float[np.ndarray, "corner 3"], Int[np.ndarray, "face 3"]]:
    """Return a surface's corners and faces with equal corners merged."""
    cell = np.round(surface.vertices_m / SAME_CORNER_M).astype(np.int64)
    _, first, number = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    return surface.vertices_m[first], number.ravel()[surface.faces]


def _planes(edge_number: Int[np.ndarray, " n"], normal: Float[np.ndarray, "face 3"]) -> Int[np.ndarray, " face"]:
    """Return a label for each face, the same for adjacent coplanar faces."""
    order = np.argsort(edge_number, kind="stable")
    shared = np.flatnonzero(np.diff(edge_number[order]) == 0)
    one, other = order[shared] // 3, order[shared + 1] // 3
    flat = np.einsum("ni,ni->n", normal[one], normal[other]) > 1 - SAME_PLANE
    one, other = one[flat], other[flat]
    graph = coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(len(normal), len(normal)))
    return connected_components(graph, directed=False)[1]


class MirrorTracer:
    """Traces the mirror reflections of a scene."""

    def __init__(self, scene: Scene, antenna: Antenna, chirp: Chirp, caster: RayCaster) -> None:
        self._antenna, self._wavelength_m, self._caster = antenna, chirp.wavelength_m, caster
        mirrors = plane_mirrors(scene, chirp) if antenna.mirrored != 0 else []
        self._patches = [m.patch for m in mirrors]
        self._amplitude = np.array([m.mirror.amplitude * antenna.mirrored for m in mirrors], dtype=np.complex128)
        self._normal = np.array([p.normal for p in self._patches]).reshape(-1, 3)
        self._centre_m = np.array([p.centre_m for p in self._patches]).reshape(-1, 3)
        self._radius_m = np.array([p.radius_m for p in self._patches])

    def __len__(self) -> int:
        return len(self._patches)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the mirror paths of a block of pulses, sorted by pulse."""
        rows, place, height, factor, patch = self._echoes(pulses.true.position_m)
        position = pulses.true.position_m[rows]
        away = place - position
        range_m = np.linalg.norm(away, axis=1)
        direction = away / range_m[:, None]
        gain = self._antenna.gain(np.einsum("nij,ni->nj", pulses.true.R_world_antenna[rows], direction))
        seen = gain > 0
        seen[seen] = self._caster.visible(position[seen], place[seen], TOUCHING_M)
        # The phase of the factor is relative to the foot, the delay of the path to the nearest point of the patch.
        turn = np.exp(4j * np.pi / self._wavelength_m * (range_m - height))
        echo = gain * self._amplitude[patch] * self._wavelength_m / (8 * np.pi * height) * factor * turn
        order = np.flatnonzero(seen)[np.argsort(rows[seen], kind="stable")]
        return Paths.to_points(
            pulses,
            rows[order],
            place[order],
            gain=echo[order],
            incidence_rad=np.arccos(np.minimum(height / range_m, 1.0))[order],
            surface=np.array([p.surface for p in self._patches], dtype=np.int64)[patch][order],
        )

    def _echoes(
        self, position_m: Float[np.ndarray, "n 3"]
    ) -> tuple[
        Int[np.ndarray, " echo"],
        Float[np.ndarray, "echo 3"],
        Float[np.ndarray, " echo"],
        Complex[np.ndarray, " echo"],
        Int[np.ndarray, " echo"],
    ]:
        """Return row, nearest point, height above the plane, factor and patch of every mirror echo."""
        echoes = []
        for number in np.flatnonzero(self._possible(position_m)):
            patch = self._patches[number]
            away = position_m - patch.centre_m
            height, foot = away @ patch.normal, away @ patch.axes.T
            reach = OUTSIDE_RADII[1] * lobe_m(np.maximum(height, 0.0), self._wavelength_m, patch.radius_m)
            row = np.flatnonzero((height > 0) & (np.linalg.norm(foot, axis=1) < patch.radius_m + reach))
            inside = patch.holds(foot[row])
            place = np.where(inside[:, None], foot[row], patch.nearest_m(foot[row]))
            offset = np.linalg.norm(place - foot[row], axis=1) / reach[row]
            row, place, offset = row[offset < 1], place[offset < 1], offset[offset < 1]
            factor = patch.factor(foot[row], height[row], self._wavelength_m) * taper(
                offset, OUTSIDE_RADII[0] / OUTSIDE_RADII[1]
            )
            world = patch.centre_m + place @ patch.axes
            echoes.append((row, world, height[row], factor, np.full(len(row), number)))
        if not echoes:
            none = np.zeros(0, dtype=np.int64)
            return none, np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.complex128), none
        rows, places, heights, factors, numbers = (np.concatenate(column) for column in zip(*echoes, strict=True))
        return rows, places, heights, factors, numbers

    def _possible(self, position_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " patch"]:
        """Return True where patches may be mirrors for any of the positions: a bound from the sphere around them."""
        middle = (position_m.min(axis=0) + position_m.max(axis=0)) / 2
        reach = np.linalg.norm(position_m - middle, axis=1).max()
        away = middle - self._centre_m
        height = np.einsum("ni,ni->n", away, self._normal)
        plan = np.sqrt(np.maximum((away**2).sum(axis=1) - height**2, 0.0))
        outside = OUTSIDE_RADII[1] * lobe_m(np.maximum(height + reach, 0.0), self._wavelength_m, self._radius_m)
        return (plan < self._radius_m + reach + outside) & (height > -reach)


def taper(fraction: Float[np.ndarray, " n"], inner: float) -> Float[np.ndarray, " n"]:
    """Return 1 up to the inner share of a distance, falling smoothly to 0 at a share of 1."""
    return np.cos(np.pi / 2 * np.clip((fraction - inner) / (1 - inner), 0.0, 1.0)) ** 2


@dataclass(frozen=True, kw_only=True)
class PlaneMirror:
    """A plane patch of a surface, and what it is made of."""

    patch: Patch
    mirror: Mirror

    def height_m(self, point_m: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Return the heights of points over the plane, positive in front of it."""
        return (point_m - self.patch.centre_m) @ self.patch.normal

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
    return across / np.linalg.norm(across, axis=1)[:, None]


def plane_mirrors(scene: Scene, chirp: Chirp) -> list[PlaneMirror]:
    """Return the plane patches of all surfaces whose material reflects as a mirror."""
    least_m = MIN_WAVELENGTHS * chirp.wavelength_m
    mirrors = []
    for number, surface in enumerate(scene.surfaces):
        mirror = as_radar_material(scene.materials[surface.material]).mirror
        if mirror is not None:
            mirrors += [PlaneMirror(patch=p, mirror=mirror) for p in patches_of(surface, number, least_m)]
    return mirrors
