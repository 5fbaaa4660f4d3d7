"""Dihedral corner reflectors: two mirrors that meet at a right angle return waves from the plane across their edge.

                  B |                 The wave meets A and then B, or B and then A: both orders together send a strip
                    |   to the radar  of it back, which reaches w = min(a sin p, b cos p) to either side of the edge,
        radar <- - -|. . . . u        for faces as deep as a and b, p the angle between A and the way u to the radar.
                  b |  /              The strip returns to the radar whatever p is: it is a plate that faces the radar,
                    | / p             with the reflection of A times that of B. So the echo is that of the radar's
                    +--------- A      image at the edge, twice its distance h away, times Fresnel integrals of the
                        a             strip and of the edge's length,

    gain = G R_A R_B lambda / (4 pi 2 h) * F(strip) F(length),    F = sqrt(2 j / (lambda h)) int exp(-j k x^2 / h) dx.

Beside its ends the edge is met under a slant, t out of the plane across it: along it the range is expanded about the
nearest end, r + ((x - s)^2 - s^2) cos^2 t / 2 r with s = r sin t / cos^2 t, and r stands for h. So a short dihedral has
the lobes sin(k L sin t) / (k L sin t) of its length L, and cos t of a plate. Between both faces a ray in the strip's
place x goes x tan t / (sin p cos p) along the edge: by so much the length that sends it back is less.
A long deep dihedral has F = 1: the mirror at its edge. A small one becomes a plate of area 2 w L, at p = 45 deg with
a = b of cross-section 8 pi a^2 L^2 / lambda^2 (Knott, Shaeffer and Tuley, "Radar Cross Section"). Faces that meet at
90 deg - e send the two halves of the strip aside, as plates turned by e: their foot lies h tan(e) from the edge.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.spatial import KDTree
from scipy.special import fresnel

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.mirrors import TOUCHING_M, PlaneMirror, taper
from sionna_radar.tracing.paths import BOUNCED, Paths

# Faces farther from a right angle return nothing: plates so turned that only their far side lobes see the radar.
MAX_TURN_RAD = float(np.deg2rad(3.0))
# Echoes weaker than this fraction of the dihedral's greatest field are left out.
MIN_FIELD = 1e-3
# Side lobes along the edge fade out where they are this share of it, from the first to the second.
LOBES_FADE = 10**-1.5, 1e-2
# Of half the strip, over each of which the length that both faces send back is even.
STRIP_SEGMENTS = 16
# Rays look at the faces this far from the edge, where the other face does not hide them.
EDGE_OFFSET_M = 0.05


@dataclass(frozen=True, kw_only=True)
class Dihedral:
    """Two plane mirrors that meet.

    edge_m, along: a point of their edge, and its direction.
    faces: unit vectors from the edge into either face, across the edge.
    near_m, far_m: from where to where each face reaches from the edge.
    low_m, high_m: of both, along the edge.
    """

    mirrors: tuple[PlaneMirror, PlaneMirror]
    edge_m: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    faces: Float[np.ndarray, "2 3"]
    near_m: tuple[float, float]
    far_m: tuple[float, float]
    low_m: float
    high_m: float

    @property
    def turn_rad(self) -> float:
        """By how much the angle between the faces is less than a right one."""
        return float(np.arcsin(np.clip(self.faces[0] @ self.faces[1], -1.0, 1.0)))


def dihedrals_of(mirrors: list[PlaneMirror]) -> list[Dihedral]:
    """Return all pairs of mirrors that meet at nearly a right angle with their fronts toward each other."""
    if not mirrors:
        return []
    # From the largest on, so that whatever touches one and comes later is no farther than twice its radius.
    mirrors = sorted(mirrors, key=lambda mirror: -mirror.patch.radius_m)
    normal = np.array([m.patch.normal for m in mirrors])
    centre = np.array([m.patch.centre_m for m in mirrors])
    radius = np.array([m.patch.radius_m for m in mirrors])
    outline = [m.patch.centre_m + m.patch.border_m.reshape(-1, 2) @ m.patch.axes for m in mirrors]
    near = KDTree(centre).query_ball_point(centre, 2 * radius + TOUCHING_M)
    dihedrals = []
    for one, others in enumerate(near):
        other = np.sort(np.array(others, dtype=np.int64))
        other = other[other > one]
        other = other[np.abs(normal[other] @ normal[one]) < np.sin(MAX_TURN_RAD)]
        touch = np.linalg.norm(centre[other] - centre[one], axis=1) < radius[other] + radius[one] + TOUCHING_M
        for number in other[touch]:
            # Walls of one house mostly look away from each other.
            ahead = ((outline[number] - centre[one]) @ normal[one]).max() > TOUCHING_M
            if ahead and ((outline[one] - centre[number]) @ normal[number]).max() > TOUCHING_M:
                corner = _dihedral(mirrors[one], mirrors[number])
                dihedrals += [] if corner is None else [corner]
    return dihedrals


def _dihedral(one: PlaneMirror, other: PlaneMirror) -> Dihedral | None:
    first, second = one.patch.normal, other.patch.normal
    along = np.cross(first, second)
    along /= np.linalg.norm(along)
    offsets = [m.patch.centre_m @ m.patch.normal for m in (one, other)]
    middle = (one.patch.centre_m + other.patch.centre_m) / 2
    edge = np.linalg.solve(np.array([first, second, along]), np.array([*offsets, middle @ along]))
    faces, near, far, low, high = [], [], [], [], []
    for mirror, facing in ((one, second), (other, first)):
        into = np.cross(along, mirror.patch.normal)
        into *= np.sign(into @ facing)
        corner = mirror.patch.centre_m + mirror.patch.border_m.reshape(-1, 2) @ mirror.patch.axes - edge
        faces.append(into)
        near.append(max(float((corner @ into).min()), 0.0))
        far.append(float((corner @ into).max()))
        low.append(float((corner @ along).min()))
        high.append(float((corner @ along).max()))
    if max(low) >= min(high) or max(near) > TOUCHING_M or min(far) <= TOUCHING_M:
        return None
    return Dihedral(
        mirrors=(one, other),
        edge_m=edge,
        along=along,
        faces=np.array(faces),
        near_m=(near[0], near[1]),
        far_m=(far[0], far[1]),
        low_m=max(low),
        high_m=min(high),
    )


class DihedralTracer:
    """Traces the echoes of dihedrals."""

    def __init__(self, dihedrals: list[Dihedral], antenna: Antenna, chirp: Chirp, caster: RayCaster) -> None:
        self._antenna, self._wavelength_m, self._caster = antenna, chirp.wavelength_m, caster
        self._dihedrals = dihedrals
        self._edge_m = np.array([d.edge_m for d in self._dihedrals]).reshape(-1, 3)
        self._along = np.array([d.along for d in self._dihedrals]).reshape(-1, 3)
        self._normal = np.array([[m.patch.normal for m in d.mirrors] for d in self._dihedrals]).reshape(-1, 2, 3)
        self._low_m, self._high_m = np.array([(d.low_m, d.high_m) for d in self._dihedrals]).reshape(-1, 2).T

    def __len__(self) -> int:
        return len(self._dihedrals)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the echoes of a block of pulses, sorted by pulse."""
        none = np.zeros(0, dtype=np.int64)
        empty = self._paths(pulses, none, np.zeros((0, 3)), np.zeros(0, dtype=np.complex128))
        return Paths.concatenate([empty, *(self._echoes(d, pulses) for d in self._possible(pulses))])

    def _possible(self, pulses: Pulses) -> list[Dihedral]:
        """Return the dihedrals across whose edge any of the pulses may stand: a bound from the sphere around them."""
        position = pulses.true.position_m
        middle = (position.min(axis=0) + position.max(axis=0)) / 2
        reach = np.linalg.norm(position - middle, axis=1).max()
        away = middle - self._edge_m
        place = np.einsum("ni,ni->n", away, self._along)
        half = (self._high_m - self._low_m) / 2
        farthest = np.sqrt(np.maximum((away**2).sum(axis=1) - place**2, 0.0)) + reach
        outside = reach + _outside_m(farthest, self._wavelength_m, 2 * half)
        near = (place > self._low_m - outside) & (place < self._high_m + outside)
        near &= (np.einsum("ni,nki->nk", away, self._normal) > -reach).all(axis=1)
        return [self._dihedrals[number] for number in np.flatnonzero(near)]

    def _echoes(self, corner: Dihedral, pulses: Pulses) -> Paths:
        position, wavelength = pulses.true.position_m, self._wavelength_m
        away = position - corner.edge_m
        place = away @ corner.along
        into = np.stack([away @ face for face in corner.faces])
        before = np.stack([m.height_m(position) for m in corner.mirrors])
        height = np.linalg.norm(away - place[:, None] * corner.along, axis=1)
        near, far = self._strip(corner, into, height)
        row = np.flatnonzero((before.min(axis=0) > 0) & (into.min(axis=0) > 0) & (far > near))
        place, height, near, far = place[row], height[row], near[row], far[row]
        foot = height * np.tan(corner.turn_rad)
        end = np.clip(place, corner.low_m, corner.high_m)
        range_m = np.hypot(height, place - end)
        straight = range_m * np.cos(corner.turn_rad)
        squared_cosine, length = (height / range_m) ** 2, corner.high_m - corner.low_m
        slant = (place - end) / squared_cosine
        # Between both faces a ray goes along the edge, by so much for each metre of its place in the strip.
        sines = into[:, row] / height
        shift = np.abs(place - end) / height / (sines[0] * sines[1])
        parts = np.linspace(near, far, STRIP_SEGMENTS + 1)
        cut = np.minimum(shift * (parts[1:] + parts[:-1]) / 2, length) / 2
        low, high = corner.low_m - end - slant + cut, corner.high_m - end - slant - cut
        # Both halves of the strip, each beside a foot of its own.
        strip = 2 * _fresnel_integral(parts[:-1] - foot, parts[1:] - foot, straight, wavelength)
        share = np.sum(strip * _fresnel_integral(low, high, straight / squared_cosine, wavelength), axis=0)
        share *= taper(np.abs(place - end) / _outside_m(height, wavelength, length), LOBES_FADE[1] / LOBES_FADE[0])
        straight_on = 2 * np.abs(_fresnel_integral(near, far, straight, wavelength))
        straight_on *= np.minimum(1.0, length * np.sqrt(2 / (wavelength * height)))
        strong = np.abs(share) > MIN_FIELD * straight_on
        row, place, end, slant, straight, share, range_m, foot = (
            column[strong] for column in (row, place, end, slant, straight, share, range_m, np.clip(foot, near, far))
        )
        edge = corner.edge_m + end[:, None] * corner.along
        amplitude = self._amplitude(corner, pulses, row, edge, foot)
        # The phase of the share is relative to the foot, the delay of the path to the nearest point of the edge.
        turn = np.exp(4j * np.pi / wavelength * (range_m - straight + slant * (place - end) / (2 * range_m)))
        gain = amplitude * wavelength / (8 * np.pi * straight) * share * turn
        seen = gain != 0
        seen[seen] = self._visible(corner, position[row[seen]], edge[seen])
        return self._paths(pulses, row[seen], edge[seen], gain[seen])

    @staticmethod
    def _paths(
        pulses: Pulses, row: Int[np.ndarray, " n"], edge_m: Float[np.ndarray, "n 3"], gain: Complex[np.ndarray, " n"]
    ) -> Paths:
        nowhere, surface = np.full(len(row), np.nan), np.full(len(row), BOUNCED)
        return Paths.to_points(pulses, row, edge_m, gain=gain, incidence_rad=nowhere, surface=surface)

    @staticmethod
    def _strip(
        corner: Dihedral, into: Float[np.ndarray, "2 n"], height_m: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the near and far limits of each half of the strip, m from the edge, where rays meet both faces."""
        # The sine of the angle between the way to the radar and one face is its cosine to the other.
        sines = into[::-1] / height_m
        near = np.maximum(*(s * n for s, n in zip(sines, corner.near_m, strict=True)))
        far = np.minimum(*(s * f for s, f in zip(sines, corner.far_m, strict=True)))
        return near, far

    def _amplitude(
        self,
        corner: Dihedral,
        pulses: Pulses,
        row: np.ndarray,
        edge_m: Float[np.ndarray, "n 3"],
        foot_m: Float[np.ndarray, " n"],
    ) -> Complex[np.ndarray, " n"]:
        """Return antenna gain times both reflections, the mean of the two orders."""
        position, turn = pulses.true.position_m[row], pulses.true.R_world_antenna[row]
        back = position - edge_m
        across = np.cross(corner.along, back)
        across *= (np.sign(across @ corner.faces[0]) / np.linalg.norm(across, axis=1))[:, None]
        total = np.zeros(len(row), dtype=np.complex128)
        for mirrors, side in ((corner.mirrors, 1.0), (corner.mirrors[::-1], -1.0)):
            ways = []
            for way in (side, -side):  # out to one half of the strip, back from the other
                toward = edge_m + way * foot_m[:, None] * across - position
                ways.append(toward / np.linalg.norm(toward, axis=1)[:, None])
            inside = [np.einsum("nij,ni->nj", turn, way) for way in ways]
            sent = np.einsum("nij,nj->ni", turn, self._antenna.fields(inside[0])[0])
            received = np.einsum("nij,nj->ni", turn, self._antenna.fields(inside[1])[1])
            direction = ways[0]
            for mirror in mirrors:
                direction, sent = mirror.reflected(direction, sent)
            gain = np.sqrt(self._antenna.transmit_gain(inside[0]) * self._antenna.receive_gain(inside[1]))
            total += gain * np.einsum("ni,ni->n", received, sent) / 2
        return total

    def _visible(
        self, corner: Dihedral, position_m: Float[np.ndarray, "n 3"], edge_m: Float[np.ndarray, "n 3"]
    ) -> np.ndarray:
        """Return True where radar positions see both faces beside the edge."""
        seen = np.ones(len(edge_m), dtype=bool)
        for face, far in zip(corner.faces, corner.far_m, strict=True):
            beside = edge_m + min(EDGE_OFFSET_M, far / 2) * face
            seen &= self._caster.visible(position_m, beside, TOUCHING_M)
        return seen


def _outside_m(
    height_m: Float[np.ndarray, " n"], wavelength_m: float, length_m: Float[np.ndarray, " n"] | float
) -> Float[np.ndarray, " n"]:
    """Return the distance beyond an edge's ends where its side lobes have fallen to the second of `LOBES_FADE`, m.

    Their envelope is sqrt(2 lambda h) / 2 pi x of an endless edge's field; a short one has L sqrt(2 / lambda h) of it.
    """
    zone = np.sqrt(wavelength_m * height_m / 2)
    return zone / np.pi / LOBES_FADE[1] * np.maximum(1.0, zone / length_m)


def _fresnel_integral(
    low_m: Float[np.ndarray, "*part n"],
    high_m: Float[np.ndarray, "*part n"],
    height_m: Float[np.ndarray, " n"],
    wavelength_m: float,
) -> Complex[np.ndarray, "*part n"]:
    """Return sqrt(2 j / (lambda h)) times the integral of exp(-j k x^2 / h) between two places beside the foot."""
    per_metre = 2 / np.sqrt(wavelength_m * height_m)
    (s_low, c_low), (s_high, c_high) = (fresnel(x * per_metre) for x in (low_m, high_m))
    return ((c_high - c_low) - 1j * (s_high - s_low)) / (1 - 1j)
