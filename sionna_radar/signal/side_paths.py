"""The paths as a receiver beside the first sees them."""

from dataclasses import replace

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.second_receiver import SideReceiver
from sionna_radar.tracing.paths import Paths


def side_paths(paths: Paths, pulses: Pulses, receiver: SideReceiver) -> Paths:
    """Return the paths of a block of pulses as they reach a second receiver, from the true pose.

    The way back to a phase centre a baseline away is longer or shorter, by exact distances; the difference of the
    antenna's halves weighs each path by its direction.
    """
    row = pulses.row_of(paths.pulse)
    pose = pulses.true
    away = paths.hit_m - pose.position_m[row]
    range_m = np.linalg.norm(away, axis=1)
    R_world_antenna = pose.R_world_antenna[row]
    direction = np.einsum("nij,ni->nj", R_world_antenna, away / range_m[:, None])
    delay_s = paths.delay_s
    if receiver.true_baseline_m:
        to_side_m = np.linalg.norm(away - receiver.true_baseline_m * R_world_antenna[:, :, receiver.axis], axis=1)
        delay_s = delay_s + (to_side_m - range_m) / speed_of_light
    return replace(paths, delay_s=delay_s, gain=paths.gain * receiver.factor(direction))
