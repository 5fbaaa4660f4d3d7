"""Evidence of all echoes pooled at nodes over a reference surface, and the types of plants that a survey holds."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_matrix

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.inference.echo.layer import LayerHeights, LayerType, layer_evidence
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.mapping.canopy.two_surfaces import NodeEvidence

# All types that are tried: extinctions from ripe stalks to wet grass, covers, and a deep canopy's backscatter over that
# of soil (`surfaces.foliage` has those of crops).
TYPES = tuple(
    LayerType(extinction_per_m=k, cover=c, backscatter=b, clear_m=a)
    for k, c, b, a in product((0.25, 0.6, 1.2, 2.4), (0.3, 0.7, 0.95), (0.25, 1.0, 4.0, 16.0), (0.0, 0.6))
)
KEPT = 4
SAMPLED = 300
# Least weight of a node's echoes, in echoes, and echoes looked at together.
MIN_ECHOES = 0.3
AT_ONCE = 2000


@dataclass(frozen=True, kw_only=True)
class Tried:
    """The heights that are tried over a reference: of the ground from `low_m` to `high_m`, of tops up to `top_m`."""

    low_m: float
    high_m: float
    top_m: float
    thickest_m: float
    step_m: float

    @property
    def heights(self) -> LayerHeights:
        """All heights."""
        return LayerHeights(low_m=self.low_m, step_m=self.step_m, count=round((self.top_m - self.low_m) / self.step_m) + 1)

    @property
    def grounds(self) -> int:
        """How many of them are tried for the ground."""
        return round((self.high_m - self.low_m) / self.step_m) + 1

    @property
    def thickest(self) -> int:
        """Steps of the thickest layer."""
        return round(self.thickest_m / self.step_m)


def node_evidence(
    sightings: Sightings,
    surface: Heightfield,
    looks: Float[np.ndarray, " pulse"],
    tried: Tried,
    types: tuple[LayerType, ...],
    spacing_m: float,
) -> NodeEvidence:
    """Return the evidence at the nodes of a square lattice around which echoes are.

    An echo belongs to the four nodes around its place, by its distance from each: what it says counts once.
    """
    pose = sightings.pose
    place_m = sightings.places(surface.first_hit(pose.position_m, pose.boresight, sightings.reach_m))[:, :2]
    met = np.flatnonzero(np.isfinite(place_m).all(axis=1))
    corner = np.floor(place_m[met] / spacing_m).astype(np.int64)
    part = place_m[met] / spacing_m - corner
    key, weight = [], []
    for east, north in product((0, 1), (0, 1)):
        key.append(corner + [east, north])
        weight.append((part[:, 0] if east else 1 - part[:, 0]) * (part[:, 1] if north else 1 - part[:, 1]))
    node, number = np.unique(np.concatenate(key), axis=0, return_inverse=True)
    shape = len(node), len(place_m)
    share = csr_matrix((np.concatenate(weight), (number.ravel(), np.tile(met, 4))), shape=shape)
    kept = np.asarray(share.sum(axis=1)).ravel() >= MIN_ECHOES
    share, node = share[kept], node[kept]
    total = np.zeros((len(node), len(types), tried.grounds, tried.thickest + 1), dtype=np.float32)
    for start in range(0, len(sightings), AT_ONCE):
        some = np.zeros(len(sightings), dtype=bool)
        some[start : start + AT_ONCE] = True
        of_echo = layer_evidence(
            sightings.rows(some), surface, looks[some], tried.heights, types, tried.grounds, tried.thickest
        )
        untried = ~np.isfinite(of_echo[0])
        of_echo[:, untried] = 0.0
        total += (share[:, np.flatnonzero(some)] @ of_echo.reshape(len(of_echo), -1)).reshape(total.shape)
        total[:, untried] = -np.inf
    at_m = node * spacing_m
    return NodeEvidence(
        place_m=at_m,
        reference_m=surface.at(*at_m.T),
        log_likelihood=total,
        ground_m=tried.heights.height_m[: tried.grounds],
        thickness_m=tried.step_m * np.arange(tried.thickest + 1),
    )


def types_in(
    sightings: Sightings, surface: Heightfield, looks: Float[np.ndarray, " pulse"], tried: Tried, spacing_m: float
) -> tuple[LayerType, ...]:
    """Return the few types that explain the echoes of some nodes best, by expectation maximization over all of them."""
    pose = sightings.pose
    place_m = sightings.places(surface.first_hit(pose.position_m, pose.boresight, sightings.reach_m))[:, :2]
    patch = np.floor(np.nan_to_num(place_m) / (2 * spacing_m)).astype(np.int64)
    _, number, count = np.unique(patch, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(-count, kind="stable")
    enough = order[count[order] >= np.median(count)]
    chosen = enough[spread_indices(min(SAMPLED, len(enough)), len(enough))]
    some = np.isin(number.ravel(), chosen)
    evidence = node_evidence(sightings.rows(some), surface, looks[some], tried, TYPES, 2 * spacing_m)
    log = evidence.log_likelihood
    layer = log_sum_exp(log[..., 1:].reshape(*log.shape[:2], -1), axis=2) - np.log(tried.thickest)
    bare = log_sum_exp(log[:, 0, :, 0], axis=1)
    both = np.column_stack([bare, layer]).astype(float)
    weight = np.full(both.shape[1], 1 / both.shape[1])
    for _ in range(200):
        share = np.exp(both + np.log(weight) - log_sum_exp(both + np.log(weight), axis=1, keepdims=True))
        weight = np.maximum(share.mean(axis=0), 1e-12)
    best = np.argsort(-weight[1:])[:KEPT]
    return tuple(TYPES[k] for k in best if weight[1 + k] > 1e-3) or (TYPES[int(best[0])],)
