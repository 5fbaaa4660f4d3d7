"""Where a beam looks on the ground: the Gaussian footprint of an echo."""

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.angle.range_strips import LENGTH_OVER_WIDTH, range_strips
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.beam import BeamNodes

# A ray closer to the horizon counts as this far below it: its footprint would be endless.
SHALLOWEST = 0.1


def footprint_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the axes of each pulse's footprint on level ground, as long as its standard deviations.

    The two-way pattern is taken for a Gaussian with the same second moments in azimuth and in elevation.
    """
    axes = []
    for number, spread in enumerate(beam.spread, start=1):
        axes.append(range_m[:, None] * spread * _on_ground(pose, pose.R_world_antenna[:, :, number]))
    return np.stack(axes, axis=1)


def strip_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the same axes for points at measured directions: the strip of a range cell, and the cells of a point."""
    strips = range_strips(pose, beam.spread)
    width = strips.along * LENGTH_OVER_WIDTH * np.cos(strips.incidence_rad)
    both = np.stack([strips.strip * strips.along[:, None], strips.climb * width[:, None]], axis=1)
    aside = np.einsum("pij,pkj->pki", pose.R_world_antenna[:, :, 1:], both)
    return np.stack([range_m[:, None] * _on_ground(pose, aside[:, k]) for k in range(2)], axis=1)


def _on_ground(pose: Pose, aside: Float[np.ndarray, "pulse 3"]) -> Float[np.ndarray, "pulse 2"]:
    """Return where on level ground, at a range of one, small angles aside of the boresight meet it."""
    ahead = pose.boresight
    down = np.minimum(ahead[:, 2], -SHALLOWEST)
    met: Float[np.ndarray, "pulse 3"] = aside - (aside[:, 2] / down)[:, None] * ahead
    return met[:, :2]
