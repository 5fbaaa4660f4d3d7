"""The mean echo of a body with vertical walls, and of what is behind it, as machine code; see `outlines`."""

from typing import no_type_check

import numpy as np

from sionna_radar.elevation.ray_march import first_hit
from sionna_radar.foundation.compiled import compiled

BEHIND, TOP, WALL = 0, 1, 2


@compiled
@no_type_check
def ranges_behind(
    height, west, south, spacing, steepest, highest, position, R_world_antenna, direction, reach, range_m, low, high
):
    """Write the ranges at which the samples of the pulses from `low` to `high` meet a surface, or infinity."""
    ray = np.empty(3)
    for pulse in range(low, high):
        for k in range(len(direction)):
            for i in range(3):
                ray[i] = 0.0
                for j in range(3):
                    ray[i] += R_world_antenna[pulse, i, j] * direction[k, j]
            hit = first_hit(height, west, south, spacing, position[pulse], ray, reach, steepest, highest)
            range_m[pulse, k] = np.inf if np.isnan(hit) else hit


@compiled
@no_type_check
def _meets(corner, box, top, east, north, up, dx, dy, dz, farthest):
    """Return the range at which a ray from a point meets the body, infinite if it does not, and where: TOP or WALL.

    box: bounds of the corners, west, east, south and north; farthest: range beyond which the body does not matter.
    """
    falling = dz - top[1] * dx - top[2] * dy
    if falling >= 0.0:
        return np.inf, TOP
    onto = (top[0] + top[1] * east + top[2] * north - up) / falling
    if onto <= 0.0:
        return np.inf, TOP
    x, y = east + onto * dx, north + onto * dy
    if onto >= farthest or max(x, east + farthest * dx) < box[0] or min(x, east + farthest * dx) > box[1]:
        return np.inf, TOP
    if max(y, north + farthest * dy) < box[2] or min(y, north + farthest * dy) > box[3]:
        return np.inf, TOP
    inside, nearest = False, np.inf
    count = len(corner)
    for k in range(count):
        ax, ay = corner[k, 0], corner[k, 1]
        bx, by = corner[(k + 1) % count, 0], corner[(k + 1) % count, 1]
        if (ay > y) != (by > y) and x < ax + (y - ay) / (by - ay) * (bx - ax):
            inside = not inside
        # Behind the plane of the top, the ray meets the first wall on its way.
        across = dx * (by - ay) - dy * (bx - ax)
        if across != 0.0:
            along = ((ax - east) * (by - ay) - (ay - north) * (bx - ax)) / across
            share = ((ax - east) * dy - (ay - north) * dx) / across
            if onto < along < nearest and 0.0 <= share <= 1.0:
                nearest = along
    if inside:
        return onto, TOP
    return nearest, WALL


@compiled
@no_type_check
def components(
    corner, top, pulses, behind, position, velocity, R_world_antenna, direction, share, doppler, unit_m, cell_m, first,
    start, response, into, result,
):  # fmt: skip
    """Write the mean profiles, at unit reflectivity, of what is behind the body, of its top and of its walls.

    pulses, behind: some pulses, and the ranges of their samples without the body; into: where in `result`, of shape
    (3, value), the profile of each of them begins.
    """
    half = len(response) // 2
    pad = 2 * half + 1
    box = np.array([np.inf, -np.inf, np.inf, -np.inf])
    for k in range(len(corner)):
        box[0], box[1] = min(box[0], corner[k, 0]), max(box[1], corner[k, 0])
        box[2], box[3] = min(box[2], corner[k, 1]), max(box[3], corner[k, 1])
    for number in range(len(pulses)):
        pulse = pulses[number]
        cells, R = start[pulse + 1] - start[pulse], R_world_antenna[pulse]
        hit = np.zeros((3, cells + 2 * pad))
        for k in range(len(share)):
            dx = R[0, 0] * direction[k, 0] + R[0, 1] * direction[k, 1] + R[0, 2] * direction[k, 2]
            dy = R[1, 0] * direction[k, 0] + R[1, 1] * direction[k, 1] + R[1, 2] * direction[k, 2]
            dz = R[2, 0] * direction[k, 0] + R[2, 1] * direction[k, 1] + R[2, 2] * direction[k, 2]
            away, what = _meets(
                corner, box, top, position[pulse, 0], position[pulse, 1], position[pulse, 2], dx, dy, dz,
                behind[number, k],
            )  # fmt: skip
            if behind[number, k] < away:
                away, what = behind[number, k], BEHIND
            if away == np.inf:
                continue
            rate = velocity[pulse, 0] * dx + velocity[pulse, 1] * dy + velocity[pulse, 2] * dz
            place = (away - doppler * rate) / cell_m - first[pulse]
            if not -half < place < cells - 1 + half:
                continue
            below = int(np.floor(place))
            power = share[k] * (unit_m / away) ** 2
            hit[what, below + pad] += power * (1 - (place - below))
            hit[what, below + pad + 1] += power * (place - below)
        for what in range(3):
            for c in range(cells):
                total = 0.0
                for tap in range(len(response)):
                    total += response[tap] * hit[what, c + pad + half - tap]
                result[what, into[number] + c] = total
