"""How each point was looked at: its footprint on the ground, and how long its speckle stays."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.threads import parts
from sionna_radar.mapping.beam import BeamNodes
from sionna_radar.mapping.footprint import footprint_axes, strip_axes
from sionna_radar.mapping.heights import Heights
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.speckle import AT_ONCE, SpeckleMemory, repeats, speckle_reach
from sionna_radar.radar.chirp import Chirp

LEAST_DISTANCE_M = 1e-9


@dataclass(frozen=True, kw_only=True)
class Looks:
    """How each point was looked at, in the order of the points.

    footprint_m: axes of its footprint on level ground, as long as its standard deviations.
    reach: over how many pulses its speckle repeats; see `speckle`.
    """

    footprint_m: Float[np.ndarray, "point 2 2"]
    reach: Float[np.ndarray, " point"]


def looks_at(
    points: Points,
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose],
    beam: BeamNodes,
    chirp: Chirp,
    memory: SpeckleMemory,
) -> Looks:
    """Return how points were looked at.

    Parameters
    ----------
    points:
        Located echoes.
    measured:
        Returns the measured poses of pulses by their indices.
    beam, chirp, memory:
        Of the radar, and of the ground.

    """
    pulse, first, row = np.unique(points.pulse, return_index=True, return_inverse=True)

    def pose_of(row: Int[np.ndarray, " row"]) -> Pose:
        return measured(pulse[row])

    reach = speckle_reach(pulse, pose_of, points.range_m[first], beam, chirp, memory)
    axes_of = footprint_axes if points.across_sigma_m is None else strip_axes

    def footprints(low: int, high: int) -> Float[np.ndarray, "some 2 2"]:
        own, back = np.unique(row[low:high], return_inverse=True)
        return axes_of(pose_of(own).rows(back), points.range_m[low:high], beam)

    footprint_m = np.concatenate([footprints(*bounds) for bounds in parts(len(points), AT_ONCE)])
    reach = reach[row] if points.reach is None else np.maximum(reach[row], points.reach)
    return Looks(footprint_m=footprint_m, reach=reach)


def point_heights(points: Points, looks: Looks | None) -> Heights:
    """Return points as heights: over their footprints, or at single places if these are unknown."""
    away = points.position_m - points.origin_m
    steep = np.abs(away[:, 2]) / np.maximum(np.linalg.norm(away, axis=1), LEAST_DISTANCE_M)
    place, height, sigma = points.position_m[:, :2], points.position_m[:, 2], points.range_sigma_m * steep
    if points.across_sigma_m is not None:
        sigma = np.hypot(sigma, points.across_sigma_m * np.sqrt(1 - steep**2))
        if looks is not None:
            # Of two pulses that share their speckle only points in the same range cells do: instead of every two points
            # of both, each counts as independent, with the errors that do as much harm.
            sigma = sigma * np.sqrt(repeats(looks.reach))
            looks = replace(looks, reach=np.zeros(len(points)))
    if looks is None:
        return Heights.at_places(place, height, sigma)
    return Heights(
        place_m=place,
        height_m=height,
        sigma_m=sigma,
        footprint_m=looks.footprint_m,
        order=points.pulse.astype(float),
        reach=looks.reach,
    )
