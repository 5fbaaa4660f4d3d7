"""
A site of your own: meshes, footprints and land use
===================================================

What a site office has: a CAD model of a bridge (GLB, millimetres, y up), a pylon (OBJ with materials), the outlines of
the buildings and the land use (GeoJSON, as OpenStreetMap gives them). This script writes such files into a temporary
folder, stands them on hilly ground with a place on the map, and flies over them. Give your own files in their places.

The bridge overhangs: the truth of a DEM is then the highest surface, and `summary.json` counts the cells below it.
"""

# %%
import itertools
import json
import os
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from pyproj import Transformer

from sionna_radar import load_scenario, run
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster

SMALL = "SIONNA_RADAR_SMALL" in os.environ
FOLDER = Path(tempfile.mkdtemp())
PLACE = (10.9, 47.55)  # longitude and latitude of the local origin


# %%
def beam(start, end, width):
    """A square bar between two points."""
    bar = trimesh.creation.box((width, width, np.linalg.norm(np.subtract(end, start))))
    turn = trimesh.geometry.align_vectors([0, 0, 1], np.subtract(end, start))
    turn[:3, 3] = np.add(start, end) / 2
    return bar.apply_transform(turn)


def bridge():
    """A deck on three piers, 60 m along the file's z axis; as CAD gives it: millimetres, and y up."""
    slabs = [((0, 8.6, 0), (6, 1.2, 60))] + [((0, 4.0, z), (4, 8.0, 1.5)) for z in (-20, 0, 20)]
    slabs += [((x, 9.6, 0), (0.3, 0.8, 60)) for x in (-2.85, 2.85)]
    mesh = trimesh.util.concatenate(
        [trimesh.creation.box(size, trimesh.transformations.translation_matrix(place)) for place, size in slabs]
    )
    return mesh.apply_scale(1000)


def pylon():
    """A lattice of four legs, braces and three cross-arms, 32 m high."""
    levels = np.array([0.0, 7.0, 13.0, 18.0, 22.0, 26.0, 32.0])
    corners = [3.2 * (1 - z / 36) * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) for z in levels]
    rings = [np.column_stack([c, np.full(4, z)]) for c, z in zip(corners, levels, strict=True)]
    bars = []
    for low, high in itertools.pairwise(rings):
        bars += [beam(low[i], high[i], 0.35) for i in range(4)]
        bars += [beam(low[i], high[(i + 1) % 4], 0.2) for i in range(4)]
        bars += [beam(high[i], high[(i + 1) % 4], 0.2) for i in range(4)]
    for z, reach in ((18.0, 7.0), (22.0, 8.5), (26.0, 6.0)):
        bars += [beam((-reach, 0, z), (reach, 0, z), 0.4), beam((-reach, 0, z), (0, 0, z + 2), 0.2)]
        bars += [beam((reach, 0, z), (0, 0, z + 2), 0.2)]
    return trimesh.util.concatenate(bars)


bridge().export(FOLDER / "bridge.glb")
(FOLDER / "pylon.obj").write_text("usemtl galvanised steel\n" + trimesh.exchange.obj.export_obj(pylon()))

# %%
# Buildings and land use, in longitude and latitude: a street of houses, a farm about a yard, a wood. Heights are what
# mappers write: metres, storeys, or nothing.
to_lonlat = Transformer.from_crs(32632, 4326, always_xy=True)
origin = to_lonlat.transform(*PLACE, direction="INVERSE")


def ring(centre, size, heading_deg=0.0):
    """A rectangle about a local place as a closed ring of longitudes and latitudes."""
    turn = np.deg2rad(heading_deg)
    corner = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * np.array(size) / 2
    place = corner @ [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]] + centre + np.array(origin)
    return np.column_stack(to_lonlat.transform(*place.T)).tolist()


