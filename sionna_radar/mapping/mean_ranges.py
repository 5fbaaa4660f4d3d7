"""The mean range of each whole echo, with which mapping begins."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.columns import Columns
from sionna_radar.mapping.echo_model import Sightings

CELLS_BELOW_PEAK = 1e-2
LEAST_SIGMA_CELLS = 0.05


@dataclass(frozen=True, kw_only=True)
class MeanRanges(Columns):
    """Power-weighted mean range of each whole echo, on the axis of the spectrum, and its speckle error."""

    range_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]


def mean_ranges(sightings: Sightings) -> MeanRanges:
    """Return the mean range of every profile, from the cells within 20 dB of its strongest.

    Behind a volume of rain, where the strongest cell may be rain, it is the detected range.
    """
    from sionna_radar.mapping.profile_kernels import mean_cells

    profiles = sightings.profiles
    shift_m = sightings.shift_m(sightings.pose.boresight[:, None])[:, 0]
    if profiles.volume is not None:
        return MeanRanges(range_m=profiles.volume.echo_m - shift_m, sigma_m=profiles.volume.echo_sigma_m)
    mean, sigma = np.empty(len(profiles)), np.empty(len(profiles))
    looks = float(sightings.looks_per_cell)
    mean_cells(profiles.start, profiles.power, profiles.noise, looks, CELLS_BELOW_PEAK, mean, sigma)
    sigma = np.maximum(sigma, LEAST_SIGMA_CELLS) * profiles.cell_m
    return MeanRanges(range_m=(profiles.first + mean) * profiles.cell_m - shift_m, sigma_m=sigma)
