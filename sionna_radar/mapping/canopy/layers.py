"""Evidence of all echoes pooled at nodes over a reference surface, and the types of plants that a survey holds."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.sparse import csr_matrix

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.inference.echo.layer import LayerHeights, LayerType, layer_evidence
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.mapping.canopy.two_surfaces import NodeEvidence

# All types that are tried, by their extinction, cover, backscatter over that of soil, and clear height: from ripe
# stalks to wet grass, as `surfaces.foliage` has them.
TYPES = tuple(
    LayerType(extinction_per_m=k, cover=c, backscatter=b, clear_m=a)
    for k, c, b, a in product((0.25, 0.6, 1.2, 2.4), (0.3, 0.7, 0.95), (0.25, 1.0, 4.0, 16.0), (0.0, 0.6))
)
# Places that the types are learned from, and rounds of that.
SAMPLED, TYPE_ROUNDS = 100, 200
# Cells to the side of a square that is done at once.
SQUARE = 24


@dataclass(frozen=True, kw_only=True)
class Tried:
    """The heights over a reference that are tried: of the ground from `low_m` to `high_m`, of tops up to `top_m`.

    step_m: of thicknesses. finer: so many times finer are the heights of the ground, a step of which may span a cell.
    """

    low_m: float
    high_m: float
    top_m: float
    thickest_m: float
    step_m: float
    finer: int = 1

    @property
    def heights(self) -> LayerHeights:
        """All heights."""
        count = round((self.top_m - self.low_m) / self.step_m) + 1
        return LayerHeights(low_m=self.low_m, step_m=self.step_m, count=count)

    @property
    def grounds(self) -> int:
        """How many of them are tried for the ground, `step_m` apart."""
        return round((self.high_m - self.low_m) / self.step_m) + 1

    @property
    def thicknesses(self) -> int:
        """How many thicknesses of a layer are tried, each a step more."""
        return round(self.thickest_m / self.step_m)

    @property
    def enough(self) -> bool:
        """Whether a layer can be told from the ground: a thickness, and heights for a spline through them."""
        return self.thicknesses >= 1 and self.grounds >= 4


@dataclass(frozen=True)
class Lattice:
    """Square cells with echoes, a node in the middle of the echoes of each.

    cell: east and north, in cells. place_m: of the nodes.
    member: 1 for each pulse of a node.
    """

    cell: Int[np.ndarray, "node 2"]
    place_m: Float[np.ndarray, "node 2"]
    member: csr_matrix

    @classmethod
    def of(cls, place_m: Float[np.ndarray, "pulse 2"], spacing_m: float) -> "Lattice":
        """Return the cells of echoes by their places; NaN for one without a place."""
        met = np.flatnonzero(np.isfinite(place_m).all(axis=1))
        cell, number = np.unique(np.floor(place_m[met] / spacing_m).astype(np.int64), axis=0, return_inverse=True)
        member = csr_matrix((np.ones(len(met)), (number.ravel(), met)), shape=(len(cell), len(place_m)))
        middle_m = (member @ np.nan_to_num(place_m)) / np.asarray(member.sum(axis=1))
        return cls(cell, middle_m, member)

    def squares(self) -> Iterator[tuple[Int[np.ndarray, " node"], Int[np.ndarray, " pulse"], csr_matrix]]:
        """Yield the nodes of square after square, the pulses that they hear, and which of these each hears."""
        _, square = np.unique(self.cell // SQUARE, axis=0, return_inverse=True)
        for number in range(int(square.max(initial=-1)) + 1):
            nodes = np.flatnonzero(square.ravel() == number)
            here = self.member[nodes]
            pulses = np.unique(here.indices)
            yield nodes, pulses, here[:, pulses]


def axis_places(sightings: Sightings, surface: Heightfield) -> Float[np.ndarray, "pulse 2"]:
    """Return the intersections x, y of the beam axes with a surface, m; NaN without one."""
    range_m = surface.first_hit(sightings.pose.position_m, sightings.pose.boresight, sightings.reach_m)
    return sightings.places(range_m)[:, :2]


def node_evidence(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    tried: Tried,
    types: tuple[LayerType, ...],
    spacing_m: float,
) -> NodeEvidence:
    """Return the evidence at the nodes of a lattice.

    sightings, looks: profiles and measured poses, and the independent looks in each range cell of each pulse.
    surface, tried: the reference, and the heights over it that are tried.
    types: of plants.
    spacing_m: of the lattice.
    """
    lattice = Lattice.of(axis_places(sightings, surface), spacing_m)
    count, chosen = len(lattice.cell), np.zeros(len(sightings), dtype=bool)
    grounds, ground_step_m = tried.grounds * tried.finer, tried.step_m / tried.finer
    bare = np.empty((count, grounds), dtype=np.float32)
    layer, mean_m, square_m2 = np.empty((3, count, len(types), grounds), dtype=np.float32)
    thickness_m = tried.step_m * np.arange(1, tried.thicknesses + 1)
    for (nodes, pulses, member), part in product(lattice.squares(), range(tried.finer)):
        chosen[:] = False
        chosen[pulses] = True
        heights = replace(tried.heights, low_m=tried.low_m + part * ground_step_m)
        on = surface, looks[chosen], heights, types, tried.grounds, tried.thicknesses
        of_echo = layer_evidence(sightings.rows(chosen), *on)
        untried = ~np.isfinite(of_echo[0])
        of_echo[:, untried] = 0.0
        total: Float32[np.ndarray, ...] = (member @ of_echo.reshape(len(of_echo), -1)).reshape(-1, *of_echo.shape[1:])
        total[:, untried] = -np.inf
        bare[nodes, part :: tried.finer] = total[:, 0, :, 0]
        some = total[..., 1:].astype(np.float64)
        whole = log_sum_exp(some, axis=3)
        layer[nodes, :, part :: tried.finer] = whole - np.log(len(thickness_m))
        some = np.exp(some - np.where(np.isfinite(whole), whole, 0.0)[..., None])
        mean_m[nodes, :, part :: tried.finer] = some @ thickness_m
        square_m2[nodes, :, part :: tried.finer] = some @ thickness_m**2
    return NodeEvidence(
        place_m=lattice.place_m,
        reference_m=surface.at(*lattice.place_m.T),
        ground_m=tried.low_m + ground_step_m * np.arange(grounds),
        bare=bare,
        layer=layer,
        thickness_m=mean_m,
        square_m2=square_m2,
    )


def types_in(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    tried: Tried,
    spacing_m: float,
    count: int,
) -> tuple[LayerType, ...]:
    """Return the types that explain the echoes of some places best, by expectation maximization over all of them.

    count: of types. Other arguments as of `node_evidence`; the places are those with many echoes, spread over the
    survey.
    """
    square = np.floor(np.nan_to_num(axis_places(sightings, surface)) / spacing_m).astype(np.int64)
    _, number, echoes = np.unique(square, axis=0, return_inverse=True, return_counts=True)
    rich = np.flatnonzero(echoes >= np.median(echoes))
    some = np.isin(number.ravel(), rich[spread_indices(min(SAMPLED, len(rich)), len(rich))])
    evidence = node_evidence(sightings.rows(some), surface, looks[some], tried, TYPES, spacing_m)
    each = np.concatenate([evidence.bare[:, None], evidence.layer], axis=1).astype(float)
    each = log_sum_exp(each, axis=2)
    weight = np.full(each.shape[1], 1 / each.shape[1])
    for _ in range(TYPE_ROUNDS):
        share = each + np.log(weight)
        share = np.exp(share - log_sum_exp(share, axis=1, keepdims=True))
        weight = np.maximum(share.mean(axis=0), np.finfo(float).tiny)
    return tuple(TYPES[kind] for kind in np.argsort(-weight[1:])[:count])
