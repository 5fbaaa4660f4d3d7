"""Thin obstacles: wires, poles and fences as round conductors along curves, much thinner than the beam is wide.

They return echoes (see `tracing.effects.thin_cylinders`), hide nothing, and are no part of the surface that a DEM is
compared with.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, kw_only=True)
class Strands:
    """The outer layer of a stranded conductor: strands side by side, wound with a lay (length of one turn)."""

    count: int
    lay_m: float

    @property
    def period_m(self) -> float:
        """Length along the axis after which the surface repeats."""
        return self.lay_m / self.count


@dataclass(frozen=True, kw_only=True, eq=False)
class Wire:
    """A round conductor along a polyline whose legs may hang through.

    vertex_m: corners, world frame, shape (vertex, 3).
    radius_m: over all strands.
    sag_m: of each leg, a parabola: its depth below the middle of the chord. The catenary differs by sag^3 / span^2 at
        most: 3 mm at a sag of 3 m over 100 m.
    strands: None for a smooth surface.
    reflectivity: of its surface, power over that of a perfect conductor.
    """

    vertex_m: Float[np.ndarray, "vertex 3"]
    radius_m: float
    sag_m: float = 0.0
    strands: Strands | None = None
    reflectivity: float = 1.0

    def points(self, spacing_m: float) -> Float[np.ndarray, "n 3"]:
        """Return points along it, corners among them, no farther from each other than about `spacing_m`."""
        start, step, sagitta, _ = pieces(self, spacing_m)
        middle = start + step / 2 - sagitta[:, None] * [0.0, 0.0, 1.0]
        return np.concatenate([np.stack([start, middle], axis=1).reshape(-1, 3), self.vertex_m[-1:]])


@dataclass(frozen=True, kw_only=True, eq=False)
class ThinObstacle:
    """A wire with its parallels, a pole or a fence, by its key in the scenario.

    kind: "wires", "poles" or "fences".
    """

    name: str
    kind: str
    wires: tuple[Wire, ...]


def pieces(
    wire: Wire, longest_m: float
) -> tuple[
    Float[np.ndarray, "piece 3"], Float[np.ndarray, "piece 3"], Float[np.ndarray, " piece"], Float[np.ndarray, " piece"]
]:
    """Return starts and steps of pieces of a wire, their depths below their chords, and the length before each.

    A part of a parabola is one: its depth falls with the square of its length.
    """
    step = np.diff(wire.vertex_m, axis=0)
    length_m = np.linalg.norm(step, axis=1)
    count = np.maximum(np.ceil(length_m / longest_m), 1).astype(np.int64)
    leg = np.repeat(np.arange(len(step)), count)
    number = np.arange(len(leg)) - np.repeat(np.cumsum(count) - count, count)
    part = np.stack([number, number + 1]) / count[leg]
    ends = wire.vertex_m[:-1][leg] + part[..., None] * step[leg]
    ends[..., 2] -= 4 * wire.sag_m * part * (1 - part)
    before_m = np.concatenate([[0.0], np.cumsum(length_m)])[leg] + part[0] * length_m[leg]
    return ends[0], ends[1] - ends[0], wire.sag_m / count[leg] ** 2, before_m


def offset_line(line_m: Float[np.ndarray, "vertex 3"], offset_m: float) -> Float[np.ndarray, "vertex 3"]:
    """Return a polyline shifted to its right on the level, by the mean normal at corners.

    Upright legs take the direction of the leg before; at the start of the line of the first leg that has one, or north.
    """
    step = np.diff(line_m[:, :2], axis=0)
    length_m = np.linalg.norm(step, axis=1)
    leg = np.maximum.accumulate(np.where(length_m > 0, np.arange(len(step)), int(np.argmax(length_m > 0))))
    step = np.where(length_m[leg, None] > 0, step[leg], [0.0, 1.0])
    right = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    before, after = np.vstack([right[:1], right]), np.vstack([right, right[-1:]])
    normal = before + after
    # At a corner the parallels keep their distance from both legs.
    normal /= np.maximum(1 + np.einsum("ni,ni->n", before, after), 0.2)[:, None]
    return line_m + offset_m * np.column_stack([normal, np.zeros(len(line_m))])


def lattice_mast(
    foot_m: Float[np.ndarray, " 3"], height_m: float, base_m: float, top_m: float
) -> list[Float[np.ndarray, "n 3"]]:
    """Return the members of a square lattice mast: four legs, a ring at each level, and crossed braces between.

    Its panels are as high as it is wide at their feet, and at least a hundredth of its height.
    """
    levels = [0.0]
    while levels[-1] < height_m and len(levels) < 1000:
        width_m = base_m + (top_m - base_m) * levels[-1] / height_m
        levels.append(min(levels[-1] + max(width_m, height_m / 100), height_m))
    corner = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) / 2
    ring = [
        foot_m + np.column_stack([corner * (base_m + (top_m - base_m) * z / height_m), np.full(4, z)]) for z in levels
    ]
    members = [np.array([ring[0][k], ring[-1][k]]) for k in range(4)]
    for low, high in pairwise(ring):
        for k in range(4):
            after = (k + 1) % 4
            members += [np.array([high[k], high[after]]), np.array([low[k], high[after]])]
            members.append(np.array([low[after], high[k]]))
    return members


def branch(
    foot_m: Float[np.ndarray, " 3"], along: Float[np.ndarray, " 3"], length_m: float
) -> list[Float[np.ndarray, "n 3"]]:
    """Return a limb and six twigs of a third of its length, which leave it at 45 deg, a golden angle apart."""
    aside = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    other = np.cross(along, aside)
    parts = [np.array([foot_m, foot_m + length_m * along])]
    for twig in range(6):
        turn = np.pi * (3 - np.sqrt(5)) * twig
        way = (along + np.cos(turn) * aside + np.sin(turn) * other) / np.sqrt(2)
        start = foot_m + length_m * (0.3 + 0.1 * twig) * along
        parts.append(np.array([start, start + length_m / 3 * way]))
    return parts
