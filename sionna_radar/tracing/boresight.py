"""Hits of the beam axes: one path per pulse, all that an ideal range sensor sees."""

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths


def trace_boresights(pulses: Pulses, caster: RayCaster) -> Paths:
    """Return the paths along the beam axes, with unit gain; a pulse without a hit has none."""
    pose = pulses.true
    hits = caster.cast(pose.position_m, pose.boresight)
    seen = hits.hit
    range_m = hits.distance_m[seen]
    return Paths.along_boresight(
        pulses,
        np.flatnonzero(seen),
        range_m,
        gain=np.ones(len(range_m), dtype=np.complex128),
        incidence_rad=np.arccos(hits.cosine[seen]),
        surface=hits.surface[seen],
    )
