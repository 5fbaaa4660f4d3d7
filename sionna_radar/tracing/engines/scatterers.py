"""Scatterers fixed to the surface, for processing that needs the phase from chirp to chirp."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Complex, Float, Int

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.scene.model import Scene

MAX_SCATTERERS = 30_000_000
CELL_M = 4.0
# Powers of the inverse of the plastic number, the root of x^3 = x + 1.
ADDITIVE_STEP = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True, kw_only=True)
class Cells:
    """Groups of neighbouring scatterers, for a quick search of those in a beam.

    first: where each cell's scatterers begin; the last entry is the end of all.
    centre_m, radius_m: a sphere around them.
    """

    first: Int[np.ndarray, " edge"]
    centre_m: Float[np.ndarray, "cell 3"]
    radius_m: Float[np.ndarray, " cell"]

    def in_beams(
        self,
        apex_m: Float[np.ndarray, "beam 3"],
        R_world_antenna: Float[np.ndarray, "beam 3 3"],
        reach: tuple[float, float],
    ) -> tuple[Int[np.ndarray, " pair"], Int[np.ndarray, " pair"]]:
        """Return beam and scatterer of all pairs whose cell reaches into the beam.

        Parameters
        ----------
        apex_m, R_world_antenna:
            Where the beams start, and the axes of their antennas.
        reach:
            Largest direction cosines along left and up inside a beam.

        """
        half_angle_rad = np.arcsin(min(np.hypot(*reach), 1.0))
        ahead = R_world_antenna[:, :, 0]
        along = ahead @ self.centre_m.T - np.sum(ahead * apex_m, axis=1)[:, None]
        squares = np.sum(self.centre_m**2, axis=1) - 2 * apex_m @ self.centre_m.T + np.sum(apex_m**2, axis=1)[:, None]
        distance = np.sqrt(np.maximum(squares, 1e-12))
        # The small angle allows for rounding of these products.
        widened = half_angle_rad + np.arcsin(np.minimum(self.radius_m / distance, 1.0)) + 1e-4
        # First a cone around the beam, for all cells; then the beam's sides, for the remaining ones.
        beam, cell = np.nonzero(along >= distance * np.cos(np.minimum(widened, np.pi)))
        away, radius = self.centre_m[cell] - apex_m[beam], self.radius_m[cell]
        aside = np.abs(np.einsum("ni,nij->nj", away, R_world_antenna[beam, :, 1:]))
        bound = (np.array(reach) + 1e-4) * (distance[beam, cell] + radius)[:, None] + radius[:, None]
        near = np.all(aside <= bound, axis=1)
        beam, cell = beam[near], cell[near]
        length = self.first[cell + 1] - self.first[cell]
        begin = np.cumsum(length) - length
        which = np.arange(length.sum()) + np.repeat(self.first[cell] - begin, length)
        return np.repeat(beam, length), which


@dataclass(frozen=True, kw_only=True)
class Scatterers:
    """Points on the surfaces of a scene, each representing the same area, cell by cell.

    surface, face: where each lies, as indices of the scene's surfaces and of their triangles.
    normal: unit normal of the triangle.
    reflectivity: complex normal numbers of mean power one; the sum of any of them is exactly Gaussian, so that
        speckle is fully developed however few share a range cell.
    area_m2: area that each represents.
    """

    position_m: Float[np.ndarray, "scatterer 3"]
    normal: Float[np.ndarray, "scatterer 3"]
    surface: Int[np.ndarray, " scatterer"]
    face: Int[np.ndarray, " scatterer"]
    reflectivity: Complex[np.ndarray, " scatterer"]
    area_m2: float
    cells: Cells

    def __len__(self) -> int:
        return len(self.surface)


def scatter(
    scene: Scene,
    per_m2: float,
    seed: int,
    region_m: Float[np.ndarray, "2 3"] | None = None,
) -> Scatterers:
    """Distribute scatterers over a scene, uniformly by area.

    Parameters
    ----------
    scene:
        The surfaces.
    per_m2:
        Scatterers per square metre of surface.
    seed:
        Each surface has its own generator, so that adding one leaves the others' scatterers where they were.
    region_m:
        Lowest and highest corner of the box of interest; triangles wholly outside get none. None: no limit.

    Raises
    ------
    ScenarioError
        There would be more than fit into memory.

    """
    corners = [s.vertices_m[s.faces] for s in scene.surfaces]
    inside = [_touching(c, region_m) for c in corners]
    _check_count(sum(_area(c[i]).sum() for c, i in zip(corners, inside, strict=True)), per_m2)
    parts = []
    for index, (corner, use) in enumerate(zip(corners, inside, strict=True)):
        generator = np.random.default_rng([seed, index])
        face = _by_area(_area(corner), per_m2, generator)
        share = _barycentric(face, len(corner), generator)
        kept = use[face]
        field = generator.standard_normal((len(face), 2)) * np.sqrt(0.5)
        face, share, field = face[kept], share[kept], field[kept]
        triangle = corner[face]
        normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])
        position = np.einsum("nk,nki->ni", share, triangle)
        unit = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        parts.append((position, unit, np.full(len(face), index), face, field[:, 0] + 1j * field[:, 1]))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order, first = _cell_order(columns[0])
    position, normal, surface, face, reflectivity = (column[order] for column in columns)
    return Scatterers(
        position_m=position,
        normal=normal,
        surface=surface,
        face=face,
        reflectivity=reflectivity,
        area_m2=1 / per_m2,
        cells=_cells(position, first),
    )


def check_scatterers(scene: Scene, per_m2: float, region_m: Float[np.ndarray, "2 3"] | None = None) -> None:
    """Refuse what `scatter` would refuse, before any scatterer is made; see there for the parameters."""
    area = 0.0
    for surface in scene.surfaces:
        corner = surface.vertices_m[surface.faces]
        area += float(_area(corner[_touching(corner, region_m)]).sum())
    _check_count(area, per_m2)


def _check_count(area_m2: float, per_m2: float) -> None:
    count = area_m2 * per_m2
    if count > MAX_SCATTERERS:
        message = (
            f"{per_m2:g} gives {count:.3g} scatterers, more than {MAX_SCATTERERS:,}; "
            f"lower it to {0.99 * MAX_SCATTERERS / area_m2:.3g}"
        )
        raise ScenarioError([Problem("tracing.scatterers_per_m2", message)])


def _cell_order(position_m: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the order that groups scatterers by cubes of space, and where each cube begins in it."""
    index = np.floor(position_m / CELL_M).astype(np.int64)
    index -= index.min(axis=0, initial=0)
    key = np.ravel_multi_index(tuple(index.T), tuple(index.max(axis=0, initial=0) + 1))
    order = np.argsort(key, kind="stable")
    return order, np.flatnonzero(np.diff(key[order], prepend=-1))


