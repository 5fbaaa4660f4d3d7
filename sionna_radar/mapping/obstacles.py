"""Obstacles that the processing reports: echoes from above the ground, in clusters. Nothing here knows the truth.

An echo is placed on the beam's axis, or in its measured direction. Its height over the map errs by the map's standard
deviation s, by that of its range, and by the direction in the beam that it comes from,

    var = s^2 + (u_z - g . u)^2 s_r^2 + r^2 sum over a of s_a^2 (a_z - g . a)^2,

u the direction, a the two axes across it with the standard deviations s_a of the two-way beam, and g the slope of the
map. Echoes higher than a multiple of its root are linked to clusters. Noise makes echoes in the air too: with the
false-alarm probability p of a cell, n cells of air in all, and q others expected within the linking distance,

    n p q^(k - 1)  clusters of k echoes,      N prod Q(z)  clusters of ground that appears so high,

are expected, N being the echoes and Q the tail of the normal distribution. exp(-expected) is the probability that such
a cluster is an obstacle.

The map is made without the echoes from above, which a plane through the ground around them tells beforehand.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.special import log_ndtr

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.numerics import MAD_SIGMA
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna, two_way_spread

# Squares around a point whose plane is its ground: five by five, of which a wire crosses five. Fewer make no plane.
NEIGHBOURS, LEAST_SQUARES = 25, 9
# Triples of neighbours, drawn once: with a third of obstacles among them one in three is of ground alone.
TRIPLES = np.random.default_rng(0).random((48, NEIGHBOURS))
# Standard deviations beyond which a square stands out of the plane. For squares on a line: slopes are near zero.
OUTSTANDING, RIDGE = 2.5, 1e-6 * np.eye(3)


@dataclass(frozen=True, kw_only=True)
class ObstacleRule:
    """What is reported as an obstacle.

    sigmas: height over the map over its standard deviation that echoes exceed.
    min_probability: of clusters.
    false_alarm_probability: of noise in a range cell; cell_m: its length; min_range_m: of the nearest.
    link_m: distance at which echoes are linked, unless the beam is wider.
    """

    sigmas: float
    min_probability: float
    false_alarm_probability: float
    cell_m: float
    min_range_m: float
    link_m: float


@dataclass(frozen=True, kw_only=True)
class ReportedObstacles(Columns):
    """Clusters of echoes above the ground, one row each.

    position_m: of its highest echo; above_m: of that over the map, with the standard deviation sigma_m.
    radius_m: horizontal distance of its farthest echo from the mean place of all, plus half a beam's width.
    echoes: number of them; first_range_m: of the first.
    report_pulse: the pulse with which the probability of those so far passes the least of the rule.
    probability: that it is an obstacle, and neither noise nor ground; see the module.
    """

    position_m: Float[np.ndarray, "obstacle 3"]
    above_m: Float[np.ndarray, " obstacle"]
    sigma_m: Float[np.ndarray, " obstacle"]
    radius_m: Float[np.ndarray, " obstacle"]
    echoes: Int[np.ndarray, " obstacle"]
    first_range_m: Float[np.ndarray, " obstacle"]
    report_pulse: Int[np.ndarray, " obstacle"]
    probability: Float[np.ndarray, " obstacle"]


@dataclass(frozen=True, kw_only=True)
class GroundAround:
    """The ground under points, as a plane through the echoes around each tells: height, slope, and their spread."""

    height_m: Float[np.ndarray, " point"]
    slope: Float[np.ndarray, "point 2"]
    spread_m: Float[np.ndarray, " point"]


def ground_around(points: Points, link_m: float) -> GroundAround | None:
    """Return the ground under points; None for too few.

    An obstacle returns many echoes from one place, so that places count alike: squares of `link_m`, each with the echo
    at the lower quartile of its heights. Squares of an obstacle alone stand out of the plane, and do not count.
    """
    square = np.floor(points.position_m[:, :2] / link_m).astype(np.int64)
    _, of, count = np.unique(square, axis=0, return_inverse=True, return_counts=True)
    if len(count) < LEAST_SQUARES:
        return None
    of = of.ravel()
    order = np.lexsort((points.position_m[:, 2], of))
    quartile = points.position_m[order[np.cumsum(count) - count + (count - 1) // 4]]
    place, height = quartile[:, :2], quartile[:, 2]
    near = KDTree(place).query(place, min(NEIGHBOURS, len(place)))[1]
    offset = place[near] - place[:, None]
    level, slope = _ground_planes(offset, height[near])
    misfit = height[near] - level[:, None] - np.einsum("nki,ni->nk", offset, slope)
    under = level[of] + np.einsum("ni,ni->n", points.position_m[:, :2] - place[of], slope[of])
    spread = MAD_SIGMA * np.median(np.abs(misfit), axis=1)
    return GroundAround(height_m=under, slope=slope[of], spread_m=spread[of])


def above_ground(points: Points, pose: Pose, antenna: Antenna, rule: ObstacleRule) -> Bool[np.ndarray, " point"]:
    """Return the mask of points higher over the ground around them than a multiple of the uncertainty.

    pose: as measured, of the pulse of each point.
    """
    ground = ground_around(points, rule.link_m)
    if ground is None:
        return np.zeros(len(points), dtype=bool)
    sigma = np.hypot(ground.spread_m, _beam_sigma_m(points, pose, antenna, ground.slope))
    return points.position_m[:, 2] - ground.height_m > rule.sigmas * sigma


def _ground_planes(
    offset: Float[np.ndarray, "n k 2"], height: Float[np.ndarray, "n k"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Return heights at the middle and slopes of planes through neighbours, whatever stands out of them.

    Of the planes through some triples that of the least median of |misfit| (Rousseeuw 1984, "Least median of squares
    regression"), then a fit without those that stand out of it.
    """
    design = np.concatenate([np.ones((*height.shape, 1)), offset], axis=2)
    best, least = np.zeros((len(height), 3)), np.full(len(height), np.inf)
    for triple in TRIPLES[:, : height.shape[1]].argsort(axis=1)[:, :3]:
        # Three on a line make no plane, and the ridge a poor one.
        normal = np.einsum("nki,nkj->nij", design[:, triple], design[:, triple]) + RIDGE
        right = np.einsum("nki,nk->ni", design[:, triple], height[:, triple])
        plane = np.linalg.solve(normal, right[..., None])[..., 0]
        middle = np.median(np.abs(height - np.einsum("nki,ni->nk", design, plane)), axis=1)
        best = np.where((middle < least)[:, None], plane, best)
        least = np.minimum(middle, least)
    misfit = np.abs(height - np.einsum("nki,ni->nk", design, best))
    weight = (misfit <= OUTSTANDING * MAD_SIGMA * least[:, None] + 1e-6).astype(np.float64)
    weighted = design * weight[..., None]
    normal = np.einsum("nki,nkj->nij", weighted, design) + RIDGE
    plane = np.linalg.solve(normal, np.einsum("nki,nk->ni", weighted, height)[..., None])[..., 0]
    return plane[:, 0], plane[:, 1:]


