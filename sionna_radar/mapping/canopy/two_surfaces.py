"""Ground and top of plants from the evidence of whole echoes, node by node, with the ground's covariance between them.

At each node of a lattice as fine as the footprints the evidence of its echoes is a table over the height of the ground
and the thickness of a layer on it (`inference.echo.layer`). A node is bare or holds a layer; how probable each is, and
which of some types of plants it holds, is learned from all nodes, the share of plants around each node from its
neighbours.

The ground is a Gaussian field. Evidence for it is seldom Gaussian: of an echo with two ends either may be the ground.
So each node is approximated by the height and the error that have the same effect as its evidence has with what all
others say of the place (expectation propagation; Minka 2001, "Expectation propagation for approximate Bayesian
inference"); what others say is kriging from the nearest ones.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from scipy.interpolate import make_interp_spline
from scipy.spatial import KDTree

from sionna_radar.foundation.numerics import log_sum_exp
from sionna_radar.inference.terrain.covariance import FittedCovariance, fit_covariance
from sionna_radar.inference.terrain.heights import Heights

ROUNDS = 6
# Between the heights evidence is a cubic spline, read at so many times as many; least error of a height, m.
FINER, LEAST_M = 5, 0.005
NEAREST = 16
# Of the nodes around one, which say how probable plants are there; itself among them.
AROUND = 9
TABLE = 2000
# Largest error of a node's ground that is followed, in heights' steps: beyond it the node says nothing.
SILENT = 1e3


@dataclass(frozen=True, kw_only=True)
class NodeEvidence:
    """Log-likelihoods at nodes, in nepers.

    place_m, reference_m: of the nodes, and of the reference surface there.
    ground_m, thickness_m: over the reference, of the ground, and of a layer: 0 and more.
    """

    place_m: Float[np.ndarray, "node 2"]
    reference_m: Float[np.ndarray, " node"]
    log_likelihood: Float32[np.ndarray, "node type ground thickness"]
    ground_m: Float[np.ndarray, " ground"]
    thickness_m: Float[np.ndarray, " thickness"]


@dataclass(frozen=True, kw_only=True)
class TwoSurfaces:
    """What is known at each node.

    site_m, site_sigma_m: the height of the ground by the node's own echoes, and its error.
    ground_m, ground_sigma_m: by all.
    plants: probability of a layer; thickness_m, thickness_sigma_m: of it, if there is one; top_sigma_m: of its top.
    type_weight: how frequent each type is.
    """

    site_m: Float[np.ndarray, " node"]
    site_sigma_m: Float[np.ndarray, " node"]
    ground_m: Float[np.ndarray, " node"]
    ground_sigma_m: Float[np.ndarray, " node"]
    plants: Float[np.ndarray, " node"]
    top_m: Float[np.ndarray, " node"]
    top_sigma_m: Float[np.ndarray, " node"]
    thickness_m: Float[np.ndarray, " node"]
    thickness_sigma_m: Float[np.ndarray, " node"]
    type_weight: Float[np.ndarray, " type"]


def two_surfaces(evidence: NodeEvidence, microrelief_m: float) -> TwoSurfaces:
    """Return ground and plants at the nodes."""
    nodes, types, grounds, layers = evidence.log_likelihood.shape
    step_m = float(evidence.ground_m[1] - evidence.ground_m[0])
    tree = KDTree(evidence.place_m)
    near = tree.query(evidence.place_m, k=min(NEAREST + 1, nodes))[1][:, 1:]
    around = near[:, : AROUND - 1]
    plants, weight = np.full(nodes, 0.5), np.full(types, 1 / types)
    bare = evidence.log_likelihood[:, 0, :, 0].astype(float)
    below_m, spread_m = float(evidence.ground_m.mean()), float(np.ptp(evidence.ground_m)) / np.sqrt(12)
    mean_m, sigma_m = np.full(nodes, below_m), np.full(nodes, spread_m)
    fine_m = np.linspace(evidence.ground_m[0], evidence.ground_m[-1], (grounds - 1) * FINER + 1)
    for _ in range(ROUNDS):
        some = np.sum(plants[around], axis=1) + 0.5
        chance = some / (around.shape[1] + 1)
        with np.errstate(divide="ignore"):
            of_layer = np.log(weight / (layers - 1))[None, :, None, None] + evidence.log_likelihood[..., 1:]
        by_type = log_sum_exp(of_layer, axis=3)
        layer = log_sum_exp(by_type, axis=1) + np.log(chance)[:, None]
        clear = bare + np.log1p(-chance)[:, None]
        total = np.logaddexp(layer, clear)
        fine = _normalised(make_interp_spline(evidence.ground_m, total, axis=1)(fine_m) + _prior(fine_m, mean_m, sigma_m))
        got_m = fine @ fine_m
        variance = np.maximum(fine @ fine_m**2 - got_m**2, LEAST_M**2)
        posterior = _normalised(total + _prior(evidence.ground_m, mean_m, np.hypot(sigma_m, step_m / 2)))
        plants = np.sum(posterior * np.exp(layer - total), axis=1)
        of_type = np.sum(posterior[:, None] * np.exp(by_type - total[:, None]), axis=2) * chance[:, None]
        weight = (of_type.sum(axis=0) + 1.0) / (of_type.sum() + types)
        information = 1 / variance - 1 / sigma_m**2
        known = information > 1 / (SILENT * step_m) ** 2
        site_sigma = np.where(known, 1 / np.sqrt(np.maximum(information, 1e-12)), SILENT * step_m)
        site = np.where(known, (got_m / variance - mean_m / sigma_m**2) * site_sigma**2, mean_m)
        heights = Heights.at_places(evidence.place_m, evidence.reference_m + site, site_sigma)
        predicted, error = predictions(heights, near, known, microrelief_m)
        mean_m, sigma_m = predicted - evidence.reference_m, np.maximum(error, 2 * LEAST_M)
    # With the last prior.
    thick = evidence.thickness_m[1:]
    joint = np.exp(of_layer + np.log(chance)[:, None, None, None] - total[:, None, :, None])
    joint = np.sum(joint * posterior[:, None, :, None], axis=1)
    share = np.maximum(joint.sum(axis=(1, 2)), 1e-300)
    top = evidence.ground_m[:, None] + thick
    mean_thick, mean_top = (np.sum(joint * each, axis=(1, 2)) / share for each in (thick[None], top))
    square_thick, square_top = (np.sum(joint * each**2, axis=(1, 2)) / share for each in (thick[None], top))
    return TwoSurfaces(
        site_m=evidence.reference_m + site,
        site_sigma_m=site_sigma,
        ground_m=evidence.reference_m + got_m,
        ground_sigma_m=np.sqrt(variance),
        plants=plants,
        top_m=evidence.reference_m + mean_top,
        top_sigma_m=np.sqrt(np.maximum(square_top - mean_top**2, 0) + step_m**2 / 12),
        thickness_m=mean_thick,
        thickness_sigma_m=np.sqrt(np.maximum(square_thick - mean_thick**2, 0) + step_m**2 / 12),
        type_weight=weight,
    )


def _prior(
    height_m: Float[np.ndarray, " ground"], mean_m: Float[np.ndarray, " node"], sigma_m: Float[np.ndarray, " node"]
) -> Float[np.ndarray, "node ground"]:
    return -0.5 * ((height_m - mean_m[:, None]) / sigma_m[:, None]) ** 2


def _normalised(log: Float[np.ndarray, "node ground"]) -> Float[np.ndarray, "node ground"]:
    return np.exp(log - log_sum_exp(log, axis=1, keepdims=True))


def predictions(
    heights: Heights, near: Int[np.ndarray, "node near"], known: Bool[np.ndarray, " node"], microrelief_m: float
) -> tuple[Float[np.ndarray, " node"], Float[np.ndarray, " node"]]:
    """Return what the nearest others say of the height at each place: mean and standard deviation."""
    trend = heights.rows(np.flatnonzero(known)).trend()
    measured = heights.above(trend, microrelief_m)
    best = known & (heights.sigma_m <= np.median(heights.sigma_m[known]) * 2)
    fitted = fit_covariance(measured.rows(best), 1)
    between = fitted.covariance.table(float(np.hypot(*np.ptp(heights.place_m, axis=0))) + 1.0, 0.0, TABLE).between
    total = between(heights.place_m[near], heights.place_m[near])
    diagonal = np.arange(near.shape[1])
    total[:, diagonal, diagonal] += fitted.noise_factor * heights.sigma_m[near] ** 2
    to = between(heights.place_m[:, None], heights.place_m[near])[:, 0]
    weight = np.linalg.solve(total, to[..., None])[..., 0]
    before = fitted.covariance.variance_m2 + fitted.covariance.microrelief.variance_m2
    left = np.maximum(before - np.sum(weight * to, axis=1), 1e-9 * before)
    plane = trend[0] + heights.place_m @ trend[1:]
    return plane + np.sum(weight * measured.height_m[near], axis=1), np.sqrt(left)
