"""Ground and top of plants from the evidence of whole echoes, node by node, with the ground's covariance between them.

A node is bare or holds a layer of plants of one type (`layers`). How probable each is, is learned: of the types from
all nodes, of plants from the nodes around each.

The ground is a Gaussian field. Evidence for it is seldom Gaussian: of an echo with two ends either may be the ground.
So each node is approximated by the height and the error that have the same effect as its evidence has with what all
others say of the place (expectation propagation; Minka 2001, "Expectation propagation for approximate Bayesian
inference"); what others say is kriging from the nearest ones.

Two errors are more than speckle. Rows and gaps scatter: the errors of nodes are scaled to how far they are from what
their neighbours say, those under plants and those of bare ground each by one factor. And neighbours hold the same
plants: what depends on the type is not averaged out, and stated as an error that they share.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.interpolate import Akima1DInterpolator
from scipy.spatial import KDTree

from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.inference.terrain.covariance_fit import fit_covariance
from sionna_radar.inference.terrain.heights import Heights

# Rounds after which neither nodes nor types change; nearest nodes that predict one, and those that share its plants.
ROUNDS, NEAREST, AROUND = 6, 16, 8
# Between the heights evidence is Akima's spline, read at so many times as many; least error of a height, m.
FINER, LEAST_M = 5, 0.005
# A node with a larger error by its own echoes, in steps of the heights, says nothing.
SILENT = 1e3
# Steps by which the ground may move with the kind of plants.
REACH = 10


@dataclass(frozen=True, kw_only=True)
class NodeEvidence:
    """Log-likelihoods of the ground's height at nodes, in nepers, without and with a layer on it.

    place_m, reference_m: of the nodes, and of the reference surface there.
    ground_m: heights of the ground over the reference, evenly spaced.
    bare: without a layer.
    layer: with one of a type, averaged over all thicknesses; its mean thickness and the mean of its square, m and m2.
    """

    place_m: Float[np.ndarray, "node 2"]
    reference_m: Float[np.ndarray, " node"]
    ground_m: Float[np.ndarray, " ground"]
    bare: Float32[np.ndarray, "node ground"]
    layer: Float32[np.ndarray, "node type ground"]
    thickness_m: Float32[np.ndarray, "node type ground"]
    square_m2: Float32[np.ndarray, "node type ground"]


@dataclass(frozen=True, kw_only=True)
class TwoSurfaces:
    """What is known of ground and plants at nodes.

    place_m: of the nodes.
    heard: whether a node's own echoes say anything of the ground; own_m, own_sigma_m: its height by them, and the
        error.
    ground_m, ground_sigma_m: by those of all nodes; shared_sigma_m: the part that neighbours share.
    plants: probability of plants; thickness_m: of them, if there are any, with its error; top_sigma_m: error of their
        tops.
    type_weight: how frequent the types are.
    """

    place_m: Float[np.ndarray, "node 2"]
    heard: Bool[np.ndarray, " node"]
    own_m: Float[np.ndarray, " node"]
    own_sigma_m: Float[np.ndarray, " node"]
    ground_m: Float[np.ndarray, " node"]
    ground_sigma_m: Float[np.ndarray, " node"]
    shared_sigma_m: Float[np.ndarray, " node"]
    plants: Float[np.ndarray, " node"]
    thickness_m: Float[np.ndarray, " node"]
    thickness_sigma_m: Float[np.ndarray, " node"]
    top_sigma_m: Float[np.ndarray, " node"]
    type_weight: Float[np.ndarray, " type"]

    def own_heights(self) -> Heights:
        """Return the ground as the nodes' own echoes have it, of those that say anything of it."""
        return Heights.at_places(self.place_m, self.own_m, self.own_sigma_m).rows(np.flatnonzero(self.heard))