def _beam_sigma_m(
    points: Points, pose: Pose, antenna: Antenna, slope: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Return the standard deviation of points' heights over ground of a slope, from their ranges and directions."""
    toward = (points.position_m - points.origin_m) / points.range_m[:, None]
    variance = (_rise(toward, slope) * points.range_sigma_m) ** 2
    if points.across_sigma_m is not None:
        return np.sqrt(variance + points.across_sigma_m**2)
    for axis, spread in zip((1, 2), two_way_spread(antenna), strict=True):
        variance += (_rise(pose.R_world_antenna[:, :, axis], slope) * points.range_m * spread) ** 2
    return np.sqrt(variance)


def _rise(way: Float[np.ndarray, "n 3"], slope: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return way[:, 2] - np.einsum("ni,ni->n", way[:, :2], slope)


def reported_obstacles(
    points: Points,
    pose: Pose,
    antenna: Antenna,
    dem: Raster,
    dem_sigma: Raster | None,
    rule: ObstacleRule,
    pulses: int,
) -> tuple[ReportedObstacles, Int[np.ndarray, " point"]]:
    """Return the clusters of echoes above a map, and the number of the cluster of each point, -1 for none.

    points, pose: all echoes, and the measured pose of each.
    dem, dem_sigma: made without those from above; without standard deviations the map counts as exact.
    pulses: number of pulses of the survey.
    """
    member = np.full(len(points), -1)
    if len(points) == 0 or not dem.filled.any():
        return _table(points, []), member
    above, spread = _over_map(points, pose, antenna, dem, dem_sigma, rule.link_m)
    z = np.nan_to_num(above / np.maximum(spread, 1e-9), nan=-np.inf)
    high = np.flatnonzero(z > rule.sigmas)
    width_m = points.range_m * max(antenna.beamwidths_rad)
    link_m = max(rule.link_m, float(np.median(width_m[high])) if len(high) else 0.0)
    label = _linked(points.position_m[high], link_m)
    air_cells = np.maximum(points.range_m - rule.min_range_m, 0.0).mean() / rule.cell_m
    alarms = np.log(max(rule.false_alarm_probability * air_cells * pulses, 1e-300))
    density = len(points) / (np.count_nonzero(dem.filled) * dem.grid.spacing_m**2)
    beside = density * np.pi * link_m**2 * rule.false_alarm_probability * 2 * link_m / rule.cell_m
    rows: list[tuple[float, ...]] = []
    for cluster in range(int(label.max(initial=-1)) + 1):
        own = high[label == cluster]
        own = own[np.argsort(points.pulse[own], kind="stable")]
        echoes = np.cumsum(np.append(True, np.diff(points.pulse[own]) > 0))
        from_noise = alarms + (echoes - 1) * np.log(max(min(beside, 1.0), 1e-300))
        from_ground = np.log(len(points)) + np.cumsum(log_ndtr(-z[own]))
        with np.errstate(over="ignore"):  # of endlessly many the probability is zero
            probability = np.exp(-np.exp([from_noise, from_ground]).sum(axis=0))
        passed = np.flatnonzero(probability >= rule.min_probability)
        if len(passed) == 0:
            continue
        place, top = points.position_m[own, :2], own[np.argmax(above[own])]
        reach_m = float(np.linalg.norm(place - place.mean(axis=0), axis=1).max() + width_m[own].mean() / 2)
        report, member[own] = points.pulse[own[passed[0]]], len(rows)
        row = (top, above[top], spread[top], reach_m, len(own), own[0], report, probability.max())
        rows.append(tuple(float(number) for number in row))
    return _table(points, rows), member


def _table(points: Points, rows: Sequence[Sequence[float]]) -> ReportedObstacles:
    top, above, sigma, radius, echoes, first, report, probability = np.array(rows, dtype=np.float64).reshape(-1, 8).T
    return ReportedObstacles(
        position_m=points.position_m[top.astype(np.int64)],
        above_m=above,
        sigma_m=sigma,
        radius_m=radius,
        echoes=echoes.astype(np.int64),
        first_range_m=points.range_m[first.astype(np.int64)],
        report_pulse=report.astype(np.int64),
        probability=probability,
    )


def _over_map(
    points: Points, pose: Pose, antenna: Antenna, dem: Raster, dem_sigma: Raster | None, link_m: float
) -> tuple[Float[np.ndarray, " point"], Float[np.ndarray, " point"]]:
    """Return heights over a map, and their standard deviations; over the ground around where the map is empty.

    What a map states of ground that its footprints do not resolve may exceed all that the ground around it varies by;
    then that is taken.
    """
    row, column, inside = dem.grid.cell_of(points.position_m)
    slope = np.stack([_gradient(dem, axis)[row, column] for axis in (1, 0)], axis=1)
    level = dem.height_m[row, column]
    sigma = np.zeros(len(points)) if dem_sigma is None else dem_sigma.height_m[row, column]
    around = ground_around(points, link_m)
    mapped = inside & np.isfinite(level)
    if around is None:
        level = np.where(mapped, level, np.nan)
        slope = np.nan_to_num(slope)
    else:
        sigma = np.where(mapped, np.fmin(sigma, around.spread_m), around.spread_m)
        level = np.where(mapped, level, around.height_m)
        slope = np.where((mapped & np.isfinite(slope).all(axis=1))[:, None], slope, around.slope)
    return points.position_m[:, 2] - level, np.hypot(sigma, _beam_sigma_m(points, pose, antenna, slope))


def _gradient(dem: Raster, axis: int) -> Float[np.ndarray, "row column"]:
    """Return the slope of a map along its rows (0) or columns (1); NaN beside empty cells."""
    if dem.height_m.shape[axis] < 2:
        return np.zeros(dem.height_m.shape)
    return np.gradient(dem.height_m, dem.grid.spacing_m, axis=axis)


def _linked(place_m: Float[np.ndarray, "n 3"], distance_m: float) -> Int[np.ndarray, " n"]:
    """Return the number of the cluster of each place: those nearer than a distance to each other are one."""
    if len(place_m) == 0:
        return np.zeros(0, dtype=np.int64)
    pairs = KDTree(place_m).query_pairs(distance_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(place_m),) * 2)
    return connected_components(graph, directed=False)[1].astype(np.int64)
