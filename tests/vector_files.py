"""Vector files of known polygons, written by another library than the one under test where there is one."""

import json

import numpy as np
import pyogrio
import shapely

DRIVERS = {".gpkg": "GPKG", ".shp": "ESRI Shapefile"}


def rectangle(west, south, east, north):
    return [[west, south], [east, south], [east, north], [west, north], [west, south]]


def write_geojson(path, features, **members):
    """Write features: pairs of a geometry, or of the rings of a polygon, and its properties."""
    collection = {"type": "FeatureCollection", **members, "features": []}
    for geometry, properties in features:
        if isinstance(geometry, list):
            geometry = {"type": "Polygon", "coordinates": geometry}
        collection["features"].append({"type": "Feature", "properties": properties, "geometry": geometry})
    path.write_text(json.dumps(collection))
    return path


def write_by_gdal(path, features, crs, layer=None, append=False):
    """Write pairs of a shapely geometry and its attributes, whose values are text or numbers."""
    names = list(features[0][1])
    columns = [np.array([given[name] for _, given in features]) for name in names]
    columns = [c.astype(object) if c.dtype.kind == "U" else c for c in columns]
    pyogrio.raw.write(
        str(path),
        np.array(shapely.to_wkb([shape for shape, _ in features]), dtype=object),
        columns,
        np.array(names, dtype=object),
        layer=layer,
        append=append,
        driver=DRIVERS[path.suffix],
        geometry_type="Polygon",
        crs=crs,
    )
    return path
