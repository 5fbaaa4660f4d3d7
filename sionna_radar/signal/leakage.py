"""Leakage from the transmitter into the receiver, and the paths to a second receiver.

Leakage follows paths of a fixed delay, the same in every sweep. They pass the mixer like any echo: the phase noise of
the oscillator mostly cancels at their short delay.

`side_paths` gives the paths to a receiver beside the first.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.second_receiver import SideReceiver
from sionna_radar.signal.stages import Received
from sionna_radar.tracing.paths import TARGET, Paths


@dataclass(frozen=True)
class Leakage:
    """Delays of the paths, and their powers over the transmitted one."""

    delay_s: Float[np.ndarray, " path"]
    power: Float[np.ndarray, " path"]

    def __call__(self, received: Received) -> Received:
        """Return the received signal with the leakage paths of each pulse added."""
        leaking = self.paths(received.pulses.index)
        return replace(received, paths=Paths.concatenate([received.paths, leaking]))

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


def side_paths(paths: Paths, pulses: Pulses, receiver: SideReceiver) -> Paths:
    """Return the paths of a block of pulses to a second receiver, from the true pose.

    The return path to a phase centre a baseline away is longer or shorter, by exact distances; the difference of the
    antenna's halves weights each path by its direction.
    """
    row = pulses.row_of(paths.pulse)
    pose = pulses.true
    offset_m = paths.hit_m - pose.position_m[row]
    range_m = np.linalg.norm(offset_m, axis=1)
    R_world_antenna = pose.R_world_antenna[row]
    direction = np.einsum("nij,ni->nj", R_world_antenna, offset_m / range_m[:, None])
    delay_s = paths.delay_s
    if receiver.true_baseline_m:
        to_side_m = np.linalg.norm(offset_m - receiver.true_baseline_m * R_world_antenna[:, :, receiver.axis], axis=1)
        delay_s = delay_s + (to_side_m - range_m) / speed_of_light
    return replace(paths, delay_s=delay_s, gain=paths.gain * receiver.factor(direction))
