r"""Two bounces: diffuse on one surface and, before or after it, a mirror reflection on another.

radar P                  A place g that a beam sees is also seen by way of a plane mirror, which is to be seen
         | \\  r1    | mirror    from the radar's image P'. Out along r1 and back along r2 = |g - P'|, or the other way
      r2 |   \\      |           round, the delay is (r1 + r2) / c, and the power of one order is
         |     \\    m
         |       \\/ |           |a|^2 = lambda^2 G(d1) G(d2) sigma(t1, t2) |R|^2 dA / ((4 pi)^3 r1^2 r2^2)
   ------+-------g--+---

with d1 toward g and d2 toward the point m of the mirror. By reciprocity both orders have the same field: together they
have twice the field of one, four times its power. They are two rows here, since the wave arrives from g in the one and
from m in the other.

Materials know how they scatter straight back. In two other directions they are taken to scatter with the geometric
mean, sigma(t1, t2) = sqrt(sigma0(t1) sigma0(t2)): it is reciprocal, exact for Lambert's law, and for constant gamma
the usual extension, gamma sqrt(cos t1 cos t2). The parts of the field in the planes of incidence and across them keep
their amplitudes, as in backscatter; cross-polar parts follow with the signs of the place. Persistent places keep their
phases: the echoes by way of the mirror are those of one and the same surface.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.radar_material import RadarMaterial, ScatteringAmplitudes, as_radar_material
from sionna_radar.tracing.effects.mirrors import TOUCHING_M, PlaneMirror, across_incidence, plane_mirrors
from sionna_radar.tracing.engines.persistent.seen_places import SeenPlaces
from sionna_radar.tracing.paths import BOUNCED, Paths

# Mirrors are looked for as far from the axis as either cut of the beam has this share of its peak.
MIN_POWER = 1e-3
# How far a ray starts from the mirror.
OFF_MIRROR_M = 0.002
TABLE_SIZE = 2049
# Points of a plane looked up in its outline at once.
LOOKED_UP = 20_000
# Pairs of mirrors and pulses that are bounded at once.
BOUNDED = 400_000


class MirroredPlaces:
    """Traces what a beam's places return by way of the scene's mirrors; see the module docstring."""

    def __init__(self, scene: Scene, antenna: Antenna, chirp: Chirp, caster: RayCaster) -> None:
        self._scene, self._antenna, self._caster = scene, antenna, caster
        self._wavelength_m = chirp.wavelength_m
        self._mirrors = plane_mirrors(scene, chirp)
        self._centre_m = np.array([m.patch.centre_m for m in self._mirrors]).reshape(-1, 3)
        self._normal = np.array([m.patch.normal for m in self._mirrors]).reshape(-1, 3)
        self._radius_m = np.array([m.patch.radius_m for m in self._mirrors])
        self._cone_rad = _cone_rad(antenna)
        self._tables = [_Scattering(as_radar_material(scene.materials[s.material])) for s in scene.surfaces]

    def with_antenna(self, antenna: Antenna) -> "MirroredPlaces":
        """Return the tracer of the same mirrors for another antenna."""
        other = copy(self)
        other._antenna, other._cone_rad = antenna, _cone_rad(antenna)
        return other

    def over(self, pulses: Pulses, places: SeenPlaces) -> Paths:
        """Return the paths by way of mirrors to places that a block's pulses see, sorted by pulse."""
        none = np.zeros(0, dtype=np.int64)
        order = np.argsort(places.row, kind="stable")
        first = np.searchsorted(places.row[order], np.arange(len(pulses) + 1))
        paths = [self._paths(pulses, none, np.zeros((0, 3)), *np.zeros((3, 0)))]
        for number, rows in self._candidates(pulses):
            seen = np.concatenate([order[first[row] : first[row + 1]] for row in np.flatnonzero(rows)])
            paths.append(self._by(self._mirrors[number], pulses, places, seen))
        return Paths.concatenate(paths)

    def _candidates(self, pulses: Pulses) -> Iterator[tuple[int, Bool[np.ndarray, " pulse"]]]:
        """Yield the mirrors that beams may meet from the front, each with the rows of those pulses."""
        position, boresight = pulses.true.position_m, pulses.true.boresight
        near, step = self._near(position), max(1, BOUNDED // len(pulses))
        for some in (near[start : start + step] for start in range(0, len(near), step)):
            away = self._centre_m[some, None] - position
            distance = np.linalg.norm(away, axis=2)
            off = np.arccos(np.clip(np.einsum("mni,ni->mn", away, boresight) / distance, -1.0, 1.0))
            size = np.arcsin(np.minimum(self._radius_m[some, None] / distance, 1.0))
            rows = np.einsum("mni,mi->mn", away, self._normal[some]) < 0
            rows &= (off - size < self._cone_rad) | (size >= np.pi / 2)
            yield from ((int(some[n]), rows[n]) for n in np.flatnonzero(rows.any(axis=1)))

    def _near(self, position_m: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " mirror"]:
        """Return the mirrors whose front any of the positions may see."""
        middle = (position_m.min(axis=0) + position_m.max(axis=0)) / 2
        reach = np.linalg.norm(position_m - middle, axis=1).max()
        return np.flatnonzero(np.einsum("ni,ni->n", middle - self._centre_m, self._normal) > -reach)

    def _by(self, mirror: PlaneMirror, pulses: Pulses, places: SeenPlaces, seen: Int[np.ndarray, " some"]) -> Paths:
        """Return the paths by way of one mirror to some of the places."""
        some = places.only(self._met(mirror, pulses, places, seen))
        ways = _Ways.of(mirror, pulses, some)
        normal = self._normals(some)
        # Both rays must be on the same side of the surface.
        cosines = [np.einsum("ni,ni->n", normal, -ways.out), np.einsum("ni,ni->n", normal, ways.leg)]
        lit = (cosines[0] * cosines[1] > 0) & (ways.range_m.min(axis=1) > 0)
        lit[lit] = self._clear(mirror, pulses, ways.rows(lit), some.only(lit))
        some, ways, normal = some.only(lit), ways.rows(lit), normal[lit]
        gains = self._gains(mirror, pulses, some, ways, normal)
        rate = -np.einsum("ni,ni->n", pulses.true.velocity_mps[ways.row], ways.out + ways.back) / 2
        delay = ways.range_m.sum(axis=1) / speed_of_light
        last = (ways.mirror_m, some.hit_m.T.astype(np.float64))
        return Paths.concatenate(
            [self._paths(pulses, ways.row, hit, gain, delay, rate) for hit, gain in zip(last, gains, strict=True)]
        )

    def _met(
        self, mirror: PlaneMirror, pulses: Pulses, places: SeenPlaces, chosen: Int[np.ndarray, " some"]
    ) -> Int[np.ndarray, " met"]:
        """Return the indices of the chosen places whose image lies inside the mirror's outline."""
        hit = places.hit_m[:, chosen].T.astype(np.float64)
        before = mirror.height_m(hit) > TOUCHING_M
        chosen, hit = chosen[before], hit[before]
        place = (_mirror_point(mirror, pulses.true.position_m[places.row[chosen]], hit) - mirror.patch.centre_m) @ (
            mirror.patch.axes.T
        )
        near = np.linalg.norm(place, axis=1) <= mirror.patch.radius_m
        chosen, place = chosen[near], place[near]
        parts = (place[start : start + LOOKED_UP] for start in range(0, len(chosen), LOOKED_UP))
        return chosen[np.concatenate([np.zeros(0, dtype=bool), *map(mirror.patch.holds, parts)])]

    def _clear(
        self, mirror: PlaneMirror, pulses: Pulses, ways: "_Ways", places: SeenPlaces
    ) -> Bool[np.ndarray, " place"]:
        """Return a mask of places with a clear line from the radar to the mirror and from the mirror to the place."""
        clear = self._caster.visible(pulses.true.position_m[ways.row], ways.mirror_m, TOUCHING_M)
        start = ways.mirror_m[clear] + OFF_MIRROR_M * mirror.patch.normal
        clear[clear] = self._caster.visible(start, places.hit_m[:, clear].T.astype(np.float64), TOUCHING_M)
        return clear

    def _gains(
        self,
        mirror: PlaneMirror,
        pulses: Pulses,
        places: SeenPlaces,
        ways: "_Ways",
        normal: Float[np.ndarray, "n 3"],
    ) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
        """Return the gains of both orders: those that arrive from the mirror, and those from the place."""
        turn, antenna = pulses.true.R_world_antenna[ways.row], self._antenna
        out, back = (np.einsum("nij,ni->nj", turn, way) for way in (ways.out, ways.back))
        (sent_out, got_out), (sent_back, got_back) = (
            tuple(np.einsum("nij,nj->ni", turn, field) for field in antenna.fields(way)) for way in (out, back)
        )
        # What the antenna would send by the mirror, as it arrives at the place.
        _, sent_back = mirror.reflected(ways.back, sent_back)
        _, got_back = mirror.reflected(ways.back, got_back)
        matrix = self._matrix(places, ways, normal)
        area = places.solid_angle_sr * ways.range_m[:, 0] ** 2 / np.abs(np.einsum("ni,ni->n", normal, ways.out))
        scale = places.factor * self._wavelength_m * np.sqrt(area / (4 * np.pi) ** 3) / np.prod(ways.range_m, axis=1)
        by_mirror = np.einsum("ni,nij,nj->n", got_back, matrix, sent_out)
        by_place = np.einsum("ni,nji,nj->n", got_out, matrix, sent_back)
        return (
            scale * np.sqrt(antenna.transmit_gain(out) * antenna.receive_gain(back)) * by_mirror,
            scale * np.sqrt(antenna.transmit_gain(back) * antenna.receive_gain(out)) * by_place,
        )

    def _matrix(
        self, places: SeenPlaces, ways: "_Ways", normal: Float[np.ndarray, "n 3"]
    ) -> Complex[np.ndarray, "n 3 3"]:
        """Return the matrices of the places from fields that arrive along `out` to those that leave along `leg`."""
        # Neither turns over between one pose and the next, so that a place keeps its phase.
        across_in, across_out = across_incidence(ways.out, normal), across_incidence(ways.leg, normal)
        arriving = across_in, np.cross(ways.out, across_in)
        leaving = across_out, np.cross(-ways.leg, across_out)
        parts = self._amplitudes(places.surface, *(np.einsum("ni,ni->n", normal, way) for way in (ways.out, ways.leg)))
        one, two = _signs(places.hit_m)
        diagonal = parts.horizontal + 1j * one * parts.opposed, parts.vertical - 1j * one * parts.opposed
        matrix = sum(
            level[:, None, None] * o[:, :, None] * i[:, None, :]
            for level, o, i in (
                (diagonal[0], leaving[0], arriving[0]),
                (diagonal[1], leaving[1], arriving[1]),
                (two * parts.exchanged, leaving[0], arriving[1]),
                (two * parts.exchanged, leaving[1], arriving[0]),
            )
        )
        return np.asarray(matrix)

    def _amplitudes(
        self, surface: Int[np.ndarray, " n"], first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"]
    ) -> ScatteringAmplitudes:
        """Return the amplitudes of places: the geometric means of those straight back along either ray."""
        parts = np.zeros((4, len(surface)))
        for number in np.unique(surface):
            on_surface = surface == number
            parts[:, on_surface] = np.sqrt(
                self._tables[number].at(first[on_surface]) * self._tables[number].at(second[on_surface])
            )
        vertical, horizontal, opposed, exchanged = parts
        return ScatteringAmplitudes(vertical=vertical, horizontal=horizontal, opposed=opposed, exchanged=exchanged)

    def _normals(self, places: SeenPlaces) -> Float[np.ndarray, "n 3"]:
        normal = np.zeros((len(places), 3))
        for number in np.unique(places.surface):
            on_surface = places.surface == number
            surface = self._scene.surfaces[number]
            corner = surface.vertices_m[surface.faces[places.face[on_surface]]]
            normal[on_surface] = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        return normal / np.linalg.norm(normal, axis=1)[:, None]

    @staticmethod
    def _paths(
        pulses: Pulses, row: np.ndarray, hit_m: np.ndarray, gain: np.ndarray, delay_s: np.ndarray, rate_mps: np.ndarray
    ) -> Paths:
        return Paths(
            pulse=pulses.index[row],
            delay_s=delay_s,
            gain=gain.astype(np.complex64),
            range_rate_mps=rate_mps,
            incidence_rad=np.full(len(row), np.nan),
            hit_m=hit_m,
            surface=np.full(len(row), BOUNCED),
        )


@dataclass(frozen=True, kw_only=True)
class _Ways(Columns):
    """The rays of two bounces by way of a mirror.

    row: of the pulse in its block.
    mirror_m: where the mirror is met.
    out, back, leg: unit vectors from the radar to the place and to the mirror, and from the place to the mirror.
    range_m: straight to the place, and by way of the mirror.
    """

    row: Int[np.ndarray, " n"]
    mirror_m: Float[np.ndarray, "n 3"]
    out: Float[np.ndarray, "n 3"]
    back: Float[np.ndarray, "n 3"]
    leg: Float[np.ndarray, "n 3"]
    range_m: Float[np.ndarray, "n 2"]

    @staticmethod
    def of(mirror: PlaneMirror, pulses: Pulses, places: SeenPlaces) -> "_Ways":
        """Return the ways of some places."""
        row = places.row.astype(np.int64)
        position, hit = pulses.true.position_m[row], places.hit_m.T.astype(np.float64)
        met = _mirror_point(mirror, position, hit)
        straight, through = hit - position, hit - mirror.image_m(position)
        range_m = np.stack([np.linalg.norm(way, axis=1) for way in (straight, through)], axis=1)
        unit = through / range_m[:, 1:]
        normal = mirror.patch.normal
        return _Ways(
            row=row,
            mirror_m=met,
            out=straight / range_m[:, :1],
            back=unit - 2 * (unit @ normal)[:, None] * normal,
            leg=-unit,
            range_m=range_m,
        )


def _cone_rad(antenna: Antenna) -> float:
    """Return the half-angle of the cone about the axis in which mirrors are searched, rad."""
    farthest = max(np.abs(cut.cosine[cut.power >= MIN_POWER]).max() for cut in (antenna.azimuth, antenna.elevation))
    return float(np.arcsin(farthest))


def _mirror_point(
    mirror: PlaneMirror, position_m: Float[np.ndarray, "n 3"], hit_m: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Return the reflection point, in the mirror's plane, of the path from the radar to a place."""
    high, low = mirror.height_m(position_m), mirror.height_m(hit_m)
    image = mirror.image_m(position_m)
    return image + (high / (high + low))[:, None] * (hit_m - image)


class _Scattering:
    """The amplitudes of a material's matrix, whose squares are sigma0, from a table over the incidence angle."""

    def __init__(self, material: RadarMaterial) -> None:
        self._material = material

    @cached_property
    def _table(self) -> Float[np.ndarray, "4 angle"]:
        parts = self._material.amplitudes(np.minimum(np.linspace(0.0, np.pi / 2, TABLE_SIZE), np.deg2rad(89.99)))
        return np.stack([parts.vertical, parts.horizontal, parts.opposed, parts.exchanged])

    def at(self, cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, "4 n"]:
        """Return the amplitudes a_v, a_h, d and x at cosines of incidence, of whatever sign."""
        place = np.arccos(np.minimum(np.abs(cosine), 1.0)) * ((TABLE_SIZE - 1) / (np.pi / 2))
        return np.stack([np.interp(place, np.arange(TABLE_SIZE), column) for column in self._table])


def _signs(place_m: Float[np.ndarray, "3 n"]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return two signs that depend only on a position, those of `tracing.sionna.material`."""
    x, y, z = (np.ascontiguousarray(c, dtype=np.float32).view(np.uint32) for c in place_m)
    bits = (x * np.uint32(73856093)) ^ (y * np.uint32(19349663)) ^ (z * np.uint32(83492791))
    bits = (bits ^ (bits >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    bits = (bits ^ (bits >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    bits ^= bits >> np.uint32(16)
    one, two = (np.where(bits & np.uint32(bit), 1.0, -1.0) for bit in (1, 2))
    return one, two
