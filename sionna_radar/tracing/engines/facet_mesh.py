"""Triangles as scatterers: their subdivision, and the identity that determines the phase of each."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt64

from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.mixing import split_mix
from sionna_radar.scene.model import Surface


@dataclass(frozen=True, kw_only=True)
class Scatterers(Columns):
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
    def scatterers(self) -> "Scatterers":
        """A scatterer at the centroid of each."""
        corner = self.corner_m
        return Scatterers(
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
    share = np.array(pieces) / parts
    return np.concatenate([1 - share.sum(axis=2, keepdims=True), share], axis=2)


def facets_of(surfaces: Sequence[Surface]) -> Facets:
    """Return the triangles of some surfaces, numbered consecutively."""
    count = sum(len(s.faces) for s in surfaces)
    return Facets(
        corner_m=np.concatenate([s.vertices_m[s.faces].astype(np.float64) for s in surfaces]),
        identity=np.arange(count, dtype=np.uint64),
        surface=np.repeat(np.arange(len(surfaces)), [len(s.faces) for s in surfaces]),
    )
