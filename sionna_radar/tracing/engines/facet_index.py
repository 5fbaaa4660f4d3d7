"""Which facets lie in a beam: a tree of bounding spheres, searched with the beam's envelope."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree

from sionna_radar.flight.pulses import Pose
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.tracing.engines.facet_mesh import Facets

# Two-way level down to which facets are included: side lobes of -20 dB, -40 dB both ways, count.
FOOTPRINT_DB = -50.0
GROUP, TOP = 16, 64
# Facets are divided no finer.
FINEST_M = 1e-3
# Cells of direction cosines along an axis, in which the amplitude of a pattern is looked at.
LEAST_CELLS, MOST_CELLS = 256, 2048


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
        cells = 2 ** int(np.ceil(np.log2(np.clip(2 / antenna.step_rad, LEAST_CELLS, MOST_CELLS))))
        counts = np.stack([_pyramid(_reached(antenna, least_voltage, cells, side)) for side in (1.0, -1.0)])
        return Footprint(np.zeros(0), np.zeros(0), least_voltage, counts, cells)

    @property
    def directions(self) -> tuple[object, ...]:
        """What the machine code is told of it."""
        return self.azimuth, self.elevation, self.least_voltage, self.counts, self.cells

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Return which spheres reach into the footprint, given their centres in the antenna's frame."""
        # Numba takes half a second to import.
        from sionna_radar.tracing.engines.facet_kernels import all_that_meet

        radius = np.ascontiguousarray(np.broadcast_to(np.asarray(radius_m, dtype=np.float64), len(ahead_m)))
        found: Bool[np.ndarray, " n"] = all_that_meet(np.ascontiguousarray(ahead_m), radius, self.directions)
        return found


def _reached(antenna: Antenna, least_voltage: float, cells: int, side: float) -> Bool[np.ndarray, "_ _"]:
    """Return in which cells of direction cosines, ahead (1) or behind (-1), the amplitude over the peak's is enough."""
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

    def parts(
        self, side_m: Float[np.ndarray, " facet"], distance_m: Float[np.ndarray, " facet"]
    ) -> Int[np.ndarray, " facet"]:
        """Return into how many parts the sides of facets are cut, by the longest and the distance of each."""
        longest = np.minimum(self.per_metre * distance_m, self.longest_m)
        parts: Int[np.ndarray, " facet"] = np.ceil(side_m / np.maximum(longest, FINEST_M)).astype(np.int64)
        return parts


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

        Parameters
        ----------
        footprint, fineness:
            The directions that count, and which facets are too coarse.
        pose, low, high:
            Poses, the first of them that is searched, and the last plus one.

        Returns
        -------
        The row of the pose, the facet, and whether it is too coarse; by pose, and in the order of the table.

        """
        # Numba takes half a second to import.
        from sionna_radar.tracing.engines.facet_kernels import search

        edges, place, coarse = search(
            low,
            high,
            pose.position_m,
            np.ascontiguousarray(pose.R_world_antenna),
            self._tree,
            (self.scatterers.place_m, self.side_m, self.radius_m),
            (fineness.per_metre, fineness.longest_m, FINEST_M),
            footprint.directions,
        )
        return np.repeat(np.arange(low, high), np.diff(edges)), place, coarse
