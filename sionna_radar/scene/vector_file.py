"""Reader of shapes from vector files (GeoJSON, GeoPackage, Shapefile): polygons, lines of wires, points of obstacles.

GDAL opens far more than files, and follows references in small files regardless of their suffix. A file's first bytes
must therefore match its name. GeoJSON is read without GDAL; GDAL opens Shapefiles, and GeoPackages without views.
"""

import json
import sqlite3
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from pyproj import CRS
from pyproj.exceptions import ProjError

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.elevation.placed_raster import horizontal_crs, reproject
from sionna_radar.foundation.city_models import refuse_city_model
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError, reason_of
from sionna_radar.foundation.input_file import regular_file, shown

MAX_BYTES = 20_000_000_000
MAX_GEOJSON_BYTES = 200_000_000
MAX_FEATURES = 2_000_000
MAX_VERTICES = 50_000_000
REMEDY = "give GeoJSON (.geojson, .json), a GeoPackage (.gpkg) or a Shapefile (.shp), or convert it with ogr2ogr"
SHAPE_MAGIC, SQLITE_MAGIC, GPKG_IDS = b"\0\0\x27\x0a", b"SQLite format 3\0", (b"GPKG", b"GP10", b"GP11")
SIDE_CARS = (".dbf", ".shx", ".prj", ".cpg", ".qix", ".sbn", ".sbx")
WGS84 = CRS(4326)
EVERYWHERE = (-np.inf, -np.inf, np.inf, np.inf)
# Width that separates polygons in metres (wider) from polygons in degrees (narrower).
DEGREES = 0.01
# Samples along each side of a window for its bounds in another projection.
WINDOW_SAMPLES = 21


@dataclass(frozen=True, kw_only=True)
class Polygons:
    """The polygons of a vector file that touch a window, in local metres.

    values: of the requested attributes, one per polygon; None if missing.
    repaired, dropped: numbers of repaired invalid polygons, and of features that are not polygons.
    """

    shape: Any
    values: dict[str, np.ndarray]
    repaired: int
    dropped: int


@dataclass(frozen=True, kw_only=True)
class Lines:
    """The lines of a vector file that touch a window, in local metres.

    line: corners of each, shape (vertex, 2), without repeated ones.
    values: of the requested attributes, one per line; None if missing.
    dropped: number of features that are no lines.
    raised: number of lines with heights of their own (z), which are not read.
    """

    line: list[Float[np.ndarray, "vertex 2"]]
    values: dict[str, np.ndarray]
    dropped: int
    raised: int


@dataclass(frozen=True, kw_only=True)
class _Features:
    """Geometries of a file (shapely) with some attributes.

    crs: stated by the file, or None. default: of its format, used if it states none.
    """

    geometry: np.ndarray
    values: dict[str, np.ndarray]
    crs: CRS | None
    default: CRS | None = None


@dataclass(frozen=True, kw_only=True)
class VectorQuery:
    """What is read of a vector file.

    path, layer: the file, and its layer, required if there are several.
    key: the scenario's table that names them, for messages.
    attributes: names of the attributes to read.
    frame: position of the local frame on the map; None without one: coordinates are then local metres.
    window_m: west, south, east and north of the region of interest.
    """

    path: Path
    layer: str | None
    key: str
    attributes: Sequence[str]
    frame: MapFrame | None = None
    window_m: tuple[float, float, float, float] = EVERYWHERE

    @property
    def name(self) -> str:
        """The file in messages."""
        return f"{self.key}.path = {shown(self.path)}"


def read_polygons(query: VectorQuery) -> Polygons:
    """Return the polygons of a vector file that touch a window.

    Raises InputFileError if it is of another format, too large or damaged, or lacks the attribute or layer.
    Raises ScenarioError if only one of file and terrain is georeferenced.
    """
    with _errors_of(query.name):
        return _local(query, _features_of(query))


def read_lines(query: VectorQuery) -> Lines:
    """Return the lines of a vector file that touch a window; errors as of `read_polygons`."""
    with _errors_of(query.name):
        return _local_lines(query, _features_of(query))


def _features_of(query: VectorQuery) -> _Features:
    if _kind(query.path, f"{query.key}.path =") != "geojson":
        return _read_by_gdal(query, query.name)
    if query.layer is not None:
        message = f"GeoJSON has no layers, such as {shown(query.layer)}; remove it"
        raise ScenarioError.of(f"{query.key}.layer", message)
    return _read_geojson(query.path, query.name, query.attributes)


@dataclass(frozen=True, kw_only=True)
class VectorPoints:
    """The points of a vector file: coordinates (m), attributes by name, and the CRS; None for local metres."""

    place_m: Float[np.ndarray, "n 2"]
    values: dict[str, np.ndarray]
    crs: CRS | None


