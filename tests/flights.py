"""Pulses of a platform in level flight."""

import numpy as np

from sionna_radar.flight.frames import whisk_broom_from_antenna, world_from_body
from sionna_radar.flight.pulses import Pose, Pulses


def make_pulses(
    count: int = 1,
    *,
    incidence_deg: float = 0.0,
    scan_deg: float | np.ndarray = 0.0,
    position_m: tuple[float, float, float] | np.ndarray = (0.0, 0.0, 50.0),
    velocity_mps: tuple[float, float, float] = (0.0, 10.0, 0.0),
    heading_deg: float = 0.0,
    first: int = 0,
) -> Pulses:
    """Return pulses of a level platform that looks at an angle from nadir, north unless turned."""
    scan_rad = np.broadcast_to(np.deg2rad(scan_deg), (count,)).astype(float)
    euler = np.tile([0.0, 0.0, np.deg2rad(heading_deg)], (count, 1))
    pose = Pose(
        position_m=np.broadcast_to(position_m, (count, 3)).astype(float),
        velocity_mps=np.tile(np.asarray(velocity_mps, dtype=float), (count, 1)),
        R_world_antenna=world_from_body(euler) @ whisk_broom_from_antenna(np.deg2rad(incidence_deg), scan_rad),
    )
    index = np.arange(first, first + count)
    return Pulses(index=index, time_s=index / 360.0, scan_rad=scan_rad, true=pose, measured=pose)
