"""Facets as scatterers: subdivision of triangles, identities (which determine phases), and backscatter.

The backscatter of a facet, polarization included, is the scattering matrix of `RadarMaterial` in plain NumPy. With e
the field that the antenna transmits toward a facet and r the one that it receives, both unit vectors across the line of
sight k, h = k x n / |k x n| across the plane of incidence and v = h x k in it, the facet's amplitude over its area is

    a_v r.e + (a_h - a_v) (r.h) (h.e)  +  j s1 d ((r.h) (e.h) - (r.v) (e.v)) + s2 x ((r.h) (e.v) + (r.v) (e.h))

where a_v^2 = sigma_v - d^2, a_h^2 = sigma_h - d^2, x^2 is the cross-polar sigma0 (and so is d^2, unless a material
has its own co-polar correlation), and the signs s1, s2 belong to the facet. A beam rotated out of the vertical
plane mixes V and H in this way, as does a sloping facet.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Inexact, Int, UInt64

from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.randomness import split_mix
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.surfaces.radar_material import RadarMaterial, as_radar_material


@dataclass(frozen=True, kw_only=True)
class FacetScatterers(Columns):
    """What a facet is to the radar: a place, a normal whose length is twice the area, an identity and a surface."""

    place_m: Float[np.ndarray, "facet 3"]
    normal_m2: Float[np.ndarray, "facet 3"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]


@dataclass(frozen=True, kw_only=True)
class Facets(Columns):
    """Triangles with the identities that determine their phases, and the surface of each."""

    corner_m: Float[np.ndarray, "facet 3 3"]
    identity: UInt64[np.ndarray, " facet"]
    surface: Int[np.ndarray, " facet"]

    @property
    def centre_m(self) -> Float[np.ndarray, "facet 3"]:
        """Centroids."""
        return (self.corner_m[:, 0] + self.corner_m[:, 1] + self.corner_m[:, 2]) / 3

    @property
    def scatterers(self) -> "FacetScatterers":
        """A scatterer at the centroid of each."""
        corner = self.corner_m
        return FacetScatterers(
            place_m=self.centre_m,
            normal_m2=np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]),
            identity=self.identity,
            surface=self.surface,
        )

    @property
    def squared_side_m2(self) -> Float[np.ndarray, "facet 3"]:
        """Squared lengths of the sides from each corner to the next."""
        side = self.corner_m[:, [1, 2, 0]] - self.corner_m
        return np.einsum("fsi,fsi->fs", side, side)

    def halved(self) -> "Facets":
        """Return both halves of every facet, cut from the middle of its longest side to its third corner."""
        first = np.argmax(self.squared_side_m2, axis=1)
        turned = (first[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(self.corner_m[np.arange(len(self))[:, None], turned], 1, 0)
        middle = (a + b) / 2
        left, right = np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)
        return Facets(
            corner_m=np.concatenate([left, right]),
            identity=split_mix(self.identity, np.array([[1], [2]], dtype=np.uint64)).ravel(),
            surface=np.tile(self.surface, 2),
        )

    def divided(self, parts: int) -> "Facets":
        """Return every facet as parts^2 equal facets of the same shape, each side cut into that many parts."""
        a, b, c = np.moveaxis(self.corner_m, 1, 0)
        weight = _lattice(parts)
        corner = np.multiply.outer(weight[:, :, 0], a) + np.multiply.outer(weight[:, :, 1], b)
        corner += np.multiply.outer(weight[:, :, 2], c)
        # Steps 1 and 2 are taken by the halves.
        step = np.arange(3, 3 + len(weight), dtype=np.uint64)
        return Facets(
            corner_m=corner.transpose(0, 2, 1, 3).reshape(-1, 3, 3),
            identity=split_mix(self.identity, step[:, None]).ravel(),
            surface=np.tile(self.surface, len(weight)),
        )


@functools.cache
def _lattice(parts: int) -> Float[np.ndarray, "piece corner 3"]:
    """Return the barycentric coordinates of the pieces of a triangle, with the same winding."""
    pieces = []
    for i in range(parts):
        for j in range(parts - i):
            pieces.append([(i, j), (i + 1, j), (i, j + 1)])
            if i + j < parts - 1:
                pieces.append([(i + 1, j + 1), (i, j + 1), (i + 1, j)])
    barycentric = np.array(pieces) / parts
    return np.concatenate([1 - barycentric.sum(axis=2, keepdims=True), barycentric], axis=2)


def facets_of(surfaces: Sequence[Surface]) -> Facets:
    """Return the triangles of some surfaces, numbered consecutively."""
    count = sum(len(s.faces) for s in surfaces)
    return Facets(
        corner_m=np.concatenate([s.vertices_m[s.faces].astype(np.float64) for s in surfaces]),
        identity=np.arange(count, dtype=np.uint64),
        surface=np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces]),
    )


class FacetScattering:
    """The amplitudes of a scene's facets for one antenna."""

    def __init__(self, scene: Scene, antenna: Antenna) -> None:
        names = sorted({s.material for s in scene.surfaces})
        self._materials = [as_radar_material(scene.materials[name]) for name in names]
        self._material_of_surface = np.array([names.index(s.material) for s in scene.surfaces])
        self._antenna = antenna

    def amplitude(
        self,
        direction: Float[np.ndarray, "facet 3"],
        normal: Float[np.ndarray, "facet 3"],
        surface: Int[np.ndarray, " facet"],
        drawn: UInt64[np.ndarray, " facet"],
        R_world_antenna: Float[np.ndarray, "facet 3 3"],
    ) -> Complex[np.ndarray, " facet"]:
        """Return amplitudes whose squares are cross-sections per unit area.

        direction, normal: unit vectors from the radar to each facet, and its normal on the illuminated side; world
            frame.
        surface, drawn: the surface of each facet, and random bits that belong to it.
        R_world_antenna: orientation of the antenna that sees each.
        """
        cosine = np.minimum(-np.einsum("fi,fi->f", direction, normal), 1.0)
        material = self._material_of_surface[surface]
        amplitude = np.zeros(len(cosine), dtype=np.complex128)
        for number in np.unique(material):
            of_material = material == number
            model = self._materials[number]
            if _is_plain(model):
                # The field returns along its transmit axis: no signal in a cross-polar receiver.
                kept = self._antenna.mirrored
                if kept != 0:
                    amplitude[of_material] = kept * np.sqrt(model.vertical.sigma0(np.arccos(cosine[of_material])))
                continue
            fields = self._fields(direction[of_material], normal[of_material], R_world_antenna[of_material])
            amplitude[of_material] = _polarized(
                model, np.arccos(cosine[of_material]), *fields, _signs(drawn[of_material])
            )
        return amplitude

    def _fields(
        self,
        direction: Float[np.ndarray, "facet 3"],
        normal: Float[np.ndarray, "facet 3"],
        R_world_antenna: Float[np.ndarray, "facet 3 3"],
    ) -> tuple[Inexact[np.ndarray, "facet 2"], Inexact[np.ndarray, "facet 2"]]:
        """Return the transmitted and the received field along v and h of each facet."""
        across = np.cross(direction, normal)
        size = np.linalg.norm(across, axis=1)
        # At normal incidence the plane of incidence is undefined; any axis across the line of sight will do.
        level = size < 1e-9
        across[level] = np.cross(direction[level], np.eye(3)[np.argmin(np.abs(direction[level]), axis=1)])
        across /= np.linalg.norm(across, axis=1)[:, None]
        axes = np.stack([np.cross(across, direction), across], axis=1)
        ahead = np.einsum("fi,fij->fj", direction, R_world_antenna)
        transmitted, received = (
            np.einsum("fi,fji->fj", field, R_world_antenna) for field in self._antenna.fields(ahead)
        )
        return np.einsum("fai,fi->fa", axes, transmitted), np.einsum("fai,fi->fa", axes, received)


