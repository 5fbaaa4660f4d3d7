"""The interface of tracing engines, their inputs, and their registration under a name.

Among the inputs are beams of pulses spread over the survey, known before the flight.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.antenna import Antenna
from sionna_radar.tracing.paths import Paths


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


@runtime_checkable
class Engine(Protocol):
    """Traces the surfaces of a scene."""

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""
        ...


@runtime_checkable
class SteerableEngine(Engine, Protocol):
    """An engine for the beams of an electronic scan."""

    def with_antenna(self, antenna: Antenna) -> Engine:
        """Return the same engine with another antenna."""
        ...
