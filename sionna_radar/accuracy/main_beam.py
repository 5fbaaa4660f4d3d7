"""True hits of the main beam on the ground: what a survey could have mapped, for the coverage of its DEM."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import in_main_lobe
from sionna_radar.tracing.paths import Paths


def main_beam_hits(
    paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna] = ()
) -> tuple[Float[np.ndarray, "hit 3"], Float[np.ndarray, "hit 3"]]:
    """Return where the paths of a block hit surfaces inside the main beam, and the true radar positions.

    beams: of an electronic scan, each with its own pattern.
    """
    pose = pulses.true
    row = pulses.row_of(paths.pulse)
    away = paths.hit_m - pose.position_m[row]
    away = away / np.linalg.norm(away, axis=1, keepdims=True)
    ahead = np.einsum("nij,ni->nj", pose.R_world_antenna[row], away)
    inside = paths.surface >= 0
    if beams and pulses.beam is not None:
        beam = pulses.beam[row]
        for number in np.unique(beam):
            own = np.flatnonzero(beam == number)
            inside[own] &= in_main_lobe(beams[int(number)], ahead[own])
    else:
        inside &= in_main_lobe(antenna, ahead)
    return paths.hit_m[inside], pose.position_m[row[inside]]
