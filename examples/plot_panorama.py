"""
A panoramic radar and its way
=============================

A 24 GHz fan beam turns once a second on a vehicle that drives around a stadium at 30 km/h, as in Fig. 1 of the paper.
A turn takes 8 m of the way, and Doppler shifts its ranges by up to 2 m: as one picture it is bent. `slam` finds the
way from the images alone, and lays them on one map.
"""

import os

import matplotlib.pyplot as plt
import numpy as np

from sionna_radar import load_scenario, panorama, slam

small = os.environ.get("SIONNA_RADAR_SMALL") == "1"
# %%
# The images
# ----------
drive = {"platform.waypoints_m": [[-104.0, -70.0], [-104.0, -10.0]], "fences": []} if small else {}
images = panorama(load_scenario("stadium", drive)).images

# %%
# The way, and what it is off
# ---------------------------
found = slam(images)
print(found)
print(f"the end is {found.drift.end_m:.2f} m off, stated {np.hypot(*found.sigma[-1, :2]):.2f} m")

# %%
# A turn as one picture, a turn with each chirp at its own place, and the map of all
# ----------------------------------------------------------------------------------
figure, axes = plt.subplots(1, 3, figsize=(13, 4.6), layout="constrained")
way, around = found.way, images.grid(found.way, 0.5, 75.0, turn=1)
pictures = [(around, images.on_grid(1, around, way, as_one=as_one)) for as_one in (True, False)]
whole = images.grid(way, 0.6, 100.0)
pictures.append((whole, images.mosaic(whole, way, 100.0)))
titles = "One turn as one picture", "Each chirp at its own place", f"Map and way of {len(images)} turns"
for axis, (grid, power), title in zip(axes, pictures, titles, strict=True):
    level = 10 * np.log10(np.where(power > 0, power, np.nan))
    top = np.nanpercentile(level, 99.8)
    axis.imshow(level, origin="lower", extent=grid.extent_m, cmap="inferno", vmin=top - 45, vmax=top)
    axis.set(title=title, xlabel="East (m)", ylabel="North (m)")
axes[2].plot(*found.state[:, :2].T, color="tab:cyan", label="by SLAM")
axes[2].plot(*found.true_state[:, :2].T, "w--", lw=0.8, label="true")
axes[2].legend(fontsize="small", loc="upper right")
figure.savefig("panorama.png", dpi=90)
