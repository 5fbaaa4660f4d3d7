"""Evidence of the echoes for and against a surface at every height over every cell of a map.

A patch of ground of reflectivity g, seen with the two-way gain w of a pulse, contributes at least the mean power
m = n + g w to its range cell, n being the receiver noise; the power P there is exponential about the
mean of everything in the cell.

** Against: P far below m. The log-likelihood of m relative to the best mean is log(P / m) - P / m + 1, at most 0.
  It does not count where something nearer in the same pulse is bright enough to occlude the patch, unless a map
  already shows the patch in plain view.
** For: P as expected of the patch. Compared with the alternative that P comes from elsewhere and is anything between
  the noise and the strongest power (uniform in its logarithm, over K nepers), the gain is
  log(P / m) - P / m + log K, where that is positive. Power leaked by the window from a neighbour does not count.

The reflectivity of each height of each cell is the one, in steps of 6 dB, that is likeliest for all pulses. So a
bright roof at the edge of the beam is not taken for ground on its axis: their powers vary differently between pulses.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import in_threads, parts
from sionna_radar.mapping.beam import BeamNodes
from sionna_radar.mapping.echo_model import Sightings

# A step of reflectivity: 6 dB, in nepers of power.
STEP = float(np.log(4.0))
# Least power of a patch of one map cell, relative to the level of a whole echo.
LEAST_SHARE = 0.3
# Least two-way gain, relative to the axis, at which echoes count as evidence for a patch.
WIDEST_FOR = 0.02
# Cells over which the window leaks a strong power.
SPREAD_CELLS = 4
# A cell with less than this share of the power leaked from its neighbours holds no echo.
SPILT = 0.25
# Rows of the map handled by one core at a time.
ROWS_AT_ONCE = 8


def evidence_against(
    sightings: Sightings,
    grid: Grid,
    base_m: Float[np.ndarray, "row column"],
    level_m: Float[np.ndarray, " level"],
    in_view_m: Float[np.ndarray, "row column"] | None = None,
    step: Step = no_step,
) -> Float32[np.ndarray, "row column level"]:
    """Return the evidence against a surface at some heights over the cells of a grid.

    Parameters
    ----------
    sightings:
        Profiles and measured poses.
    grid:
        Cells of the map.
    base_m, level_m:
        Base heights of the cells, and the levels above them, increasing.
    in_view_m:
        Heights above which the cells are known to be in view; None if unknown.
    step:
        Called after each pulse.

    Returns
    -------
    Negative log-likelihood ratios, in nepers: 0 where nothing was seen, negative where echoes agree.

    """
    from sionna_radar.mapping.evidence_kernels import add_evidence

    bright = _reflectivities(sightings)
    if len(bright.step) == 0:
        return np.zeros((*grid.shape, len(level_m)), dtype=np.float32)
    against = np.zeros((*grid.shape, len(level_m), len(bright.step)), dtype=np.float32)
    windows = _windows(sightings, grid, (float(base_m.min() + level_m[0]), float(base_m.max() + level_m[-1])))
    beam, chirp, pose, profiles = sightings.beam, sightings.chirp, sightings.pose, sightings.profiles
    spill = SPILT * sightings.response / sightings.response.max()
    spill[len(spill) // 2] = 0.0
    gain = (beam.share / beam.share.max()).reshape(len(beam.azimuth), len(beam.elevation))
    given = (
        *(windows, profiles.first, profiles.start, profiles.power, profiles.noise, spill, profiles.cell_m),
        *(np.ascontiguousarray(each) for each in (pose.position_m, pose.velocity_mps, pose.R_world_antenna)),
        sightings.doppler * float(chirp.doppler_range_m(np.ones(1))[0]),
        *(gain, _axes(beam)),
        *(grid.x_m, grid.y_m, np.ascontiguousarray(base_m), level_m),
        np.full(grid.shape, np.inf) if in_view_m is None else np.ascontiguousarray(in_view_m),
        *(bright.step, bright.typical, bright.alternatives, WIDEST_FOR, SPREAD_CELLS),
    )
    for _ in in_threads(lambda low, high: add_evidence(*given, against, low, high), parts(grid.rows, ROWS_AT_ONCE)):
        pass
    for _ in range(len(sightings)):
        step()
    lowest: Float32[np.ndarray, "row column level"] = against.min(axis=-1)
    return lowest


def _axes(beam: BeamNodes) -> Float[np.ndarray, "6"]:
    """Return start and step of the samples in azimuth and in elevation, and the ends of both."""
    u, v = beam.azimuth, beam.elevation
    return np.array([u[0], u[1] - u[0], v[0], v[1] - v[0], u[-1], v[-1]])


@dataclass(frozen=True)
class _Reflectivities:
    """Powers of patches on the axis: steps from the weakest, a typical one, and the span K of all powers."""

    step: Float[np.ndarray, " step"]
    typical: float
    alternatives: float


def _reflectivities(sightings: Sightings) -> _Reflectivities:
    profiles = sightings.profiles
    from sionna_radar.mapping.profile_kernels import echo_levels

    level, volume = np.empty(len(profiles)), np.zeros(len(profiles.power))
    if profiles.volume is not None:
        volume = profiles.volume.power.astype(np.float64) * profiles.volume.in_air
    echo_levels(profiles.start, profiles.power, profiles.noise, volume, level)
    level = level[level > 0]
    if len(level) == 0:
        return _Reflectivities(np.zeros(0), 0.0, 0.0)
    low, typical, high = np.percentile(level, [5, 25, 99])
    lowest, highest = np.log(LEAST_SHARE * low), np.log(high / LEAST_SHARE)
    span = float(np.log(profiles.power.max() / profiles.noise.min()))
    return _Reflectivities(np.exp(np.arange(lowest, highest + STEP, STEP)), LEAST_SHARE * float(typical), span)


def _windows(sightings: Sightings, grid: Grid, span_m: tuple[float, float]) -> Int[np.ndarray, "pulse 4"]:
    """Return the rows and columns that the main lobe of each pulse crosses between two heights, the last excluded."""
    position = sightings.pose.position_m[:, None, None]
    corner = sightings.direction()[:, None, sightings.beam.corners]
    drop = np.array(span_m)[:, None] - position[..., 2]
    reach = np.clip(drop / np.minimum(corner[..., 2], -0.05), 0.0, sightings.reach_m)
    place = (position[..., :2] + reach[..., None] * corner[..., :2]).reshape(len(sightings), -1, 2)
    low, high = place.min(axis=1), place.max(axis=1)
    rows = (np.searchsorted(grid.y_m, bound[:, 1]) for bound in (low, high))
    columns = (np.searchsorted(grid.x_m, bound[:, 0]) for bound in (low, high))
    return np.column_stack([*rows, *columns])
