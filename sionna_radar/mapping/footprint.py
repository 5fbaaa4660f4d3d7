"""Where a beam looks on the ground: the Gaussian footprint of an echo."""

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.beam import BeamNodes

# A ray closer to the horizon counts as this far below it: its footprint would be endless.
SHALLOWEST = 0.1


def footprint_axes(pose: Pose, range_m: Float[np.ndarray, " pulse"], beam: BeamNodes) -> Float[np.ndarray, "pulse 2 2"]:
    """Return the axes of each pulse's footprint on level ground, as long as its standard deviations.

    The two-way pattern is taken for a Gaussian with the same second moments in azimuth and in elevation.
    """
    ahead = pose.boresight
    down = np.minimum(ahead[:, 2], -SHALLOWEST)
    axes = []
    for number, spread in enumerate(beam.spread, start=1):
        aside = pose.R_world_antenna[:, :, number]
        on_ground = aside - (aside[:, 2] / down)[:, None] * ahead
        axes.append(range_m[:, None] * spread * on_ground[:, :2])
    return np.stack(axes, axis=1)
