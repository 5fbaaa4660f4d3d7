"""Which facets lie in a beam: a tree of bounding spheres, searched with the beam's envelope."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import maximum_filter
from scipy.spatial import KDTree

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.tracing.engines.facet_mesh import Facets

# Two-way level down to which facets are included: side lobes of -20 dB, -40 dB both ways, count.
FOOTPRINT_DB = -50.0
GROUP, TOP = 16, 64
# Cells of direction cosines along an axis, in which the amplitude of a pattern is looked at.
LEAST_CELLS, MOST_CELLS = 256, 2048


@dataclass(frozen=True)
class Footprint:
    """The directions that count, as outer envelopes of the two cuts against the magnitude of the direction cosine.

    An envelope is the largest voltage at that distance from the axis or beyond, over the cut's peak, so it never
    rises outward: no side lobe beyond it is missed, and the nearest direction decides for a whole sphere.
    """

    azimuth: Float[np.ndarray, " m"]
    elevation: Float[np.ndarray, " n"]
    least_voltage: float

    @staticmethod
    def of(antenna: Antenna, level_db: float = FOOTPRINT_DB) -> "Footprint | TableFootprint":
        """Return the footprint of an antenna down to a two-way level over the peak."""
        if not antenna.separable:
            return TableFootprint.of(antenna, 10 ** (level_db / 40))
        cuts = _envelope(antenna.azimuth), _envelope(antenna.elevation)
        return Footprint(*cuts, least_voltage=10 ** (level_db / 40))

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Return which spheres reach into the footprint, given their centres in the antenna's frame."""
        x, left, up = ahead_m.T
        distance = np.maximum(np.sqrt(x * x + left * left + up * up), 1e-9)
        reach = _reach(radius_m, distance)
        voltage = _outside(self.azimuth, np.abs(left) / distance - reach)
        voltage *= _outside(self.elevation, np.abs(up) / distance - reach)
        inside = (voltage >= self.least_voltage) & (x / distance > -reach)
        return inside | (radius_m >= distance)


@dataclass(frozen=True)
class TableFootprint:
    """The directions that count of an antenna of any pattern, on cells of direction cosines, ahead and behind.

    levels: ahead and behind, whether the amplitude reaches the least one in a cell or next to it; each level halves
        the number of cells along both axes of the one before, down to one.
    """

    levels: tuple[tuple[Bool[np.ndarray, "_ _"], ...], tuple[Bool[np.ndarray, "_ _"], ...]]

    @staticmethod
    def of(antenna: Antenna, least_voltage: float) -> "TableFootprint":
        """Return the directions toward which the amplitude over the peak's reaches a level."""
        cells = 2 ** int(np.ceil(np.log2(np.clip(2 / antenna.step_rad, LEAST_CELLS, MOST_CELLS))))
        place = (np.arange(cells) + 0.5) * (2 / cells) - 1
        halves = []
        for side in (1.0, -1.0):
            counts = np.zeros((cells, cells), dtype=bool)
            for row, up in enumerate(place):
                inside = np.flatnonzero(place**2 + up**2 < 1)
                ahead = side * np.sqrt(1 - place[inside] ** 2 - up**2)
                direction = np.column_stack([ahead, place[inside], np.full(len(inside), up)])
                counts[row, inside] = np.sqrt(antenna.gain(direction) / antenna.peak_gain) >= least_voltage
            halves.append(_pyramid(counts))
        return TableFootprint((halves[0], halves[1]))

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Return which spheres reach into the footprint, given their centres in the antenna's frame."""
        distance = np.maximum(np.linalg.norm(ahead_m, axis=1), 1e-9)
        x, left, up = (ahead_m / distance[:, None]).T
        reach = _reach(radius_m, distance)
        found: Bool[np.ndarray, " n"] = np.zeros(len(distance), dtype=bool)
        found[np.asarray(distance <= radius_m)] = True
        for side, levels in zip((x, -x), self.levels, strict=True):
            cells = len(levels[0])
            # The first level whose cells are no smaller than the reach: what is within it is next to the cell.
            level = np.ceil(np.log2(np.maximum(reach * cells / 2, 1.0))).astype(np.int64)
            for number, counts in enumerate(levels):
                own = np.flatnonzero((np.minimum(level, len(levels) - 1) == number) & (side > -reach))
                row, column = (
                    np.clip(((c[own] + 1) * (len(counts) / 2)).astype(np.int64), 0, len(counts) - 1) for c in (up, left)
                )
                found[own] |= counts[row, column]
        return found


def _pyramid(counts: Bool[np.ndarray, "_ _"]) -> tuple[Bool[np.ndarray, "_ _"], ...]:
    """Return cells and their neighbours, then pairs of them along both axes and their neighbours, and so on."""
    levels = [maximum_filter(counts, size=3, mode="constant")]
    while len(counts) > 1:
        counts = np.asarray(counts.reshape(len(counts) // 2, 2, -1, 2).any(axis=(1, 3)))
        levels.append(maximum_filter(counts, size=3, mode="constant"))
    return tuple(levels)


def _reach(radius_m: Float[np.ndarray, " n"] | float, distance_m: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the largest chord between a direction into each sphere and the direction to its centre."""
    if not np.any(radius_m):
        return np.zeros(len(distance_m))
    sine = np.minimum(radius_m / distance_m, 1.0)
    reach: Float[np.ndarray, " n"] = np.sqrt(2 - 2 * np.sqrt(1 - sine * sine))
    return reach


def _envelope(cut: Cut) -> Float[np.ndarray, " n"]:
    size = np.abs(cut.voltage)
    middle = len(size) // 2
    folded = np.maximum(size[middle:], size[: len(size) - middle][::-1])
    return np.maximum.accumulate(folded[::-1])[::-1] / folded.max()


def _outside(envelope: Float[np.ndarray, " m"], cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    cell = (np.maximum(cosine, 0.0) * (len(envelope) - 1)).astype(np.int64)
    return envelope[cell]


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
        self._centre, self._radius = [], []
        low, high = self.facets.corner_m.min(axis=1), self.facets.corner_m.max(axis=1)
        while len(low) > TOP:
            start = np.arange(0, len(low), GROUP)
            low, high = np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)
            self._centre.append((low + high) / 2)
            self._radius.append(np.sqrt(((high - low) ** 2).sum(axis=1)) / 2)

    def search(
        self,
        footprint: Footprint | TableFootprint,
        position_m: Float[np.ndarray, " 3"],
        R_world_antenna: Float[np.ndarray, "3 3"],
    ) -> Int[np.ndarray, " facet"]:
        """Return the facets of the groups whose spheres reach into the footprint of a pose."""
        sizes = [len(self.facets), *(len(centre) for centre in self._centre)]
        place = np.arange(sizes[-1])
        for level in range(len(self._centre) - 1, -1, -1):
            ahead = (self._centre[level][place] - position_m) @ R_world_antenna
            place = place[footprint.meets(ahead, self._radius[level][place])]
            place = (place[:, None] * GROUP + np.arange(GROUP)).ravel()
            place = place[place < sizes[level]]
        return place
