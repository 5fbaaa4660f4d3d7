"""Discretised main lobe of the antenna for mapping: directions and two-way power of beam samples.

The samples form a low-discrepancy set rather than a lattice, so that few of them cross an edge at once.
"""

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.interpolate import RegularGridInterpolator
from scipy.sparse import csr_matrix

from sionna_radar.radar.antenna import FOLLOWED, Antenna, Cut, lobe_samples
from sionna_radar.radar.two_way_grid import toward

# Rays along which the range is computed, in azimuth and elevation, and the finer samples of power between two rays:
# more in elevation, along which the range of level ground changes.
NODES = 12, 16
SAMPLES_PER_STEP = 2, 8

Lattice = tuple[Int[np.ndarray, " u"], Float[np.ndarray, " u"], Int[np.ndarray, " v"], Float[np.ndarray, " v"]]


@dataclass(frozen=True)
class BeamNodes:
    """Directions of the main lobe on a coarse grid for ray casting, and on a fine one for power.

    direction: unit vectors of the nodes in the antenna's frame.
    power: two-way power of the fine samples, summing to one.
    azimuth, elevation: direction cosines of the fine samples, azimuth the slower in `power`.
    between: interpolates values at the nodes to the samples, bilinear in the direction cosines.
    """

    direction: Float[np.ndarray, "node 3"]
    power: Float[np.ndarray, " sample"]
    azimuth: Float[np.ndarray, " u"]
    elevation: Float[np.ndarray, " v"]
    between: csr_matrix

    @cached_property
    def corner(self) -> Int[np.ndarray, "sample 4"]:
        """The four nodes around each fine sample."""
        return self.between.indices.reshape(-1, 4).astype(np.int64)

    @cached_property
    def weight(self) -> Float[np.ndarray, "sample 4"]:
        """Weights of the four nodes around each fine sample, of `between`."""
        return self.between.data.reshape(-1, 4)

    @cached_property
    def lattice(self) -> "Lattice":
        """The fine samples along azimuth and elevation: the node below each, and how far it is toward the next."""
        return *_between(len(self.azimuth), SAMPLES_PER_STEP[0]), *_between(len(self.elevation), SAMPLES_PER_STEP[1])

    @cached_property
    def spread(self) -> tuple[float, float]:
        """Standard deviations of the two-way power over the direction cosines in azimuth and in elevation."""
        power = self.power.reshape(len(self.azimuth), len(self.elevation))
        return _spread(self.azimuth, power.sum(axis=1)), _spread(self.elevation, power.sum(axis=0))

    @property
    def corners(self) -> Int[np.ndarray, "4"]:
        """Nodes at the corners of the main lobe."""
        last = NODES[1] - 1
        return np.array([0, last, -last - 1, -1])

    def two_way(self, direction: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "..."]:
        """Return the two-way gain over the axis' along unit vectors in the antenna's frame; 0 outside the main lobe."""
        gain: Float[np.ndarray, ...] = self._two_way(direction[..., 1:])
        return np.where(direction[..., 0] > 0, gain, 0.0)

    @property
    def gain(self) -> Float[np.ndarray, "azimuth elevation"]:
        """Two-way gain of the nodes over that of the strongest."""
        return (self.power / self.power.max()).reshape(len(self.azimuth), len(self.elevation))

    @cached_property
    def _two_way(self) -> RegularGridInterpolator:
        return RegularGridInterpolator((self.azimuth, self.elevation), self.gain, bounds_error=False, fill_value=0.0)


def beam_nodes(antenna: Antenna) -> BeamNodes:
    """Return the nodes of an antenna's main lobe: finer in elevation, along which the range changes."""
    u, fine_u, power_u = _axis(antenna.azimuth, NODES[0], SAMPLES_PER_STEP[0])
    v, fine_v, power_v = _axis(antenna.elevation, NODES[1], SAMPLES_PER_STEP[1])
    U, V = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    fine_beyond = np.add.outer(fine_u**2, fine_v**2) >= 1
    power = np.outer(power_u, power_v) if antenna.separable else _power_on(antenna, fine_u, fine_v)
    power = np.where(fine_beyond, 0.0, power).ravel()
    return BeamNodes(
        direction=_directions(U, V),
        power=power / power.sum(),
        azimuth=fine_u,
        elevation=fine_v,
        between=_interpolation(),
    )


