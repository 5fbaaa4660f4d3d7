"""What leaks from the transmitter into the receiver: paths of a fixed delay, the same in every sweep.

They pass the mixer like any echo, so that the oscillator leaves of them what their short delay does.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.scenario.bases import StageParameters
from sionna_radar.signal.stages import Received, StageInputs, register_receiver_stage
from sionna_radar.tracing.paths import TARGET, Paths


@dataclass(frozen=True)
class Leakage:
    """Delays of the paths, and their powers over the transmitted one."""

    delay_s: Float[np.ndarray, " path"]
    power: Float[np.ndarray, " path"]

    def __call__(self, received: Received) -> Received:
        """Return what is received with the leaking paths of each pulse."""
        own = self.paths(received.pulses.index)
        return replace(received, paths=Paths.concatenate([received.paths, own]))

    def paths(self, pulse: Int[np.ndarray, " pulse"]) -> Paths:
        """Return the leaking paths of some pulses."""
        count = len(self.delay_s) * len(pulse)
        return Paths(
            pulse=np.repeat(pulse, len(self.delay_s)),
            delay_s=np.tile(self.delay_s, len(pulse)),
            gain=np.tile(np.sqrt(self.power).astype(np.complex128), len(pulse)),
            range_rate_mps=np.zeros(count),
            incidence_rad=np.full(count, np.nan),
            hit_m=np.zeros((count, 3)),
            surface=np.full(count, TARGET),
        )


@register_receiver_stage("leakage", StageParameters)
def build_leakage(_: StageParameters, given: StageInputs) -> Leakage:
    """Return the leakage of a scenario's radar."""
    ways = given.radar.receiver.leakage
    return Leakage(
        delay_s=np.array([1e-9 * way.delay_ns for way in ways]),
        power=10.0 ** (np.array([way.level_db for way in ways]) / 10),
    )
