"""Land cover of the ground mesh, the bare ground under objects, and detection of overhangs.

Covers are rectangles, polygons, and files of classes. A face belongs to the cover that contains its centre, so borders
follow the mesh: its spacing is their accuracy. Later covers override earlier ones: the raster's classes, then those of
the vector file, then `fields`, then `cover`, each in the order given.

Surfaces may lie over one another. A vertical ray from below meets undersides, which face down, and tops, which face up.
From a top to the next underside is air; from an underside to the next top is solid, as is the space below a top without
an underside (a roof on walls).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import find_objects, label

from sionna_radar.elevation.local_frame import frame_of
from sionna_radar.elevation.placed_raster import apply_affine, in_crs_of
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Georeference, Grid, box_around
from sionna_radar.scene.model import Surface
from sionna_radar.scene.raycast import EDGE_JUMP_M, EDGE_STEP_M, RayCaster
from sionna_radar.scene.vector_file import VectorQuery, read_polygons

NO_CLASS = -(2**31)
MAX_CELLS_READ = 100_000_000


@dataclass(frozen=True, kw_only=True)
class ClassRaster:
    """A raster of land-cover classes, and the material of each."""

    path: Path
    materials: Mapping[int, str]


@dataclass(frozen=True, kw_only=True)
class ClassPolygons:
    """A vector file of land-cover polygons, and the material of each value of an attribute; layer: None for its own."""

    path: Path
    attribute: str
    materials: Mapping[str, str]
    layer: str | None = None


@dataclass(frozen=True, kw_only=True)
class MaterialRectangle:
    """A rectangle of another material: its centre and its size along east and north."""

    centre_m: tuple[float, float]
    size_m: tuple[float, float]
    material: str


@dataclass(frozen=True, kw_only=True)
class MaterialPolygon:
    """A polygon of another material, by its corners."""

    corners_m: Sequence[tuple[float, float]]
    material: str


@dataclass(frozen=True, kw_only=True)
class GroundCover:
    """The material of the ground, and its covers in their order; see the module."""

    material: str = "ground"
    raster: ClassRaster | None = None
    vector: ClassPolygons | None = None
    fields: tuple[MaterialRectangle, ...] = ()
    polygons: tuple[MaterialPolygon, ...] = ()

    @property
    def bare(self) -> bool:
        """Whether nothing covers the ground."""
        return self.raster is None and self.vector is None and not self.fields and not self.polygons


def cover_ground(
    vertices_m: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    cover: GroundCover,
    georeference: Georeference | None,
) -> tuple[Surface, ...]:
    """Return the ground's mesh as one surface for each visible cover.

    Raises ScenarioError, InputFileError if a polygon covers no face; the raster of classes cannot be read or
        georeferenced.
    """
    if cover.bare:
        return (Surface(name="terrain-0", vertices_m=vertices_m, faces=faces, material=cover.material),)
    names, owner = materials_at(cover, vertices_m[faces][:, :, :2].mean(axis=1), georeference, faces=True)
    count = np.bincount(owner, minlength=len(names))
    if np.count_nonzero(count) == 1:
        only = int(np.argmax(count))
        return (Surface(name=f"terrain-{only}", vertices_m=vertices_m, faces=faces, material=names[only]),)
    groups = np.split(np.argsort(owner, kind="stable"), np.cumsum(count)[:-1])
    return tuple(
        _with_faces(vertices_m, faces[face_rows], number, names[number])
        for number, face_rows in enumerate(groups)
        if len(face_rows)
    )


def materials_at(
    cover: GroundCover, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None, faces: bool = False
) -> tuple[list[str], Int[np.ndarray, " n"]]:
    """Return the materials of a ground and its covers, and the number of the one at each horizontal position.

    faces: whether the positions are those of all of the ground, where each polygon has to cover one.

    Raises ScenarioError, InputFileError as `cover_ground`.
    """
    names = [cover.material]
    owner = np.zeros(len(point_m), dtype=np.int64)
    if cover.raster is not None:
        value = classes_at(cover.raster, point_m, georeference)
        for cover_class, name in cover.raster.materials.items():
            owner[value == cover_class] = len(names)
            names.append(name)
    if cover.vector is not None:
        value = vector_classes_at(cover.vector, point_m, georeference)
        owner = np.where(value >= 0, len(names) + value, owner)
        names += cover.vector.materials.values()
    for field in cover.fields:
        owner[np.all(np.abs(point_m - field.centre_m) <= np.array(field.size_m) / 2, axis=1)] = len(names)
        names.append(field.material)
    for index, polygon in enumerate(cover.polygons):
        covered = _inside(np.array(polygon.corners_m), point_m)
        if faces and len(covered) == 0:
            message = "covers no face of the terrain; move it, enlarge it, or refine terrain.spacing_m"
            raise ScenarioError.of(f"terrain.cover.{index}.polygon_m", message)
        owner[covered] = len(names)
        names.append(polygon.material)
    return names, owner


def _with_faces(
    vertices_m: Float[np.ndarray, "vertex 3"], faces: Int[np.ndarray, "face 3"], cover: int, material: str
) -> Surface:
    """Return some faces of the ground as a surface, with only their vertices."""
    kept_vertices, index = np.unique(faces, return_inverse=True)
    return Surface(
        name=f"terrain-{cover}", vertices_m=vertices_m[kept_vertices], faces=index.reshape(-1, 3), material=material
    )


def _inside(corner_m: Float[np.ndarray, "corner 2"], point_m: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " inside"]:
    """Return the indices of points in a polygon; only those in its bounding box are tested against its sides."""
    from shapely import Polygon, contains_xy

    lower, upper = corner_m.min(axis=0), corner_m.max(axis=0)
    in_box = np.flatnonzero(np.all((point_m >= lower) & (point_m <= upper), axis=1))
    return in_box[contains_xy(Polygon(corner_m), point_m[in_box])]


def vector_classes_at(
    cover: ClassPolygons, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None
) -> Int[np.ndarray, " n"]:
    """Return the class at each horizontal position, by its number in the table; -1 without one.

    The last of overlapping polygons in the file counts; polygons of classes outside the table are ignored.

    Raises InputFileError if the file cannot be read, or none of its polygons of these classes lies over the points.
    Raises ScenarioError if only one of the file and the terrain is georeferenced.
    """
    import shapely

    query = VectorQuery(
        path=cover.path,
        layer=cover.layer,
        key="terrain.cover_vector",
        attributes=[cover.attribute],
        frame=frame_of(georeference),
        window_m=box_around(point_m),
    )
    polygons = read_polygons(query)
    class_index = {name: polygon_class for polygon_class, name in enumerate(cover.materials)}
    polygon_class = np.array(
        [class_index.get(_class_name(v), -1) for v in polygons.values[cover.attribute]], dtype=np.int64
    )
    shape, polygon_class = polygons.shape[polygon_class >= 0], polygon_class[polygon_class >= 0]
    point, polygon = shapely.STRtree(shapely.points(point_m)).query(shape, predicate="covers")[::-1]
    if len(point) == 0:
        options = sorted({_class_name(v) for v in polygons.values[cover.attribute]})
        raise InputFileError(
            f"{query.name}: no polygon of the classes {', '.join(map(shown, cover.materials))} "
            f"lies over the terrain; those over it are {', '.join(map(shown, options[:50])) or 'none'}"
        )
    last_polygon = np.full(len(point_m), -1, dtype=np.int64)
    np.maximum.at(last_polygon, point, polygon)  # polygons are in the order of the file
    return np.where(last_polygon >= 0, polygon_class[last_polygon], -1)


def _class_name(value: Any) -> str:
    """Return an attribute's value as a class name: integers without decimals, 3 for 3.0."""
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return "" if value is None else str(value)


