"""Multiple reflections inside a body: shooting and bouncing rays (SBR) with physical optics.

Tubes of rays from the radar are lit faces, or parts of them. Each is reflected by geometrical optics from plane to
plane (Ling, Chou and Lee 1989, "Shooting and bouncing rays", IEEE Trans. AP 37, 194-205), and wherever it falls on a
plane after its first reflection the currents that it makes there return to the radar the amplitude

    sqrt(sigma) = (2 sqrt(pi) / lambda) ((r . s) (n . e) - (r . e) (n . s)) * integral of exp(-j k (way - mean way)) dp

with s the ray's direction and e its field there, n the normal, r the field that the antenna receives, and the whole way
of a ray from the radar and back to it. Ways are linear over a tube's triangle, whose integral is that of a face (see
`physical_optics`). A tube whose rays part, at an edge or a shadow, is cut into four, down to a wavelength; from
there on it goes where its middle goes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int

from sionna_radar.foundation.columns import Columns
from sionna_radar.tracing.effects.physical_optics import Scatterer

# Planes that a ray meets at most.
MAX_BOUNCES = 3
# Side of the smallest tube, in wavelengths.
SMALLEST = 1.0
# How far the corners of a tube are drawn in to be cast, of the way to its middle.
DRAWN_IN = 1e-3
# How far a reflected ray starts off its plane, of the body's radius.
OFF_PLANE = 1e-5
# Tubes that are cast at once.
AT_ONCE = 100_000


@dataclass(frozen=True, kw_only=True)
class BouncedEchoes(Columns):
    """Echoes of tubes after two or more reflections.

    row: of the place of the radar. place_m: half way between first and last face, in the body's axes.
    range_m: half of the whole way. amplitude: square root of the cross-section, relative to the phase of that way.
    """

    row: Int[np.ndarray, " echo"]
    place_m: Float[np.ndarray, "echo 3"]
    range_m: Float[np.ndarray, " echo"]
    amplitude: Complex[np.ndarray, " echo"]


@dataclass(frozen=True, kw_only=True)
class _Tubes(Columns):
    """Triangles on the face that each first meets."""

    row: Int[np.ndarray, " tube"]
    face: Int[np.ndarray, " tube"]
    corner_m: Float[np.ndarray, "tube 3 3"]

    def quartered(self) -> "_Tubes":
        """Return the four triangles of each that the middles of its sides divide it into."""
        a, b, c = np.moveaxis(self.corner_m, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = [np.stack(part, axis=1) for part in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
        return _Tubes(row=np.tile(self.row, 4), face=np.tile(self.face, 4), corner_m=np.concatenate(parts))


def bounced_echoes(
    scatterer: Scatterer,
    radar_m: Float[np.ndarray, "place 3"],
    sent: Inexact[np.ndarray, "place 3"],
    received: Inexact[np.ndarray, "place 3"],
) -> BouncedEchoes:
    """Return the echoes of a body after two reflections and more, seen from places.

    scatterer: the body.
    radar_m: places, in the body's axes.
    sent, received: unit vectors of the fields that the antenna sends toward the body and receives from there, in its
        axes.
    """
    row, face = np.nonzero(scatterer.seen(radar_m))
    level = _Tubes(row=row, face=face, corner_m=scatterer.corner_m[face])
    nothing = np.zeros((0, MAX_BOUNCES), dtype=np.int64)
    echoes = [_returned(scatterer, radar_m, sent, received, level.rows(slice(0, 0)), nothing)]
    # Level by level, so that the order of a place's tubes does not depend on what other places there are.
    while len(level):
        parted = []
        for low in range(0, len(level), AT_ONCE):
            tubes = level.rows(slice(low, low + AT_ONCE))
            faces = _faces_met(scatterer, radar_m, tubes)
            planes = np.where(faces >= 0, scatterer.plane[faces], -1)
            bounces = (planes[:, :, 1] >= 0).any(axis=1)
            alike = (planes == planes[:, :1]).all(axis=(1, 2))
            side_m = np.linalg.norm(tubes.corner_m - np.roll(tubes.corner_m, 1, axis=1), axis=2).max(axis=1)
            whole = alike | (side_m <= SMALLEST * scatterer.wavelength_m)
            complete = np.flatnonzero(bounces & whole)
            echoes.append(_returned(scatterer, radar_m, sent, received, tubes.rows(complete), faces[complete, 0]))
            parted.append(tubes.rows(np.flatnonzero(bounces & ~whole)))
        level = _Tubes.concatenate(parted).quartered()
    return BouncedEchoes.concatenate(echoes)


def _faces_met(
    scatterer: Scatterer, radar_m: Float[np.ndarray, "place 3"], tubes: _Tubes
) -> Int[np.ndarray, "tube ray bounce"]:
    """Return the faces that a tube's rays meet one after the other, of its middle and its corners; -1 for none."""
    middle = tubes.corner_m.mean(axis=1, keepdims=True)
    start = np.concatenate([middle, tubes.corner_m + DRAWN_IN * (middle - tubes.corner_m)], axis=1)
    shape = start.shape[:2]
    place, row = start.reshape(-1, 3), np.repeat(tubes.row, shape[1])
    faces = np.full((len(place), MAX_BOUNCES), -1)
    faces[:, 0] = np.where(scatterer.hidden(radar_m, row, place), -1, np.repeat(tubes.face, shape[1]))
    direction = _unit(place - radar_m[row])
    going = np.flatnonzero(faces[:, 0] >= 0)
    for bounce in range(1, MAX_BOUNCES):
        normal = scatterer.plane_normal[scatterer.plane[faces[going, bounce - 1]]]
        direction[going] = _mirrored(direction[going], normal)
        ahead = normal * np.sign(np.einsum("ri,ri->r", direction[going], normal))[:, None]
        distance_m, met = scatterer.first_hit(place[going] + OFF_PLANE * scatterer.sphere[1] * ahead, direction[going])
        hit = np.isfinite(distance_m)
        going, met = going[hit], met[hit]
        place[going] += distance_m[hit, None] * direction[going]
        front = np.einsum("ri,ri->r", direction[going], scatterer.normal_m2[met]) < 0
        front |= scatterer.body.two_sided[met]
        going, met = going[front], met[front]
        faces[going, bounce] = met
    return faces.reshape(*shape, MAX_BOUNCES)


