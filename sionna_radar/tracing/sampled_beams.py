"""Beams of pulses spread over a survey: how it looks at the scene, known before it flies."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.columns import Columns


@dataclass(frozen=True, kw_only=True)
class SampledBeams(Columns):
    """Beams of pulses spread over a survey.

    range_m: along the axis to the surface; infinite for a beam that meets none.
    beam: which of the antennas each looks through.
    """

    position_m: Float[np.ndarray, "look 3"]
    R_world_antenna: Float[np.ndarray, "look 3 3"]
    range_m: Float[np.ndarray, " look"]
    beam: Int[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "look 3"]:
        """Where the axes meet the surface."""
        return self.position_m + self.range_m[:, None] * self.R_world_antenna[:, :, 0]
