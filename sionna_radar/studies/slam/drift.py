"""Drift of an estimated way: errors of its parts relative to their lengths (Geiger, Lenz, Urtasun 2012, CVPR)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.studies.slam.motion import travelled_m

LENGTHS_M = (100.0, 200.0, 300.0, 400.0, 500.0, 600.0, 700.0, 800.0)


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Drift over parts of 100 to 800 m that begin at every turn; NaN for a way that is shorter.

    translation: mean error of the place at the end of a part, relative to its length.
    rotation_rad_per_m: mean error of the heading there over its length.
    end_m: distance between the ends of the estimated and the true way. parts: their number.
    """

    translation: float
    rotation_rad_per_m: float
    end_m: float
    parts: int


def drift_of(state: Float[np.ndarray, "turn 6"], true_state: Float[np.ndarray, "turn 6"]) -> Drift:
    """Return the drift of states: east, north, heading clockwise from north, and others."""
    way_m = travelled_m(true_state)
    errors = []
    for length_m in LENGTHS_M:
        end = np.searchsorted(way_m, way_m + length_m)
        for first in np.flatnonzero(end < len(way_m)):
            (dx, dy, turn), (tx, ty, true_turn) = (_between(s[first], s[end[first]]) for s in (state, true_state))
            angle = np.mod(turn - true_turn + np.pi, 2 * np.pi) - np.pi
            errors.append((np.hypot(dx - tx, dy - ty) / length_m, abs(angle) / length_m))
    translation, angle = np.mean(errors, axis=0) if errors else (np.nan, np.nan)
    return Drift(
        translation=float(translation),
        rotation_rad_per_m=float(angle),
        end_m=float(np.linalg.norm(state[-1, :2] - true_state[-1, :2])),
        parts=len(errors),
    )


def _between(first: Float[np.ndarray, " 6"], last: Float[np.ndarray, " 6"]) -> tuple[float, float, float]:
    """Return the last pose in the axes of the first: to the right, ahead, and the turn."""
    east, north = last[:2] - first[:2]
    sin, cos = np.sin(first[2]), np.cos(first[2])
    return east * cos - north * sin, east * sin + north * cos, last[2] - first[2]
