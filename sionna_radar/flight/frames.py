"""Frames and the rotations between them.

world   east, north, up (ENU): the frame of scenes and points
level   forward, right, down with the heading of the platform: the paper's absolute coordinates
body    nose, right, down (FRD): `level` rotated by pitch and roll
antenna x boresight, y to the left of it, z completing the right-handed frame (up, for a level boresight)

`R_a_b` transforms components in b into components in a: v_a = R_a_b @ v_b, so R_a_c = R_a_b @ R_b_c.
Heading is clockwise from north; the Euler order is heading, pitch, roll (ZYX), vehicle-carried
north-east-down to body, as in Rouveure et al. 2017.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

# north-east-down components to east-north-up components
R_WORLD_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def world_from_body(euler_rad: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return R_world_body for Euler angles (roll, pitch, heading)."""
    R_ned_body = Rotation.from_euler("ZYX", euler_rad[:, ::-1]).as_matrix()
    return R_WORLD_NED @ R_ned_body


def world_from_level(euler_rad: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Return R_world_level: the heading alone, roll and pitch removed by stabilisation."""
    return world_from_body(euler_rad * np.array([0.0, 0.0, 1.0]))


def whisk_broom_from_antenna(incidence_rad: float, scan_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the antenna's axes in forward-right-down components, rotated about the forward axis.

    The boresight, the first column, is (sin a, cos a sin b, cos a cos b).
    """
    # A right-handed rotation about forward takes right to down; the scan angle is positive toward the right.
    turn = Rotation.from_rotvec(np.outer(-scan_rad, [1.0, 0.0, 0.0])).as_matrix()
    return turn @ _tilted_antenna(incidence_rad)


def conical_from_antenna(incidence_rad: float, scan_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the antenna's axes in forward-right-down components, rotated about the downward axis.

    The boresight, the first column, is (sin a cos b, sin a sin b, cos a).
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