def _spread(cosine: Float[np.ndarray, " n"], power: Float[np.ndarray, " n"]) -> float:
    mean = power @ cosine / power.sum()
    return float(np.sqrt(power @ (cosine - mean) ** 2 / power.sum()))


def _power_on(antenna: Antenna, u: Float[np.ndarray, " u"], v: Float[np.ndarray, " v"]) -> Float[np.ndarray, "u v"]:
    """Return the two-way power of an antenna of any pattern at direction cosines."""
    U, V = (grid.ravel() for grid in np.meshgrid(u, v, indexing="ij"))
    power: Float[np.ndarray, " n"] = antenna.gain(_directions(U, V)) ** 2
    return power.reshape(len(u), len(v))


def _directions(u: Float[np.ndarray, " node"], v: Float[np.ndarray, " node"]) -> Float[np.ndarray, "node 3"]:
    """Return unit vectors of direction cosines; invalid ones, in the corners of a wide beam, are set abeam."""
    direction = toward(u, v)
    beyond = u**2 + v**2 > 1
    direction[beyond] /= np.linalg.norm(direction[beyond], axis=1, keepdims=True)
    return direction


def _axis(
    cut: Cut, nodes: int, samples: int
) -> tuple[
    Float[np.ndarray, " node"],
    Float[np.ndarray, " sample"],
    Float[np.ndarray, " sample"],
]:
    """Return the nodes of one cut, its samples, and their two-way power."""
    lobe = lobe_samples(cut, FOLLOWED)
    low, high = cut.cosine[max(lobe.start - 1, 0)], cut.cosine[min(lobe.stop, len(cut.cosine) - 1)]
    count = (nodes - 1) * samples
    below, fraction = _between(count, samples)
    cosine = low + (below + fraction) / (nodes - 1) * (high - low)
    return np.linspace(low, high, nodes), cosine, cut.at(cosine) ** 4


@cache
def _interpolation() -> csr_matrix:
    """Return the interpolation from the nodes to the samples, which is the same for all antennas."""
    azimuth, elevation = (_along(*axis) for axis in zip(NODES, SAMPLES_PER_STEP, strict=True))
    return csr_matrix(np.kron(azimuth, elevation))


def _along(nodes: int, samples: int) -> Float[np.ndarray, "sample node"]:
    count = (nodes - 1) * samples
    below, fraction = _between(count, samples)
    between = np.zeros((count, nodes))
    between[np.arange(count), below] = 1 - fraction
    between[np.arange(count), below + 1] = fraction
    return between


def _between(count: int, samples: int) -> tuple[Int[np.ndarray, " sample"], Float[np.ndarray, " sample"]]:
    """Return the node below each fine sample of an axis, and how far the sample is toward the next."""
    place = (np.arange(count) + 0.5) / samples
    below = np.floor(place).astype(np.int64)
    return below, place - below


MIN_GAIN = 3e-3


def beam_samples(beam: BeamNodes, count: int) -> tuple[Float[np.ndarray, "sample 3"], Float[np.ndarray, " sample"]]:
    """Return directions across the main lobe in the antenna frame, and the fraction of the power around each.

    beam: the antenna's main lobe.
    count: of samples in the rectangle of direction cosines around it, of which those too weak to matter are left out.
    """
    # The sequence of Roberts (2018): fractional parts of multiples of powers of the plastic number's inverse.
    even = (np.arange(1, count + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    u = beam.azimuth[0] + even[:, 0] * np.ptp(beam.azimuth)
    v = beam.elevation[0] + even[:, 1] * np.ptp(beam.elevation)
    direction = toward(u, v)
    gain = beam.two_way(direction)
    seen = gain > MIN_GAIN
    return direction[seen], gain[seen] / gain.sum()
