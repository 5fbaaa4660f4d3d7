"""A vehicle on its wheels: height, pitch and roll from the ground under them.

The four wheels stand dx ahead or behind and dy beside the middle of the vehicle. A plane through their heights z, by
least squares, has at the middle their mean height, the pitch atan(mean of front less rear z / axle distance), and the
roll atan(mean of left less right z / wheel distance). What is carried stands upright on that plane.
"""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.trajectory import Course, Heights, Phase, Trajectory

# Distances between the places where the ground is read, relative to the distance between the axles.
STEP_AXLES = 0.25


def on_wheels(
    track: Course, speed_mps: float, altitude_m: float, wheels_m: tuple[float, float], ground_m: Heights
) -> Trajectory:
    """Return the drive along a track at constant speed.

    altitude_m: of the navigation system over the plane of the wheels, normal to it.
    wheels_m: distance between the axles, and between the wheels of one.
    ground_m: height of the ground at horizontal positions.
    """
    along, across = np.array(wheels_m) / 2
    count = max(int(np.ceil(track.length_m / (STEP_AXLES * wheels_m[0]))) + 1, 5)
    distance = np.linspace(0.0, track.length_m, count)
    ahead, middle = track.direction(distance), track.point(distance)
    right = ahead[:, ::-1] * [1.0, -1.0]
    front_left, front_right, rear_left, rear_right = (
        ground_m(middle + x * along * ahead + y * across * right) for x in (1, -1) for y in (-1, 1)
    )
    level = np.nanmean([front_left, front_right, rear_left, rear_right], axis=0)
    pitch = np.arctan2(front_left + front_right - rear_left - rear_right, 2 * wheels_m[0])
    roll = np.arctan2(front_left + rear_left - front_right - rear_right, 2 * wheels_m[1])
    surface = CubicSpline(distance, np.column_stack([level, pitch, roll]))

    def along_track(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.clip(time_s * speed_mps, 0.0, track.length_m)

    def attitude(at_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        _, nose, bank = surface(at_m).T
        east, north = track.direction(at_m).T
        return np.column_stack([bank, nose, np.arctan2(east, north)])

    def place(at_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        down = world_from_body(attitude(at_m))[:, :, 2]
        return np.column_stack([track.point(at_m), surface(at_m)[:, 0]]) - altitude_m * down

    def velocity(time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        at_m, half = along_track(time_s), STEP_AXLES * wheels_m[0] / 100
        low, high = np.maximum(at_m - half, 0.0), np.minimum(at_m + half, track.length_m)
        return speed_mps * (place(high) - place(low)) / (high - low)[:, None]

    duration_s = track.length_m / speed_mps
    return Trajectory(
        position=lambda time_s: place(along_track(time_s)),
        velocity=velocity,
        euler=lambda time_s: attitude(along_track(time_s)),
        phases=((Phase.CRUISE, 0.0, duration_s),),
    )
