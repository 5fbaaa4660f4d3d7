"""True hits of the main beam on the ground: what a survey could have mapped, for the coverage of its DEM."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.pulses import Pulses
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import LIT, in_main_lobe
from sionna_radar.tracing.paths import Paths


def main_beam_hits(
    paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna] = ()
) -> tuple[Float[np.ndarray, "hit 3"], Float[np.ndarray, "hit 3"]]:
    """Return where the paths of a block hit surfaces inside the main beam, and the true radar positions.

    beams: of an electronic scan, each with its own pattern.
    """
    from sionna_radar.accuracy.beam_kernels import ahead

    pose = pulses.true
    first = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    direction = np.empty((len(paths), 3))
    ahead(first, pose.position_m, np.ascontiguousarray(pose.R_world_antenna), paths.hit_m, direction)
    row = np.repeat(np.arange(len(pulses)), np.diff(first))
    inside = paths.surface >= 0
    if beams and pulses.beam is not None:
        beam = pulses.beam[row]
        for number in np.unique(beam):
            own = np.flatnonzero(beam == number)
            inside[own] &= in_main_lobe(beams[int(number)], direction[own])
    else:
        inside &= in_main_lobe(antenna, direction)
    return paths.hit_m[inside], pose.position_m[row[inside]]


def light(paths: Paths, pulses: Pulses, antenna: Antenna, beams: Sequence[Antenna], lit: Illumination) -> None:
    """Mark the cells under what `main_beam_hits` returns; for a separable antenna all in one go."""
    if not antenna.separable or (beams and pulses.beam is not None):
        lit.add(*main_beam_hits(paths, pulses, antenna, beams))
        return
    from sionna_radar.accuracy import beam_kernels

    pose = pulses.true
    first = np.searchsorted(paths.pulse, np.append(pulses.index, pulses.index[-1] + 1))
    lobe = (*(np.ascontiguousarray(cut.voltage) for cut in (antenna.azimuth, antenna.elevation)), LIT)
    # As NumPy does with numbers of Python: in the precision of the hits.
    grid = (paths.hit_m.dtype.type(number) for number in (lit.grid.west_m, lit.grid.south_m, lit.grid.spacing_m))
    axes = np.ascontiguousarray(pose.R_world_antenna)
    beam_kernels.light(first, pose.position_m, axes, paths.hit_m, paths.surface, lobe, tuple(grid), *lit.columns)
