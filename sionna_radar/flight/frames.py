"""Coordinate frames, rotations between them, and the motion of an antenna at the end of a lever arm.

world   east, north, up (ENU): the frame of scenes and points
level   forward, right, down with the heading of the platform: the paper's absolute coordinates
body    nose, right, down (FRD): `level` rotated by pitch and roll
antenna x boresight, y to the left of it, z completing the right-handed frame (up, for a level boresight)

`R_a_b` transforms components in b into components in a: v_a = R_a_b @ v_b, so R_a_c = R_a_b @ R_b_c.
Heading is clockwise from north; the Euler order is heading, pitch, roll (ZYX), vehicle-carried
north-east-down to body, as in Rouveure et al. 2017.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from sionna_radar.flight.trajectory import Trajectory

# north-east-down components to east-north-up components
R_WORLD_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])

# A ray that meets the ground at a smaller grazing angle counts as one at the angle with this sine, 3 deg: what it meets
# would be endless.
MIN_GRAZING_SINE = 0.05


def world_from_body(euler_rad: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return rotations from body axes (nose, right, down) to world axes, by roll, pitch and heading, rad."""
    R_ned_body = Rotation.from_euler("ZYX", euler_rad[:, ::-1]).as_matrix()
    return R_WORLD_NED @ R_ned_body


def world_from_level(euler_rad: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return R_world_level: the heading alone, roll and pitch removed by stabilisation."""
    return world_from_body(euler_rad * np.array([0.0, 0.0, 1.0]))


def whisk_broom_from_antenna(incidence_rad: float, scan_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the antenna's axes in forward-right-down components, rotated about the forward axis.

    The boresight, the first column, is (sin a, cos a sin b, cos a cos b).

    Parameters
    ----------
    incidence_rad:
        Angle of the boresight from nadir in the middle of the scan, rad.
    scan_rad:
        Scan angles about the forward axis, rad.

    Returns
    -------
    Rotation matrices R_mount_antenna, one for each scan angle.
    """
    # A right-handed rotation about forward takes right to down; the scan angle is positive toward the right.
    turn = Rotation.from_rotvec(np.outer(-scan_rad, [1.0, 0.0, 0.0])).as_matrix()
    return turn @ _tilted_antenna(incidence_rad)


def conical_from_antenna(incidence_rad: float, scan_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Return R_mount_antenna, the antenna's axes in forward-right-down components, turned about the downward axis.

    The boresight, the first column, is (sin a cos b, sin a sin b, cos a): a from nadir, b the scan angle, rad.
    """
    turn = Rotation.from_rotvec(np.outer(scan_rad, [0.0, 0.0, 1.0])).as_matrix()
    return turn @ _tilted_antenna(incidence_rad)


def steering(azimuth_rad: float, elevation_rad: float) -> Float[np.ndarray, "3 3"]:
    """Return R_face_beam: the axes of a beam steered to the left and up, as columns in the axes of its array's face."""
    (ca, sa), (ce, se) = ((np.cos(angle), np.sin(angle)) for angle in (azimuth_rad, elevation_rad))
    return np.array([[ce * ca, -sa, -se * ca], [ce * sa, ca, -se * sa], [se, 0.0, ce]])


def _tilted_antenna(incidence_rad: float) -> Float[np.ndarray, "3 3"]:
    sin, cos = np.sin(incidence_rad), np.cos(incidence_rad)
    boresight, left, up = [sin, 0.0, cos], [0.0, -1.0, 0.0], [cos, 0.0, -sin]
    return np.array([boresight, left, up]).T


Vector3 = tuple[float, float, float]

# Time between the attitudes from which the turn rate is computed.
TURN_STEP_S = 1e-3


@dataclass(frozen=True, kw_only=True)
class BodyMotion:
    """Motion of the platform at its navigation system.

    position_m, velocity_mps: world frame.
    euler_rad: roll, pitch, heading.
    trajectory, time_s: the trajectory, and times within the flight.
    """

    position_m: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"]
    euler_rad: Float[np.ndarray, "n 3"]
    trajectory: Trajectory
    time_s: Float[np.ndarray, " n"]

    @cached_property
    def turn_rad_s(self) -> Float[np.ndarray, "n 3"]:
        """Turn rate about nose, right and down."""
        known = self.trajectory.turn
        return _turn_rate(self.trajectory, self.time_s) if known is None else known(self.time_s)


def body_motion(trajectory: Trajectory, time_s: Float[np.ndarray, " n"]) -> BodyMotion:
    """Return the motion at given times, extrapolated at constant velocity before and after the flight."""
    clipped_s = np.clip(time_s, 0.0, trajectory.end_s)
    velocity = trajectory.velocity(clipped_s)
    return BodyMotion(
        position_m=trajectory.position(clipped_s) + velocity * (time_s - clipped_s)[:, None],
        velocity_mps=velocity,
        euler_rad=trajectory.euler(clipped_s),
        trajectory=trajectory,
        time_s=clipped_s,
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
    """Return the smaller of the backward and forward rates: zero at an instantaneous turn at a waypoint."""
    before, now, after = (
        Rotation.from_matrix(world_from_body(trajectory.euler(time_s + step)))
        for step in (-TURN_STEP_S, 0.0, TURN_STEP_S)
    )
    past, coming = (before.inv() * now).as_rotvec(), (now.inv() * after).as_rotvec()
    slower = np.linalg.norm(past, axis=1) < np.linalg.norm(coming, axis=1)
    return np.where(slower[:, None], past, coming) / TURN_STEP_S
