"""The pixels of an image: a parallelogram of points on a plane, usually the level ground beside the track."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pose


@dataclass(frozen=True, kw_only=True)
class PixelGrid:
    """Pixels by their positions along and across the track.

    origin_m: the point that both axes count from, world frame.
    along, across: unit vectors of the axes.
    along_m, across_m: positions of the columns and of the rows.
    """

    origin_m: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, " 3"]
    across: Float[np.ndarray, " 3"]
    along_m: Float[np.ndarray, " column"]
    across_m: Float[np.ndarray, " row"]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.across_m), len(self.along_m)

    @property
    def position_m(self) -> Float[np.ndarray, "row column 3"]:
        """Pixel centres, world frame."""
        return self.origin_m + self.across_m[:, None, None] * self.across + self.along_m[None, :, None] * self.along


def ground_pixels(
    pose: Pose,
    side: Literal["left", "right"],
    height_m: float,
    along_m: Float[np.ndarray, " column"],
    across_m: Float[np.ndarray, " row"],
) -> PixelGrid:
    """Return pixels on level ground beside a straight track.

    Parameters
    ----------
    pose:
        Poses along the track; the first and the last give its direction.
    side:
        The side that the antenna looks to.
    height_m:
        Height of the ground, world frame.
    along_m, across_m:
        Positions along the track from below the first pose, and ground ranges from the track.

    """
    start, end = pose.position_m[0, :2], pose.position_m[-1, :2]
    along = (end - start) / np.linalg.norm(end - start)
    turn = 1.0 if side == "right" else -1.0
    return PixelGrid(
        origin_m=np.array([*start, height_m]),
        along=np.array([*along, 0.0]),
        across=turn * np.array([along[1], -along[0], 0.0]),
        along_m=along_m,
        across_m=across_m,
    )
