"""Where the ground of a range cell lies in the beam: a strip across the direction in which the range grows.

Over level ground the range of a direction d in the antenna's frame is -h / (d . up): it grows along g, the part of up
across the boresight, by r tan(incidence) a radian, and stays along t, at right angles to g. A range cell is a strip
along t, and the two-way beam's power on it, taken for a Gaussian with the variances S of the direction cosines, has
along t the variance 1 / (t' S^-1 t). Tilted ground turns the strip by no more than it is tilted.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns

# A beam within so many radians of the nadir meets no range that grows, one as near to the horizon no ground.
STEEPEST_RAD = 0.02
# Standard deviation of a point's ranges on the ground, over that of its width across: together 1.12 times the latter.
LENGTH_OVER_WIDTH = 0.5


@dataclass(frozen=True, kw_only=True)
class RangeStrips(Columns):
    """How the range cells of some pulses lie across their beams, from measured poses; left and up in each pair.

    climb: unit vector along which the range grows.
    incidence_rad: of the boresight from nadir, kept off nadir and horizon.
    along: standard deviation of the two-way power's direction along the strip.
    mean: where on a strip its mean lies, per unit of its distance from the boresight along `climb`.
    """

    climb: Float[np.ndarray, "pulse 2"]
    incidence_rad: Float[np.ndarray, " pulse"]
    along: Float[np.ndarray, " pulse"]
    mean: Float[np.ndarray, "pulse 2"]

    @property
    def strip(self) -> Float[np.ndarray, "pulse 2"]:
        """Unit vectors along the strips."""
        return np.column_stack([-self.climb[:, 1], self.climb[:, 0]])

    def length_m(self, range_m: Float[np.ndarray, " pulse"]) -> Float[np.ndarray, " pulse"]:
        """Return the slant ranges that leave the resolution on the ground to the width of the beam.

        Ranges spread evenly over a length l have the standard deviation l / sqrt(12), on level ground that over the
        sine of the incidence.
        """
        width_m = range_m * self.along
        return np.sqrt(12) * LENGTH_OVER_WIDTH * width_m * np.sin(self.incidence_rad)


def range_strips(pose: Pose, spread: tuple[float, float]) -> RangeStrips:
    """Return the strips of pulses.

    Parameters
    ----------
    pose:
        Measured poses.
    spread:
        Standard deviations of the two-way power over the direction cosines in azimuth and in elevation.

    """
    up = pose.R_world_antenna[:, 2, :]
    across = np.linalg.norm(up[:, 1:], axis=1)
    upright = np.array([0.0, 1.0])
    climb = np.where(across[:, None] > 0, up[:, 1:] / np.maximum(across, 1e-300)[:, None], upright)
    strip = np.column_stack([-climb[:, 1], climb[:, 0]])
    variance = np.array(spread) ** 2
    along = 1 / np.sqrt(np.sum(strip**2 / variance, axis=1))
    mean = variance * climb / np.sum(variance * climb**2, axis=1)[:, None]
    incidence = np.clip(np.arctan2(across, -up[:, 0]), STEEPEST_RAD, np.pi / 2 - STEEPEST_RAD)
    return RangeStrips(climb=climb, incidence_rad=incidence, along=along, mean=mean)


def stretches_of(
    length: Int[np.ndarray, " echo"], most: Float[np.ndarray, " echo"]
) -> tuple[Int[np.ndarray, " point"], Int[np.ndarray, " point"]]:
    """Divide echoes of some lengths, in bins, into equal stretches; return echo and first bin in it of each."""
    count = np.maximum(1, np.rint(length / np.maximum(most, 1.0)).astype(np.int64))
    count = np.minimum(count, length)
    echo = np.repeat(np.arange(len(length)), count)
    number = np.arange(len(echo)) - np.repeat(np.cumsum(count) - count, count)
    return echo, number * length[echo] // count[echo]
