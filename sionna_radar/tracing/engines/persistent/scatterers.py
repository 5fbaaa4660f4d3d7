"""Random scatterers fixed to surfaces, drawn on demand where beams need them.

Their density follows the place (see `density`), decided before the flight, so that all pulses see scatterers of one
and the same surface. They are drawn cell by cell of space when a beam first reaches the cell, from the seed, the
surface and the place of the cell alone: which pulses were traced before, and in which blocks, changes nothing.
"""

from dataclasses import dataclass, fields
from typing import no_type_check

import numpy as np
from jaxtyping import Complex, Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.compiled import compiled, turned
from sionna_radar.scene.model import Scene
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.persistent.cell_tree import CellTree
from sionna_radar.tracing.engines.persistent.density import DensityMap, FilledBeam
from sionna_radar.tracing.engines.persistent.seen_places import SeenPlaces
from sionna_radar.tracing.engines.persistent.surface_cells import (
    SurfaceCells,
    Triangles,
    cells_of,
    corners_of,
    expected_of,
    scratch,
)

# Scatterers kept for later pulses, 30 MB; those of one block may be more.
KEPT = 500_000
# Powers of the inverse of the plastic number, the root of x^3 = x + 1.
ADDITIVE_STEP = (0.7548776662466927, 0.5698402909980532)
# SplitMix64 (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators").
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST_MIX, SECOND_MIX = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)


@dataclass(frozen=True, kw_only=True)
class CellPoints(Columns):
    """Scatterers.

    normal: unit normal of its triangle.
    area_m2: area that each represents.
    reflectivity: unit numbers of random phase. All scatterers are equally strong: the sum of the ten or more in a range
        cell is Gaussian enough (its mean square intensity is 2 - 1/n instead of 2), and ground of one reflectivity has
        no bright and dark places that all pulses see alike, which random strengths would give it.
    wander: numbers of the two-sided exponential distribution of mean size one, for surfaces that move.
    surface, face: where each lies: the surface in the scene, and the triangle in the surface.
    """

    position_m: Float[np.ndarray, "point 3"]
    normal: Float[np.ndarray, "point 3"]
    area_m2: Float[np.ndarray, " point"]
    reflectivity: Complex[np.ndarray, " point"]
    wander: Float[np.ndarray, " point"]
    surface: Int[np.ndarray, " point"]
    face: Int[np.ndarray, " point"]

    @staticmethod
    def room_for(count: int) -> "CellPoints":
        """Return a table to be written into."""
        return CellPoints(
            position_m=np.empty((count, 3)),
            normal=np.empty((count, 3), dtype=np.float32),
            area_m2=np.empty(count, dtype=np.float32),
            reflectivity=np.empty(count, dtype=np.complex64),
            wander=np.empty(count, dtype=np.float32),
            surface=np.empty(count, dtype=np.int32),
            face=np.empty(count, dtype=np.int32),
        )

    @property
    def columns(self) -> tuple[np.ndarray, ...]:
        """All columns, for compiled code."""
        return tuple(getattr(self, f.name) for f in fields(self))


