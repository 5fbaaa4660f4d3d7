"""Density of scatterers on surfaces, set before the flight by the footprints of sampled beams.

Speckle needs enough scatterers in the beam, and enough in every range cell. What that takes per square metre depends on
the beam's footprint, and so on the place: every place gets what the smallest footprint near it asks for. Densities are
powers of two, so that they, and with them the scatterers, change in few places when the flight changes a little.

Fixed scatterers fill a part of the beam: an ellipse of direction cosines around its axis.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.two_way_grid import TwoWayGrid
from sionna_radar.tracing.paths import SampledBeams

# Fraction of the two-way power outside the ellipse. A beam with side lobes of -20 dB is 28 dB down there.
OUTSIDE_FRACTION = 2e-3
# Shape of the ellipse: what reaches as far to either side as all but this share of the power.
SHAPE_FRACTION = 3e-4
# Half axes over the half-power widths, at most: strong side lobes are left out.
WIDEST = 1.25
# Edges of either kind along each cut of a separable antenna.
EDGES = 200


@dataclass(frozen=True)
class FilledBeam:
    """Directions with (left / a)^2 + (up / b)^2 at most one, in front of the antenna.

    left, up: the half axes a and b, direction cosines.
    """

    left: float
    up: float

    def holds(self, direction: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return True where unit vectors in the antenna's frame lie in it."""
        ahead, left, up = direction.T
        return (ahead > 0) & ((left / self.left) ** 2 + (up / self.up) ** 2 <= 1.0)


@lru_cache(maxsize=64)  # an electronic scan has many antennas
def filled_beam(antenna: Antenna) -> FilledBeam:
    """Return the part of an antenna's beam that scatterers fill."""
    grid = power_grid(antenna)
    left, up = grid.reach(SHAPE_FRACTION)
    ahead, across, along = grid.direction.T
    away = np.where(ahead > 0, np.hypot(across / left, along / up), np.inf)
    order = np.argsort(away)
    below = np.cumsum(grid.power_sr.ravel()[order])
    scale = away[order][np.searchsorted(below, (1 - OUTSIDE_FRACTION) * below[-1])]
    widest = WIDEST * np.array(antenna.beamwidths_rad) if antenna.separable else np.full(2, np.inf)
    return FilledBeam(float(min(scale * left, widest[0])), float(min(scale * up, widest[1])))


def power_grid(antenna: Antenna) -> TwoWayGrid:
    """Return the two-way power in front of an antenna, for a separable one from its cuts."""
    return _separable_grid(antenna) if antenna.separable else antenna.two_way


@lru_cache(maxsize=2)
def _separable_grid(antenna: Antenna) -> TwoWayGrid:
    (left, across), (up, along) = (_cells(cut) for cut in (antenna.azimuth, antenna.elevation))
    middle = ((left[1:] + left[:-1]) / 2) ** 2 + (((up[1:] + up[:-1]) / 2) ** 2)[:, None]
    # G^2 dOmega = A^4 E^4 cos^2 du dv / cos.
    power = np.outer(along, across) * np.sqrt(np.maximum(1 - middle, 0.0))
    return TwoWayGrid(left=left, up=up, power_sr=power, R_face_antenna=np.eye(3))


def _cells(cut: Cut) -> tuple[Float[np.ndarray, " edge"], Float[np.ndarray, " cell"]]:
    """Return edges, half of them by equal shares of the one-way power, and the two-way power between them."""
    cosine = cut.cosine
    below = np.concatenate([[0.0], np.cumsum((cut.voltage[1:] ** 2 + cut.voltage[:-1] ** 2) / 2)])
    rising = np.concatenate([[True], np.diff(below) > 0])
    equal_power = np.interp(np.linspace(0, below[-1], EDGES + 1)[1:-1], below[rising], cosine[rising])
    edges = np.unique(np.concatenate([equal_power, np.linspace(-1.0, 1.0, EDGES + 1)]))
    return edges, np.diff(np.interp(edges, cosine, cut.two_way_distribution))


# Fewest scatterers in the range cell of the beam's axis.
PER_RANGE_CELL = 10.0
# Footprints are computed no closer to grazing than this cosine.
MIN_COSINE = 0.1
# Cells of the map of densities: the smallest, and about how many.
FINEST_M, CELLS = 4.0, 40_000
NEIGHBOURS = 8


