"""The motion of the platform, and of an antenna at the end of a lever arm."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.trajectory import Trajectory

Vector3 = tuple[float, float, float]

# Time between the attitudes from which the turn rate is computed.
TURN_STEP_S = 1e-3


@dataclass(frozen=True, kw_only=True)
class BodyMotion:
    """Motion of the platform at its navigation system.

    position_m, velocity_mps: world frame.
    euler_rad: roll, pitch, heading.
    trajectory, time_s: what it is the motion of, and when; within the flight.
    """

    position_m: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"]
    euler_rad: Float[np.ndarray, "n 3"]
    trajectory: Trajectory
    time_s: Float[np.ndarray, " n"]

    @cached_property
    def turn_rad_s(self) -> Float[np.ndarray, "n 3"]:
        """Turn rate about nose, right and down."""
        return _turn_rate(self.trajectory, self.time_s)


def body_motion(trajectory: Trajectory, time_s: Float[np.ndarray, " n"]) -> BodyMotion:
    """Return the motion at some times; before and after the flight it continues at constant velocity."""
    inside = np.clip(time_s, 0.0, trajectory.end_s)
    velocity = trajectory.velocity(inside)
    return BodyMotion(
        position_m=trajectory.position(inside) + velocity * (time_s - inside)[:, None],
        velocity_mps=velocity,
        euler_rad=trajectory.euler(inside),
        trajectory=trajectory,
        time_s=inside,
    )


def antenna_place(
    motion: BodyMotion, lever_arm_m: Vector3
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
    """Return position and velocity of a point `lever_arm_m` away (nose, right, down)."""
    if not any(lever_arm_m):
        return motion.position_m, motion.velocity_mps
    R_world_body = world_from_body(motion.euler_rad)
    swing = np.cross(motion.turn_rad_s, np.array(lever_arm_m))
    return (
        motion.position_m + R_world_body @ np.array(lever_arm_m),
        motion.velocity_mps + np.einsum("nij,nj->ni", R_world_body, swing),
    )


def _turn_rate(trajectory: Trajectory, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Return the slower of the rates before and after, which is zero at an instantaneous turn at a waypoint."""
    before, now, after = (
        Rotation.from_matrix(world_from_body(trajectory.euler(time_s + step)))
        for step in (-TURN_STEP_S, 0.0, TURN_STEP_S)
    )
    past, coming = (before.inv() * now).as_rotvec(), (now.inv() * after).as_rotvec()
    slower = np.linalg.norm(past, axis=1) < np.linalg.norm(coming, axis=1)
    rate: Float[np.ndarray, "n 3"] = np.where(slower[:, None], past, coming) / TURN_STEP_S
    return rate
