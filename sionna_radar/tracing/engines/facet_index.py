"""Which facets lie in a beam: a tree of bounding spheres, searched with the beam's envelope."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import KDTree

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.tracing.engines.facet_mesh import Facets

# Two-way level down to which facets are included: side lobes of -20 dB, -40 dB both ways, count.
FOOTPRINT_DB = -50.0
GROUP = 64


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
    def of(antenna: Antenna, level_db: float = FOOTPRINT_DB) -> "Footprint":
        """Return the footprint of an antenna down to a two-way level over the peak."""
        cuts = _envelope(antenna.azimuth), _envelope(antenna.elevation)
        return Footprint(*cuts, least_voltage=10 ** (level_db / 40))

    def meets(
        self, ahead_m: Float[np.ndarray, "n 3"], radius_m: Float[np.ndarray, " n"] | float
    ) -> Bool[np.ndarray, " n"]:
        """Return which spheres reach into the footprint, given their centres in the antenna's frame."""
        x, left, up = ahead_m.T
        distance = np.maximum(np.sqrt(x * x + left * left + up * up), 1e-9)
        sine = np.minimum(radius_m / distance, 1.0)
        # Largest chord between a direction into the sphere and the direction to its centre.
        reach = np.sqrt(2 - 2 * np.sqrt(1 - sine * sine))
        voltage = _outside(self.azimuth, np.abs(left) / distance - reach)
        voltage *= _outside(self.elevation, np.abs(up) / distance - reach)
        inside = (voltage >= self.least_voltage) & (x / distance > -reach)
        return inside | (radius_m >= distance)


def _envelope(cut: Cut) -> Float[np.ndarray, " n"]:
    size = np.abs(cut.voltage)
    middle = len(size) // 2
    folded = np.maximum(size[middle:], size[: len(size) - middle][::-1])
    return np.maximum.accumulate(folded[::-1])[::-1] / folded.max()


def _outside(envelope: Float[np.ndarray, " m"], cosine: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    cell = (np.clip(cosine, 0.0, 1.0) * (len(envelope) - 1)).astype(np.int64)
    return envelope[cell]


class FacetIndex:
    """Bounding spheres of facets, of groups of them, of groups of groups, up to a handful at the top.

    The facets are in the order of a KD-tree's leaves, so neighbours in the table are neighbours in space.
    """

    def __init__(self, facets: Facets) -> None:
        tree = KDTree(facets.centre_m, leafsize=GROUP)
        self.facets = facets.rows(tree.indices)
        centre = self.facets.centre_m
        radius = np.sqrt(((self.facets.corner_m - centre[:, None]) ** 2).sum(axis=2).max(axis=1))
        self._centre, self._radius = [centre], [radius]
        low, high = self.facets.corner_m.min(axis=1), self.facets.corner_m.max(axis=1)
        while len(low) > GROUP:
            start = np.arange(0, len(low), GROUP)
            low, high = np.minimum.reduceat(low, start), np.maximum.reduceat(high, start)
            self._centre.append((low + high) / 2)
            self._radius.append(np.sqrt(((high - low) ** 2).sum(axis=1)) / 2)

    def search(
        self,
        footprint: Footprint,
        position_m: Float[np.ndarray, " 3"],
        R_world_antenna: Float[np.ndarray, "3 3"],
    ) -> Facets:
        """Return the facets whose spheres reach into the footprint of a pose."""
        place = np.arange(len(self._centre[-1]))
        for level in range(len(self._centre) - 1, -1, -1):
            ahead = (self._centre[level][place] - position_m) @ R_world_antenna
            place = place[footprint.meets(ahead, self._radius[level][place])]
            if level > 0:
                place = (place[:, None] * GROUP + np.arange(GROUP)).ravel()
                place = place[place < len(self._centre[level - 1])]
        return self.facets.rows(place)