def read_points(path: Path, key: str, attributes: Sequence[str], layer: str) -> VectorPoints:
    """Return the points of a layer of a GeoPackage, in its own coordinates.

    path, key, attributes: see `VectorQuery`.

    Raises InputFileError as `read_polygons`, and for anything but points.
    """
    import shapely

    name = f"{key} = {shown(path)}"
    if _kind(path, f"{key} =") != "gpkg":
        raise InputFileError(f"{name} is not a GeoPackage; convert it with ogr2ogr")
    with _errors_of(name):
        query = VectorQuery(path=path, layer=layer, key=key, attributes=attributes)
        features = _read_by_gdal(query, name)
        if not np.all(shapely.get_type_id(features.geometry) == 0):
            raise InputFileError(f"{name} holds more than points; give a layer of points alone")
        place_m = shapely.get_coordinates(features.geometry)
        if len(place_m) != len(features.geometry):
            raise InputFileError(f"{name} holds empty points; remove them")
        return VectorPoints(place_m=place_m, values=features.values, crs=features.crs)


@contextmanager
def _errors_of(name: str) -> Iterator[None]:
    """Turn errors of a file's content into InputFileError."""
    try:
        with warnings.catch_warnings():
            # Warnings about lines with measures and overflow beyond a projection, neither of which are polygons.
            warnings.simplefilter("ignore")
            yield
    except RadarError:
        raise
    except Exception as error:
        from pyogrio.errors import DataSourceError
        from shapely.errors import ShapelyError

        of_content = (ValueError, TypeError, LookupError, AttributeError, OverflowError, OSError, RuntimeError)
        if not isinstance(error, (*of_content, DataSourceError, ShapelyError, ProjError, sqlite3.Error)):
            raise
        reason = reason_of(error)
        raise InputFileError(f"{name} cannot be read as a vector file ({reason}); {REMEDY}") from error


def _kind(path: Path, name: str) -> str:
    """Return the format of a file; its name and first bytes must agree."""
    size = regular_file(path, name, REMEDY, MAX_BYTES)
    refuse_city_model(path, name)
    with path.open("rb") as file:
        head = file.read(4096)
    suffix = path.suffix.lower()
    if suffix in (".geojson", ".json") and head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] == b"{":
        if size > MAX_GEOJSON_BYTES:
            raise InputFileError(
                f"{name} {shown(path)} has {size:,} bytes of GeoJSON, more than {MAX_GEOJSON_BYTES:,}; convert it to "
                "a GeoPackage with ogr2ogr"
            )
        return "geojson"
    if suffix == ".gpkg" and head.startswith(SQLITE_MAGIC) and head[68:72] in GPKG_IDS:
        return "gpkg"
    if suffix == ".shp" and head.startswith(SHAPE_MAGIC):
        stem = path.stem.lower()
        for side_file in path.parent.iterdir():
            if side_file.stem.lower() == stem and side_file.suffix.lower() in SIDE_CARS:
                regular_file(side_file, name, "remove it", MAX_BYTES)
        return "shp"
    message = f"{name} {shown(path)} is not a GeoJSON, GeoPackage or Shapefile by its name and content; {REMEDY}"
    raise InputFileError(message)


