"""Assignment of border cells to parts of a map, from the range profiles of the pulses that see them; see `borders`.

Cells are columns with plane tops. `Columns`, `Views` and `Echoes` hold arrays that all functions share.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Float32, Int, Int32

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.numerics import MAX_SPECKLE

NOTHING = -1
# Rays approach the map in strides of so many cells.
STRIDE_CELLS = 4


class CellColumns(NamedTuple):
    """The map: height and slopes of each cell's top, and its part.

    ceiling: a height that no cell near reaches, not even after a change; highest: of all ceilings.
    """

    height: Float[np.ndarray, "row column"]
    slope_x: Float[np.ndarray, "row column"]
    slope_y: Float[np.ndarray, "row column"]
    part: Int[np.ndarray, "row column"]
    ceiling: Float[np.ndarray, "row column"]
    highest: float
    west: float
    south: float
    spacing: float


@compiled
@no_type_check
def cast(columns, x, y, z, dx, dy, dz, begin, farthest, row, column, height, slope_x, slope_y, part):
    """Return the range at which a ray meets the columns, and what it meets, if one of them were another (row >= 0)."""
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
                top, a, b, number = height, slope_x, slope_y, part
            else:
                top, a, b = columns.height[i, j], columns.slope_x[i, j], columns.slope_y[i, j]
                number = columns.part[i, j]
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
def candidate(columns, row, column, part):
    """Return height and slopes of the top of a cell if it belonged to a part of its neighbours, and their number."""
    height, a, b, count = 0.0, 0.0, 0.0, 0
    for down in range(-1, 2):
        for right in range(-1, 2):
            i, j = row + down, column + right
            if (down == 0 and right == 0) or i < 0 or j < 0 or i >= columns.part.shape[0] or j >= columns.part.shape[1]:
                continue
            if columns.part[i, j] == part:
                x, y = columns.slope_x[i, j], columns.slope_y[i, j]
                height += columns.height[i, j] - (x * right + y * down) * columns.spacing
                a, b, count = a + x, b + y, count + 1
    return (height / count, a / count, b / count, count) if count else (0.0, 0.0, 0.0, 0)


# By which share of a cell rays may pass beside it that are looked at more closely.
ROUNDING = 1e-6


class CellViews(NamedTuple):
    """Poses of the pulses and samples of the beam, and where its rays meet the map.

    enters: range at which each ray comes near the map; meets: range of what it meets, infinite without;
    what: twice the number of the part there, plus one on a wall; NOTHING without.
    """

    position: Float[np.ndarray, "pulse 3"]
    velocity: Float[np.ndarray, "pulse 3"]
    R_world_antenna: Float[np.ndarray, "pulse 3 3"]
    direction: Float[np.ndarray, "sample 3"]
    share: Float[np.ndarray, " sample"]
    enters: Float[np.ndarray, "pulse sample"]
    meets: Float[np.ndarray, "pulse sample"]
    what: Int32[np.ndarray, "pulse sample"]


class PulseEchoes(NamedTuple):
    """The measured profiles, and those that the map predicts.

    floor: noise and unexplained power in the cells of each pulse; hits: predicted power before the window's response
    spreads it, with `pad` cells on both sides of each profile; mean: after it; looks: independent looks of a cell.
    """

    first: Int[np.ndarray, " pulse"]
    start: Int[np.ndarray, " pulse+1"]
    power: Float[np.ndarray, " value"]
    floor: Float[np.ndarray, " pulse"]
    response: Float[np.ndarray, " tap"]
    doppler: float
    cell_m: float
    unit_m: float
    hits: Float[np.ndarray, " padded"]
    mean: Float[np.ndarray, " value"]
    looks: Float[np.ndarray, " pulse"]


@compiled
@no_type_check
def ray(views, pulse, sample):
    """Return the direction of a sample of the beam in the world frame."""
    R, d = views.R_world_antenna[pulse], views.direction[sample]
    return (
        R[0, 0] * d[0] + R[0, 1] * d[1] + R[0, 2] * d[2],
        R[1, 0] * d[0] + R[1, 1] * d[1] + R[1, 2] * d[2],
        R[2, 0] * d[0] + R[2, 1] * d[1] + R[2, 2] * d[2],
    )


@compiled
@no_type_check
def cast_all(columns, views, farthest, low, high):
    """Cast all rays of the pulses from `low` to `high`."""
    nowhere = np.int64(NOTHING)
    for pulse in range(low, high):
        x, y, z = views.position[pulse, 0], views.position[pulse, 1], views.position[pulse, 2]
        for k in range(len(views.share)):
            dx, dy, dz = ray(views, pulse, k)
            begin = approach(columns, x, y, z, dx, dy, dz, farthest)
            views.enters[pulse, k] = begin
            found, what = cast(columns, x, y, z, dx, dy, dz, begin, farthest, nowhere, nowhere, 0.0, 0.0, 0.0, nowhere)
            views.meets[pulse, k], views.what[pulse, k] = found, what


@compiled
@no_type_check
def crossed(columns, views, beyond_m, into, pulse_of, low, high):
    """Write the cells over which the rays of some pulses come near the map; return how many entries were needed."""
    rows, count = columns.height.shape
    marked = np.full(rows * count, NOTHING)
    used = 0
    for pulse in range(low, high):
        x, y = views.position[pulse, 0], views.position[pulse, 1]
        for k in range(len(views.share)):
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
def landing(views, echoes, pulse, sample, meets, what):
    """Return the first of the two range cells that a ray falls into, the share of the second, and a power factor.

    The cell is NOTHING outside the profile; the factor is that by which power falls with the range. Share and factor
    are in single precision, as they are kept: what is taken away is what was added.
    """
    nothing = NOTHING, np.float32(0.0), np.float32(0.0)
    if what == NOTHING:
        return nothing
    half = len(echoes.response) // 2
    dx, dy, dz = ray(views, pulse, sample)
    velocity = views.velocity[pulse]
    rate = velocity[0] * dx + velocity[1] * dy + velocity[2] * dz
    place = (meets - echoes.doppler * rate) / echoes.cell_m - echoes.first[pulse]
    if not -half < place < echoes.start[pulse + 1] - echoes.start[pulse] - 1 + half:
        return nothing
    below = int(np.floor(place))
    return below + 2 * half + 1, np.float32(place - below), np.float32((echoes.unit_m / meets) ** 2)


@compiled
@no_type_check
def put(views, echoes, level, pulse, sample, meets, what, sign, hits):
    """Add or take away what a ray adds to its range cells; return the first of them, or NOTHING outside the profile."""
    cell, beyond, fall = landing(views, echoes, pulse, sample, meets, what)
    if cell != NOTHING:
        power = sign * level[what] * views.share[sample] * fall
        hits[cell] += power * (1 - beyond)
        hits[cell + 1] += power * beyond
    return cell


@compiled
@no_type_check
def predict_cells(echoes, pulse, hits, low, high, mean):
    """Write the mean powers of some cells of a profile."""
    half = len(echoes.response) // 2
    for cell in range(low, high):
        mean[cell] = echoes.floor[pulse]
    for tap in range(len(echoes.response)):
        weight, begin = echoes.response[tap], 3 * half + 1 - tap
        for cell in range(low, high):
            mean[cell] += weight * hits[cell + begin]


@compiled
@no_type_check
def unlikely(power, mean):
    """Return the negative log-likelihood of a power, but for the logarithm of its mean.

    What is no speckle counts by its logarithm only, so that one glint decides nothing.
    """
    ratio = power / mean
    return ratio if ratio <= MAX_SPECKLE else MAX_SPECKLE + np.log(ratio / MAX_SPECKLE)


@compiled
@no_type_check
def recast(
    columns, views, echoes, level, farthest, pulse, row, column, height, slope_x, slope_y, part, hits, met, what
):
    """Cast the rays of a pulse over a cell again as if it were another; return the range cells that change.

    hits: its profile before the window, changed in place; met, what: of all of its rays, afterwards.
    """
    x, y, z = views.position[pulse, 0], views.position[pulse, 1], views.position[pulse, 2]
    low, high = len(hits), NOTHING
    side = columns.spacing
    east, north = columns.west + (column + 0.5) * side - x, columns.south + (row + 0.5) * side - y
    half_wide = side * (0.5 + ROUNDING)
    for k in range(len(views.share)):
        met[k], what[k] = views.meets[pulse, k], views.what[pulse, k]
        before, of = views.meets[pulse, k], views.what[pulse, k]
        dx, dy, dz = ray(views, pulse, k)
        # Most rays pass the cell by, which this tells without a division.
        if abs(east * dy - north * dx) > half_wide * (abs(dx) + abs(dy)):
            continue
        in_x, out_x = (columns.west + column * side - x) / dx, (columns.west + (column + 1) * side - x) / dx
        in_y, out_y = (columns.south + row * side - y) / dy, (columns.south + (row + 1) * side - y) / dy
        enters = max(min(in_x, out_x), min(in_y, out_y))
        leaves = min(max(in_x, out_x), max(in_y, out_y))
        if enters >= leaves or leaves < views.enters[pulse, k] or enters > before + 1e-6:
            continue
        # Up to the cell the ray meets nothing, and beyond it what it met before.
        begin, until = max(views.enters[pulse, k], enters - side), farthest if before <= leaves else leaves
        meets, found = cast(columns, x, y, z, dx, dy, dz, begin, until, row, column, height, slope_x, slope_y, part)
        if (meets == before and found == of) or (found == NOTHING and before > leaves):
            continue
        met[k], what[k] = meets, found
        for new in range(2):
            range_m, surface, sign = (meets, found, 1.0) if new else (before, of, -1.0)
            at = put(views, echoes, level, pulse, k, range_m, surface, sign, hits)
            if at != NOTHING:
                low, high = min(low, at), max(high, at + 1)
    return low, high


@compiled
@no_type_check
def gained(columns, views, echoes, level, farthest, row, column, height, slope_x, slope_y, part, pulses, keep):
    """Return the log-likelihood gain of replacing a cell; with `keep`, store its rays and predictions."""
    pad = 2 * (len(echoes.response) // 2) + 1
    half = len(echoes.response) // 2
    met, what = np.empty(len(views.share)), np.empty(len(views.share), dtype=views.what.dtype)
    gain = 0.0
    for pulse in pulses:
        begin, end = echoes.start[pulse], echoes.start[pulse + 1]
        stored = echoes.hits[begin + 2 * pad * pulse : end + 2 * pad * (pulse + 1)]
        hits = np.empty(len(stored))
        for k in range(len(stored)):
            hits[k] = stored[k]
        low, high = recast(
            columns, views, echoes, level, farthest, pulse, row, column, height, slope_x, slope_y, part, hits, met, what
        )
        if high == NOTHING:
            continue
        change, low, high = 0.0, max(low - pad - half, 0), min(high - pad + half + 1, end - begin)
        means = np.empty(end - begin)
        predict_cells(echoes, pulse, hits, low, high, means)
        for cell in range(low, high):
            before, after, power = echoes.mean[begin + cell], means[cell], echoes.power[begin + cell]
            change += unlikely(power, before) - unlikely(power, after) - np.log(after / before)
            if keep:
                echoes.mean[begin + cell] = after
        gain += echoes.looks[pulse] * change
        if keep:
            for k in range(len(stored)):
                stored[k] = hits[k]
            for k in range(len(views.share)):
                views.meets[pulse, k], views.what[pulse, k] = met[k], what[k]
    return gain


@compiled
@no_type_check
def improve(
    columns, views, echoes, level, farthest, alike, cells, first, pulses, ground, ground_height, changed, margin, step
):
    """Give each of some cells, one after the other, to the part under which the profiles are likeliest.

    alike: gain for each of the eight neighbours in the same part; first, pulses: which pulses' rays cross each cell;
    ground, ground_height: a further part for each cell and its height there, NOTHING without.
    margin: by how many nepers each cell's part is likelier than any whose height there is by a `step` another.
    """
    count = columns.height.shape[1]
    tried = np.empty(11, dtype=np.int64)
    keep = np.bool_(True)
    for cell in cells:
        i, j = cell // count, cell % count
        own = columns.part[i, j]
        near, most, next_best = pulses[first[cell] : first[cell + 1]], 0.0, -np.inf
        best, best_height, best_x, best_y = own, 0.0, 0.0, 0.0
        beside = candidate(columns, i, j, own)[3]
        tried[0], tried[1], known = own, NOTHING, 2
        for place in range(9):
            u, v = i + place // 3 - 1, j + place % 3 - 1
            if place == 4:
                part = ground[cell]
            elif 0 <= u < columns.part.shape[0] and 0 <= v < count:
                part = columns.part[u, v]
            else:
                continue
            again = False
            for k in range(known):
                again |= part == tried[k]
            if again:
                continue
            tried[known], known = part, known + 1
            height, a, b, number = candidate(columns, i, j, part)
            if number == 0:
                height = ground_height[cell]
            if height + (abs(a) + abs(b)) * columns.spacing > columns.ceiling[i, j]:
                continue
            gain = alike * (number - beside) + gained(
                columns, views, echoes, level, farthest, i, j, height, a, b, part, near, not keep
            )
            if abs(height - columns.height[i, j]) > step:
                next_best = max(next_best, gain)
            if gain > most:
                most, best, best_height, best_x, best_y = gain, part, height, a, b
        margin[i, j] = abs(next_best)
        if best != own:
            gained(columns, views, echoes, level, farthest, i, j, best_height, best_x, best_y, best, near, keep)
            columns.height[i, j], columns.part[i, j] = best_height, best
            columns.slope_x[i, j], columns.slope_y[i, j] = best_x, best_y
            changed[i, j] = True


class Landings(NamedTuple):
    """Where the rays that were cast fall in the profiles, whatever the reflectivities.

    cell: the first of the two range cells of each ray, NOTHING outside the profile; beyond: the share of the second.
    fall: by how much power falls with the range; top: number of the map cell whose top it meets, or NOTHING.
    """

    cell: Int32[np.ndarray, "pulse sample"]
    beyond: Float32[np.ndarray, "pulse sample"]
    fall: Float32[np.ndarray, "pulse sample"]
    top: Int32[np.ndarray, "pulse sample"]


def unknown_landings(shape: tuple[int, int]) -> Landings:
    """Return landings not yet computed."""
    return Landings(
        cell=np.empty(shape, dtype=np.int32),
        beyond=np.empty(shape, dtype=np.float32),
        fall=np.empty(shape, dtype=np.float32),
        top=np.empty(shape, dtype=np.int32),
    )


@compiled
@no_type_check
def land(columns, views, echoes, landings, low, high):
    """Compute where the rays of some pulses fall."""
    rows, count = columns.height.shape
    for pulse in range(low, high):
        x, y = views.position[pulse, 0], views.position[pulse, 1]
        for k in range(len(views.share)):
            what, meets = views.what[pulse, k], views.meets[pulse, k]
            cell, beyond, fall = landing(views, echoes, pulse, k, meets, what)
            landings.cell[pulse, k], landings.beyond[pulse, k], landings.fall[pulse, k] = cell, beyond, fall
            landings.top[pulse, k] = NOTHING
            if cell != NOTHING and what % 2 == 0:
                dx, dy, _ = ray(views, pulse, k)
                i = int(np.floor((y + meets * dy - columns.south) / columns.spacing))
                j = int(np.floor((x + meets * dx - columns.west) / columns.spacing))
                if 0 <= i < rows and 0 <= j < count:
                    landings.top[pulse, k] = i * count + j


@compiled
@no_type_check
def predict(views, echoes, landings, level, low, high):
    """Predict the profiles of some pulses."""
    pad = 2 * (len(echoes.response) // 2) + 1
    for pulse in range(low, high):
        begin, end = echoes.start[pulse], echoes.start[pulse + 1]
        hits = echoes.hits[begin + 2 * pad * pulse : end + 2 * pad * (pulse + 1)]
        hits[:] = 0.0
        for k in range(len(views.share)):
            cell = landings.cell[pulse, k]
            if cell == NOTHING:
                continue
            power = level[views.what[pulse, k]] * views.share[k] * landings.fall[pulse, k]
            beyond = landings.beyond[pulse, k]
            hits[cell] += power * (1 - beyond)
            hits[cell + 1] += power * beyond
        predict_cells(echoes, pulse, hits, np.int64(0), end - begin, echoes.mean[begin:end])


@compiled
@no_type_check
def shares(views, echoes, landings, level, found, expected, cell_found, cell_expected, by_cell, low, high):
    """Add up, of each part and its walls, by how much measured power exceeds the mean, and what was expected.

    Of the two sums, over the powers P that a reflectivity adds p to: p P / mean^2, and p / mean. The same by map cell
    if that is asked for.
    """
    half = len(echoes.response) // 2
    pad = 2 * half + 1
    for pulse in range(low, high):
        begin, end = echoes.start[pulse], echoes.start[pulse + 1]
        excess, inverse = np.zeros(end - begin + 2 * pad), np.zeros(end - begin + 2 * pad)
        usual_there, more_there = np.empty(end - begin), np.empty(end - begin)
        for cell in range(end - begin):
            usual_there[cell] = 1 / echoes.mean[begin + cell]
            more_there[cell] = min(echoes.power[begin + cell] * usual_there[cell], MAX_SPECKLE) * usual_there[cell]
        for tap in range(len(echoes.response)):
            weight, first = echoes.response[tap], 3 * half + 1 - tap
            for cell in range(end - begin):
                excess[cell + first] += weight * more_there[cell]
                inverse[cell + first] += weight * usual_there[cell]
        for k in range(len(views.share)):
            at = landings.cell[pulse, k]
            if at == NOTHING:
                continue
            what, beyond = views.what[pulse, k], landings.beyond[pulse, k]
            power = level[what] * views.share[k] * landings.fall[pulse, k]
            nearer, farther = power * (1 - beyond), power * beyond
            more = nearer * excess[at] + farther * excess[at + 1]
            usual = nearer * inverse[at] + farther * inverse[at + 1]
            found[what] += more
            expected[what] += usual
            top = landings.top[pulse, k]
            if by_cell and top != NOTHING:
                cell_found[top] += more
                cell_expected[top] += usual
