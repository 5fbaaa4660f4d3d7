"""Mirror reflections: plane patches of a surface that send the wave straight back.

A plane large against the first Fresnel zone acts as a mirror: the echo is that of the radar's own image, twice as
far away as the plane, so |gain| = G |R| lambda / (4 pi 2 r), with R the coherent reflection at right angles. It
comes from the foot of the perpendicular from the radar onto the plane.

                radar            Faces that lie in one plane and touch form a patch. The foot must lie inside it,
                  |              at least one Fresnel radius sqrt(lambda r / 2) from its border (0.3 m at 50 m):
                  | r            a smaller facet is no mirror, and its diffuse return stands for it.
      ------------+---------
                foot             A patch that is only just large enough shines like an endless plane; the ripple
                                 of diffraction at its border, up to 6 dB, is not modelled.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.constants import speed_of_light
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.scene.radar_material import as_radar_material
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths

# Corners nearer than this are one, and faces whose normals differ by less are in one plane (1e-9: 0.003 deg).
SAME_CORNER_M = 1e-3
SAME_PLANE = 1e-9
# The float32 of the ray caster.
TOUCHING_M = 0.02
# Nearer mirrors are not looked for, so that small facets need not be kept.
LEAST_RANGE_M = 1.0


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A plane piece of a surface.

    border_m: segments of its outline, in the plane's own two coordinates about `centre_m`.
    """

    surface: int
    amplitude: complex
    normal: Float[np.ndarray, " 3"]
    axes: Float[np.ndarray, "2 3"]
    centre_m: Float[np.ndarray, " 3"]
    border_m: Float[np.ndarray, "edge 2 2"]

    @property
    def radius_m(self) -> float:
        """Distance from the centre to the farthest corner."""
        return float(np.linalg.norm(self.border_m, axis=2).max())

    def depth_m(self, point_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return how far inside the border points of the plane lie; negative outside."""
        start, along = self.border_m[:, 0], self.border_m[:, 1] - self.border_m[:, 0]
        away = point_m[:, None] - start
        share = np.clip((away * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
        nearest = np.linalg.norm(away - share[:, :, None] * along, axis=2).min(axis=1)
        # Inside, a line to the right crosses the border an odd number of times.
        y, y0, dy = point_m[:, 1:2], start[:, 1], along[:, 1]
        level = (y0 <= y) != (y0 + dy <= y)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = start[:, 0] + (y - y0) / dy * along[:, 0]
        odd = (level & (crossing > point_m[:, :1])).sum(axis=1) % 2 == 1
        return np.where(odd, nearest, -nearest)


def patches_of(surface: Surface, number: int, amplitude: complex, least_m: float) -> list[Patch]:
    """Return the plane patches of a surface that have room for a circle of radius `least_m`, nearly."""
    corners, faces = _welded(surface)
    corner = corners[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    area = np.linalg.norm(normal, axis=1)
    # A face of no area has no plane.
    faces, corner, normal = faces[area > 0], corner[area > 0], normal[area > 0] / area[area > 0][:, None]
    border, owner, first_face = _borders(faces, normal)
    patches = []
    by_owner = np.argsort(owner, kind="stable")
    for edges in np.split(by_owner, np.flatnonzero(np.diff(owner[by_owner])) + 1):
        outline = corners[border[edges]]
        if np.ptp(outline.reshape(-1, 3), axis=0).max() < 2 * least_m / np.sqrt(3):
            continue
        patches.append(_patch(number, amplitude, normal[first_face[owner[edges[0]]]], outline))
    return patches


def _borders(
    faces: Int[np.ndarray, "face 3"], normal: Float[np.ndarray, "face 3"]
) -> tuple[Int[np.ndarray, "edge 2"], Int[np.ndarray, " edge"], Int[np.ndarray, " patch"]]:
    """Return the border edges of all patches, the patch of each, and one face of each patch."""
    edge = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edge_number = np.unique(edge, axis=0, return_inverse=True)[1].ravel()
    label = _planes(edge_number, normal)
    # An edge between two faces of one patch is no border.
    owner = np.repeat(label, 3)
    order = np.lexsort([owner, edge_number])
    twice = np.zeros(len(order), dtype=bool)
    same = (np.diff(edge_number[order]) == 0) & (np.diff(owner[order]) == 0)
    twice[order[:-1][same]] = twice[order[1:][same]] = True
    border, owner = edge[~twice], owner[~twice]
    return border, owner, np.unique(label, return_index=True)[1]


def _patch(
    surface: int, amplitude: complex, normal: Float[np.ndarray, " 3"], outline: Float[np.ndarray, "edge 2 3"]
) -> Patch:
    first = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    axes = np.stack([first, np.cross(normal, first)])
    low, high = outline.reshape(-1, 3).min(axis=0), outline.reshape(-1, 3).max(axis=0)
    # The middle of the box may lie off the plane of a slanted patch.
    centre = (low + high) / 2
    centre = centre - (centre - outline[0, 0]) @ normal * normal
    return Patch(
        surface=surface,
        amplitude=amplitude,
        normal=normal,
        axes=axes,
        centre_m=centre,
        border_m=(outline - centre) @ axes.T,
    )


def _welded(surface: Surface) -> tuple[Float[np.ndarray, "corner 3"], Int[np.ndarray, "face 3"]]:
    """Return a surface's corners and faces with equal corners made one."""
    cell = np.round(surface.vertices_m / SAME_CORNER_M).astype(np.int64)
    _, first, number = np.unique(cell, axis=0, return_index=True, return_inverse=True)
    return surface.vertices_m[first], number.ravel()[surface.faces]


def _planes(edge_number: Int[np.ndarray, " n"], normal: Float[np.ndarray, "face 3"]) -> Int[np.ndarray, " face"]:
    """Return a number for each face, the same for faces that touch and lie in one plane."""
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
        least_m = float(self._fresnel_radius_m(np.array([LEAST_RANGE_M]))[0])
        self._patches: list[Patch] = []
        for number, surface in enumerate(scene.surfaces):
            mirror = as_radar_material(scene.materials[surface.material]).mirror
            if mirror is not None and antenna.receives == "co":
                self._patches += patches_of(surface, number, mirror.amplitude, least_m)
        self._normal = np.array([p.normal for p in self._patches]).reshape(-1, 3)
        self._centre_m = np.array([p.centre_m for p in self._patches]).reshape(-1, 3)
        self._radius_m = np.array([p.radius_m for p in self._patches])

    def __len__(self) -> int:
        return len(self._patches)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the mirror paths of a block of pulses, sorted by pulse."""
        rows, feet, patch = self._feet(pulses.true.position_m)
        position, velocity = pulses.true.position_m[rows], pulses.true.velocity_mps[rows]
        away = feet - position
        range_m = np.linalg.norm(away, axis=1)
        direction = away / range_m[:, None]
        gain = self._antenna.gain(np.einsum("nij,ni->nj", pulses.true.R_world_antenna[rows], direction))
        seen = gain > 0
        seen[seen] = self._caster.visible(position[seen], feet[seen], TOUCHING_M)
        amplitude = np.array([p.amplitude for p in self._patches], dtype=np.complex128)[patch]
        echo = gain * amplitude * self._wavelength_m / (8 * np.pi * range_m)
        order = np.flatnonzero(seen)[np.argsort(rows[seen], kind="stable")]
        return Paths(
            pulse=pulses.index[rows][order],
            delay_s=2 * range_m[order] / speed_of_light,
            gain=echo[order],
            range_rate_mps=-np.einsum("ni,ni->n", velocity, direction)[order],
            incidence_rad=np.zeros(len(order)),
            hit_m=feet[order],
            surface=np.array([p.surface for p in self._patches], dtype=np.int64)[patch][order],
        )

    def _fresnel_radius_m(self, range_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the radius from which a path to a plane and back is half a wavelength longer."""
        radius: Float[np.ndarray, " n"] = np.sqrt(self._wavelength_m * range_m / 2)
        return radius

    def _feet(
        self, position_m: Float[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " foot"], Float[np.ndarray, "foot 3"], Int[np.ndarray, " foot"]]:
        """Return the row, place and patch of every foot inside a patch with room for the Fresnel zone."""
        rows, feet, numbers = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
        for number in np.flatnonzero(self._possible(position_m)):
            patch = self._patches[number]
            away = position_m - patch.centre_m
            height, plan = away @ patch.normal, away @ patch.axes.T
            row = np.flatnonzero((height > 0) & (np.linalg.norm(plan, axis=1) < patch.radius_m))
            row = row[patch.depth_m(plan[row]) >= self._fresnel_radius_m(height[row])]
            rows.append(row)
            feet.append(patch.centre_m + plan[row] @ patch.axes)
            numbers.append(np.full(len(row), number))
        return np.concatenate(rows), np.concatenate(feet), np.concatenate(numbers)

    def _possible(self, position_m: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " patch"]:
        """Tell which patches may be mirrors for some of the positions: a bound from the ball around them."""
        middle = (position_m.min(axis=0) + position_m.max(axis=0)) / 2
        reach = np.linalg.norm(position_m - middle, axis=1).max()
        away = middle - self._centre_m
        height = np.einsum("ni,ni->n", away, self._normal)
        plan = np.sqrt(np.maximum((away**2).sum(axis=1) - height**2, 0.0))
        near = plan < self._radius_m + reach
        large = self._radius_m >= self._fresnel_radius_m(np.maximum(height - reach, 0.0))
        return near & large & (height > -reach)
