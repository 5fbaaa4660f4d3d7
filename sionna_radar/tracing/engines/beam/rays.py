"""Importance sampling of ray directions inside a beam, on the device.

A few hundred rays represent the whole echo. Most rays are drawn in proportion to the two-way power of the beam, a small
share uniformly over the half sphere in front of the antenna, for the side lobes. Within a pulse the rays form a
low-discrepancy set (Halton), shifted at random in each pulse (Cranley and Patterson 1976), which leaves every single
ray random and makes the pulse's total power far less noisy than independent rays would.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.sequences import halton
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.two_way_grid import TwoWayGrid
from sionna_radar.tracing.sionna.material import mi

# isort: split
# Loads libLLVM, which an import above has selected.
import drjit as dr

QUANTILES = 4096


@dataclass(frozen=True, kw_only=True)
class BeamSampler:
    """The rays of one pulse before its random shift.

    unit: low-discrepancy points of the unit square, one per ray; the first `beam_rays` follow the beam.
    """

    unit: Float[np.ndarray, "ray 2"]
    beam_rays: int

    @property
    def rays(self) -> int:
        """Rays per pulse."""
        return len(self.unit)

    @property
    def beam_fraction(self) -> float:
        """Share of the rays that follow the beam."""
        return self.beam_rays / self.rays


def beam_sampler(rays: int, side_lobe_share: float) -> BeamSampler:
    """Return the sampler of a number of rays; at least one goes to the side lobes."""
    wide_rays = max(1, round(rays * side_lobe_share))
    beam_rays = rays - wide_rays
    return BeamSampler(unit=np.concatenate([halton(beam_rays), halton(wide_rays)]), beam_rays=beam_rays)


def quantiles_of(cut: Cut, *, one_way: bool = False) -> Float[np.ndarray, " quantile"]:
    """Return the direction cosines of a cut at equally spaced probabilities of its two-way or one-way power.

    Between two of them the density is constant, and the weights of the rays use that density.
    """
    distribution = cut.one_way_distribution if one_way else cut.two_way_distribution
    rising = np.concatenate([[True], np.diff(distribution) > 0])
    quantiles = np.interp(np.linspace(0, 1, QUANTILES + 1), distribution[rising], cut.cosine[rising])
    quantiles[[0, -1]] = -1.0, 1.0
    return quantiles


def beam_rays(antenna: Antenna) -> "CutRays | GridRays":
    """Return the rays of an antenna."""
    return CutRays(antenna) if antenna.separable else GridRays(antenna.two_way)


def wide_beam_rays(antenna: Antenna) -> "CutRays | GridRays":
    """Return rays that sample the skirts of the beam as well, which decide derivatives by the shape of the beam.

    Rays by the one-way power: for a Gaussian beam their weights, and those times any power of the angle, are bounded.
    An antenna that is no product of two cuts keeps its rays.
    """
    return CutRays(antenna, one_way=True) if antenna.separable else GridRays(antenna.two_way)


class CutRays:
    """Rays of a separable antenna, each cosine by the quantiles of its cut; the others fill the half sphere ahead."""

    def __init__(self, antenna: Antenna, *, one_way: bool = False) -> None:
        cuts = [quantiles_of(cut, one_way=one_way) for cut in (antenna.azimuth, antenna.elevation)]
        self._quantiles = [mi.Float(q.astype(np.float32)) for q in cuts]

    def shoot(self, unit: Any, in_beam: Any, beam_fraction: float) -> tuple[Any, Any, Any]:
        """Return directions (ahead, left, up), densities per steradian, and which are valid.

        unit: two columns of points in the unit square; in_beam: which rays follow the beam; the others are spread
        evenly. beam_fraction: share of the former.
        """
        wide = mi.warp.square_to_uniform_hemisphere(mi.Point2f(*unit))
        cosines = [
            dr.select(in_beam, _quantile(q, t), w)
            for q, t, w in zip(self._quantiles, unit, (wide.x, wide.y), strict=True)
        ]
        u, v = cosines
        cos = dr.safe_sqrt(1 - u * u - v * v)
        beam = cos * _density(self._quantiles[0], u) * _density(self._quantiles[1], v)
        density = beam_fraction * beam + (1 - beam_fraction) / (2 * dr.pi)
        # Quantiles of the two cuts can combine to invalid direction cosines; such a ray carries no power.
        return (cos, u, v), density, u * u + v * v < 1


class GridRays:
    """Rays of any antenna: a row of cells by its power, a cell in the row, a place in the cell; others all around."""

    def __init__(self, grid: TwoWayGrid) -> None:
        power = grid.power_sr / grid.power_sr.sum()
        self._rows, self._columns = power.shape
        self._left, self._up = (mi.Float(edges.astype(np.float32)) for edges in (grid.left, grid.up))
        row = power.sum(axis=1)
        inside = np.cumsum(power, axis=1) / np.maximum(row, 1e-300)[:, None]
        inside[row == 0] = np.linspace(0, 1, self._columns + 1)[1:]
        self._row_below = mi.Float(np.concatenate([[0.0], np.cumsum(row)]).astype(np.float32))
        # Each row begins with its zero, so that a cell's bounds are neighbours.
        self._below = mi.Float(np.pad(inside, ((0, 0), (1, 0))).astype(np.float32).ravel())
        turn = grid.R_face_antenna
        self._turn = [[dr.opaque(mi.Float, float(value)) for value in row] for row in turn]

    def shoot(self, unit: Any, in_beam: Any, beam_fraction: float) -> tuple[Any, Any, Any]:
        """Return directions, densities per steradian, and which are valid; see `CutRays.shoot`."""
        sphere = mi.warp.square_to_uniform_sphere(mi.Point2f(*unit))
        row = _cell(self._row_below, mi.UInt32(0), self._rows, unit[1])
        v = _within(self._row_below, self._up, row, row, unit[1])
        first = row * (self._columns + 1)
        column = _cell(self._below, first, self._columns, unit[0])
        u = _within(self._below, self._left, first + column, column, unit[0])
        valid = ~in_beam | (u * u + v * v < 1)
        normal = dr.select(in_beam, dr.safe_sqrt(1 - u * u - v * v), sphere.z)
        u, v = dr.select(in_beam, u, sphere.x), dr.select(in_beam, v, sphere.y)
        density = beam_fraction * self._density(normal, u, v) + (1 - beam_fraction) / (4 * dr.pi)
        across = [self._turn[0][i] * normal + self._turn[1][i] * u + self._turn[2][i] * v for i in range(3)]
        return (across[0], across[1], across[2]), density, valid

    def _density(self, normal: Any, u: Any, v: Any) -> Any:
        """Return the density per steradian of the rays that follow the beam; none behind the face."""
        row = _cell(self._up, mi.UInt32(0), self._rows, v)
        column = _cell(self._left, mi.UInt32(0), self._columns, u)
        probability = _step(self._row_below, row) * _step(self._below, row * (self._columns + 1) + column)
        area = dr.maximum(_step(self._up, row) * _step(self._left, column), 1e-20)
        return dr.select(normal > 0, dr.maximum(normal, 0.0) * probability / area, 0.0)


def _cell(edges: Any, first: Any, cells: int, value: Any) -> Any:
    """Return the index of the cell that holds a value, among consecutive cells from the edge `first` on."""
    above = dr.binary_search(0, cells, lambda i: dr.gather(mi.Float, edges, first + i) <= value)
    return mi.UInt32(dr.clip(mi.Int32(above) - 1, 0, cells - 1))


def _step(edges: Any, cell: Any) -> Any:
    return dr.gather(mi.Float, edges, cell + 1) - dr.gather(mi.Float, edges, cell)


def _within(below: Any, edges: Any, at: Any, cell: Any, share: Any) -> Any:
    """Return the place inside a cell of a share of all, between the shares at its two edges."""
    fraction = (share - dr.gather(mi.Float, below, at)) / dr.maximum(_step(below, at), 1e-30)
    return dr.lerp(dr.gather(mi.Float, edges, cell), dr.gather(mi.Float, edges, cell + 1), dr.clip(fraction, 0.0, 1.0))


def _quantile(quantiles, probability):  # type: ignore[no-untyped-def]
    position = probability * (dr.width(quantiles) - 1)
    below = mi.UInt32(dr.minimum(position, dr.width(quantiles) - 2))
    fraction = position - mi.Float(below)
    low, high = dr.gather(mi.Float, quantiles, below), dr.gather(mi.Float, quantiles, below + 1)
    return dr.lerp(low, high, fraction)


def _density(quantiles, cosine):  # type: ignore[no-untyped-def]
    """Return the density of the piecewise linear quantile function at a cosine."""
    cells = dr.width(quantiles) - 1
    below = dr.binary_search(0, cells, lambda i: dr.gather(mi.Float, quantiles, i) < cosine)
    below = mi.UInt32(dr.maximum(mi.Int32(below) - 1, 0))
    width = dr.gather(mi.Float, quantiles, below + 1) - dr.gather(mi.Float, quantiles, below)
    return dr.rcp(cells * dr.maximum(width, 1e-12))