class Scatterers:
    """The scatterers of a scene, drawn where beams need them.

    scene: the surfaces.
    density: where how many are needed.
    seed: each surface draws its own numbers, so that adding one leaves the others' scatterers where they were.
    region_m: lowest and highest corner of the box of interest; there are none outside. None: no limit.
    caster: of the scene's surfaces, with which their cells may be kept.
    """

    def __init__(
        self,
        scene: Scene,
        density: DensityMap,
        seed: int,
        region_m: Float[np.ndarray, "2 3"] | None = None,
        caster: RayCaster | None = None,
    ) -> None:
        self.density = density

        def divide() -> tuple[Triangles, SurfaceCells, CellTree]:
            triangles = Triangles.of(scene.surfaces)
            cells = cells_of(triangles, density, region_m)
            return triangles, cells, CellTree.over(cells.low_m, cells.high_m)

        # None of it depends on the seed, and nothing below writes into it.
        key = (density.key, None if region_m is None else region_m.tobytes())
        surface_cells = divide() if caster is None else caster.once("scatterers' cells", key, divide)
        self._triangles, self.cells, self._tree = surface_cells
        self._state = np.empty(len(self.cells), dtype=np.uint64)
        _states(np.uint64(seed), self.cells.surface, self.cells.place, self.cells.side_m, self._state)
        self._count = np.empty(len(self.cells), dtype=np.int64)
        _counts(self._state, self.cells.expected, self._count)
        self.release_memory()

    def release_memory(self) -> None:
        """Give back the memory of what was drawn; what beams need is drawn again."""
        self._at = np.full(len(self.cells), -1, dtype=np.int64)
        # Room that is not written to takes no memory.
        self._points = CellPoints.room_for(min(int(self._count.sum()), KEPT))
        self._used = 0
        self._room = SeenPlaces.room_for(0)

    def in_beams(
        self, pulses: Pulses, beam: FilledBeam, wander_hz: float, spare: int
    ) -> tuple[SeenPlaces, Int[np.ndarray, " beam_edge"]]:
        """Return a table that begins with what lies inside beams, beam by beam, and where in it each beam's begin.

        Occlusion is ignored. It never calls Python's ray tracer, and may be called on any one thread. The table is good
        until the next call, which writes into the same memory.

        pulses: the pulses; beams start at their true positions.
        beam: what scatterers fill of the antenna's.
        wander_hz: mean size of the scatterers' Doppler shifts.
        spare: entries at the end of the table that are left to be written.
        """
        pose = pulses.true
        apex_m, axes = np.ascontiguousarray(pose.position_m), np.ascontiguousarray(pose.R_world_antenna)
        edges, cell = self._tree.in_beams(apex_m, axes, beam)
        self._draw(np.unique(cell))
        out = self._room_for(int(self._count[cell].sum()) + spare)
        beams = (apex_m, pose.velocity_mps, axes, pulses.time_s, beam.left, beam.up, wander_hz)
        ends = np.empty(len(edges), dtype=np.int64)
        _inside(edges, cell, self._at, self._count, self._points.columns, *beams, out.columns, ends)
        return out, ends

    def _room_for(self, count: int) -> SeenPlaces:
        """Return a table to be written into, in the memory of the last one if that is enough.

        Fresh pages from the system would cost as much as what is written into them.
        """
        if count > len(self._room):
            self._room = SeenPlaces.room_for(count)
        return self._room.first(count)

    def _draw(self, cell: Int[np.ndarray, " cell"]) -> None:
        """Draw the scatterers of cells that do not have theirs yet."""
        new = cell[self._at[cell] < 0]
        if self._used + int(self._count[new].sum()) > max(KEPT, len(self._points)):
            self._at[:] = -1
            self._used, new = 0, cell
        needed = self._used + int(self._count[new].sum())
        if needed > len(self._points):  # more than are kept, all of them for this block
            self._points = CellPoints.room_for(needed)
        length = self._count[new]
        self._at[new] = self._used + np.cumsum(length) - length
        cells = self.cells
        pieces = (cells.first, cells.face, cells.parts, cells.part, cells.surface, cells.expected)
        meshes, density = (
            (self._triangles.vertices_m, self._triangles.corners, self._triangles.first),
            self.density.columns,
        )
        _fill(new, self._at, self._count, self._state, pieces, *meshes, density, self._points.columns, *scratch())
        self._used = needed


@compiled
@no_type_check
def _mixed(value):
    value = (value ^ (value >> np.uint64(30))) * FIRST_MIX
    value = (value ^ (value >> np.uint64(27))) * SECOND_MIX
    return value ^ (value >> np.uint64(31))


@compiled
@no_type_check
def _unit(state, number):
    """Return the given number of a stream, in (0, 1)."""
    mixed = _mixed(state + np.uint64(number + 1) * GOLDEN)
    return (float(mixed >> np.uint64(12)) + 0.5) * 2.0**-52


@compiled
@no_type_check
def _states(seed, surface, place, side, out):
    level = int(np.rint(np.log2(side))) + 64
    first = _mixed(_mixed(seed + GOLDEN) + np.uint64(level))
    for cell in range(len(surface)):
        state = _mixed(first + np.uint64(surface[cell] + 1) * GOLDEN)
        for axis in range(3):
            state = _mixed(state + np.uint64(place[cell, axis] + 2**40) * GOLDEN)
        out[cell] = state


@compiled
@no_type_check
def _counts(state, expected, out):
    """Write the number of scatterers of each cell: its expected number, rounded up or down at random without bias."""
    for cell in range(len(state)):
        out[cell] = int(np.floor(expected[cell] + _unit(state[cell], np.int64(0))))


