"""Parallel flight lines that cover a rectangle with the swath of a beam tilted ahead."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.errors import ScenarioError

MAX_LINES = 10_000
# Cruise beyond each end of a line, in ground samples.
RUN_OUT_SAMPLES = 2.0


@dataclass(frozen=True, kw_only=True)
class CoveringLines:
    """Lines over a rectangle, along its longer side.

    spacing_m: of neighbouring lines. ends_m: of the lines in the order flown, to the right of the rectangle's heading
        and along it, from its centre.
    """

    spacing_m: float
    ends_m: Float[np.ndarray, "end 2"]

    @property
    def count(self) -> int:
        """Number of lines."""
        return len(self.ends_m) // 2

    @property
    def length_m(self) -> float:
        """Length of the track, with the straight ways between lines."""
        return float(np.linalg.norm(np.diff(self.ends_m, axis=0), axis=1).sum())


def covering_lines(
    size_m: tuple[float, float],
    sampling_m: float,
    altitude_m: float,
    incidence_rad: float,
    half_swath_rad: float,
    overlap: float,
) -> CoveringLines:
    """Return the lines over a rectangle for a swath.

    size_m: to the right of the rectangle's heading, and along it.
    sampling_m: spacing of echoes on the ground; lines overrun the area by two of them.
    incidence_rad: tilt of the beam ahead of the platform, from nadir.
    overlap: of neighbouring swaths, as a fraction.

    Raises ScenarioError for more than `MAX_LINES`.
    """
    right, forward = size_m
    along, across = max(right, forward), min(right, forward)
    swath = 2 * altitude_m * math.tan(half_swath_rad)
    if (lines := across / (swath * (1 - overlap))) > MAX_LINES:
        message = f"{sampling_m:g} m takes {lines:.3g} lines, more than {MAX_LINES:,}; raise it"
        raise ScenarioError.of("sampling", message, "plan")
    count = max(math.ceil(across / (swath * (1 - overlap)) - 1e-9), 1)
    spacing = across / count
    offset = spacing * (np.arange(count) - (count - 1) / 2)
    # The beam meets the ground ahead: farthest at the edges of the swath, nearest in its middle.
    near, far = altitude_m * math.tan(incidence_rad), altitude_m * math.tan(incidence_rad) / math.cos(half_swath_rad)
    margin = RUN_OUT_SAMPLES * sampling_m
    ends = (-along / 2 - far - margin, along / 2 - near + margin)
    waypoints = []
    for number, side in enumerate(offset):
        direction = 1 if number % 2 == 0 else -1
        for end in ends:
            waypoints.append((direction * end, side) if right >= forward else (side, direction * end))
    return CoveringLines(spacing_m=float(spacing), ends_m=np.array(waypoints, dtype=np.float64))
