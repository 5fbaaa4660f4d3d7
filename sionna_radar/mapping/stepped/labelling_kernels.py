"""Numba kernels of `labelling`: ray casting on cell columns, predicted profiles, and changes of labels.

Cells are columns with plane tops. `CellColumns`, `CellViews` and `PulseEchoes` hold arrays that all functions share.

A changed cell is evaluated incrementally: the difference of the powers that the rays over it add to the range cells is
spread by the window and added to the predicted profile.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int, Int32

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.numerics import MAX_SPECKLE

NOTHING = -1
# Stride of a ray that approaches the map, cells.
STRIDE_CELLS = 4


class CellColumns(NamedTuple):
    """The map: height and slopes of each cell's top, and its region.

    ceiling: a height that no cell near reaches, not even after a change; highest: of all ceilings.
    """

    height: Float[np.ndarray, "row column"]
    slope_x: Float[np.ndarray, "row column"]
    slope_y: Float[np.ndarray, "row column"]
    region: Int[np.ndarray, "row column"]
    ceiling: Float[np.ndarray, "row column"]
    highest: float
    west: float
    south: float
    spacing: float


@compiled
@no_type_check
def cast(columns, x, y, z, dx, dy, dz, begin, farthest, row, column, height, slope_x, slope_y, region):
    """Return the range at which a ray meets the columns, and what it meets; one cell may be replaced (row >= 0)."""
    rows, count = columns.height.shape
    west, south, size = columns.west, columns.south, columns.spacing
    j = int(np.floor((x + begin * dx - west) / size))
    i = int(np.floor((y + begin * dy - south) / size))
    right, up = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
    each_x = size / abs(dx) if dx != 0 else np.inf
    each_y = size / abs(dy) if dy != 0 else np.inf
    next_x = (west + (j + (dx > 0)) * size - x) / dx if dx != 0 else np.inf
    next_y = (south + (i + (dy > 0)) * size - y) / dy if dy != 0 else np.inf
    at = begin
    while at < farthest:
        leaves = min(next_x, next_y)
        if i < 0 or j < 0 or i >= rows or j >= count:
            if (i < 0 and up < 0) or (j < 0 and right < 0) or (i >= rows and up > 0) or (j >= count and right > 0):
                return np.inf, NOTHING
        else:
            if i == row and j == column:
                top, a, b, number = height, slope_x, slope_y, region
            else:
                top, a, b = columns.height[i, j], columns.slope_x[i, j], columns.slope_y[i, j]
                number = columns.region[i, j]
            top += a * (x + at * dx - west - (j + 0.5) * size) + b * (y + at * dy - south - (i + 0.5) * size)
            above = z + at * dz - top
            if above <= 0:
                return at, 2 * number + (1 if at > begin else 0)
            falls = a * dx + b * dy - dz
            if falls > 0 and at + above / falls <= leaves:
                return at + above / falls, 2 * number
        at = leaves
        if next_x <= next_y:
            j, next_x = j + right, next_x + each_x
        else:
            i, next_y = i + up, next_y + each_y
    return np.inf, NOTHING


@compiled
@no_type_check
def approach(columns, x, y, z, dx, dy, dz, farthest):
    """Return a range at which a ray is still above everything, near where it may meet the map."""
    rows, count = columns.height.shape
    stride = STRIDE_CELLS * columns.spacing / max(np.hypot(dx, dy), 1e-6)
    at = 0.0
    if dz < 0 and z > columns.highest:
        at = max(np.floor((z - columns.highest) / -dz / stride) - 1, 0.0) * stride
    while at + stride < farthest:
        then = at + stride
        i = min(max(int(np.floor((y + then * dy - columns.south) / columns.spacing)), 0), rows - 1)
        j = min(max(int(np.floor((x + then * dx - columns.west) / columns.spacing)), 0), count - 1)
        if z + then * dz <= columns.ceiling[i, j]:
            return at
        at = then
    return at


@compiled
@no_type_check
def candidate(columns, row, column, region):
    """Return height and slopes of the top of a cell if it belonged to a region of its neighbours, and their number."""
    height, a, b, count = 0.0, 0.0, 0.0, 0
    for down in range(-1, 2):
        for right in range(-1, 2):
            i, j = row + down, column + right
            if (
                (down == 0 and right == 0)
                or i < 0
                or j < 0
                or i >= columns.region.shape[0]
                or j >= columns.region.shape[1]
            ):
                continue
            if columns.region[i, j] == region:
                x, y = columns.slope_x[i, j], columns.slope_y[i, j]
                height += columns.height[i, j] - (x * right + y * down) * columns.spacing
                a, b, count = a + x, b + y, count + 1
    return (height / count, a / count, b / count, count) if count else (0.0, 0.0, 0.0, 0)


# Rays passing within this fraction of a cell are tested exactly.
ROUNDING = 1e-6
# Half the diagonal of a cell, in cells, and a little more.
HALF_DIAGONAL = 0.7072
# Number of factors multiplied before their logarithm is taken.
FACTORS = 8


class CellViews(NamedTuple):
    """Poses of the pulses, samples of the beam, where their rays meet the map, and the range cells they fall into.

    power: two-way power of the samples of the beam.

    enters: range at which each ray comes near the map, NaN if unknown; meets: range of what it meets, infinite without;
    what: twice the number of the region there, plus one on a wall; NOTHING without.
    entries: of each pulse, rays from one surface that fall into the same range cells count as one; surface: what it is;
    cell: the first of the two range cells; nearer, farther: power in it and in the next, at a reflectivity of one.
    These four have a row for each entry and a column for each pulse. A pulse has far fewer entries than rays, so that
    most rows are never written and take no memory.
    """

    position: Float[np.ndarray, "pulse 3"]
    velocity: Float[np.ndarray, "pulse 3"]
    R_world_antenna: Float[np.ndarray, "pulse 3 3"]
    direction: Float[np.ndarray, "3 sample"]
    power: Float[np.ndarray, " sample"]
    enters: Float[np.ndarray, "pulse sample"]
    meets: Float[np.ndarray, "pulse sample"]
    what: Int32[np.ndarray, "pulse sample"]
    entries: Int[np.ndarray, " pulse"]
    surface: Int32[np.ndarray, "sample pulse"]
    cell: Int32[np.ndarray, "sample pulse"]
    nearer: Float[np.ndarray, "sample pulse"]
    farther: Float[np.ndarray, "sample pulse"]


class PulseEchoes(NamedTuple):
    """The measured profiles, and those that the map predicts.

    floor: noise and unexplained power in the cells of each pulse; mean: predicted power; looks: independent looks of a
    cell. Range cells are numbered from `len(response) // 2 * 2 + 1` before the profile.
    """

    first: Int[np.ndarray, " pulse"]
    start: Int[np.ndarray, " pulse+1"]
    power: Float[np.ndarray, " value"]
    floor: Float[np.ndarray, " pulse"]
    response: Float[np.ndarray, " tap"]
    doppler: float
    cell_m: float
    unit_m: float
    mean: Float[np.ndarray, " value"]
    looks: Float[np.ndarray, " pulse"]


@compiled
@no_type_check
def ray(views, pulse, sample):
    """Return the direction of a sample of the beam in the world frame."""
    R, d = views.R_world_antenna[pulse], views.direction
    x, y, z = d[0, sample], d[1, sample], d[2, sample]
    return (
        R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
        R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
        R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
    )


@compiled
@no_type_check
def landing(views, echoes, pulse, sample, meets, what):
    """Return the first of two range cells that a ray falls into, NOTHING outside the profile, and powers in both."""
    if what == NOTHING:
        return NOTHING, 0.0, 0.0
    half = len(echoes.response) // 2
    dx, dy, dz = ray(views, pulse, sample)
    velocity = views.velocity[pulse]
    rate = velocity[0] * dx + velocity[1] * dy + velocity[2] * dz
    place = (meets - echoes.doppler * rate) / echoes.cell_m - echoes.first[pulse]
    if not -half < place < echoes.start[pulse + 1] - echoes.start[pulse] - 1 + half:
        return NOTHING, 0.0, 0.0
    below = int(np.floor(place))
    power, beyond = views.power[sample] * (echoes.unit_m / meets) ** 2, place - below
    return below + 2 * half + 1, power * (1 - beyond), power * beyond


@compiled
@no_type_check
def cast_all(columns, views, echoes, farthest, pulses, low, high):
    """Cast all rays of the pulses from `low` to `high` of some, and compute where they fall in the profiles."""
    nowhere = np.int64(NOTHING)
    for n in range(low, high):
        pulse = pulses[n]
        x, y, z = views.position[pulse, 0], views.position[pulse, 1], views.position[pulse, 2]
        surface, cell, entries = views.surface[:, pulse], views.cell[:, pulse], 0
        for k in range(len(views.power)):
            dx, dy, dz = ray(views, pulse, k)
            if np.isnan(views.enters[pulse, k]):
                views.enters[pulse, k] = approach(columns, x, y, z, dx, dy, dz, farthest)
            begin = views.enters[pulse, k]
            range_m, what = cast(
                columns, x, y, z, dx, dy, dz, begin, farthest, nowhere, nowhere, 0.0, 0.0, 0.0, nowhere
            )
            views.meets[pulse, k], views.what[pulse, k] = range_m, what
            at, nearer, farther = landing(views, echoes, pulse, k, range_m, what)
            if at == NOTHING:
                continue
            one = 0
            while one < entries and (cell[one] != at or surface[one] != what):
                one += 1
            if one == entries:
                surface[one], cell[one], entries = what, at, entries + 1
                views.nearer[one, pulse], views.farther[one, pulse] = 0.0, 0.0
            views.nearer[one, pulse] += nearer
            views.farther[one, pulse] += farther
        views.entries[pulse] = entries


@compiled
@no_type_check
def cells_crossed(columns, views, beyond_m, into, pulse_of, low, high):
    """Write the cells over which the rays of some pulses come near the map; return how many entries were needed."""
    rows, count = columns.height.shape
    marked = np.full(rows * count, NOTHING)
    used = 0
    for pulse in range(low, high):
        x, y = views.position[pulse, 0], views.position[pulse, 1]
        for k in range(len(views.power)):
            if views.what[pulse, k] == NOTHING:
                continue
            dx, dy, _ = ray(views, pulse, k)
            stride = 0.7 * columns.spacing / max(np.hypot(dx, dy), 1e-6)
            at, last = views.enters[pulse, k], views.meets[pulse, k] + beyond_m
            while at < last:
                i = int(np.floor((y + at * dy - columns.south) / columns.spacing))
                j = int(np.floor((x + at * dx - columns.west) / columns.spacing))
                if 0 <= i < rows and 0 <= j < count and marked[i * count + j] != pulse:
                    marked[i * count + j] = pulse
                    if used < len(into):
                        into[used], pulse_of[used] = i * count + j, pulse
                    used += 1
                at += stride
    return used


@compiled
@no_type_check
def spread(response, hits, low, high, mean):
    """Add what the window spreads from the range cells `hits` to some cells of a profile."""
    into = mean[low:high]
    for tap in range(len(response)):
        begin = low + 3 * (len(response) // 2) + 1 - tap
        weight, source = response[tap], hits[begin : begin + len(into)]
        for cell in range(len(into)):
            into[cell] += weight * source[cell]


@compiled
@no_type_check
def speckle_loss(power, mean):
    """Return the negative log-likelihood of a power, without the logarithm of its mean.

    Powers above MAX_SPECKLE are compressed logarithmically, so that a single glint cannot dominate.
    """
    ratio = power / mean
    return ratio if ratio <= MAX_SPECKLE else MAX_SPECKLE + np.log(ratio / MAX_SPECKLE)


@compiled
@no_type_check
def rays_over(columns, views, pulse, row, column, near, which, enters, leaves):
    """List the rays of a pulse that come near the map over a cell, or before, and meet nothing before it.

    near: room for a mark of each ray; which, enters, leaves: written, the rays and where they are over the cell.
    Returns their number.
    """
    side, x, y = columns.spacing, views.position[pulse, 0], views.position[pulse, 1]
    west, south = columns.west + column * side - x, columns.south + row * side - y
    east, north = west + 0.5 * side, south + 0.5 * side
    half_wide, half_long = side * (0.5 + ROUNDING), side * HALF_DIAGONAL
    R, d = views.R_world_antenna[pulse], views.direction
    # Most rays miss the cell; this test has no branch.
    for k in range(len(near)):
        dx = R[0, 0] * d[0, k] + R[0, 1] * d[1, k] + R[0, 2] * d[2, k]
        dy = R[1, 0] * d[0, k] + R[1, 1] * d[1, k] + R[1, 2] * d[2, k]
        square, along = dx * dx + dy * dy, east * dx + north * dy
        margin = half_long * np.sqrt(square)
        near[k] = (
            (abs(east * dy - north * dx) <= half_wide * (abs(dx) + abs(dy)))
            & (along - margin <= (views.meets[pulse, k] + ROUNDING) * square)
            & (along + margin >= views.enters[pulse, k] * square)
        )
    count = 0
    for k in range(len(near)):
        if not near[k]:
            continue
        dx, dy, _ = ray(views, pulse, k)
        in_x, out_x, in_y, out_y = west / dx, (west + side) / dx, south / dy, (south + side) / dy
        first = max(min(in_x, out_x), min(in_y, out_y))
        last = min(max(in_x, out_x), max(in_y, out_y))
        if first < last and last >= views.enters[pulse, k] and first <= views.meets[pulse, k] + ROUNDING:
            which[count], enters[count], leaves[count] = k, first, last
            count += 1
    return count


@compiled
@no_type_check
def redirect(views, echoes, level, pulse, sample, meets, what, hits, sign, low, high):
    """Add the power of a ray to the range cells that it falls into, or take it away; return which cells have changed.

    hits: power that comes to each range cell; sign: 1 or -1; low, high: the first and the last that have changed.
    """
    at, nearer, farther = landing(views, echoes, pulse, sample, meets, what)
    if at == NOTHING:
        return low, high
    hits[at] += sign * level[what] * nearer
    hits[at + 1] += sign * level[what] * farther
    return min(low, at), max(high, at + 1)


@compiled
@no_type_check
def recast_cell_rays(columns, views, echoes, level, farthest, pulse, cell, top, rays, hits, met, what):
    """Cast the rays of a pulse over a replaced cell again; return the range cells that change.

    cell, top: row and column, and height, slopes and region; rays: see `rays_over`, and their number.
    hits: where it is zero, power that comes to each range cell; met, what: of each of the rays, afterwards.
    """
    row, column = cell
    height, slope_x, slope_y, region = top
    which, enters, leaves, count = rays
    x, y, z = views.position[pulse, 0], views.position[pulse, 1], views.position[pulse, 2]
    side = columns.spacing
    east, north = columns.west + (column + 0.5) * side - x, columns.south + (row + 0.5) * side - y
    low, high = len(hits), NOTHING
    for n in range(count):
        k = which[n]
        before, of = views.meets[pulse, k], np.int64(views.what[pulse, k])
        met[n], what[n] = before, of
        dx, dy, dz = ray(views, pulse, k)
        passes = before > leaves[n]
        if passes:
            # Over the cell it goes on, unless the top rises into its way.
            falls, above = slope_x * dx + slope_y * dy - dz, z - height + slope_x * east + slope_y * north
            if above > max(falls * enters[n], falls * leaves[n]):
                continue
        # Up to the cell the ray meets nothing, and beyond it what it met before.
        begin, until = max(views.enters[pulse, k], enters[n] - ROUNDING * side), leaves[n] if passes else farthest
        meets, surface = cast(columns, x, y, z, dx, dy, dz, begin, until, row, column, height, slope_x, slope_y, region)
        if (meets == before and surface == of) or (surface == NOTHING and passes):
            continue
        met[n], what[n] = meets, surface
        low, high = redirect(views, echoes, level, pulse, k, before, of, hits, -1.0, low, high)
        low, high = redirect(views, echoes, level, pulse, k, meets, surface, hits, 1.0, low, high)
    return low, high


@compiled
@no_type_check
def likelihood_gain(echoes, pulse, hits, low, high, mean):
    """Return the log-likelihood ratio of a profile with more power in some range cells, which are emptied.

    low, high: the first and the last of these cells; mean: written, the prediction with it in the cells that change.
    Returns the first and the last of those, too.
    """
    half = len(echoes.response) // 2
    pad, begin = 2 * half + 1, echoes.start[pulse]
    first, last = max(low - pad - half, 0), min(high - pad + half + 1, echoes.start[pulse + 1] - begin)
    for cell in range(first, last):
        mean[cell] = echoes.mean[begin + cell]
    spread(echoes.response, hits, first, last, mean)
    for cell in range(low, high + 1):
        hits[cell] = 0.0
    gain, factor = 0.0, 1.0
    for cell in range(first, last):
        before, after, power = echoes.mean[begin + cell], mean[cell], echoes.power[begin + cell]
        gain += speckle_loss(power, before) - speckle_loss(power, after)
        factor *= before / after
        if cell % FACTORS == 0 or cell == last - 1:
            gain, factor = gain + np.log(factor), 1.0
    return echoes.looks[pulse] * gain, first, last


@compiled
@no_type_check
def regions_around(columns, i, j, pair, tried, prior, tops):
    """Write the regions that a cell may be of, its own first and then its neighbours', and return their number.

    tried, prior, tops: of each region, its prior, Np, and height and slopes of the cell in it; pair: see `visit_cells`.
    """
    tried[0], tried_count = columns.region[i, j], 1
    prior[0] = pair * candidate(columns, i, j, tried[0])[3]
    tops[0, 0], tops[0, 1], tops[0, 2] = columns.height[i, j], columns.slope_x[i, j], columns.slope_y[i, j]
    for place in range(9):
        u, v = i + place // 3 - 1, j + place % 3 - 1
        if place == 4 or not (0 <= u < columns.region.shape[0] and 0 <= v < columns.region.shape[1]):
            continue
        region, again = columns.region[u, v], False
        for k in range(tried_count):
            again |= region == tried[k]
        if again:
            continue
        height, a, b, number = candidate(columns, i, j, region)
        if height + (abs(a) + abs(b)) * columns.spacing <= columns.ceiling[i, j]:
            tried[tried_count], prior[tried_count] = region, pair * number
            tops[tried_count, 0], tops[tried_count, 1], tops[tried_count, 2] = height, a, b
            tried_count += 1
    return tried_count


@compiled
@no_type_check
def likeliest(gain, count, odds):
    """Write the odds of the first `count` regions to the likeliest of them; return that one, and their sum."""
    best = 0
    for k in range(count):
        if gain[k] > gain[best]:
            best = k
    total = 0.0
    for k in range(count):
        odds[k] = np.exp(gain[k] - gain[best])
        total += odds[k]
    return best, total


@compiled
@no_type_check
def visit_cells(
    columns, views, echoes, level, farthest, pair, discount, cells, first, pulses, uniform, reference, step, changed,
    other_side, square,
):  # fmt: skip
    """Give cells, one after the other, the region of one of their neighbours, given all others.

    pair: gain for each of the eight neighbours in the same region, Np; discount: factor of log-likelihoods.
    first, pulses: which pulses' rays cross each cell.
    uniform: a random number for each cell of the map, by which its region is drawn; empty to take the likeliest.
    reference: heights; other_side, square: the probability that a cell is more than a `step` off them is added to the
    one, and the mean square of how far off to the other.
    """
    count, samples, longest = columns.height.shape[1], len(views.power), 0
    for pulse in range(len(echoes.first)):
        longest = max(longest, echoes.start[pulse + 1] - echoes.start[pulse])
    hits, mean = np.zeros(longest + 4 * len(echoes.response)), np.empty(longest)
    near, which = np.empty(samples, dtype=np.bool_), np.empty(samples, dtype=np.int64)
    enters, leaves, met, what = np.empty(samples), np.empty(samples), np.empty(samples), np.empty(samples, np.int64)
    tried, gain, tops = np.empty(9, dtype=np.int64), np.empty(9), np.empty((9, 3))
    prior, odds = np.empty(9), np.empty(9)
    for cell in cells:
        i, j = cell // count, cell % count
        tried_count, gain[:] = regions_around(columns, i, j, pair, tried, prior, tops), 0.0
        for pulse in pulses[first[cell] : first[cell + 1] if tried_count > 1 else first[cell]]:
            rays = which, enters, leaves, rays_over(columns, views, pulse, i, j, near, which, enters, leaves)
            for k in range(1, tried_count):
                top = tops[k, 0], tops[k, 1], tops[k, 2], tried[k]
                low, high = recast_cell_rays(
                    columns, views, echoes, level, farthest, pulse, (i, j), top, rays, hits, met, what
                )
                if high != NOTHING:
                    gain[k] += likelihood_gain(echoes, pulse, hits, low, high, mean)[0]
        for k in range(tried_count):
            gain[k] = discount * gain[k] + prior[k]
        best, total = likeliest(gain, tried_count, odds)
        for k in range(tried_count):
            off = tops[k, 0] - reference[i, j]
            if abs(off) > step:
                other_side[i, j] += odds[k] / total
                square[i, j] += off * off * odds[k] / total
        if len(uniform):
            left = uniform[i, j] * total
            for k in range(tried_count):
                best, left = k, left - odds[k]
                if left <= 0:
                    break
        if best == 0:
            continue
        top = tops[best, 0], tops[best, 1], tops[best, 2], tried[best]
        for pulse in pulses[first[cell] : first[cell + 1]]:
            rays = which, enters, leaves, rays_over(columns, views, pulse, i, j, near, which, enters, leaves)
            low, high = recast_cell_rays(
                columns, views, echoes, level, farthest, pulse, (i, j), top, rays, hits, met, what
            )
            for n in range(rays[3]):
                views.meets[pulse, which[n]], views.what[pulse, which[n]] = met[n], what[n]
            if high != NOTHING:
                _, low, high = likelihood_gain(echoes, pulse, hits, low, high, mean)
                for k in range(low, high):
                    echoes.mean[echoes.start[pulse] + k] = mean[k]
        columns.height[i, j], columns.region[i, j] = tops[best, 0], tried[best]
        columns.slope_x[i, j], columns.slope_y[i, j] = tops[best, 1], tops[best, 2]
        changed[i, j] = True


@compiled
@no_type_check
def region_gains(columns, views, echoes, level, farthest, window, pulses, accept, gain, low, high):
    """Write what the log-likelihoods of some pulses gain from new columns within a window of the map.

    window: first and last rows and columns, the last excluded; columns: as they would be.
    accept: whether the rays and the predicted profiles are changed, too.
    """
    side, samples, longest = columns.spacing, len(views.power), 0
    for pulse in range(len(echoes.first)):
        longest = max(longest, echoes.start[pulse + 1] - echoes.start[pulse])
    hits, mean = np.zeros(longest + 4 * len(echoes.response)), np.empty(longest)
    south, north = columns.south + window[0] * side, columns.south + window[1] * side
    west, east = columns.west + window[2] * side, columns.west + window[3] * side
    nowhere = np.int64(NOTHING)
    for n in range(low, high):
        pulse = pulses[n]
        x, y, z = views.position[pulse, 0], views.position[pulse, 1], views.position[pulse, 2]
        nearest, last = len(hits), nowhere
        for k in range(samples):
            dx, dy, dz = ray(views, pulse, k)
            in_x, out_x, in_y, out_y = (west - x) / dx, (east - x) / dx, (south - y) / dy, (north - y) / dy
            enters = max(min(in_x, out_x), min(in_y, out_y)) - ROUNDING * side
            leaves = min(max(in_x, out_x), max(in_y, out_y)) + ROUNDING * side
            before, of = views.meets[pulse, k], np.int64(views.what[pulse, k])
            if enters > leaves or leaves < views.enters[pulse, k] or enters > before + ROUNDING:
                continue
            begin = max(views.enters[pulse, k], enters)
            meets, surface = cast(
                columns, x, y, z, dx, dy, dz, begin, farthest, nowhere, nowhere, 0.0, 0.0, 0.0, nowhere
            )
            if meets == before and surface == of:
                continue
            nearest, last = redirect(views, echoes, level, pulse, k, before, of, hits, -1.0, nearest, last)
            nearest, last = redirect(views, echoes, level, pulse, k, meets, surface, hits, 1.0, nearest, last)
            if accept:
                views.meets[pulse, k], views.what[pulse, k] = meets, surface
        gain[n] = 0.0
        if last != NOTHING:
            gain[n], nearest, last = likelihood_gain(echoes, pulse, hits, nearest, last, mean)
            if accept:
                for k in range(nearest, last):
                    echoes.mean[echoes.start[pulse] + k] = mean[k]


@compiled
@no_type_check
def predict(views, echoes, level, returned, expected, low, high):
    """Predict the profiles of some pulses, and compare the measured ones with them.

    Sums, for each region and its walls, the returned and the expected power of the multiplicative update: p P / mean^2
    and p / mean over the powers P to which a reflectivity adds p. With no output array they are not computed.
    """
    half, longest = len(echoes.response) // 2, 0
    pad = 2 * half + 1
    for pulse in range(low, high):
        longest = max(longest, echoes.start[pulse + 1] - echoes.start[pulse])
    hits, excess, inverse = np.empty(longest + 2 * pad), np.empty(longest + 2 * pad), np.empty(longest + 2 * pad)
    usual_there, more_there = np.empty(longest), np.empty(longest)
    for pulse in range(low, high):
        begin, cells = echoes.start[pulse], echoes.start[pulse + 1] - echoes.start[pulse]
        for cell in range(cells + 2 * pad):
            hits[cell] = excess[cell] = inverse[cell] = 0.0
        for k in range(views.entries[pulse]):
            at, here = views.cell[k, pulse], level[views.surface[k, pulse]]
            hits[at] += here * views.nearer[k, pulse]
            hits[at + 1] += here * views.farther[k, pulse]
        mean = echoes.mean[begin : begin + cells]
        for cell in range(cells):
            mean[cell] = echoes.floor[pulse]
        spread(echoes.response, hits, np.int64(0), cells, mean)
        if len(returned) == 0:
            continue
        for cell in range(cells):
            usual_there[cell] = 1 / mean[cell]
            more_there[cell] = min(echoes.power[begin + cell] * usual_there[cell], MAX_SPECKLE) * usual_there[cell]
        for tap in range(len(echoes.response)):
            first, weight = 3 * half + 1 - tap, echoes.response[tap]
            more, usual = excess[first : first + cells], inverse[first : first + cells]
            for cell in range(cells):
                more[cell] += weight * more_there[cell]
                usual[cell] += weight * usual_there[cell]
        for k in range(views.entries[pulse]):
            at, what = views.cell[k, pulse], views.surface[k, pulse]
            nearer, farther = level[what] * views.nearer[k, pulse], level[what] * views.farther[k, pulse]
            returned[what] += nearer * excess[at] + farther * excess[at + 1]
            expected[what] += nearer * inverse[at] + farther * inverse[at + 1]