@compiled
@no_type_check
def _fill(chosen, at, counts, states, pieces, vertices, corners, first_face, density, columns, corner, piece):
    """Draw the scatterers of some cells.

    They are spread by equal steps of their expected number over the pieces of the cell, and inside a piece along an
    additive sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
    """
    first, face, parts, part, surface, expected = pieces
    position, normal, area_m2, reflectivity, wander, own_surface, own_face = columns
    for cell in chosen:
        count, state = counts[cell], states[cell]
        if count == 0:
            continue
        start_u, start_v = _unit(state, np.int64(1)), _unit(state, np.int64(2))
        p, below, n, done = first[cell] - 1, 0.0, 0.0, 0.0
        for number in range(count):
            stream = 3 + 5 * number
            target = (number + _unit(state, stream)) * (expected[cell] / count)
            while p < first[cell] or (below + done < target and p < first[cell + 1] - 1):
                p += 1
                below += done
                corners_of(np.int64(face[p]), vertices, corners, corner)
                n, area = expected_of(corner, np.int64(parts[p]), np.int64(part[p]), density, piece)
                done = n * area
                normal_x = (piece[1, 1] - piece[0, 1]) * (piece[2, 2] - piece[0, 2]) - (piece[1, 2] - piece[0, 2]) * (
                    piece[2, 1] - piece[0, 1]
                )
                normal_y = (piece[1, 2] - piece[0, 2]) * (piece[2, 0] - piece[0, 0]) - (piece[1, 0] - piece[0, 0]) * (
                    piece[2, 2] - piece[0, 2]
                )
                normal_z = (piece[1, 0] - piece[0, 0]) * (piece[2, 1] - piece[0, 1]) - (piece[1, 1] - piece[0, 1]) * (
                    piece[2, 0] - piece[0, 0]
                )
                size = np.sqrt(normal_x**2 + normal_y**2 + normal_z**2)
            u = (start_u + number * ADDITIVE_STEP[0]) % 1.0
            v = (start_v + number * ADDITIVE_STEP[1]) % 1.0
            root = np.sqrt(u)
            a, b, c = 1.0 - root, root * (1.0 - v), root * v
            row = at[cell] + number
            for axis in range(3):
                position[row, axis] = a * piece[0, axis] + b * piece[1, axis] + c * piece[2, axis]
            normal[row, 0], normal[row, 1], normal[row, 2] = normal_x / size, normal_y / size, normal_z / size
            area_m2[row] = 1.0 / n
            turn = 2.0 * np.pi * _unit(state, stream + 2)
            reflectivity[row] = complex(np.cos(turn), np.sin(turn))
            sign = 1.0 if _unit(state, stream + 3) < 0.5 else -1.0
            wander[row] = -sign * np.log(_unit(state, stream + 4))
            own_face[row] = face[p] - first_face[surface[cell]]
            own_surface[row] = surface[cell]


@compiled
@no_type_check
def _inside(
    edges, cells, at, counts, points, apex, velocity, axes, time_s, half_left, half_up, wander_hz, columns, ends
):  # fmt: skip
    """Write the scatterers inside beams, beam by beam, the first row of each beam, and the total."""
    position, normal, area_m2, reflectivity, wander, own_surface, own_face = points
    row, east, north, above, range_m, rate, cosine, solid_angle, surface, face, factor = columns
    ends[0] = n = 0
    per_left, per_up = 1.0 / half_left, 1.0 / half_up
    for beam in range(len(apex)):
        ax, ay, az = apex[beam, 0], apex[beam, 1], apex[beam, 2]
        vx, vy, vz = velocity[beam, 0], velocity[beam, 1], velocity[beam, 2]
        fx, fy, fz = axes[beam, 0, 0], axes[beam, 1, 0], axes[beam, 2, 0]
        lx, ly, lz = axes[beam, 0, 1], axes[beam, 1, 1], axes[beam, 2, 1]
        ux, uy, uz = axes[beam, 0, 2], axes[beam, 1, 2], axes[beam, 2, 2]
        for pair in range(edges[beam], edges[beam + 1]):
            cell = cells[pair]
            for i in range(at[cell], at[cell] + counts[cell]):
                x, y, z = position[i, 0] - ax, position[i, 1] - ay, position[i, 2] - az
                if x * fx + y * fy + z * fz <= 0.0:
                    continue
                left = (x * lx + y * ly + z * lz) * per_left
                up = (x * ux + y * uy + z * uz) * per_up
                if left * left + up * up > x * x + y * y + z * z:
                    continue
                distance = np.sqrt(x * x + y * y + z * z)
                cos = min(abs(x * normal[i, 0] + y * normal[i, 1] + z * normal[i, 2]) / distance, 1.0)
                row[n] = beam
                east[n], north[n], above[n] = position[i, 0], position[i, 1], position[i, 2]
                range_m[n] = distance
                rate[n] = -(x * vx + y * vy + z * vz) / distance
                cosine[n] = cos
                solid_angle[n] = area_m2[i] * cos / (distance * distance)
                surface[n], face[n] = own_surface[i], own_face[i]
                if wander_hz == 0.0:
                    factor[n] = reflectivity[i]
                else:
                    factor[n] = reflectivity[i] * complex(*turned(wander[i] * wander_hz * time_s[beam]))
                n += 1
        ends[beam + 1] = n