def _read_geojson(path: Path, name: str, attributes: Sequence[str]) -> _Features:
    import shapely

    try:
        document = json.loads(path.read_bytes().decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        message = f"{name} is not GeoJSON ({str(error)[:100] or 'nested too deeply'}); correct it, or export it again"
        raise InputFileError(message) from error
    features: Any = [document]
    if not isinstance(document, dict) or document.get("type") == "FeatureCollection":
        features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(features, list) or not all(isinstance(f, dict) for f in features):
        raise InputFileError(f"{name} has no list of features; give a FeatureCollection of GeoJSON")
    _check_count(len(features), name)
    if len(features) == 1 and "coordinates" in features[0]:
        features = [{"geometry": features[0], "properties": {}}]
    texts = [json.dumps(f.get("geometry")) for f in features]
    geometry = shapely.from_geojson(np.array(texts, dtype=object), on_invalid="ignore")
    properties = [f.get("properties") if isinstance(f.get("properties"), dict) else {} for f in features]
    values = {}
    for attribute in attributes:
        if not any(attribute in entry for entry in properties):
            _refuse_attribute(name, attribute, sorted({key for entry in properties[:1000] for key in entry}))
        values[attribute] = np.array([entry.get(attribute) for entry in properties], dtype=object)
    return _Features(geometry=np.atleast_1d(geometry), values=values, crs=_stated_crs(document, name), default=WGS84)


def _stated_crs(document: dict[str, Any], name: str) -> CRS | None:
    """Return the CRS named in a GeoJSON document (standard of 2008; that of 2016 allows only WGS 84)."""
    stated = document.get("crs")
    if stated is None:
        return None
    try:
        return CRS.from_user_input(str(stated["properties"]["name"]))
    except (ProjError, TypeError, KeyError) as error:
        message = f"{name} names the CRS {shown(stated)}, which is not a CRS; remove it, or give one like 'EPSG:25832'"
        raise InputFileError(message) from error


def _read_by_gdal(query: VectorQuery, name: str) -> _Features:
    import pyogrio
    import shapely

    path, layer, attributes = query.path, query.layer, query.attributes
    if path.suffix.lower() == ".gpkg":
        _check_tables(path, name)
    source = str(path.absolute())
    layers = [str(entry[0]) for entry in pyogrio.list_layers(source)]
    if layer is None and len(layers) != 1:
        message = f"{name} has {len(layers)} layers; name one as layer: {', '.join(map(shown, layers[:50]))}"
        raise InputFileError(message)
    if layer is not None and layer not in layers:
        raise InputFileError(f"{name} has no layer {shown(layer)}; it has {', '.join(map(shown, layers[:50]))}")
    info = pyogrio.read_info(source, layer=layer, force_feature_count=True)
    for attribute in attributes:
        if attribute not in info["fields"]:
            _refuse_attribute(name, attribute, [str(field) for field in info["fields"]])
    crs = CRS.from_user_input(info["crs"]) if info["crs"] else None
    bounds = _window_in(crs, query)
    _, _, blobs, columns = pyogrio.raw.read(
        source, layer=layer, columns=list(attributes), bbox=bounds, force_2d=True, max_features=MAX_FEATURES + 1
    )
    _check_count(len(blobs), name)
    geometry = shapely.from_wkb(blobs, on_invalid="ignore")
    fields = [field for field in info["fields"] if field in attributes]
    return _Features(geometry=geometry, values=dict(zip(fields, columns, strict=True)), crs=crs)


def _check_tables(path: Path, name: str) -> None:
    """Reject a GeoPackage whose layers are not plain tables: a view may never end, or access other files."""
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        layers = [row[0] for row in database.execute("SELECT table_name FROM gpkg_contents LIMIT 1000")]
        definitions = dict(database.execute("SELECT name, type || ' ' || coalesce(sql, '') FROM sqlite_master"))
    for layer in layers:
        definition = str(definitions.get(layer, "nothing"))
        if not definition.lower().startswith("table create table"):
            message = f"{name} has the layer {shown(layer)}, which is not a plain table; copy the layer with ogr2ogr"
            raise InputFileError(message)


def _window_in(crs: CRS | None, query: VectorQuery) -> tuple[float, float, float, float] | None:
    """Return the bounds of a window in a file's CRS; None if undefined there, or everywhere."""
    frame, window_m = query.frame, query.window_m
    if crs is None or frame is None or window_m == EVERYWHERE:
        return None if window_m == EVERYWHERE else window_m
    west, south, east, north = window_m
    x, y = np.meshgrid(np.linspace(west, east, WINDOW_SAMPLES), np.linspace(south, north, WINDOW_SAMPLES))
    projected = reproject(frame.crs, horizontal_crs(crs), x.ravel() + frame.origin_m[0], y.ravel() + frame.origin_m[1])
    if not np.isfinite(projected).all() or (crs.is_geographic and np.ptp(projected[0]) > 180):
        return None
    (low_x, low_y), (high_x, high_y) = np.min(projected, axis=1), np.max(projected, axis=1)
    # The sides of a window are curved in another projection: add a margin to the samples.
    over_x, over_y = 0.02 * (high_x - low_x), 0.02 * (high_y - low_y)
    return float(low_x - over_x), float(low_y - over_y), float(high_x + over_x), float(high_y + over_y)


def _local(query: VectorQuery, features: _Features) -> Polygons:
    """Return valid polygons in local metres that touch a window, with multipolygons split."""
    import shapely

    flat = shapely.force_2d(features.geometry)
    solid = np.isin(shapely.get_type_id(flat), (3, 6)) & ~shapely.is_empty(flat)
    shape, feature, local, owner = _parts(flat, solid, query, features)
    broken = np.bincount(owner, ~np.isfinite(local).all(axis=1), minlength=len(shape)) > 0
    shape = shapely.set_coordinates(shape.copy(), np.where(np.isfinite(local), local, 0.0))
    window = shapely.box(*query.window_m)
    invalid = ~shapely.is_valid(shape)
    touching = invalid.copy()
    touching[~invalid] = shapely.intersects(shape[~invalid], window)
    touching &= ~broken
    shape, feature, invalid = shape[touching], feature[touching], invalid[touching]
    if invalid.any():
        shape[invalid] = shapely.make_valid(shape[invalid])
        shape, parent = shapely.get_parts(shape, return_index=True)
        shape, subparent = shapely.get_parts(shape, return_index=True)  # collections hold multipolygons
        feature = feature[parent][subparent]
        selected = (shapely.get_type_id(shape) == 3) & shapely.intersects(shape, window)
        shape, feature = shape[selected], feature[selected]
    return Polygons(
        shape=shape,
        values={attribute: column[feature] for attribute, column in features.values.items()},
        repaired=int(invalid.sum()),
        dropped=int(np.count_nonzero(~solid)) + int(broken.sum()),
    )


def _parts(
    flat: np.ndarray, chosen: np.ndarray, query: VectorQuery, features: _Features
) -> tuple[np.ndarray, np.ndarray, Float[np.ndarray, "n 2"], np.ndarray]:
    """Return the parts of some shapes, the feature of each, their corners in local metres, and the part of each."""
    import shapely

    shape, feature = shapely.get_parts(flat[chosen], return_index=True)
    feature = np.flatnonzero(chosen)[feature]
    vertices = int(shapely.get_num_coordinates(shape).sum())
    if vertices > MAX_VERTICES:
        message = f"{query.name} has {vertices:,} vertices over the survey, more than {MAX_VERTICES:,}; simplify it"
        raise InputFileError(message)
    coordinates, owner = shapely.get_coordinates(shape, return_index=True)
    local = _transformed(coordinates, query, features)
    width_m = np.ptp(shapely.bounds(shape).reshape(-1, 2, 2), axis=1)
    if query.frame is None and len(shape) and np.median(width_m) < DEGREES:
        message = "its shapes measure millimetres, and so seem to be in degrees; set terrain.centre_lonlat_deg"
        raise ScenarioError.of(f"{query.key}.path", message)
    return shape, feature, local, owner


def _local_lines(query: VectorQuery, features: _Features) -> Lines:
    """Return the lines in local metres that touch a window, with multilines split."""
    import shapely

    flat = shapely.force_2d(features.geometry)
    chosen = np.isin(shapely.get_type_id(flat), (1, 5)) & ~shapely.is_empty(flat)
    shape, feature, local, owner = _parts(flat, chosen, query, features)
    window, kept, lines = shapely.box(*query.window_m), [], []
    for number, line in enumerate(np.split(local, np.flatnonzero(np.diff(owner)) + 1) if len(shape) else []):
        line = line[np.append(True, np.any(np.diff(line, axis=0) != 0, axis=1))]
        if len(line) > 1 and np.isfinite(line).all() and shapely.LineString(line).intersects(window):
            kept.append(number)
            lines.append(line)
    values = {attribute: column[feature[kept]] for attribute, column in features.values.items()}
    raised = int(np.count_nonzero(shapely.has_z(features.geometry[feature[kept]])))
    return Lines(line=lines, values=values, dropped=int(np.count_nonzero(~chosen)), raised=raised)


def _transformed(
    coordinates: Float[np.ndarray, "n 2"], query: VectorQuery, features: _Features
) -> Float[np.ndarray, "n 2"]:
    frame, key, name = query.frame, f"{query.key}.path", query.name
    if frame is None:
        if features.crs is None:
            return coordinates
        message = (
            f"the file is in {features.crs.name!r}, but the terrain is on no map; set terrain.centre_lonlat_deg, or "
            "remove the file's CRS, so that its coordinates are local metres"
        )
        raise ScenarioError.of(key, message)
    crs = features.crs or features.default
    if crs is None:
        message = "the file has no CRS, but the terrain has a place on the map; add one with ogr2ogr -a_srs"
        raise ScenarioError.of(key, message)
    file_crs = horizontal_crs(crs)
    if not (file_crs.is_projected or file_crs.is_geographic):
        message = f"{name} is in {file_crs.name!r}, neither projected nor geographic; convert it with ogr2ogr -t_srs"
        raise InputFileError(message)
    try:
        return np.column_stack(frame.local_of(file_crs, *coordinates.T))
    except ProjError as error:
        raise InputFileError(
            f"{name} is in {file_crs.name!r}, which cannot be transformed to {frame.crs.name!r} ({error}); convert it "
            "with ogr2ogr -t_srs"
        ) from error


def _check_count(count: int, name: str) -> None:
    if count > MAX_FEATURES:
        message = f"{name} has {count:,} features, more than {MAX_FEATURES:,}; cut out the part that is flown"
        raise InputFileError(message)


def _refuse_attribute(name: str, attribute: str, available: list[str]) -> None:
    listed = ", ".join(available[:50]) or "none"
    raise InputFileError(f"{name} has no attribute {shown(attribute)}; it has {listed[:1000]}")
