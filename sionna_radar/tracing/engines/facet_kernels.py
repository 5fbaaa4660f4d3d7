"""Which facets lie in beams, as machine code: spheres against the directions that count, and a tree of them."""

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from sionna_radar.foundation.compiled import compiled

# Nothing is taken as nearer to the radar than this.
NEAREST_M = 1e-9
# Facets that room is made for first.
LEAST_ROOM = 16384


@compiled
@no_type_check
def search(
    low: int,
    high: int,
    position_m: Float[ndarray, "pulse 3"],
    R_world_antenna: Float[ndarray, "pulse 3 3"],
    tree: tuple[Float[ndarray, "node 3"], Float[ndarray, " node"], Int[ndarray, " level"], int],
    facet: tuple[Float[ndarray, "facet 3"], Float[ndarray, " facet"], Float[ndarray, " facet"]],
    fineness: tuple[float, float, float],
    directions: tuple[Float[ndarray, " m"], Float[ndarray, " n"], float, Bool[ndarray, "2 cell"], int],
) -> tuple[Int[ndarray, " edge"], Int[ndarray, " found"], Bool[ndarray, " found"]]:
    """Return the facets in the beams of pulses from low to high, in their order.

    Parameters
    ----------
    low, high, position_m, R_world_antenna:
        Which pulses, and the poses of all.
    tree:
        Centres and radii of the spheres around groups, the lowest level first; how many facets and then groups there
        are on each level; and how many are in a group of the next.
    facet:
        Centroids, longest sides, and radii of the spheres around them.
    fineness:
        Longest side of a facet that is not divided: for each metre of distance, at the most, and at the least.
    directions:
        Those that count, see `Footprint`.

    Returns
    -------
    Where each pulse's begin; the facets; and which of them are too coarse, for which a corner in the beam is enough.

    """
    edges = np.zeros(high - low + 1, dtype=np.int64)
    found, coarse = np.empty(LEAST_ROOM, dtype=np.int64), np.empty(LEAST_ROOM, dtype=np.bool_)
    for n in range(high - low):
        apex_m, axes = position_m[low + n], R_world_antenna[low + n]
        count = _search_one(apex_m, axes, tree, facet, fineness, directions, edges[n], found, coarse)
        # Here and not where they are found: arrays that are replaced within a loop cost it half of its speed.
        while count > len(found):
            found, coarse = np.append(found, np.empty_like(found)), np.append(coarse, np.empty_like(coarse))
            count = _search_one(apex_m, axes, tree, facet, fineness, directions, edges[n], found, coarse)
        edges[n + 1] = count
    return edges, found[: edges[-1]], coarse[: edges[-1]]


@compiled
@no_type_check
def _search_one(
    apex_m: Float[ndarray, " 3"],
    R: Float[ndarray, "3 3"],
    tree: tuple[Float[ndarray, "node 3"], Float[ndarray, " node"], Int[ndarray, " level"], int],
    facet: tuple[Float[ndarray, "facet 3"], Float[ndarray, " facet"], Float[ndarray, " facet"]],
    fineness: tuple[float, float, float],
    directions: tuple[Float[ndarray, " m"], Float[ndarray, " n"], float, Bool[ndarray, "2 cell"], int],
    count: int,
    found: Int[ndarray, " room"],
    coarse: Bool[ndarray, " room"],
) -> int:
    """Write the facets in one beam behind those of others; return how many there are then, or one too many."""
    centre_m, group_radius_m, sizes, group = tree
    place_m, side_m, radius_m = facet
    per_metre, longest_m, finest_m = fineness
    # Not handed on as a tuple: its arrays would be counted at every call.
    azimuth, elevation, least_voltage, counts, cells = directions
    top, px, py, pz = len(sizes) - 1, apex_m[0], apex_m[1], apex_m[2]
    first = np.zeros(top + 2, dtype=np.int64)
    for level in range(1, top + 1):
        first[level + 1] = first[level] + sizes[level]
    room = group * (top + 1) + 1
    waiting, its_level = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.int64)
    for root in range(sizes[top]):
        depth = 1
        waiting[0], its_level[0] = root, top
        while depth > 0:
            depth -= 1
            node, level = waiting[depth], its_level[depth]
            if level > 0:
                at = first[level] + node
                ahead = _ahead(centre_m[at, 0] - px, centre_m[at, 1] - py, centre_m[at, 2] - pz, R)
                if _meets(ahead, group_radius_m[at], azimuth, elevation, least_voltage, counts, cells):
                    # The first is looked at first, so that facets come in their order.
                    for member in range(min((node + 1) * group, sizes[level - 1]) - 1, node * group - 1, -1):
                        waiting[depth], its_level[depth] = member, level - 1
                        depth += 1
                continue
            x, y, z = place_m[node, 0] - px, place_m[node, 1] - py, place_m[node, 2] - pz
            fine_m = max(min(per_metre * math.sqrt(x * x + y * y + z * z), longest_m), finest_m)
            divided = side_m[node] > fine_m
            reach_m = radius_m[node] if divided else 0.0
            if not _meets(_ahead(x, y, z, R), reach_m, azimuth, elevation, least_voltage, counts, cells):
                continue
            if count == len(found):
                return count + 1
            found[count], coarse[count] = node, divided
            count += 1
    return count


