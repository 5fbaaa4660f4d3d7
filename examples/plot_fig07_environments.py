"""
Paper Fig. 7: environments
==========================

The surfaces that the beam is traced on: box buildings on flat ground, and real terrain (SRTM).
"""

# %%
import os

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from sionna_radar import load_scenario, prepare
from sionna_radar.scene import TerrainInputs, build_landscape

SMALL = "SIONNA_RADAR_SMALL" in os.environ
SUN = LightSource(azdeg=315, altdeg=45)


def north_arrow(axes, x, y, z, length):
    """Draw an arrow to the north into a 3-D view."""
    axes.quiver(x, y, z, 0, length, 0, color="black", lw=1.8, arrow_length_ratio=0.35, zorder=500)
    axes.text(x, y + 1.25 * length, z, "N", weight="bold", ha="center", va="center", zorder=500)


figure = Figure(figsize=(11.5, 4.9), layout="constrained")

# %%
# Four boxes on flat ground, as scenes/buildings.toml places them, coloured by the height of each face.
scene = prepare(load_scenario("buildings")).world.scene
boxes = [surface for surface in scene.surfaces if surface.name.startswith("building")]
heights = Normalize(0, 10)
left = figure.add_subplot(1, 2, 1, projection="3d", computed_zorder=False)
west, east, south, north = -40.0, 60.0, -50.0, 50.0
ground = [[(west, south, 0), (east, south, 0), (east, north, 0), (west, north, 0)]]
left.add_collection3d(Poly3DCollection(ground, facecolors=["0.85"], zorder=1))
for box in boxes:
    triangles = box.vertices_m[box.faces]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    colours = np.tile(colormaps["viridis"](heights(triangles[:, :, 2].max())), (len(triangles), 1))
    colours[:, :3] *= 0.72 + 0.28 * np.clip(normal @ [-0.3, -0.2, 0.93], 0, 1)[:, None]
    # The nearer of two boxes is drawn over the farther one.
    order = 200 - box.vertices_m[:, 1].max()
    left.add_collection3d(Poly3DCollection(triangles, facecolors=colours, zorder=order))
north_arrow(left, -34.0, 20.0, 0.0, 14.0)
left.set(xlim=(west, east), ylim=(south, north), zlim=(0, 25), xlabel="East (m)", ylabel="North (m)")
left.set_zticks([0, 10])
left.set_title("Boxes on flat ground", fontsize="medium")
left.set_box_aspect((east - west, north - south, 25), zoom=1.1)
left.view_init(38, -60)
figure.colorbar(ScalarMappable(heights, "viridis"), ax=left, label="Height of the roof (m)", shrink=0.6, pad=0.09)

# %%
# The mountains of scenes/jacksboro.toml: posts 3 arc seconds apart, in a local frame of metres.
scenario = load_scenario("jacksboro")
window_m = (-1800.0, -1800.0, 1800.0, 1800.0)
land = build_landscape(scenario.terrain, TerrainInputs(window_m=window_m, carrier_hz=77e9, channel="VV"))
raster, place = land.heights, land.georeference
step = 2 if SMALL else 1
x, y = np.meshgrid(raster.grid.x_m[::step], raster.grid.y_m[::step])
z = raster.height_m[::step, ::step] + (place.origin_m[2] if place else 0.0)
limits = Normalize(np.nanmin(z), np.nanmax(z))
colours = SUN.shade(z, colormaps["viridis"], norm=limits, vert_exag=1.5, dx=90 * step, dy=90 * step, blend_mode="soft")
right = figure.add_subplot(1, 2, 2, projection="3d", computed_zorder=False)
right.plot_surface(x / 1e3, y / 1e3, z, facecolors=colours, rstride=1, cstride=1, lw=0, antialiased=False, shade=False)
north_arrow(right, -1.75, -1.75, float(np.nanmax(z)), 0.6)
right.set(xlabel="East (km)", ylabel="North (km)")
right.set_zticks([400, 600, 800])
right.set_title("Real terrain: Jacksboro, Tennessee (heights 2 times exaggerated)", fontsize="medium")
right.set_box_aspect((3.6, 3.6, 2 * np.ptp(z[np.isfinite(z)]) / 1e3), zoom=1.1)
right.view_init(38, -60)
figure.colorbar(ScalarMappable(limits, "viridis"), ax=right, label="Height above sea level (m)", shrink=0.6, pad=0.09)
figure.savefig("fig07_environments.png", dpi=150, bbox_inches="tight")
print(f"{len(boxes)} boxes; terrain of {raster.grid.rows} x {raster.grid.columns} posts")