def classes_at(
    cover: ClassRaster, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None
) -> Int[np.ndarray, " n"]:
    """Return the class value of the raster cell at each horizontal position; NO_CLASS beyond the raster.

    Raises InputFileError if the raster cannot be read, or does not overlap the points.
    Raises ScenarioError if only one of the raster and the terrain is georeferenced.
    """
    key, content = "terrain.cover_raster.path", "class values; give a GeoTIFF of whole numbers"
    covered, cells = raster_at(cover.path, key, content, point_m, georeference)
    value = np.full(len(point_m), NO_CLASS, dtype=np.int64)
    value[covered] = _whole(cells)
    return value


def raster_at(
    path: Path | str, key: str, wanted: str, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None
) -> tuple[Bool[np.ndarray, " n"], np.ma.MaskedArray]:
    """Return a mask of the horizontal positions that a raster covers, and the values of its cells there.

    path, key, wanted: the file, its dotted key, and its expected content, for messages.
    point_m, georeference: the positions, and the georeference of the local frame.

    Raises InputFileError if the raster cannot be read, or does not overlap the points.
    Raises ScenarioError if only one of the raster and the terrain is georeferenced.
    """
    # rasterio, which nothing but a file needs, takes long to import.
    from sionna_radar.foundation.raster_file import open_raster, require_cells

    with open_raster(path, key) as source:
        require_cells(source, str(path), wanted)
        x, y = in_crs_of(source, point_m, georeference, key)
        column, row = apply_affine(~source.transform, x, y)
        inside = (column >= 0) & (column < source.width) & (row >= 0) & (row < source.height)
        if not inside.any():
            raise InputFileError(f"{path}: does not overlap the terrain; check its position and CRS")
        column, row = (c[inside].astype(np.int64) for c in (column, row))
        # Read only the part of the file over the ground.
        left, top, width, height = column.min(), row.min(), np.ptp(column) + 1, np.ptp(row) + 1
        if width * height > MAX_CELLS_READ:
            raise InputFileError(
                f"{path}: has {width:,} x {height:,} cells over the terrain, more than "
                f"{MAX_CELLS_READ:,}; coarsen it with gdal_translate -tr"
            )
        cells = source.read(1, window=((top, top + height), (left, left + width)), masked=True)
        return inside, cells[row - top, column - left]


