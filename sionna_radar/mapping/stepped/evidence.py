"""Log-likelihood of a surface at every height over every cell, from range profiles.

A patch of ground of reflectivity g, seen with the two-way gain w of a pulse, contributes at least the mean power
m = n + g w to its range cell, n being the receiver noise; the power P there is exponential about the
mean of everything in the cell.

* Against: P far below m. The log-likelihood of m relative to the best mean is log(P / m) - P / m + 1, at most 0.
  It does not count where something nearer in the same pulse is bright enough to occlude the patch.
* For: P as expected of the patch. Compared with the alternative that P comes from elsewhere and is anything between
  the noise and the strongest power (uniform in its logarithm, over K nepers), the gain is
  log(P / m) - P / m + log K, where that is positive.

The reflectivity of each height of each cell is the one, in steps of 6 dB, that is likeliest for all pulses. So a
bright roof at the edge of the beam is not taken for ground on its axis: their powers vary differently between pulses.

Every function works on some rows of the map alone, pulse after pulse, so that rows may be divided among cores.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Grid
from sionna_radar.foundation.threads import over_rows
from sionna_radar.inference.echo.beam import BeamNodes
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.mapping.options import STEPPED, SteppedParameters


def evidence_against(
    sightings: Sightings,
    grid: Grid,
    base_m: Float[np.ndarray, "row column"],
    level_m: Float[np.ndarray, " level"],
    options: SteppedParameters = STEPPED,
) -> Float32[np.ndarray, "row column level"]:
    """Return negative log-likelihood ratios of surfaces at some heights over the cells of a grid, in nepers.

    They are 0 where nothing was seen, and negative where echoes agree.

    sightings: profiles and measured poses.
    grid: cells of the map.
    base_m, level_m: base heights of the cells, and the levels above them, increasing.
    options: of the method.
    """
    bright = _reflectivities(sightings, options)
    against = np.zeros((*grid.shape, len(level_m), max(len(bright.step), 1)), dtype=np.float32)
    windows = windows_of(sightings, grid, (float(base_m.min() + level_m[0]), float(base_m.max() + level_m[-1])))
    beam, pose, profiles = sightings.beam, sightings.pose, sightings.profiles
    arguments = (
        *(windows, profiles.first, profiles.start, profiles.power, profiles.noise, profiles.cell_m),
        *(np.ascontiguousarray(each) for each in (pose.position_m, pose.velocity_mps, pose.R_world_antenna)),
        sightings.doppler_s,
        *(beam.gain, _axes(beam)),
        *(grid.x_m, grid.y_m, np.ascontiguousarray(base_m), level_m),
        *(bright.step, bright.typical, bright.alternatives, options.min_gain, against),
    )
    if len(bright.step):
        over_rows(lambda low, high: add_evidence(*arguments, low, high), grid.rows)
    advance(len(sightings))
    lowest = against[..., 0].copy()

    def some(low: int, high: int) -> None:
        # Several times as fast as a minimum over a short last axis.
        for step in range(1, against.shape[-1]):
            np.minimum(lowest[low:high], against[low:high, ..., step], out=lowest[low:high])

    over_rows(some, len(lowest))
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


def _reflectivities(sightings: Sightings, options: SteppedParameters = STEPPED) -> _Reflectivities:
    profiles = sightings.profiles
    from sionna_radar.inference.echo.power_kernels import echo_levels

    level, volume = np.empty(len(profiles)), np.zeros(len(profiles.power))
    if profiles.volume is not None:
        volume = profiles.volume.power.astype(np.float64) * profiles.volume.in_air
    echo_levels(profiles.start, profiles.power, profiles.noise, volume, level)
    level = level[level > 0]
    if len(level) == 0:
        return _Reflectivities(np.zeros(0), 0.0, 0.0)
    low, typical, high = np.percentile(level, [5, 25, 99])
    step, (lowest, highest) = float(np.log(options.reflectivity_ratio)), np.log([low, high])
    span = float(np.log(profiles.power.max() / profiles.noise.min()))
    return _Reflectivities(np.exp(np.arange(lowest, highest + step, step)), float(typical), span)


def windows_of(sightings: Sightings, grid: Grid, span_m: tuple[float, float]) -> Int[np.ndarray, "pulse 4"]:
    """Return the rows and columns that the main lobe of each pulse crosses between two heights, the last excluded."""
    position = sightings.pose.position_m[:, None, None]
    corner = sightings.corner_directions()[:, None]
    drop = np.array(span_m)[:, None] - position[..., 2]
    reach = np.clip(drop / np.minimum(corner[..., 2], -0.05), 0.0, sightings.reach_m)
    place = (position[..., :2] + reach[..., None] * corner[..., :2]).reshape(len(sightings), -1, 2)
    low, high = place.min(axis=1), place.max(axis=1)
    rows = (np.searchsorted(grid.y_m, bound[:, 1]) for bound in (low, high))
    columns = (np.searchsorted(grid.x_m, bound[:, 0]) for bound in (low, high))
    return np.column_stack([*rows, *columns])


# Beams whose directions are farther off the boresight than by this cosine are not bounded by planes, and planes that
# are steeper than this slope, upright ones, bound no height.
MIN_BORESIGHT, MIN_SLOPE = 0.1, 1e-6


@compiled
@no_type_check
def prepare_cells(power, noise, edged, most, nearer):
    """Write what the range cells of one profile say, each with two cells more at both ends, where there is noise.

    edged: the power, at least the noise; most: largest power of the cell and its two neighbours.
    nearer: strongest power of all nearer cells.
    """
    edged[:] = noise
    for c in range(len(power)):
        edged[c + 2] = max(power[c], noise)
    strongest, last = noise, len(power) + 3
    for k in range(last + 1):
        most[k] = max(edged[max(k - 1, 0)], edged[k], edged[min(k + 1, last)])
        nearer[k] = strongest
        strongest = max(strongest, edged[k])


@compiled
@no_type_check
def two_way(gain, first_u, each_u, first_v, each_v, u, v):
    """Return the bilinear two-way gain at direction cosines within the table, of `each` entries for a unit of both."""
    i, j = (u - first_u) * each_u, (v - first_v) * each_v
    low_i, low_j = min(max(int(i), 0), gain.shape[0] - 2), min(max(int(j), 0), gain.shape[1] - 2)
    a, b = i - low_i, j - low_j
    below = gain[low_i, low_j] * (1 - b) + gain[low_i, low_j + 1] * b
    above = gain[low_i + 1, low_j] * (1 - b) + gain[low_i + 1, low_j + 1] * b
    return below * (1 - a) + above * a


@compiled
@no_type_check
def planes_around(R, axes, planes):
    """Write planes through the antenna between which the beam's table lies; a row of zeros is none.

    Where |u| <= U and |v| <= V, the part f of a unit vector along the boresight is at least c = sqrt(1 - U^2 - V^2), so
    that u <= u_max implies u <= (u_max / c) f for a positive u_max, and u <= u_max f for any other.
    planes: a, b and c = 1, -1 or 0 of a x + b y + c z <= 0, in the world frame from the antenna.
    """
    planes[:] = 0.0
    least = 1 - max(abs(axes[0]), abs(axes[4])) ** 2 - max(abs(axes[2]), abs(axes[5])) ** 2
    widen = 1 / np.sqrt(least) if least > MIN_BORESIGHT**2 else np.inf
    for c in range(3):
        planes[4, c] = -R[c, 0]
    if widen < np.inf:
        for k in range(4):
            axis, sign = 1 + k // 2, 1.0 - 2.0 * (k % 2)
            bound = sign * axes[(4, 0, 5, 2)[k]]
            factor = bound * (widen if bound > 0 else 1.0)
            for c in range(3):
                planes[k, c] = sign * R[c, axis] - factor * R[c, 0]
    for k in range(len(planes)):
        steep = abs(planes[k, 2])
        for c in range(3):
            planes[k, c] = planes[k, c] / steep if steep > MIN_SLOPE else 0.0


@compiled
@no_type_check
def columns_between(planes, north, span, west, spacing, sides):
    """Return the first and the last column, excluded, of a row of the map that may lie between planes.

    north, west: of the row and of its first column, from the antenna, as the span of heights; sides: all columns.
    """
    (bottom, top), (first, last) = span, sides
    low, high = -np.inf, np.inf
    for k in range(len(planes)):
        bound = -planes[k, 1] * north - planes[k, 2] * (bottom if planes[k, 2] > 0 else top)
        if planes[k, 0] > 0:
            high = min(high, bound / planes[k, 0])
        elif planes[k, 0] < 0:
            low = max(low, bound / planes[k, 0])
    # One more on both sides, for rounding.
    low, high = max((low - west) / spacing - 1, float(first)), min((high - west) / spacing + 2, float(last))
    return (int(low), int(high)) if low < high else (first, first)


@compiled
@no_type_check
def levels_between(planes, east, north, base_up, level):
    """Return the first and the last level, excluded, of a column of the map that may lie between planes.

    level: evenly spaced.
    """
    if len(level) == 1:
        return 0, 1
    bottom, spacing = base_up + level[0], level[1] - level[0]
    lowest, highest = bottom, base_up + level[-1]
    for k in range(len(planes)):
        beyond = planes[k, 0] * east + planes[k, 1] * north
        if planes[k, 2] > 0:
            highest = min(highest, -beyond)
        elif planes[k, 2] < 0:
            lowest = max(lowest, beyond)
    # One more on both sides, for rounding.
    return max(int((lowest - bottom) / spacing) - 1, 0), min(int((highest - bottom) / spacing) + 3, len(level))


@compiled
@no_type_check
def add_evidence(
    windows, first, start, power, noise, cell_m, position, velocity, R_world_antenna, doppler, gain, axes, x, y,
    base, level, steps, typical, alternatives, widest_for, against, low, high,
):  # fmt: skip
    """Subtract the evidence of all pulses for the rows of the map from `low` to `high`.

    windows: first and last row and column of the map that each pulse sees, the last excluded.
    gain: two-way gain of the beam on a table of direction cosines, of which `axes` has starts, steps and ends.
    steps: the reflectivities; against: (row, column, level, step).
    """
    spacing = x[1] - x[0] if len(x) > 1 else 1.0
    lowest, highest = np.inf, -np.inf
    for row in range(low, high):
        for column in range(len(x)):
            lowest, highest = min(lowest, base[row, column]), max(highest, base[row, column])
    lowest, highest = lowest + level[0], highest + level[-1]
    log_alternatives, each_u, each_v, cells_per_m = np.log(alternatives), 1 / axes[1], 1 / axes[3], 1 / cell_m
    longest = 0
    for pulse in range(len(windows)):
        longest = max(longest, start[pulse + 1] - start[pulse])
    edged, most, before = np.empty(longest + 4), np.empty(longest + 4), np.empty(longest + 4)
    log_edged, log_most, planes = np.empty(longest + 4), np.empty(longest + 4), np.empty((5, 3))
    for pulse in range(len(windows)):
        top, bottom = max(windows[pulse, 0], low), min(windows[pulse, 1], high)
        if top >= bottom or windows[pulse, 2] >= windows[pulse, 3]:
            continue
        cells = start[pulse + 1] - start[pulse]
        own_noise = noise[pulse]
        here = power[start[pulse] : start[pulse + 1]]
        prepare_cells(here, own_noise, edged[: cells + 4], most, before)
        for k in range(cells + 4):
            log_edged[k], log_most[k] = np.log(edged[k]), np.log(most[k])
        R = R_world_antenna[pulse]
        planes_around(R, axes, planes)
        west, height_there = x[0] - position[pulse, 0], position[pulse, 2]
        for row in range(top, bottom):
            north = y[row] - position[pulse, 1]
            span, sides = (lowest - height_there, highest - height_there), (windows[pulse, 2], windows[pulse, 3])
            first_column, last_column = columns_between(planes, north, span, west, spacing, sides)
            for column in range(first_column, last_column):
                east = x[column] - position[pulse, 0]
                flat = east * east + north * north
                first_level, last_level = levels_between(planes, east, north, base[row, column] - height_there, level)
                for number in range(first_level, last_level):
                    height = base[row, column] + level[number]
                    up = height - height_there
                    range_m = np.sqrt(flat + up * up)
                    inverse = 1 / range_m
                    u = (R[0, 1] * east + R[1, 1] * north + R[2, 1] * up) * inverse
                    v = (R[0, 2] * east + R[1, 2] * north + R[2, 2] * up) * inverse
                    if u < axes[0] or u > axes[4] or v < axes[2] or v > axes[5]:
                        continue
                    if R[0, 0] * east + R[1, 0] * north + R[2, 0] * up <= 0.0:
                        continue
                    w = two_way(gain, axes[0], each_u, axes[2], each_v, u, v)
                    if w <= 0.0:
                        continue
                    rate = velocity[pulse, 0] * east + velocity[pulse, 1] * north + velocity[pulse, 2] * up
                    apparent = range_m - doppler * rate * inverse
                    cell = int(np.rint(apparent * cells_per_m)) - first[pulse]
                    place = min(max(cell, -1), cells) + 2
                    seen, fits = before[place] < own_noise + typical * w, 0 <= cell < cells and w > widest_for
                    if not seen and not fits:
                        continue
                    there, strong, log_there, log_strong = edged[place], most[place], log_edged[place], log_most[place]
                    for step in range(len(steps)):
                        mean = own_noise + steps[step] * w
                        one_over, log_mean = 1 / mean, np.log(mean)
                        short = log_strong - log_mean - strong * one_over + 1
                        match = max(log_there - log_mean - there * one_over + log_alternatives, 0.0)
                        support = short if seen and strong < mean else 0.0
                        against[row, column, number, step] -= support + (match if fits else 0.0)
