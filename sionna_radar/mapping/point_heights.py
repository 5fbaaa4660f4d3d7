"""Points as heights over their footprints, with the speckle that neighbouring pulses share."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.angle.segments import LENGTH_OVER_WIDTH, range_strips
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.threads import chunks_of_bytes
from sionna_radar.inference.echo.beam import BeamNodes
from sionna_radar.inference.echo.speckle import SpeckleMemory, repeats, speckle_reach
from sionna_radar.inference.terrain.heights import Heights, footprint_axes, on_ground
from sionna_radar.mapping.points import Points
from sionna_radar.radar.chirp import Chirp


def strip_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the footprint axes of points at measured directions: along a range strip, and across it."""
    strips = range_strips(pose, beam.spread)
    width = strips.along * LENGTH_OVER_WIDTH * np.cos(strips.incidence_rad)
    both = np.stack([strips.strip * strips.along[:, None], strips.climb * width[:, None]], axis=1)
    offset = np.einsum("pij,pkj->pki", pose.R_world_antenna[:, :, 1:], both)
    return np.stack([range_m[:, None] * on_ground(pose, offset[:, k]) for k in range(2)], axis=1)


@dataclass(frozen=True, kw_only=True)
class PointFootprints:
    """Footprints of points, in the order of the points.

    footprint_m: axes of its footprint on level ground, as long as its standard deviations.
    reach: over how many pulses its speckle repeats; see `speckle`.
    """

    footprint_m: Float[np.ndarray, "point 2 2"]
    reach: Float[np.ndarray, " point"]


def point_footprints(
    points: Points,
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
    beam: BeamNodes,
    chirp: Chirp,
    memory: SpeckleMemory,
) -> PointFootprints:
    """Return the footprint and speckle reach of each point.

    points: located echoes.
    measured: returns the measured poses of pulses by their indices.
    beam, chirp, memory: of the radar, and of the ground.
    """
    pulse, first, row = np.unique(points.pulse, return_index=True, return_inverse=True)

    def pose_of(row: Int[np.ndarray, " row"]) -> Pose:
        return measured(pulse[row])

    reach = speckle_reach(pulse, pose_of, points.range_m[first], beam, chirp, memory)
    axes_of = footprint_axes if points.across_sigma_m is None else strip_axes

    def footprints(low: int, high: int) -> Float[np.ndarray, "some 2 2"]:
        unique_rows, back = np.unique(row[low:high], return_inverse=True)
        return axes_of(pose_of(unique_rows).rows(back), points.range_m[low:high], beam)

    footprint_m = np.concatenate([footprints(*bounds) for bounds in chunks_of_bytes(len(points), 3 * 3 * 8)])
    reach = reach[row] if points.reach is None else np.maximum(reach[row], points.reach)
    return PointFootprints(footprint_m=footprint_m, reach=reach)


def point_heights(points: Points, view: PointFootprints | None) -> Heights:
    """Return points as heights: over their footprints, or at single places if these are unknown."""
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / np.maximum(np.linalg.norm(away, axis=1), np.finfo(float).tiny)
    place, height, sigma = points.position_m[:, :2], points.position_m[:, 2], points.range_sigma_m * steep
    if points.across_sigma_m is not None:
        sigma = np.hypot(sigma, points.across_sigma_m * np.sqrt(1 - steep**2))
        if view is not None:
            # Of two pulses that share their speckle only points in the same range cells do: instead of every two points
            # of both, each counts as independent, with the errors that do as much harm.
            sigma = sigma * np.sqrt(repeats(view.reach))
            view = replace(view, reach=np.zeros(len(points)))
    if view is None:
        return Heights.at_places(place, height, sigma)
    return Heights(
        place_m=place,
        height_m=height,
        sigma_m=sigma,
        footprint_m=view.footprint_m,
        order=points.pulse.astype(float),
        reach=view.reach,
    )
