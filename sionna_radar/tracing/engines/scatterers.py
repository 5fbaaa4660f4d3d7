"""Scatterers fixed to the surface, so that the phase from chirp to chirp is that of a real scene.

Their density follows the place (see `density`), decided before the flight, so that all pulses see scatterers of one and
the same surface. They are drawn cell by cell of space when a beam first reaches the cell, from the seed, the surface and
the place of the cell alone: which pulses were traced before, and in which blocks, changes nothing.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from sionna_radar.flight.pulses import Pose
from sionna_radar.scene.model import Scene
from sionna_radar.tracing.engines.cell_tree import CellTree
from sionna_radar.tracing.engines.density import DensityMap
from sionna_radar.tracing.engines.surface_cells import cells_of, density_at, piece_of

# Scatterers kept for later pulses; those of one block may be more.
KEPT = 2_000_000
# Powers of the inverse of the plastic number, the root of x^3 = x + 1.
ADDITIVE_STEP = (0.7548776662466927, 0.5698402909980532)
# SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators").
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST_MIX, SECOND_MIX = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)

# One row of what is kept of every scatterer.
ROW = np.dtype(
    [
        ("position_m", np.float64, 3),
        ("normal", np.float32, 3),
        ("area_m2", np.float32),
        ("reflectivity", np.complex64),
        ("wander", np.float32),
        ("face", np.int32),
        ("surface", np.int32),
    ],
    align=True,
)
# One row of what a pulse sees of a scatterer.
SEEN = np.dtype(
    [
        ("row", np.uint32),
        ("which", np.int32),
        ("range_m", np.float64),
        ("range_rate_mps", np.float32),
        ("cosine", np.float32),
        ("solid_angle_sr", np.float32),
    ],
    align=True,
)


class Scatterers:
    """The scatterers of a scene, drawn where beams need them.

    Of each there are: position and unit normal; the area that it represents; reflectivity, a complex normal number of
    mean power one, so that the sum of any of them is exactly Gaussian and speckle is fully developed however few share
    a range cell; wander, a number of the two-sided exponential distribution of mean size one, for surfaces that move;
    its triangle in its surface, and the surface.

    Parameters
    ----------
    scene:
        The surfaces.
    density:
        Where how many are needed.
    seed:
        Each surface draws its own numbers, so that adding one leaves the others' scatterers where they were.
    region_m:
        Lowest and highest corner of the box of interest; there are none outside. None: no limit.

    """

    def __init__(
        self, scene: Scene, density: DensityMap, seed: int, region_m: Float[np.ndarray, "2 3"] | None = None
    ) -> None:
        self._corner = np.concatenate([s.vertices_m[s.faces] for s in scene.surfaces]).astype(np.float64)
        self._first_face = np.concatenate([[0], np.cumsum([len(s.faces) for s in scene.surfaces])])
        self.density = density
        self.cells = cells_of(scene.surfaces, self._corner, self._first_face, density, region_m)
        self._tree = CellTree.over(self.cells.low_m, self.cells.high_m)
        self._state = _states(np.uint64(seed), self.cells.surface, self.cells.place, self.cells.side_m)
        self._count = _counts(self._state, self.cells.expected)
        self._at = np.full(len(self.cells), -1, dtype=np.int64)
        self.kept = np.empty(0, dtype=ROW)
        self._used = 0

    def in_beams(self, pose: Pose, reach: tuple[float, float]) -> np.ndarray:
        """Return a table, of rows `SEEN`, of what lies inside beams, sorted by beam; occlusion is ignored.

        `kept` holds the scatterers until the next call.

        Parameters
        ----------
        pose:
            Of the antennas; a beam's number is its row.
        reach:
            Largest direction cosines along left and up inside a beam.

        """
        axes = np.ascontiguousarray(pose.R_world_antenna)
        edges, cell = self._tree.in_beams(pose.position_m, axes, reach)
        self._draw(np.unique(cell))
        most = int(self._count[cell].sum())
        out = np.empty(most, dtype=SEEN)
        count = _inside(
            edges, cell, self._at, self._count, self.kept, pose.position_m, pose.velocity_mps, axes, *reach, out
        )
        return out[:count]

    def all(self) -> np.ndarray:
        """Return a table, of rows `ROW`, of all scatterers, surface by surface."""
        self._draw(np.arange(len(self.cells)))
        rows = np.concatenate([np.arange(a, a + n) for a, n in zip(self._at, self._count, strict=True)] or [[]])
        table = self.kept[rows.astype(np.int64)]
        return table[np.argsort(table["surface"], kind="stable")]

    def __len__(self) -> int:
        return int(self._count.sum())

    def _draw(self, cell: Int[np.ndarray, " cell"]) -> None:
        """Draw the scatterers of cells that do not have theirs yet."""
        new = cell[self._at[cell] < 0]
        if self._used + int(self._count[new].sum()) > max(KEPT, len(self.kept)):
            self._at[:] = -1
            self._used, new = 0, cell
        needed = self._used + int(self._count[new].sum())
        if needed > len(self.kept):
            grown = np.empty(max(needed, 2 * len(self.kept)), dtype=ROW)
            grown[: self._used] = self.kept[: self._used]
            self.kept = grown
        length = self._count[new]
        self._at[new] = self._used + np.cumsum(length) - length
        grid = (self.density.west_m, self.density.south_m, self.density.step_m, self.density.per_m2)
        pieces = (self.cells.first, self.cells.face, self.cells.parts, self.cells.part, self.cells.surface)
        _fill(new, self._at, self._count, self._state, *pieces, self._corner, self._first_face, *grid, self.kept)
        self._used = needed


@njit(cache=True, nogil=True)
@no_type_check
def _mixed(value):
    value = (value ^ (value >> np.uint64(30))) * FIRST_MIX
    value = (value ^ (value >> np.uint64(27))) * SECOND_MIX
    return value ^ (value >> np.uint64(31))


@njit(cache=True, nogil=True)
@no_type_check
def _unit(state, number):
    """Return the given number of a stream, in (0, 1)."""
    mixed = _mixed(state + np.uint64(number + 1) * GOLDEN)
    return (float(mixed >> np.uint64(12)) + 0.5) * 2.0**-52


@njit(cache=True, nogil=True)
@no_type_check
def _states(seed, surface, place, side):
    out = np.empty(len(surface), dtype=np.uint64)
    level = int(np.round(np.log2(side))) + 64
    first = _mixed(_mixed(seed + GOLDEN) + np.uint64(level))
    for cell in range(len(surface)):
        state = _mixed(first + np.uint64(surface[cell] + 1) * GOLDEN)
        for axis in range(3):
            state = _mixed(state + np.uint64(place[cell, axis] + 2**40) * GOLDEN)
        out[cell] = state
    return out


@njit(cache=True, nogil=True)
@no_type_check
def _counts(state, expected):
    """Return how many scatterers each cell has: its expected number in the mean, rounded up or down at random."""
    out = np.empty(len(state), dtype=np.int64)
    for cell in range(len(state)):
        out[cell] = int(np.floor(expected[cell] + _unit(state[cell], 0)))
    return out


@njit(cache=True, nogil=True)
@no_type_check
def _fill(
    chosen, at, counts, states, first, face, parts, part, surface, corners, first_face, west, south, step, per_m2, kept
):
    """Draw the scatterers of some cells.

    They are spread by equal steps of their expected number over the pieces of the cell, and inside a piece along an
    additive sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
    """
    piece = np.empty((3, 3))
    for cell in chosen:
        count, state = counts[cell], states[cell]
        if count == 0:
            continue
        total = 0.0
        for p in range(first[cell], first[cell + 1]):
            total += _expected(p, face, parts, part, corners, west, south, step, per_m2, piece)[0]
        start_u, start_v = _unit(state, 1), _unit(state, 2)
        p, below, n, done = first[cell] - 1, 0.0, 0.0, 0.0
        for number in range(count):
            stream = 3 + 5 * number
            target = (number + _unit(state, stream)) * (total / count)
            while p < first[cell] or (below + done < target and p < first[cell + 1] - 1):
                p += 1
                below += done
                done, n = _expected(p, face, parts, part, corners, west, south, step, per_m2, piece)
                normal_x = (piece[1, 1] - piece[0, 1]) * (piece[2, 2] - piece[0, 2]) - (
                    piece[1, 2] - piece[0, 2]
                ) * (piece[2, 1] - piece[0, 1])
                normal_y = (piece[1, 2] - piece[0, 2]) * (piece[2, 0] - piece[0, 0]) - (
                    piece[1, 0] - piece[0, 0]
                ) * (piece[2, 2] - piece[0, 2])
                normal_z = (piece[1, 0] - piece[0, 0]) * (piece[2, 1] - piece[0, 1]) - (
                    piece[1, 1] - piece[0, 1]
                ) * (piece[2, 0] - piece[0, 0])
                size = np.sqrt(normal_x**2 + normal_y**2 + normal_z**2)
            u = (start_u + number * ADDITIVE_STEP[0]) % 1.0
            v = (start_v + number * ADDITIVE_STEP[1]) % 1.0
            root = np.sqrt(u)
            a, b, c = 1.0 - root, root * (1.0 - v), root * v
            row = kept[at[cell] + number]
            for axis in range(3):
                row.position_m[axis] = a * piece[0, axis] + b * piece[1, axis] + c * piece[2, axis]
            row.normal[0], row.normal[1], row.normal[2] = normal_x / size, normal_y / size, normal_z / size
            row.area_m2 = 1.0 / n
            # Box and Muller: both parts of a complex normal number of mean power one.
            radius = np.sqrt(-np.log(_unit(state, stream + 1)))
            turn = 2.0 * np.pi * _unit(state, stream + 2)
            row.reflectivity = complex(radius * np.cos(turn), radius * np.sin(turn))
            sign = 1.0 if _unit(state, stream + 3) < 0.5 else -1.0
            row.wander = -sign * np.log(_unit(state, stream + 4))
            row.face = face[p] - first_face[surface[cell]]
            row.surface = surface[cell]


@njit(cache=True, nogil=True)
@no_type_check
def _expected(p, face, parts, part, corners, west, south, step, per_m2, piece):
    """Write the corners of a piece, and return its expected number of scatterers and their density."""
    piece_of(corners[face[p]], parts[p], part[p], piece)
    ux, uy, uz = (piece[1, 0] - piece[0, 0], piece[1, 1] - piece[0, 1], piece[1, 2] - piece[0, 2])
    vx, vy, vz = (piece[2, 0] - piece[0, 0], piece[2, 1] - piece[0, 1], piece[2, 2] - piece[0, 2])
    area = 0.5 * np.sqrt((uy * vz - uz * vy) ** 2 + (uz * vx - ux * vz) ** 2 + (ux * vy - uy * vx) ** 2)
    x = (piece[0, 0] + piece[1, 0] + piece[2, 0]) / 3
    y = (piece[0, 1] + piece[1, 1] + piece[2, 1]) / 3
    n = density_at(x, y, west, south, step, per_m2)
    return n * area, n


@njit(cache=True, nogil=True)
@no_type_check
def _inside(edges, cells, at, counts, kept, apex, velocity, axes, reach_left, reach_up, out):
    """Write what lies inside beams, beam by beam, and return how much that is."""
    count = 0
    for beam in range(len(apex)):
        px, py, pz = apex[beam, 0], apex[beam, 1], apex[beam, 2]
        R = axes[beam]
        for pair in range(edges[beam], edges[beam + 1]):
            cell = cells[pair]
            for which in range(at[cell], at[cell] + counts[cell]):
                place = kept[which].position_m
                x, y, z = place[0] - px, place[1] - py, place[2] - pz
                if x * R[0, 0] + y * R[1, 0] + z * R[2, 0] <= 0.0:
                    continue
                distance = np.sqrt(x * x + y * y + z * z)
                if abs(x * R[0, 1] + y * R[1, 1] + z * R[2, 1]) > reach_left * distance:
                    continue
                if abs(x * R[0, 2] + y * R[1, 2] + z * R[2, 2]) > reach_up * distance:
                    continue
                normal = kept[which].normal
                cosine = min(abs(x * normal[0] + y * normal[1] + z * normal[2]) / distance, 1.0)
                row = out[count]
                row.row, row.which, row.range_m = beam, which, distance
                row.range_rate_mps = (
                    -(x * velocity[beam, 0] + y * velocity[beam, 1] + z * velocity[beam, 2]) / distance
                )
                row.cosine = cosine
                row.solid_angle_sr = kept[which].area_m2 * cosine / (distance * distance)
                count += 1
    return count