def _cells(position_m: Float[np.ndarray, "n 3"], first: Int[np.ndarray, " cell"]) -> Cells:
    if len(first) == 0:
        return Cells(first=np.zeros(1, dtype=np.int64), centre_m=np.zeros((0, 3)), radius_m=np.zeros(0))
    low, high = np.minimum.reduceat(position_m, first), np.maximum.reduceat(position_m, first)
    return Cells(
        first=np.append(first, len(position_m)),
        centre_m=(low + high) / 2,
        radius_m=np.linalg.norm(high - low, axis=1) / 2,
    )


def _area(corner: Float[np.ndarray, "face 3 3"]) -> Float[np.ndarray, " face"]:
    return np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1) / 2


def _touching(
    corner: Float[np.ndarray, "face 3 3"], region_m: Float[np.ndarray, "2 3"] | None
) -> Bool[np.ndarray, " face"]:
    if region_m is None:
        return np.ones(len(corner), dtype=bool)
    return np.all((corner.max(axis=1) >= region_m[0]) & (corner.min(axis=1) <= region_m[1]), axis=1)


def _by_area(
    area: Float[np.ndarray, " face"], per_m2: float, generator: np.random.Generator
) -> Int[np.ndarray, " scatterer"]:
    """Return the triangle of each scatterer: equal steps of area from one random start."""
    edge = np.cumsum(area) * per_m2
    step = np.arange(int(edge[-1] + generator.random())) + generator.random()
    return np.minimum(np.searchsorted(edge, step, side="right"), len(area) - 1)


def _barycentric(face: Int[np.ndarray, " n"], faces: int, generator: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Return the position of each scatterer in its triangle.

    The scatterers of a triangle follow an additive sequence with a random start (Roberts 2018, "The unreasonable
    effectiveness of quasirandom sequences"), which spreads them more evenly than random draws: a range cell then holds
    nearly the number it should.
    """
    first = np.flatnonzero(np.diff(face, prepend=-1))
    number = np.arange(len(face)) - np.repeat(first, np.diff(first, append=len(face)))
    start = generator.random((faces, 2))[face]
    u, v = np.mod(start + number[:, None] * ADDITIVE_STEP, 1.0).T
    root = np.sqrt(u)
    return np.column_stack([1 - root, root * (1 - v), root * v])
