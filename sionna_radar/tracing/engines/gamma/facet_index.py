"""Search for the facets inside a beam: a tree of bounding spheres against the beam's envelope."""

import math
from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.compiled import compiled
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.tracing.engines.gamma.facet_mesh import Facets

# Two-way level down to which facets are included: side lobes of -20 dB, -40 dB both ways, count.
FOOTPRINT_DB = -50.0
GROUP, TOP = 16, 64
# Facets are divided no finer.
FINEST_M = 1e-3
# Cells of direction cosines along an axis, in which the amplitude of a pattern is looked at.
MIN_CELLS, MAX_CELLS = 256, 2048


@dataclass(frozen=True)
class Footprint:
    """The directions that count.

    Of an antenna whose pattern is the product of two cuts, by their outer envelopes against the magnitude of the
    direction cosine: the largest voltage at that distance from the axis or beyond, over the cut's peak. It never rises
    outward: no side lobe beyond it is missed, and the nearest direction decides for a whole sphere. Of any other, by
    cells of direction cosines.

    azimuth, elevation: the envelopes of the cuts; empty for other antennas.
    least_voltage: what their product must reach.
    counts: ahead and behind, whether the amplitude reaches the least one in a cell or next to it. `cells` rows of as
        many columns, by the cosines up and to the left, are followed by levels of half as many along both axes, down to
        one; none for the product of two cuts.
    """

    azimuth: Float[np.ndarray, " m"]
    elevation: Float[np.ndarray, " n"]
    least_voltage: float
    counts: Bool[np.ndarray, "2 cell"]
    cells: int

    @staticmethod
    def of(antenna: Antenna, level_db: float = FOOTPRINT_DB) -> "Footprint":
        """Return the footprint of an antenna down to a two-way level over the peak."""
        least_voltage = 10 ** (level_db / 40)
        if antenna.separable:
            cuts = _envelope(antenna.azimuth), _envelope(antenna.elevation)
            return Footprint(*cuts, least_voltage, counts=np.zeros((2, 0), dtype=bool), cells=0)
        cells = 2 ** int(np.ceil(np.log2(np.clip(2 / antenna.step_rad, MIN_CELLS, MAX_CELLS))))
        counts = np.stack([_pyramid(_reached(antenna, least_voltage, cells, side)) for side in (1.0, -1.0)])
        return Footprint(np.zeros(0), np.zeros(0), least_voltage, counts, cells)

    @property
    def directions(self) -> tuple[object, ...]:
        """The footprint as arguments of compiled code."""
        return self.azimuth, self.elevation, self.least_voltage, self.counts, self.cells

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Return True where spheres reach into the footprint, given their centres in the antenna's frame."""
        radius = np.ascontiguousarray(np.broadcast_to(np.asarray(radius_m, dtype=np.float64), len(ahead_m)))
        return all_that_meet(np.ascontiguousarray(ahead_m), radius, self.directions)


def _reached(antenna: Antenna, least_voltage: float, cells: int, side: float) -> Bool[np.ndarray, "_ _"]:
    """Return True where cells of direction cosines, ahead (1) or behind (-1), have enough amplitude over the peak's."""
    place = (np.arange(cells) + 0.5) * (2 / cells) - 1
    reached = np.zeros((cells, cells), dtype=bool)
    for row, up in enumerate(place):
        inside = np.flatnonzero(place**2 + up**2 < 1)
        ahead = side * np.sqrt(1 - place[inside] ** 2 - up**2)
        direction = np.column_stack([ahead, place[inside], np.full(len(inside), up)])
        reached[row, inside] = np.sqrt(antenna.gain(direction) / antenna.peak_gain) >= least_voltage
    return reached


