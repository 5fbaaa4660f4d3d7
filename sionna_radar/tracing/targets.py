"""Point targets: one path each, by the radar equation."""

from collections.abc import Sequence

import numpy as np
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths

# A target on the ground touches the mesh; rays that end this far short of it still see it.
TOUCHING_M = 0.05


def trace_targets(
    targets: Sequence[Target], pulses: Pulses, antenna: Antenna, chirp: Chirp, caster: RayCaster
) -> Paths:
    """Return the paths of visible targets, sorted by pulse.

    |gain|^2 = G^2 lambda^2 sigma / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 3), the phase zero but for the
    delay, as of a fixed point.
    """
    place = np.array([t.position_m for t in targets])
    rcs_m2 = np.tile([t.rcs_m2 for t in targets], len(pulses))
    pose = pulses.true
    away = (place[None] - pose.position_m[:, None]).reshape(-1, 3)
    row = np.repeat(np.arange(len(pulses)), len(targets))
    range_m = np.linalg.norm(away, axis=1)
    direction = away / range_m[:, None]
    gain = antenna.gain(np.einsum("nij,ni->nj", pose.R_world_antenna[row], direction))
    power = gain**2 * chirp.wavelength_m**2 * rcs_m2 / ((4 * np.pi) ** 3 * range_m**4)
    seen = power > 0
    hit = pose.position_m[row] + away
    seen[seen] = caster.visible(pose.position_m[row][seen], hit[seen], TOUCHING_M)
    return Paths(
        pulse=pulses.index[row][seen],
        delay_s=2 * range_m[seen] / speed_of_light,
        gain=np.sqrt(power[seen]).astype(np.complex128),
        range_rate_mps=-np.einsum("ni,ni->n", pose.velocity_mps[row], direction)[seen],
        incidence_rad=np.full(int(seen.sum()), np.nan),
        hit_m=hit[seen],
        surface=np.full(int(seen.sum()), -1),
    )
