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
from jaxtyping import Bool, Float, Float32

from sionna_radar.foundation.progress import Step, no_step
from sionna_radar.foundation.raster import Grid
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
    bright = _reflectivities(sightings)
    if len(bright.step) == 0:
        return np.zeros((*grid.shape, len(level_m)), dtype=np.float32)
    against = np.zeros((len(bright.step), *grid.shape, len(level_m)), dtype=np.float32)
    span_m = float(base_m.min() + level_m[0]), float(base_m.max() + level_m[-1])
    for pulse in range(len(sightings)):
        step()
        rows, columns = _window(sightings, pulse, grid, span_m)
        height_m = base_m[rows, columns, None] + level_m
        patch = np.broadcast_arrays(grid.x_m[None, columns, None], grid.y_m[rows, None, None], height_m)
        if height_m.size:
            in_view = height_m > (np.inf if in_view_m is None else in_view_m[rows, columns, None])
            seen = _seen(sightings, pulse, np.stack(patch, axis=-1), in_view, bright)
            part = against[:, rows, columns]
            for number, reflectivity in enumerate(bright.step):
                part[number][seen.where] -= seen.support(reflectivity)
    lowest: Float32[np.ndarray, "row column level"] = against.min(axis=0)
    return lowest


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


def _window(sightings: Sightings, pulse: int, grid: Grid, span_m: tuple[float, float]) -> tuple[slice, slice]:
    """Return the rows and columns that the main lobe of a pulse crosses between two heights."""
    position = sightings.pose.position_m[pulse]
    corner = sightings.beam.direction[sightings.beam.corners] @ sightings.pose.R_world_antenna[pulse].T
    drop = np.array(span_m)[:, None] - position[2]
    reach = np.clip(drop / np.minimum(corner[:, 2], -0.05), 0.0, sightings.reach_m)
    place = (position[:2] + reach[..., None] * corner[:, :2]).reshape(-1, 2)
    (west, south), (east, north) = place.min(axis=0), place.max(axis=0)
    rows = np.searchsorted(grid.y_m, [south, north])
    columns = np.searchsorted(grid.x_m, [west, east])
    return slice(int(rows[0]), int(rows[1])), slice(int(columns[0]), int(columns[1]))


@dataclass(frozen=True)
class _Seen:
    """The patches that one pulse sees.

    where: their indices; gain: two-way, relative to the axis; noise: receiver noise power.
    power: in the patch's range cell; most: largest in it and its two neighbours; at least the noise.
    own: whether the power comes from the cell itself; open: whether nothing occludes the patch.
    """

    where: Bool[np.ndarray, "row column level"]
    gain: Float[np.ndarray, " patch"]
    noise: float
    alternatives: float
    power: Float[np.ndarray, " patch"]
    most: Float[np.ndarray, " patch"]
    own: Bool[np.ndarray, " patch"]
    open: Bool[np.ndarray, " patch"]

    def support(self, reflectivity: float) -> Float[np.ndarray, " patch"]:
        """Return the log-likelihood ratio of patches of a reflectivity, in nepers."""
        mean = self.noise + reflectivity * self.gain
        short = np.minimum(self.most / mean, 1.0)
        ratio = self.power / mean
        fits = np.maximum(np.log(ratio) - ratio + np.log(self.alternatives), 0.0)
        return (np.log(short) - short + 1) * self.open + fits * (self.own & (self.gain > WIDEST_FOR))


def _seen(
    sightings: Sightings,
    pulse: int,
    patch_m: Float[np.ndarray, "row column level 3"],
    in_view: Bool[np.ndarray, "row column level"],
    bright: _Reflectivities,
) -> _Seen:
    profiles, pose = sightings.profiles, sightings.pose
    power, noise = profiles.values(pulse), float(profiles.noise[pulse])
    away = patch_m - pose.position_m[pulse]
    range_m = np.linalg.norm(away, axis=-1)
    direction = away / range_m[..., None]
    gain = sightings.beam.two_way(direction @ pose.R_world_antenna[pulse])
    where = gain > 0
    rate = -direction[where] @ pose.velocity_mps[pulse]
    apparent = range_m[where] + sightings.doppler * sightings.chirp.doppler_range_m(rate)
    cell = np.round(apparent / profiles.cell_m).astype(np.int64) - int(profiles.first[pulse])
    spill = SPILT * sightings.response / sightings.response.max()
    spill[len(spill) // 2] = 0.0
    # Outside the profile, which extends past all echoes, there is noise.
    edged = np.concatenate([[noise, noise], np.maximum(power, noise), [noise, noise]])
    place = np.clip(cell, -1, len(power)) + 2
    nearer = np.concatenate([np.full(SPREAD_CELLS + 1, noise), np.maximum.accumulate(edged[2:-2])])
    before = nearer[np.clip(cell + 1, 0, len(power) + SPREAD_CELLS)]
    own = np.pad(power > np.convolve(power, spill, "same"), 2)
    cleared = np.where(own, edged, noise)
    return _Seen(
        where=where,
        gain=gain[where],
        noise=noise,
        alternatives=bright.alternatives,
        power=edged[place],
        most=np.maximum(np.maximum(cleared[place - 1], cleared[place]), cleared[place + 1]),
        own=own[place],
        open=in_view[where] | (before < noise + bright.typical * gain[where]),
    )
