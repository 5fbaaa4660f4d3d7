"""What the beam axes meet: one path a pulse, the whole of what an ideal range sensor sees."""

import numpy as np

from sionna_radar.flight.pulses import Pulses
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.paths import Paths


def trace_boresights(pulses: Pulses, caster: RayCaster) -> Paths:
    """Return the paths along the beam axes, of unit gain; a pulse that meets nothing has none."""
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
