"""Point targets: one path each, by the radar equation, with a constant or fluctuating cross-section.

Swerling's cases draw the cross-section about its mean: 1 and 2 from an exponential distribution, as of many scatterers
alike, 3 and 4 from a chi-squared one with four degrees of freedom, as of a large scatterer among small ones; 1 and 3
once per scan, 2 and 4 for every pulse. Source: Swerling 1954, RAND RM-1217, as restated in "Chi-squared target
models" (handwiki.org) and in AGI's description of its SwerlingTargetModel.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.randomness import Stream, pulse_uniforms
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import TARGET, Paths

# A target on the ground touches the mesh; rays that end this far short of it still see it.
TOUCHING_M = 0.05


def trace_targets(
    targets: Sequence[Target], pulses: Pulses, antenna: Antenna, chirp: Chirp, caster: RayCaster, seed: int = 0
) -> Paths:
    """Return the paths of visible targets, sorted by pulse.

    |gain|^2 = G^2 lambda^2 sigma / ((4 pi)^3 r^4) (Rouveure et al. 2017, eq. 3), with zero phase apart from the
    delay, as of a fixed point.

    seed: of the fluctuations.
    """
    place = np.array([t.position_m for t in targets])
    rcs_m2 = np.column_stack([cross_section(t, k, pulses, seed) for k, t in enumerate(targets)]).ravel()
    pose = pulses.true
    away = (place[None] - pose.position_m[:, None]).reshape(-1, 3)
    row = np.repeat(np.arange(len(pulses)), len(targets))
    range_m = np.linalg.norm(away, axis=1)
    direction = away / range_m[:, None]
    gain = antenna.gain(np.einsum("nij,ni->nj", pose.R_world_antenna[row], direction))
    power = gain**2 * chirp.wavelength_m**2 * rcs_m2 / ((4 * np.pi) ** 3 * range_m**4) * abs(antenna.mirrored) ** 2
    seen = power > 0
    hit = pose.position_m[row] + away
    seen[seen] = caster.visible(pose.position_m[row][seen], hit[seen], TOUCHING_M)
    return Paths.to_points(
        pulses,
        row[seen],
        hit[seen],
        gain=np.sqrt(power[seen]).astype(np.complex128),
        incidence_rad=np.full(int(seen.sum()), np.nan),
        surface=np.full(int(seen.sum()), TARGET),
    )


def cross_section(target: Target, number: int, pulses: Pulses, seed: int) -> Float[np.ndarray, " pulse"]:
    """Return the cross-section of a target at each pulse.

    number: index of the target in its scene; it and the seed alone determine the fluctuation.
    """
    if target.swerling == 0:
        return np.full(len(pulses), target.rcs_m2)
    if target.swerling in (2, 4):
        drawn = pulse_uniforms(seed, Stream.TARGETS, pulses.index, 2, item=number)
    else:
        number_of_scan = np.zeros(len(pulses), np.int64) if pulses.scan_number is None else pulses.scan_number
        scan, back = np.unique(number_of_scan, return_inverse=True)
        drawn = pulse_uniforms(seed, Stream.TARGET_SCANS, scan, 2, item=number)[back]
    exponential = -np.log1p(-drawn)
    # The mean of two exponentials is chi-squared with four degrees of freedom.
    share = exponential[:, 0] if target.swerling in (1, 2) else exponential.mean(axis=1)
    return target.rcs_m2 * share