def write(name, features):
    """Write polygons, given by their rings and properties, as GeoJSON."""
    collection = [
        {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": rings}}
        for rings, properties in features
    ]
    (FOLDER / name).write_text(json.dumps({"type": "FeatureCollection", "features": collection}))


houses = [([ring((-8 + 21 * i, -34 - 4 * i), (9, 11), 12)], {"height": f"{6 + i % 3} m"}) for i in range(4)]
houses += [([ring((2 + 21 * i, -57 - 4 * i), (10, 8), 12)], {"building:levels": str(1 + i % 2)}) for i in range(3)]
houses += [([ring((2, 44), (26, 20), 20), ring((2, 44), (14, 8), 20)], {"height": "24 ft"})]
houses += [([ring((32, 47), (12, 9), 20)], {})]
write("buildings.geojson", houses)
write("landuse.geojson", [([ring((72, 44), (44, 36), -15)], {"landuse": "forest"})])

# %%
# Hills with all of it. `materials` maps a mesh's own names; `heading_deg` turns it clockwise.
SITE = {
    "description": "A site model on hills",
    "terrain": {
        "kind": "hills",
        "size_m": [340.0, 340.0],
        "spacing_m": 2.0 if SMALL else 0.5,
        "filter_sigma_m": 22.0,
        "height_m": 14.0,
        "seed": 5,
        "centre_lonlat_deg": PLACE,
        "cover_vector": {
            "path": str(FOLDER / "landuse.geojson"),
            "attribute": "landuse",
            "classes": {"forest": "forest"},
        },
    },
    "objects": [
        {
            "path": str(FOLDER / "bridge.glb"),
            "units": "mm",
            "position_m": [32.0, 2.0],
            "heading_deg": 70.0,
            "material": "concrete",
        },
        {
            "path": str(FOLDER / "pylon.obj"),
            "position_m": [50.0, -15.0],
            "heading_deg": 30.0,
            "materials": {"galvanised steel": "steel"},
        },
    ],
    "footprints": [
        {
            "path": str(FOLDER / "buildings.geojson"),
            "height": "height",
            "levels": "building:levels",
            "height_m": 5.0,
        }
    ],
    "materials": {
        "forest": {"model": "constant_gamma", "gamma_db": -7.0},
        "concrete": {"model": "constant_gamma", "gamma_db": -12.0},
        "steel": {"model": "constant_gamma", "gamma_db": 0.0},
    },
    "platform.start_m": [-85.0, 0.0],
    "platform.length_m": 3.0 if SMALL else 100.0,
    "platform.altitude_m": 60.0,
    "dem.method": "linear" if SMALL else "stepped",
    "processing.echoes": "all",
    "processing.ranging": "centroid",
}
survey = run(load_scenario("hills", SITE))
over = survey.overhang
print(f"{over.cells} cells of the map, {over.share:.1%}, have air between two surfaces: the bridge and the pylon")
print(f"RMS {survey.lit_error.rms_m:.2f} m, off the walls {survey.off_wall_error.rms_m:.2f} m")

# %%
# A photograph of the world that the radar saw, by the same ray caster: colours by material, one sun.
PAINT = {"ground": "#a9a378", "forest": "#4f7942", "building": "#b5694d", "concrete": "#d9d9d6", "steel": "#3f5870"}
SUN = np.array([-0.5, -0.35, 0.8]) / np.linalg.norm([-0.5, -0.35, 0.8])


def photograph(built, eye, toward, columns, rows, width_deg):
    """Colours of what a camera sees: columns x rows pixels, white where there is nothing."""
    ahead = np.subtract(toward, eye) / np.linalg.norm(np.subtract(toward, eye))
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    half = np.tan(np.deg2rad(width_deg) / 2)
    x, y = np.meshgrid(np.linspace(-half, half, 2 * columns), np.linspace(half, -half, 2 * rows) * rows / columns)
    # Four rays a pixel, so that edges are smooth.
    ray = ahead + x[..., None] * right + y[..., None] * np.cross(right, ahead)
    ray = (ray / np.linalg.norm(ray, axis=-1, keepdims=True)).reshape(-1, 3)
    hits = built.caster.cast(np.broadcast_to(np.array(eye, dtype=float), ray.shape), ray)
    colour = np.ones((len(ray), 3))
    seen = np.flatnonzero(hits.hit)
    place = np.array(eye) + hits.distance_m[seen, None] * ray[seen]
    in_sun = ~built.caster.cast(place + 0.05 * SUN, np.broadcast_to(SUN, place.shape)).hit
    paint = np.array([[int(PAINT[s.material][i : i + 2], 16) for i in (1, 3, 5)] for s in built.scene.surfaces]) / 255
    light = (0.55 + 0.45 * hits.cosine[seen]) * np.where(in_sun, 1.0, 0.55)
    colour[seen] = paint[hits.surface[seen]] * light[:, None]
    return colour.reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))


# %%
columns, rows = (320, 120) if SMALL else (1300, 500)
picture = photograph(survey.prepared.world, (-66, -178, 122), (36, -10, 2), columns, rows, 48.0)
heights, off = Normalize(*np.nanpercentile(survey.truth.height_m, [0.5, 99.7])), Normalize(-4.0, 4.0)
figure = Figure(figsize=(14.0, 10.1), layout="constrained")
top, bottom = figure.subfigures(2, 1, height_ratios=[5.2, 4.9])
view = top.subplots()
view.imshow(picture)
view.set_axis_off()
view.set_title("The site: a bridge (GLB), a pylon (OBJ), footprints and a wood (GeoJSON) on hills")
panels = bottom.subplots(1, 3)
error = f"DEM minus truth\nRMS {survey.lit_error.rms_m:.2f} m, {survey.off_wall_error.rms_m:.2f} m off the walls"
for axes, raster, colours, scale, title in (
    (panels[0], survey.truth, "viridis", heights, f"Truth: the highest surface\n{over.cells} cells have another below"),
    (panels[1], survey.dem, "viridis", heights, f"DEM\n{survey.lit_error.coverage:.0%} of the lit cells filled"),
    (panels[2], survey.error, "RdBu_r", off, error),
):
    show_raster(axes, raster, colours, scale)
    finish_map(axes, survey.truth.grid.extent_m, title)
    name = "Error (m)" if raster is survey.error else "Height (m)"
    colour_bar(axes, ScalarMappable(scale, colours), name, 2.4, extend="both" if raster is survey.error else "neither")
bottom.legend(handles=[empty_patch()], loc="outside lower center", frameon=False)
figure.savefig("site_model.png", dpi=100)