def two_surfaces(evidence: NodeEvidence, microrelief_m: float, before: TwoSurfaces | None = None) -> TwoSurfaces:
    """Return ground and plants at the nodes.

    evidence: of their echoes.
    microrelief_m: what is usual on such ground; see `Covariance`.
    before: what is known of them from another reference surface, to begin with.
    """
    nodes, types, grounds = evidence.layer.shape
    ground_m, step_m = evidence.ground_m, float(evidence.ground_m[1] - evidence.ground_m[0])
    near = KDTree(evidence.place_m).query(evidence.place_m, k=min(NEAREST + 1, nodes))[1][:, 1:]
    around = near[:, :AROUND]
    plants, weight = np.full(nodes, 0.5), np.full(types, 1 / types)
    mean_m, sigma_m = np.full(nodes, ground_m.mean()), np.full(nodes, np.ptp(ground_m) / np.sqrt(12))
    if before is not None:
        nearest = KDTree(before.place_m).query(evidence.place_m)[1]
        plants, weight = before.plants[nearest], before.type_weight
        mean_m = before.ground_m[nearest] - evidence.reference_m
        sigma_m = np.maximum(before.ground_sigma_m[nearest], step_m)
    fine_m = np.linspace(ground_m[0], ground_m[-1], (grounds - 1) * FINER + 1)
    for number in range(ROUNDS):
        chance = (np.sum(plants[around], axis=1) + 0.5) / (around.shape[1] + 1)
        by_type = evidence.layer + np.log(weight[:, None] * chance[:, None, None])
        clear = evidence.bare + np.log1p(-chance)[:, None]
        total = np.logaddexp(log_sum_exp(by_type, axis=1), clear)
        prior = _prior(fine_m, mean_m, sigma_m)
        # Within the heights that are tried the prior itself is narrower: that is no information of the echoes.
        before_m, before_m2 = _moments(_normalised(prior), fine_m)
        # Evidence falls by hundreds of nepers where an echo ends: splines of continuous curvature overshoot there.
        fine = Akima1DInterpolator(ground_m, total, axis=1)(fine_m)
        by_all_m, variance = _moments(_normalised(fine + prior), fine_m)
        # The heights are a step apart, which the prior must not fall between.
        wide_m = np.hypot(sigma_m, step_m / 2)
        posterior = _normalised(total + _prior(ground_m, mean_m, wide_m))
        of_type = posterior[:, None] * np.exp(by_type - total[:, None])
        plants = np.minimum(of_type.sum(axis=(1, 2)), 1.0)
        weight = (of_type.sum(axis=(0, 2)) + 1.0) / (of_type.sum() + types)
        information = 1 / variance - 1 / before_m2
        known = information > 1 / (SILENT * step_m) ** 2
        own_m = (by_all_m / variance - before_m / before_m2) / np.where(known, information, 1.0)
        # One that would be beyond the heights that were tried is no measurement.
        known &= (own_m >= ground_m[0]) & (own_m <= ground_m[-1])
        own_m = np.where(known, own_m, mean_m)
        own_sigma_m = np.where(known, 1 / np.sqrt(np.where(known, information, 1.0)), SILENT * step_m)
        if number:
            own_sigma_m *= _excess(own_m - mean_m, np.hypot(own_sigma_m, sigma_m), plants, known)
        if known.sum() <= NEAREST:
            continue  # too few say anything to predict the others
        heights = Heights.at_places(evidence.place_m, evidence.reference_m + own_m, own_sigma_m)
        predicted_m, sigma_m = predictions(heights, near, known, microrelief_m)
        mean_m, sigma_m = predicted_m - evidence.reference_m, np.maximum(sigma_m, 2 * LEAST_M)
    every = np.concatenate([evidence.bare[:, None], evidence.layer], axis=1).astype(float)
    nearby = (plants + plants[around].sum(axis=1)) / (1 + around.shape[1])
    shared_sigma_m = _of_kinds(every, (mean_m - ground_m[0]) / step_m, around, nearby) * step_m
    with_plants = of_type / np.maximum(of_type.sum(axis=(1, 2), keepdims=True), np.finfo(float).tiny)

    def mean(values: Float[np.ndarray, "node type ground"]) -> Float[np.ndarray, " node"]:
        return np.sum(with_plants * values, axis=(1, 2))

    thickness_m, square_m2 = evidence.thickness_m.astype(float), evidence.square_m2.astype(float)
    thick_m, top_m = mean(thickness_m), mean(ground_m + thickness_m)
    thick_m2 = mean(square_m2) - thick_m**2
    top_m2 = mean(ground_m**2 + 2 * ground_m * thickness_m + square_m2) - top_m**2
    return TwoSurfaces(
        place_m=evidence.place_m,
        heard=known,
        own_m=evidence.reference_m + own_m,
        own_sigma_m=own_sigma_m,
        ground_m=evidence.reference_m + by_all_m,
        ground_sigma_m=np.sqrt(variance),
        shared_sigma_m=shared_sigma_m,
        plants=plants,
        thickness_m=thick_m,
        thickness_sigma_m=np.sqrt(np.maximum(thick_m2, 0.0) + step_m**2 / 12),
        top_sigma_m=np.sqrt(np.maximum(top_m2, 0.0) + step_m**2 / 12),
        type_weight=weight,
    )


