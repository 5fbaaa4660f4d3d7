"""How far a DEM reads the tops of plants, and how far the ground under them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.raster import Raster


@dataclass(frozen=True, kw_only=True)
class CanopyReading:
    """The heights of a DEM among plants; the truth is the ground under them.

    count: filled cells with plants.
    height_m: mean height of these plants.
    above_ground_m: mean of the DEM over the ground there.
    share: the second over the first: 0 where it reads the ground, 1 where it reads the tops.
    ground_rms_m, top_rms_m: root mean square of the DEM less the ground, and less the tops.
    """

    count: int
    height_m: float
    above_ground_m: float
    share: float
    ground_rms_m: float
    top_rms_m: float


def read_canopy(error: Raster, height_m: Float[np.ndarray, "row column"]) -> CanopyReading:
    """Return how high among plants a DEM lies.

    Parameters
    ----------
    error:
        The DEM less the ground.
    height_m:
        Height of the plants over each cell; NaN where none stand.

    """
    among = error.filled & np.isfinite(height_m)
    if not among.any():
        nothing = float("nan")
        return CanopyReading(
            count=0, height_m=nothing, above_ground_m=nothing, share=nothing, ground_rms_m=nothing, top_rms_m=nothing
        )
    above, height = error.height_m[among], height_m[among]
    return CanopyReading(
        count=int(among.sum()),
        height_m=float(height.mean()),
        above_ground_m=float(above.mean()),
        share=float(above.mean() / height.mean()),
        ground_rms_m=float(np.sqrt(np.mean(above**2))),
        top_rms_m=float(np.sqrt(np.mean((above - height) ** 2))),
    )