def _whole(cells: np.ma.MaskedArray) -> Int[np.ndarray, " n"]:
    """Return class values as integers; invalid ones are NO_CLASS."""
    if cells.dtype.kind != "f":
        return np.ma.filled(cells.astype(np.int64), NO_CLASS)
    stored = cells.filled(np.nan)
    return np.where(np.abs(stored) < -NO_CLASS, stored, NO_CLASS).astype(np.int64)


# Smaller gaps are contact between stacked objects, not air.
MIN_AIR_M = 0.1
# Restart offset of a ray behind the last surface; the ray tracer computes in float32.
STEP_M = 0.002
MAX_LAYERS = 32
RAYS_AT_ONCE = 1_000_000


# Largest number of listed places with an overhang.
MAX_PLACES = 20


@dataclass(frozen=True, kw_only=True)
class OverhungPlace:
    """Connected cells with air under a surface: their number and local extent (west, south, east, north)."""

    cells: int
    extent_m: tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Overhang:
    """Cells of a DEM above which there is more than one surface.

    cells: number. share: of all cells with a surface. places: the largest first, at most `MAX_PLACES`.
    """

    cells: int
    share: float
    places: tuple[OverhungPlace, ...] = ()


def bare_ground(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float, top_m: float
) -> Float[np.ndarray, " n"]:
    """Return the height of the lowest upward-facing surface at horizontal positions; NaN without one."""
    lowest_m = _lowest_top(caster, point_m, bottom_m, top_m)
    # A ray may slip through the edge between two triangles; a slightly offset one then decides.
    offset_m = _lowest_top(caster, point_m + EDGE_STEP_M, bottom_m, top_m)
    slipped = np.nan_to_num(lowest_m - offset_m, nan=np.inf) > EDGE_JUMP_M
    return np.where(slipped & np.isfinite(offset_m), offset_m, lowest_m)


def _lowest_top(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float, top_m: float
) -> Float[np.ndarray, " n"]:
    lowest_m = np.full(len(point_m), np.nan)
    height = np.full(len(point_m), bottom_m)
    active = np.arange(len(point_m))
    for _ in range(MAX_LAYERS):
        if len(active) == 0:
            break
        hit_m, upward = _next_above(caster, point_m[active], height[active])
        lowest_m[active[upward]] = hit_m[upward]
        height[active] = hit_m + STEP_M
        active = active[np.isfinite(hit_m) & ~upward & (hit_m < top_m)]
    return lowest_m


def overhang(caster: RayCaster, grid: Grid, bottom_m: float) -> Overhang:
    """Return the cells of a grid where air lies between two surfaces, at their centres."""
    centre_m = grid.centres_m
    overhung, covered = np.zeros((2, len(centre_m)), dtype=bool)
    for start in range(0, len(centre_m), RAYS_AT_ONCE):
        rows = slice(start, start + RAYS_AT_ONCE)
        overhung[rows], covered[rows] = _air_below(caster, centre_m[rows], bottom_m)
    cells = int(overhung.sum())
    places = _places(overhung.reshape(grid.shape), grid)
    return Overhang(cells=cells, share=cells / int(covered.sum()) if covered.any() else 0.0, places=places)


def _places(overhung: Bool[np.ndarray, "row column"], grid: Grid) -> tuple[OverhungPlace, ...]:
    """Return the 8-connected groups of cells, the largest first."""
    labels, _ = label(overhung, structure=np.ones((3, 3)))
    count = np.bincount(labels.ravel())[1:]
    places = []
    for group, (rows, columns) in enumerate(find_objects(labels)):
        west, east, south, north = grid.cut(rows, columns).extent_m
        places.append(OverhungPlace(cells=int(count[group]), extent_m=(west, south, east, north)))
    return tuple(sorted(places, key=lambda place: -place.cells)[:MAX_PLACES])


def _air_below(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], bottom_m: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return masks of the positions with air under a surface, and of those with any surface."""
    airy, met_any = np.zeros((2, len(point_m)), dtype=bool)
    height = np.full(len(point_m), bottom_m)
    top = np.full(len(point_m), np.nan)  # the last surface met, if it faces up
    active = np.arange(len(point_m))
    for _ in range(MAX_LAYERS):
        if len(active) == 0:
            break
        hit_m, upward = _next_above(caster, point_m[active], height[active])
        hit = np.isfinite(hit_m)
        met_any[active] |= hit
        airy[active] |= hit & ~upward & (hit_m - top[active] > MIN_AIR_M)
        top[active] = np.where(upward, hit_m, np.nan)
        height[active] = hit_m + STEP_M
        active = active[hit & ~airy[active]]
    return airy, met_any


def _next_above(
    caster: RayCaster, point_m: Float[np.ndarray, "n 2"], from_m: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Return the height of the next surface above each point, NaN without one, and whether it faces up."""
    origin = np.column_stack([point_m, from_m])
    hits = caster.intersect(caster.prepare(origin, np.broadcast_to([0.0, 0.0, 1.0], origin.shape)))
    hit = hits.is_valid().numpy()
    distance = np.where(hit, hits.t.numpy(), np.nan).astype(np.float64)
    return from_m + distance, hit & (hits.n.numpy()[2] > 0)