def _returned(
    scatterer: Scatterer,
    radar_m: Float[np.ndarray, "place 3"],
    sent: Inexact[np.ndarray, "place 3"],
    received: Inexact[np.ndarray, "place 3"],
    tubes: _Tubes,
    faces: Int[np.ndarray, "tube bounce"],
) -> BouncedEchoes:
    """Return the echoes of tubes that meet faces one after the other."""
    from sionna_radar.tracing.effects.physical_optics import second_differences

    radar, first = radar_m[tubes.row], tubes.corner_m.mean(axis=1)
    corner, field = tubes.corner_m.copy(), sent[tubes.row].astype(np.complex128)
    way = np.linalg.norm(corner - radar[:, None], axis=2)
    direction = (corner - radar[:, None]) / way[..., None]
    sound, parts = np.ones(len(tubes), dtype=bool), []
    for bounce in range(1, MAX_BOUNCES):
        normal = scatterer.plane_normal[scatterer.plane[faces[:, bounce - 1]]]
        direction = _mirrored(direction, normal[:, None])
        field = np.sqrt(scatterer.body.reflectivity) * (
            2 * np.einsum("ti,ti->t", field, normal)[:, None] * normal - field
        )
        onto, normal = scatterer.middle_m[faces[:, bounce]], scatterer.plane_normal[scatterer.plane[faces[:, bounce]]]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.einsum("tci,ti->tc", onto[:, None] - corner, normal) / np.einsum(
                "tci,ti->tc", direction, normal
            )
        # The smallest tubes go as a whole where their middle goes; a corner may have to go back for it.
        sound &= (faces[:, bounce] >= 0) & (np.abs(distance) < 4 * scatterer.sphere[1]).all(axis=1)
        corner = corner + np.where(sound[:, None], distance, 0.0)[..., None] * direction
        way = way + np.where(sound[:, None], distance, 0.0)
        valid = np.flatnonzero(sound)
        middle, ray = corner[valid].mean(axis=1), _unit(direction[valid].mean(axis=1))
        normal = normal[valid] * -np.sign(np.einsum("ti,ti->t", ray, normal[valid]))[:, None]
        back = np.einsum("ti,ti->t", radar[valid] - middle, normal) > 0
        back[back] = ~scatterer.hidden(radar_m, tubes.row[valid[back]], middle[back])
        valid, middle, ray, normal = valid[back], middle[back], ray[back], normal[back]
        heard, at = received[tubes.row[valid]], field[valid]
        turned = _dot(heard, ray) * _dot(normal, at) - _dot(heard, at) * _dot(normal, ray)
        whole = way[valid] + np.linalg.norm(corner[valid] - radar[valid, None], axis=2)
        mean = whole.mean(axis=1)
        wave = -2 * np.pi / scatterer.wavelength_m * (whole - mean[:, None])
        sides = corner[valid, 1:] - corner[valid, :1]
        area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
        scale = 2 * np.sqrt(np.pi * scatterer.body.reflectivity) / scatterer.wavelength_m
        parts.append(
            BouncedEchoes(
                row=tubes.row[valid],
                place_m=(first[valid] + middle) / 2,
                range_m=mean / 2,
                amplitude=scale * turned * 2 * area * second_differences(np.ascontiguousarray(wave)),
            )
        )
    return BouncedEchoes.concatenate(parts)


def _mirrored(
    direction: Float[np.ndarray, "*shape 3"], normal: Float[np.ndarray, "*other 3"]
) -> Float[np.ndarray, "*shape 3"]:
    return direction - 2 * np.sum(direction * normal, axis=-1, keepdims=True) * normal


def _unit(vector: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return vector / np.linalg.norm(vector, axis=1, keepdims=True)


def _dot(one: Inexact[np.ndarray, "n 3"], other: Inexact[np.ndarray, "n 3"]) -> Inexact[np.ndarray, " n"]:
    return np.einsum("ni,ni->n", one, other)