def _of_kinds(
    log: Float[np.ndarray, "node kind ground"],
    middle: Float[np.ndarray, " node"],
    around: Int[np.ndarray, "node near"],
    chance: Float[np.ndarray, " node"],
) -> Float[np.ndarray, " node"]:
    """Return the standard deviation of the ground at each node between types of plants, in steps of the heights.

    log: evidence without plants, the first kind, and with those of each type.
    middle: the ground by all nodes, in steps from the lowest height; around: the neighbours of each node.
    chance: probability of plants.
    """
    offset = np.arange(-REACH, REACH + 1)
    place = np.clip(middle[:, None] + offset, 0, log.shape[2] - 1.001)
    below = place.astype(np.int64)[:, None]
    part = place[:, None] - below
    near = np.take_along_axis(log, below, 2) * (1 - part) + np.take_along_axis(log, below + 1, 2) * part
    pooled = near + near[around].sum(axis=1)
    weight = np.exp(pooled - pooled.max(axis=2, keepdims=True))
    moved = weight @ offset / weight.sum(axis=2)
    # What one node tells of the types counts, not all together: they are but the likeliest of many.
    told = log_sum_exp(near[:, 1:], axis=2)
    told = (told + told[around].sum(axis=1)) / (around.shape[1] + 1)
    share = np.column_stack([1 - chance, chance[:, None] * _normalised(told)])
    return np.sqrt(np.maximum(np.sum(share * moved**2, axis=1) - np.sum(share * moved, axis=1) ** 2, 0.0))


def _excess(
    residual_m: Float[np.ndarray, " node"],
    sigma_m: Float[np.ndarray, " node"],
    plants: Float[np.ndarray, " node"],
    known: Bool[np.ndarray, " node"],
) -> Float[np.ndarray, " node"]:
    """Return the ratios of errors of nodes to those stated, at least 1: under plants, and elsewhere."""
    square, factor = (residual_m / sigma_m) ** 2, np.ones(len(plants))
    for share in (plants, 1 - plants):
        some = np.sum(square * share * known) / max(float(np.sum(share * known)), 1.0)
        factor[(share > 0.5) & known] = np.sqrt(max(some, 1.0))
    return factor


def _prior(
    height_m: Float[np.ndarray, " ground"], mean_m: Float[np.ndarray, " node"], sigma_m: Float[np.ndarray, " node"]
) -> Float[np.ndarray, "node ground"]:
    return -0.5 * ((height_m - mean_m[:, None]) / sigma_m[:, None]) ** 2


def _moments(
    probability: Float[np.ndarray, "node ground"], height_m: Float[np.ndarray, " ground"]
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the mean of heights and their variance, which is at least that of the least error."""
    mean_m = probability @ height_m
    return mean_m, np.maximum(probability @ height_m**2 - mean_m**2, LEAST_M**2)


def _normalised(log: Float[np.ndarray, "node ground"]) -> Float[np.ndarray, "node ground"]:
    return np.exp(log - log_sum_exp(log, axis=1, keepdims=True))


def predictions(
    heights: Heights, near: Int[np.ndarray, "node near"], known: Bool[np.ndarray, " node"], microrelief_m: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return the ground kriged from the nearest other nodes at each: mean and standard deviation, m.

    heights: of all nodes; near: the nearest others of each; known: the nodes whose own echoes say something.
    """
    trend = heights.rows(np.flatnonzero(known)).trend()
    measured = heights.above(trend, microrelief_m)
    # The covariance is learned where the ground is known best.
    sure = known & (heights.sigma_m <= 2 * np.median(heights.sigma_m[known]))
    fitted = fit_covariance(measured.rows(sure), 1)
    farthest_m = float(np.hypot(*np.ptp(heights.place_m, axis=0))) + 1.0
    between = fitted.covariance.table(farthest_m, 0.0).between
    total, diagonal = between(heights.place_m[near], heights.place_m[near]), np.arange(near.shape[1])
    total[:, diagonal, diagonal] += fitted.noise_factor * heights.sigma_m[near] ** 2
    to = between(heights.place_m[:, None], heights.place_m[near])[:, 0]
    weight = np.linalg.solve(total, to[..., None])[..., 0]
    before = fitted.covariance.variance_m2 + fitted.covariance.microrelief.variance_m2
    left = np.maximum(before - np.sum(weight * to, axis=1), 0.0)
    plane = trend[0] + heights.place_m @ trend[1:]
    return plane + np.sum(weight * measured.height_m[near], axis=1), np.sqrt(left)
