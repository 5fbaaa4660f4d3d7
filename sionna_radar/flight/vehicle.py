"""A vehicle on its wheels: heading from its axles, height, pitch and roll from the ground under the wheels.

Both axles follow the track, half their distance ahead of the middle and behind it; the nose points from one to the
other, so that a corner of the track is a smooth turn. A plane through the heights z of the four wheels, by least
squares, has at the middle their mean height; with its slope p ahead and its fall q to the right the pitch is atan(p)
and the roll atan(q cos(pitch)). What is carried stands upright on that plane.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from sionna_radar.flight.frames import world_from_body
from sionna_radar.flight.trajectory import Course, Phase, Trajectory
from sionna_radar.foundation.raster import Heights

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
    drive = _Drive(track=track, speed_mps=speed_mps, altitude_m=altitude_m, wheels_m=wheels_m, ground_m=ground_m)
    return Trajectory(
        position=drive.position,
        velocity=drive.velocity,
        euler=drive.euler,
        phases=((Phase.CRUISE, 0.0, track.length_m / speed_mps),),
    )


@dataclass(frozen=True, kw_only=True)
class _Drive:
    track: Course
    speed_mps: float
    altitude_m: float
    wheels_m: tuple[float, float]
    ground_m: Heights

    def position(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return the places of the navigation system."""
        at_m = self._along(time_s)
        front, rear = self._axles(at_m)
        down = world_from_body(self.euler(time_s))[:, :, 2]
        return np.column_stack([(front + rear) / 2, self._surface(at_m)[:, 0]]) - self.altitude_m * down

    def velocity(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return its velocities, differences over a hundredth of the axles' distance."""
        half_s = self.wheels_m[0] / 200 / self.speed_mps
        end_s = self.track.length_m / self.speed_mps
        low, high = np.maximum(time_s - half_s, 0.0), np.minimum(time_s + half_s, end_s)
        return (self.position(high) - self.position(low)) / np.maximum(high - low, 1e-12)[:, None]

    def euler(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading."""
        at_m = self._along(time_s)
        _, pitch, roll = self._surface(at_m).T
        front, rear = self._axles(at_m)
        return np.column_stack([roll, pitch, np.arctan2(*(front - rear).T)])

    def _along(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.clip(time_s * self.speed_mps, 0.0, self.track.length_m)

    def _axles(self, at_m: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
        """Return the places of the front and the rear axle, straight on before the track and after it."""
        front, rear = (self._beyond(at_m + side * self.wheels_m[0] / 2) for side in (1, -1))
        return front, rear

    def _beyond(self, at_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        inside = np.clip(at_m, 0.0, self.track.length_m)
        return self.track.point(inside) + (at_m - inside)[:, None] * self.track.direction(inside)

    @cached_property
    def _surface(self) -> CubicSpline:
        """Height of the middle, pitch and roll against the distance along the track."""
        length, width = self.wheels_m
        count = max(int(np.ceil(self.track.length_m / (STEP_AXLES * length))) + 1, 5)
        at_m = np.linspace(0.0, self.track.length_m, count)
        front, rear = self._axles(at_m)
        ahead = (front - rear) / np.linalg.norm(front - rear, axis=1)[:, None]
        right = width / 2 * ahead[:, ::-1] * [1.0, -1.0]
        front_left, front_right, rear_left, rear_right = (
            self.ground_m(axle + side * right) for axle in (front, rear) for side in (-1, 1)
        )
        height = np.nanmean([front_left, front_right, rear_left, rear_right], axis=0)
        pitch = np.arctan2(front_left + front_right - rear_left - rear_right, 2 * length)
        falls = (front_left + rear_left - front_right - rear_right) / (2 * width)
        roll = np.arctan(falls * np.cos(pitch))
        return CubicSpline(at_m, np.column_stack([height, pitch, roll]))
