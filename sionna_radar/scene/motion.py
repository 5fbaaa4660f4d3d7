"""Motion of targets (straight legs at constant speed) and of their rotors, and tables of radar cross-section."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import RegularGridInterpolator


@dataclass(frozen=True, kw_only=True)
class Way:
    """A path of straight legs, at constant speed.

    corner_m: world frame, at least two, without consecutive duplicates; a closed path ends at its start and is
        repeated; at the end of an open one the target stops.
    """

    corner_m: Float[np.ndarray, "corner 3"]
    speed_mps: float
    closed: bool = False

    @cached_property
    def _along_m(self) -> Float[np.ndarray, " corner"]:
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.corner_m, axis=0), axis=1))])

    def at(self, time_s: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Return positions and velocities at times."""
        gone_m = self.speed_mps * time_s
        if self.closed:
            gone_m = np.mod(gone_m, self._along_m[-1])
        leg = self._leg(gone_m)
        start, step = self.corner_m[leg], self.corner_m[leg + 1] - self.corner_m[leg]
        toward = step / np.linalg.norm(step, axis=1)[:, None]
        along_leg_m = np.clip(gone_m - self._along_m[leg], 0.0, np.diff(self._along_m)[leg])
        moving = (gone_m >= 0) & (gone_m < self._along_m[-1])
        return start + along_leg_m[:, None] * toward, self.speed_mps * toward * moving[:, None]

    def _leg(self, gone_m: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        return np.clip(np.searchsorted(self._along_m, gone_m, side="right") - 1, 0, len(self._along_m) - 2)

    def heading_rad(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return headings along the path, clockwise from north; at the end that of the last leg."""
        gone_m = self.speed_mps * time_s
        leg = self._leg(np.mod(gone_m, self._along_m[-1]) if self.closed else gone_m)
        step = self.corner_m[leg + 1] - self.corner_m[leg]
        return np.arctan2(step[:, 0], step[:, 1])


@dataclass(frozen=True, kw_only=True)
class Rotor:
    """Blades rotating about an axis of the target, each a row of points.

    offset_m: of the hub from the target's position: forward, to the right, and up.
    axis: unit vector, forward, right and up.
    rcs_m2: of a blade; its points share it.
    """

    offset_m: tuple[float, float, float]
    axis: tuple[float, float, float]
    radius_m: float
    turns_per_s: float
    blades: int
    points: int
    rcs_m2: float

    def at(
        self, time_s: Float[np.ndarray, " n"], heading_rad: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, "n point 3"], Float[np.ndarray, "n point 3"]]:
        """Return offsets and velocities of all points from the target, in the world frame, for its headings."""
        axis = np.array(self.axis)
        # Any vector perpendicular to the axis.
        axis_1 = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        axis_1 = axis_1 / np.linalg.norm(axis_1)
        axis_2 = np.cross(axis, axis_1)
        rate = 2 * np.pi * self.turns_per_s
        blade = 2 * np.pi * np.arange(self.blades) / self.blades
        radius_m = self.radius_m * (np.arange(self.points) + 1) / self.points
        angle = (rate * time_s[:, None] + blade)[:, :, None]
        radial = np.cos(angle)[..., None] * axis_1 + np.sin(angle)[..., None] * axis_2
        turning = rate * (np.cos(angle)[..., None] * axis_2 - np.sin(angle)[..., None] * axis_1)
        position = np.array(self.offset_m) + radius_m[:, None] * radial
        speed = radius_m[:, None] * turning
        count = len(time_s)
        to_world = level_axes(heading_rad)
        return (
            np.einsum("nij,npj->npi", to_world, position.reshape(count, -1, 3)),
            np.einsum("nij,npj->npi", to_world, speed.reshape(count, -1, 3)),
        )


def level_axes(heading_rad: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
    """Return the axes forward, right and up of level bodies, as columns, in the world frame."""
    sine, cosine, zero = np.sin(heading_rad), np.cos(heading_rad), np.zeros(len(heading_rad))
    forward, right = np.stack([sine, cosine, zero], axis=1), np.stack([cosine, -sine, zero], axis=1)
    up = np.broadcast_to(np.array([0.0, 0.0, 1.0]), forward.shape)
    return np.stack([forward, right, up], axis=2)


@dataclass(frozen=True, kw_only=True)
class RcsTable:
    """Radar cross-section by the direction to the radar, in the target's level axes.

    azimuth_rad: of that direction, clockwise from forward, increasing within a turn; elevation_rad: above the target's
        horizon, increasing. rcs_m2: interpolated in decibels; constant beyond the elevations.
    """

    azimuth_rad: Float[np.ndarray, " azimuth"]
    elevation_rad: Float[np.ndarray, " elevation"]
    rcs_m2: Float[np.ndarray, "elevation azimuth"]

    def toward(
        self, seen_from: Float[np.ndarray, "n 3"], heading_rad: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Return the cross-section for unit vectors toward the radar, in the world frame."""
        azimuth = np.arctan2(seen_from[:, 0], seen_from[:, 1]) - heading_rad
        elevation = np.arcsin(np.clip(seen_from[:, 2], -1.0, 1.0))
        turn = 2 * np.pi
        azimuths = np.concatenate([self.azimuth_rad, [self.azimuth_rad[0] + turn]])
        level = np.log(np.maximum(self.rcs_m2, 1e-30))
        level = np.concatenate([level, level[:, :1]], axis=1)
        column = np.mod(azimuth - azimuths[0], turn) + azimuths[0]
        if len(self.elevation_rad) == 1:
            return np.exp(np.interp(column, azimuths, level[0]))
        height = np.clip(elevation, self.elevation_rad[0], self.elevation_rad[-1])
        return np.exp(RegularGridInterpolator((self.elevation_rad, azimuths), level)(np.column_stack([height, column])))