@compiled
@no_type_check
def all_that_meet(
    ahead_m: Float[ndarray, "sphere 3"],
    radius_m: Float[ndarray, " sphere"],
    directions: tuple[Float[ndarray, " m"], Float[ndarray, " n"], float, Bool[ndarray, "2 cell"], int],
) -> Bool[ndarray, " sphere"]:
    """Return which spheres reach into directions, given their centres in the antenna's frame."""
    azimuth, elevation, least_voltage, counts, cells = directions
    found = np.empty(len(ahead_m), dtype=np.bool_)
    for n in range(len(ahead_m)):
        ahead = ahead_m[n, 0], ahead_m[n, 1], ahead_m[n, 2]
        found[n] = _meets(ahead, radius_m[n], azimuth, elevation, least_voltage, counts, cells)
    return found


@compiled
@no_type_check
def _ahead(x: float, y: float, z: float, R: Float[ndarray, "3 3"]) -> tuple[float, float, float]:
    """Return a vector in the antenna's frame."""
    return (
        x * R[0, 0] + y * R[1, 0] + z * R[2, 0],
        x * R[0, 1] + y * R[1, 1] + z * R[2, 1],
        x * R[0, 2] + y * R[1, 2] + z * R[2, 2],
    )


@compiled
@no_type_check
def _meets(
    ahead_m: tuple[float, float, float],
    radius_m: float,
    azimuth: Float[ndarray, " m"],
    elevation: Float[ndarray, " n"],
    least_voltage: float,
    counts: Bool[ndarray, "2 cell"],
    cells: int,
) -> bool:
    """Return whether a sphere reaches into directions, given its centre in the antenna's frame."""
    x, left, up = ahead_m
    per_m = 1 / max(math.sqrt(x * x + left * left + up * up), NEAREST_M)
    x, left, up, sine = x * per_m, left * per_m, up * per_m, radius_m * per_m
    if sine >= 1:
        return True
    # The largest chord between a direction into the sphere and that to its centre.
    reach = math.sqrt(2 - 2 * math.sqrt(1 - sine * sine)) if sine > 0 else 0.0
    if cells == 0:
        # The envelopes at these direction cosines or beyond.
        across = azimuth[int(max(abs(left) - reach, 0.0) * (len(azimuth) - 1))]
        along = elevation[int(max(abs(up) - reach, 0.0) * (len(elevation) - 1))]
        return x > -reach and across * along >= least_voltage
    # The first level whose cells are no smaller than the reach: what is within it is next to the cell.
    start, size = 0, cells
    while size > 1 and reach * size > 2:
        start += size * size
        size //= 2
    row = min(max(int((up + 1) * (size / 2)), 0), size - 1)
    column = min(max(int((left + 1) * (size / 2)), 0), size - 1)
    cell = start + row * size + column
    return (x > -reach and counts[0, cell]) or (-x > -reach and counts[1, cell])