@dataclass(frozen=True, kw_only=True)
class DensityMap:
    """Scatterers per square metre of surface, on square cells of the plan; the outermost cells go on for ever.

    per_m2: zero where no scatterer is needed.
    """

    west_m: float
    south_m: float
    step_m: float
    per_m2: Float[np.ndarray, "row column"]

    @staticmethod
    def constant(per_m2: float) -> "DensityMap":
        """Return the same density everywhere."""
        return DensityMap(west_m=0.0, south_m=0.0, step_m=1.0, per_m2=np.full((1, 1), per_m2))

    def at(self, place_m: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        """Return the density at places of the plan."""
        index = np.floor((place_m - [self.west_m, self.south_m]) / self.step_m)
        column, row = np.clip(index, 0, np.array(self.per_m2.shape[::-1]) - 1).astype(np.int64).T
        return self.per_m2[row, column]

    @property
    def columns(self) -> tuple[float, float, float, np.ndarray]:
        """All of it, for compiled code."""
        return self.west_m, self.south_m, self.step_m, self.per_m2

    @property
    def key(self) -> tuple[float, float, float, tuple[int, ...], bytes]:
        """Its content, to be compared."""
        return self.west_m, self.south_m, self.step_m, self.per_m2.shape, self.per_m2.tobytes()

    @property
    def typical_per_m2(self) -> float:
        """Median of the densities; zero without any."""
        some = self.per_m2[self.per_m2 > 0]
        return float(np.median(some)) if len(some) else 0.0


def footprint_density(
    looks: SampledBeams, beams: Sequence[FilledBeam], range_resolution_m: float, scatterers: int
) -> DensityMap:
    """Return the density that a survey's footprints ask for.

    looks: beams of pulses spread over the survey.
    beams: what they fill of the beams of the antennas they look through.
    range_resolution_m: of the sweep.
    scatterers: how many the beam should hold; more, where it spreads over more than a tenth as many range cells.
    """
    looks = looks.rows(np.isfinite(looks.range_m))
    if not len(looks.range_m):
        return DensityMap.constant(0.0)
    half_axes = np.array([(beam.left, beam.up) for beam in beams])[looks.beam]
    density, radius = _needed(looks, half_axes, range_resolution_m, scatterers)
    place = looks.hit_m[:, :2]
    tree = cKDTree(place)
    spacing = 4 * float(np.median(tree.query(place, k=min(2, len(place)))[0].reshape(len(place), -1)[:, -1]))
    margin = 2 * radius + spacing
    low, high = (place - margin[:, None]).min(axis=0), (place + margin[:, None]).max(axis=0)
    step = max(FINEST_M, float(np.sqrt(np.prod(high - low) / CELLS)))
    # Cells on a fixed raster, so that a longer flight has the same ones.
    first = np.floor(low / step)
    columns, rows = (np.ceil(high / step) - first).astype(np.int64) + 1
    x, y = np.meshgrid((first[0] + np.arange(columns) + 0.5) * step, (first[1] + np.arange(rows) + 0.5) * step)
    count = min(NEIGHBOURS, len(place))
    away, near = (
        found.reshape(x.size, count) for found in tree.query(np.column_stack([x.ravel(), y.ravel()]), k=count)
    )
    near_enough = away <= np.maximum(away[:, :1], radius[near] + step)
    needed = np.where(near_enough, density[near], 0.0).max(axis=1)
    needed[away[:, 0] > margin[near[:, 0]] + step] = 0.0
    needed[needed > 0] = 2.0 ** np.round(np.log2(needed[needed > 0]))
    # Nothing beyond the map either, whose outermost cells go on.
    return DensityMap(
        west_m=float((first[0] - 1) * step),
        south_m=float((first[1] - 1) * step),
        step_m=step,
        per_m2=np.pad(needed.reshape(x.shape), 1),
    )


def _needed(
    looks: SampledBeams, half_axes: Float[np.ndarray, "look 2"], range_resolution_m: float, scatterers: int
) -> tuple[Float[np.ndarray, " look"], Float[np.ndarray, " look"]]:
    """Return the density that each look asks for on level ground, and the radius of its footprint."""
    down = np.maximum(np.abs(looks.R_world_antenna[:, 2, 0]), MIN_COSINE)
    area = np.minimum(np.pi * np.prod(half_axes, axis=1), 2 * np.pi) * looks.range_m**2 / down
    # Along a direction e across the axis k the range of level ground grows by r (e.n) / (k.n) per radian.
    growth = np.abs(looks.R_world_antenna[:, 2, 1:]) / down[:, None]
    span = looks.range_m * (2 * np.linalg.norm(half_axes * growth, axis=1) + half_axes.max(axis=1) ** 2 / 2)
    # An ellipse is 4 / pi times as wide across its middle as in the mean.
    in_cells = PER_RANGE_CELL * np.pi / 4 * span / range_resolution_m
    return np.maximum(scatterers, in_cells) / area, looks.range_m * half_axes.max(axis=1) / down