def _is_plain(model: RadarMaterial) -> bool:
    return model.cross_polar == 0.0 and model.copolar_correlation is None and model.vertical is model.horizontal


def _polarized(
    model: RadarMaterial,
    incidence_rad: Float[np.ndarray, " facet"],
    transmitted: Inexact[np.ndarray, "facet 2"],
    received: Inexact[np.ndarray, "facet 2"],
    signs: Sequence[Float[np.ndarray, " facet"]],
) -> Complex[np.ndarray, " facet"]:
    parts = model.amplitudes(incidence_rad)
    (transmitted_v, transmitted_h), (received_v, received_h) = transmitted.T, received.T
    kept = parts.vertical * (transmitted_v * received_v) + parts.horizontal * (transmitted_h * received_h)
    opposed = transmitted_h * received_h - transmitted_v * received_v
    exchanged = transmitted_h * received_v + transmitted_v * received_h
    return kept + 1j * (signs[0] * parts.opposed) * opposed + signs[1] * parts.exchanged * exchanged


def _signs(drawn: UInt64[np.ndarray, " facet"]) -> tuple[Float[np.ndarray, " facet"], Float[np.ndarray, " facet"]]:
    """Return two signs of each facet, apart from its phase by another hash of its bits."""
    mixed = drawn * np.uint64(0x9E3779B97F4A7C15)
    bits: tuple[Bool[np.ndarray, " facet"], ...] = tuple(
        (mixed >> np.uint64(place)) & np.uint64(1) == 1 for place in (40, 52)
    )
    return np.where(bits[0], 1.0, -1.0), np.where(bits[1], 1.0, -1.0)
