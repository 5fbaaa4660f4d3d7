"""The echoes that detection returns."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.columns import Columns


@dataclass(frozen=True, kw_only=True)
class Echoes(Columns):
    """Detected echoes, one row each, sorted by pulse and then by range.

    pulse: index of the pulse in the survey.
    number: 0 for the nearest echo of its pulse, 1 for the next, ...
    range_m: slant range, Doppler corrected if the processing says so.
    range_sigma_m: standard deviation of that range, as estimated from the echo itself.
    power: calibrated power of the echo's strongest cell; W, or relative to the transmitted power under snr_db.
    direction: mean direction of the echo in the antenna's frame (boresight, left, up), a little shorter than one as
        means of unit vectors are; None for echoes on the beam's axis.
    across_sigma_rad: standard deviation of that direction in the vertical plane; None with `direction`.
    reach: over how many pulses errors of the range repeat, where neighbours decided it together; None where each was
        ranged by itself.
    snr_db: that power over the mean noise power estimated from the training cells, unbiased for every kind of CFAR.
    """

    pulse: Int[np.ndarray, " echo"]
    number: Int[np.ndarray, " echo"]
    range_m: Float[np.ndarray, " echo"]
    range_sigma_m: Float[np.ndarray, " echo"]
    power: Float[np.ndarray, " echo"]
    snr_db: Float[np.ndarray, " echo"]
    direction: Float[np.ndarray, "echo 3"] | None = None
    across_sigma_rad: Float[np.ndarray, " echo"] | None = None
    reach: Float[np.ndarray, " echo"] | None = None

    def of_pulses(self, pulse: Int[np.ndarray, " pulse"]) -> "Echoes":
        """Return the echoes of consecutive pulses."""
        first, last = np.searchsorted(self.pulse, [pulse[0], pulse[-1] + 1])
        return self.rows(slice(int(first), int(last)))
