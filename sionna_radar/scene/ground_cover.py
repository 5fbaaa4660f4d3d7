"""Splitting the ground's mesh by what covers it: rectangles, polygons, and a raster of classes.

A face belongs to the cover that its middle lies in, so borders follow the mesh: its spacing is their accuracy.
Later covers lie over earlier ones: the raster's classes, then `fields`, then `cover`, each in the order given.
"""

import numpy as np
import rasterio
from jaxtyping import Float, Int
from matplotlib.path import Path as Outline
from pyproj import CRS, Transformer
from rasterio.errors import RasterioError
from rasterio.windows import Window

from sionna_radar.errors import InputFileError, Problem, ScenarioError
from sionna_radar.raster import Georeference
from sionna_radar.scenario.cover import CoverRaster
from sionna_radar.scenario.terrain import CoveredTerrain
from sionna_radar.scene.model import Surface
from sionna_radar.scene.placed_raster import apply_affine

NO_CLASS = -(2**31)


def cover_ground(
    vertices_m: Float[np.ndarray, "vertex 3"],
    faces: Int[np.ndarray, "face 3"],
    terrain: CoveredTerrain,
    georeference: Georeference | None,
) -> tuple[Surface, ...]:
    """Return the ground's mesh as one surface for each cover that shows.

    Raises
    ------
    ScenarioError, InputFileError
        A polygon covers nothing; the raster of classes cannot be read or placed.

    """
    middle = vertices_m[faces][:, :, :2].mean(axis=1)
    names = [terrain.material]
    owner = np.zeros(len(faces), dtype=np.int64)
    if terrain.cover_raster is not None:
        value = classes_at(terrain.cover_raster, middle, georeference)
        for cover_class, name in terrain.cover_raster.material_of_class.items():
            owner[value == cover_class] = len(names)
            names.append(name)
    for field in getattr(terrain, "fields", ()):
        owner[np.all(np.abs(middle - field.centre_m) <= np.array(field.size_m) / 2, axis=1)] = len(names)
        names.append(field.material)
    for index, polygon in enumerate(terrain.cover):
        inside = Outline(np.array(polygon.polygon_m)).contains_points(middle)
        if not inside.any():
            message = "covers no face of the terrain; move it, enlarge it, or refine terrain.spacing_m"
            raise ScenarioError([Problem(f"terrain.cover.{index}.polygon_m", message)])
        owner[inside] = len(names)
        names.append(polygon.material)
    return tuple(
        Surface(name=f"terrain-{number}", vertices_m=vertices_m, faces=faces[owner == number], material=name)
        for number, name in enumerate(names)
        if np.any(owner == number)
    )


def classes_at(
    cover: CoverRaster, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None
) -> Int[np.ndarray, " n"]:
    """Return the class value of the cell that each point of the plan lies in; NO_CLASS beyond the raster.

    Raises
    ------
    InputFileError
        The raster cannot be read, or lies nowhere over the points.
    ScenarioError
        Only one of the raster and the terrain has a place on the Earth.

    """
    try:
        with rasterio.open(cover.path) as source:
            x, y = _in_crs_of(source, point_m, georeference)
            column, row = apply_affine(~source.transform, x, y)
            inside = (column >= 0) & (column < source.width) & (row >= 0) & (row < source.height)
            value = np.full(len(point_m), NO_CLASS, dtype=np.int64)
            if not inside.any():
                message = f"{cover.path}: lies nowhere over the terrain; check its place and CRS"
                raise InputFileError(message)
            column, row = (c[inside].astype(np.int64) for c in (column, row))
            # No more of the file is read than the ground needs.
            window = Window(column.min(), row.min(), np.ptp(column) + 1, np.ptp(row) + 1)
            cells = source.read(1, window=window, masked=True).astype(np.int64).filled(NO_CLASS)
            value[inside] = cells[row - row.min(), column - column.min()]
            return value
    except RasterioError as error:
        message = f"{cover.path}: cannot be read as a raster ({error}); give a GeoTIFF of class values"
        raise InputFileError(message) from error


def _in_crs_of(
    source: rasterio.DatasetReader, point_m: Float[np.ndarray, "n 2"], georeference: Georeference | None
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return local points in the raster's own coordinates."""
    x, y = point_m.T
    if georeference is None:
        if source.crs is not None:
            message = (
                f"the raster is in {source.crs.to_string()}, but the terrain lies nowhere on the Earth; remove the "
                "raster's CRS, so that its coordinates are local metres, or use a georeferenced terrain"
            )
            raise ScenarioError([Problem("terrain.cover_raster.path", message)])
        return x, y
    if source.crs is None:
        message = "the raster has no CRS, so it cannot be placed; add one, e.g. with gdal_translate -a_srs"
        raise ScenarioError([Problem("terrain.cover_raster.path", message)])
    local = CRS.from_wkt(georeference.crs_wkt)
    # Only the plan is asked for: of a compound CRS the horizontal part.
    local = local.sub_crs_list[0] if local.is_compound else local
    turn = Transformer.from_crs(local, CRS.from_wkt(source.crs.to_wkt()), always_xy=True)
    east, north = georeference.origin_m[:2]
    there: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] = turn.transform(x + east, y + north)
    return there
