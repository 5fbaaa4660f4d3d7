"""A recorded flight at any time: splines through positions and attitudes.

Positions with velocities: cubic Hermite splines, which pass through both. Without velocities: modified Akima splines,
whose velocity is continuous and which a single bad fix disturbs only beside it; a spline with a continuous acceleration
would ring through the whole log, and a monotone one flattens every turn. Attitudes: rotation splines (continuous
angular acceleration); over gaps long against their rate the shortest rotation at a steady rate, since a rotation spline
may overshoot there.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.interpolate import Akima1DInterpolator, CubicHermiteSpline, PPoly
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from sionna_radar.flight.logs.log import Attitudes, Positions, Spreads

# A step this many times as long as the usual one, and longer than this, is a gap in the attitudes.
GAP_RATIO, LEAST_GAP_S = 5.0, 0.5
# Slower, a vehicle's course says nothing of its heading.
LEAST_COURSE_MPS = 1.0


def position_spline(positions: Positions, start_s: float) -> PPoly:
    """Return positions against the time since a start."""
    time_s = positions.time_s - start_s
    if positions.velocity_mps is not None:
        return CubicHermiteSpline(time_s, positions.place, positions.velocity_mps)
    return Akima1DInterpolator(time_s, positions.place, method="makima")


@dataclass(frozen=True, kw_only=True)
class AttitudeSpline:
    """Attitudes against time; before the first and after the last they stay as they are."""

    starts_s: Float[np.ndarray, " part"]
    parts: tuple[Callable[[Float[np.ndarray, " n"]], Rotation], ...]
    span_s: tuple[float, float]

    def euler(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading."""
        time_s = np.clip(time_s, *self.span_s)
        part = np.maximum(np.searchsorted(self.starts_s, time_s, side="right") - 1, 0)
        angles = np.empty((len(time_s), 3))
        with warnings.catch_warnings():
            # Nose straight up: heading and roll are one turn, and any share of it is right.
            warnings.filterwarnings("ignore", message="Gimbal lock")
            for number in np.unique(part):
                rows = part == number
                angles[rows] = self.parts[number](time_s[rows]).as_euler("ZYX")[:, ::-1]
        return angles


def attitude_spline(attitudes: Attitudes, start_s: float) -> AttitudeSpline:
    """Return attitudes against the time since a start."""
    time_s = attitudes.time_s - start_s
    turned = Rotation.from_quat(attitudes.quaternion)
    step = np.diff(time_s)
    gap = (step > LEAST_GAP_S) & (step > GAP_RATIO * np.median(step))
    edges = np.unique(np.concatenate([[0], np.flatnonzero(gap), np.flatnonzero(gap) + 1, [len(time_s) - 1]]))
    parts: list[Callable[[Float[np.ndarray, " n"]], Rotation]] = []
    for first, last in pairwise(edges.tolist()):
        build = Slerp if last == first + 1 else RotationSpline
        parts.append(build(time_s[first : last + 1], turned[first : last + 1]))
    return AttitudeSpline(starts_s=time_s[edges[:-1]], parts=tuple(parts), span_s=(float(time_s[0]), float(time_s[-1])))


def course_attitudes(positions: Positions) -> Attitudes:
    """Return level attitudes with the heading of the motion; a vehicle that hardly moves keeps its last one."""
    velocity = position_spline(positions, 0.0)(positions.time_s, 1)
    course = np.arctan2(velocity[:, 0], velocity[:, 1])
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > LEAST_COURSE_MPS
    moving = moving if moving.any() else np.ones(len(course), dtype=bool)
    held = np.maximum.accumulate(np.where(moving, np.arange(len(course)), int(np.argmax(moving))))
    return Attitudes(
        source="course of the positions",
        time_s=positions.time_s,
        quaternion=Rotation.from_euler("z", course[held][:, None]).as_quat(),
    )


def sigma_at(
    spreads: Spreads, start_s: float
) -> Callable[[Float[np.ndarray, " n"]], Float[np.ndarray, "n 3 3"]] | None:
    """Return standard deviations against the time since a start; None where nothing is known."""
    columns = np.column_stack([spreads.position_m, spreads.velocity_mps, spreads.attitude_rad])
    known = np.isfinite(columns) & (columns >= 0)
    if not known.any():
        return None
    time_s = spreads.time_s - start_s

    def sigma(at_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3 3"]:
        found = np.full((len(at_s), 9), np.nan)
        for axis in np.flatnonzero(known.any(axis=0)):
            rows = known[:, axis]
            found[:, axis] = np.interp(at_s, time_s[rows], columns[rows, axis])
        return found.reshape(-1, 3, 3)

    return sigma