def _pyramid(reached: Bool[np.ndarray, "_ _"]) -> Bool[np.ndarray, " cell"]:
    """Return cells and their neighbours, then pairs of them along both axes and their neighbours, and so on."""
    levels = [maximum_filter(reached, size=3, mode="constant")]
    while len(reached) > 1:
        reached = np.asarray(reached.reshape(len(reached) // 2, 2, -1, 2).any(axis=(1, 3)))
        levels.append(maximum_filter(reached, size=3, mode="constant"))
    return np.concatenate([level.ravel() for level in levels])


def _envelope(cut: Cut) -> Float[np.ndarray, " n"]:
    size = np.abs(cut.voltage)
    middle = len(size) // 2
    folded = np.maximum(size[middle:], size[: len(size) - middle][::-1])
    return np.maximum.accumulate(folded[::-1])[::-1] / folded.max()


@dataclass(frozen=True, kw_only=True)
class Fineness:
    """How long the sides of facets may be, m: for each metre of distance, and at the most.

    Raised to `FINEST_M` where it is less.
    """

    per_metre: float
    longest_m: float

    def subdivisions(
        self, side_m: Float[np.ndarray, " facet"], distance_m: Float[np.ndarray, " facet"]
    ) -> Int[np.ndarray, " facet"]:
        """Return the number of parts of each facet's sides, from its longest side and its distance."""
        longest = np.minimum(self.per_metre * distance_m, self.longest_m)
        return np.ceil(side_m / np.maximum(longest, FINEST_M)).astype(np.int64)


class FacetIndex:
    """Bounding spheres of facets, of groups of them, of groups of groups, up to a handful at the top.

    The facets are in the order of a KD-tree's leaves, so neighbours in the table are neighbours in space. What is asked
    of each for every pulse is kept: its scatterer, its longest side and the radius of its sphere.
    """

    def __init__(self, facets: Facets) -> None:
        tree = KDTree(facets.centre_m, leafsize=GROUP)
        self.facets = facets.rows(tree.indices)
        self.scatterers = self.facets.scatterers
        self.side_m = np.sqrt(self.facets.squared_side_m2.max(axis=1))
        from_centre = self.facets.corner_m - self.scatterers.place_m[:, None]
        self.radius_m = np.sqrt((from_centre**2).sum(axis=2).max(axis=1))
        low, high = self.facets.corner_m.min(axis=1), self.facets.corner_m.max(axis=1)
        centre, radius, sizes = [np.zeros((0, 3))], [np.zeros(0)], [len(low)]
        while len(low) > TOP:
            start = np.arange(0, len(low), GROUP)
            low, high = np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)
            centre.append((low + high) / 2)
            radius.append(np.sqrt(((high - low) ** 2).sum(axis=1)) / 2)
            sizes.append(len(low))
        self._tree = np.concatenate(centre), np.concatenate(radius), np.array(sizes), GROUP

    def search(
        self, footprint: Footprint, fineness: Fineness, pose: Pose, low: int, high: int
    ) -> tuple[Int[np.ndarray, " found"], Int[np.ndarray, " found"], Bool[np.ndarray, " found"]]:
        """Return the facets in the footprints of some poses, of those too coarse all that reach into them.

        low, high: the first pose that is searched, and the last plus one.

        Returned are the row of the pose, the facet, and whether it is too coarse; by pose, in the order of the table.
        """
        edges, place, coarse = search(
            low,
            high,
            np.ascontiguousarray(pose.position_m),
            np.ascontiguousarray(pose.R_world_antenna),
            self._tree,
            (self.scatterers.place_m, self.side_m, self.radius_m),
            (fineness.per_metre, fineness.longest_m, FINEST_M),
            footprint.directions,
        )
        return np.repeat(np.arange(low, high), np.diff(edges)), place, coarse


# Nothing is taken as nearer to the radar than this.
NEAREST_M = 1e-9
# Facets that room is made for first.
MIN_ROOM = 16384


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

    tree: centres and radii of the spheres around groups, the lowest level first; how many facets and then groups there
    are on each level; and how many are in a group of the next.
    facet: centroids, longest sides, and radii of the spheres around them.
    fineness: longest side of a facet that is not divided: for each metre of distance, at the most, and at the least.
    directions: those that count, see `Footprint`.

    Returned are where each pulse's begin; the facets; and which of them are too coarse, for which a corner in the beam
    is enough.
    """
    edges = np.zeros(high - low + 1, dtype=np.int64)
    facets, coarse = np.empty(MIN_ROOM, dtype=np.int64), np.empty(MIN_ROOM, dtype=np.bool_)
    for n in range(high - low):
        apex_m, axes = position_m[low + n], R_world_antenna[low + n]
        count = _search_one(apex_m, axes, tree, facet, fineness, directions, edges[n], facets, coarse)
        # Here and not where they are found: arrays that are replaced within a loop cost it half of its speed.
        while count > len(facets):
            facets, coarse = np.append(facets, np.empty_like(facets)), np.append(coarse, np.empty_like(coarse))
            count = _search_one(apex_m, axes, tree, facet, fineness, directions, edges[n], facets, coarse)
        edges[n + 1] = count
    return edges, facets[: edges[-1]], coarse[: edges[-1]]


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
    listed: Int[ndarray, " room"],
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
            if count == len(listed):
                return count + 1
            listed[count], coarse[count] = node, divided
            count += 1
    return count


@compiled
@no_type_check
def all_that_meet(
    ahead_m: Float[ndarray, "sphere 3"],
    radius_m: Float[ndarray, " sphere"],
    directions: tuple[Float[ndarray, " m"], Float[ndarray, " n"], float, Bool[ndarray, "2 cell"], int],
) -> Bool[ndarray, " sphere"]:
    """Return True where spheres reach into directions, given their centres in the antenna's frame."""
    azimuth, elevation, least_voltage, counts, cells = directions
    meets = np.empty(len(ahead_m), dtype=np.bool_)
    for n in range(len(ahead_m)):
        ahead = ahead_m[n, 0], ahead_m[n, 1], ahead_m[n, 2]
        meets[n] = _meets(ahead, radius_m[n], azimuth, elevation, least_voltage, counts, cells)
    return meets


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
    """Return True if a sphere reaches into directions, given its centre in the antenna's frame."""
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
