"""
Paper Fig. 13: the error at an edge
===================================

A beam has a width, a detection has none: it is placed on the beam axis at the measured range. Where a beam lights a
roof and the ground behind it, the stronger of them decides the range, and the point ends between the two: beside the
roof in the air, or above the ground. Here the beam of Fig. 8 is carried across the edge.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run

SMALL = "SIONNA_RADAR_SMALL" in os.environ
BLUE, ORANGE, RED = "#0072b2", "#e69f00", "#d55e00"  # safe for colour-blind readers
ROOF_M, EDGE_M, HEIGHT_M = 4.74, 26.66, 30.0

crossing = {
    "platform.speed_mps": 10.0,
    "platform.start_m": [-5.0 if not SMALL else -2.0, 0.0],
    "platform.length_m": 10.0 if not SMALL else 4.0,
    "processing.echoes": "strongest",
    "processing.ranging": "peak",  # the paper's method
}
scenario = load_scenario("roof_edge", crossing)
survey = run(scenario)
angle = np.deg2rad(scenario.radar.scan.incidence_deg)
position = survey.points.position_m

# %%
# Truth on the axis: the first surface it meets.
radar_x = survey.points.origin_m[:, 0]
meets_roof = radar_x + np.tan(angle) * (HEIGHT_M - ROOF_M) <= EDGE_M
# The error h of the paper: the placed height against the surface that lies under the placed point.
below = np.where(position[:, 0] <= EDGE_M, ROOF_M, 0.0)
error = position[:, 2] - below
ground_axis = ~meets_roof
swapped = ground_axis & (position[:, 2] > ROOF_M / 2)
print(f"{swapped.sum()} of {ground_axis.sum()} chirps whose axis meets the ground range the roof instead")
print(f"largest error {np.abs(error).max():.2f} m; the roof is {ROOF_M:g} m high")

# %%
figure = Figure(figsize=(8.6, 10.2), layout="constrained")
geometry, placed = figure.subplots(2, 1, height_ratios=[10.5, 9.0])
for axes in (geometry, placed):
    axes.fill_between([16.66, EDGE_M], [ROOF_M] * 2, -1.5, color="0.85", lw=0)
    axes.plot([10, 16.66, 16.66, EDGE_M, EDGE_M, 45], [0, 0, ROOF_M, ROOF_M, 0, 0], color="0.35", lw=1.4)

# %%
# The geometry, true to scale: one chirp whose axis just passes the edge. Its strongest echo comes from the roof.
half = np.deg2rad(scenario.radar.antenna.beamwidth_deg) / 2
start = EDGE_M - np.tan(angle) * (HEIGHT_M - ROOF_M) + 0.3
for tilt, style in ((angle - half, ":"), (angle, "--"), (angle + half, ":")):
    bottom = ROOF_M if start + np.tan(tilt) * (HEIGHT_M - ROOF_M) <= EDGE_M else 0.0
    end = start + np.tan(tilt) * (HEIGHT_M - bottom)
    geometry.plot([start, end], [HEIGHT_M, bottom], color=BLUE, lw=1.4, ls=style)
lit = start + np.tan(angle - half) * (HEIGHT_M - ROOF_M)
middle = np.array([(lit + EDGE_M) / 2, ROOF_M])
reach = np.hypot(middle[0] - start, HEIGHT_M - ROOF_M)
arc = np.linspace(angle - 1.5 * half, angle + 1.5 * half, 50)
geometry.plot(start + reach * np.sin(arc), HEIGHT_M - reach * np.cos(arc), color=RED, lw=1.4)
geometry.plot([lit, EDGE_M], [ROOF_M] * 2, color=ORANGE, lw=5, solid_capstyle="butt", label="Lit roof")
far = start + np.tan(angle + half) * HEIGHT_M
behind = start + (EDGE_M - start) * HEIGHT_M / (HEIGHT_M - ROOF_M)
geometry.plot([behind, far], [0, 0], color="#009e73", lw=5, solid_capstyle="butt", label="Lit ground")
on_axis = np.array([start + reach * np.sin(angle), HEIGHT_M - reach * np.cos(angle)])
geometry.plot(*middle, ls="", marker="o", ms=8, mfc=ORANGE, mec="black", label="Where the echo comes from")
geometry.plot(*on_axis, ls="", marker="X", ms=10, mfc=RED, mec="black", label="Where the detection is placed")
geometry.annotate("", on_axis, (on_axis[0], 0.0), arrowprops={"arrowstyle": "<->", "lw": 1.3, "shrinkA": 0})
geometry.text(on_axis[0] + 0.15, 1.2, f"error h = {on_axis[1]:.1f} m", va="center")
geometry.plot([], [], color=BLUE, ls="--", label="Beam axis")
geometry.plot([], [], color=BLUE, ls=":", label="Half-power directions")
geometry.plot([], [], color=RED, label=f"Equal range, {reach:.1f} m")
geometry.set(xlim=(20, 36.5), ylim=(-1.5, 9), ylabel="Height (m)", xlabel="East (m)")
geometry.set_aspect("equal")
geometry.legend(frameon=False, loc="upper right", fontsize="small", ncols=2)
geometry.set_title("The detection is placed on the beam axis", fontsize="medium")

# %%
# The simulated crossing: every chirp's strongest echo, placed on its axis.
bad = np.abs(error) > 1.0
placed.plot(*position[~bad][:, [0, 2]].T, ls="", marker="o", ms=5, mew=0, color=BLUE, label="Within 1 m of the surface")
placed.plot(*position[bad][:, [0, 2]].T, ls="", marker="X", ms=7, mfc=RED, mec="black", mew=0.5, label="Edge error")
placed.set(xlim=(20, 36.5), ylim=(-1.5, 7.5), xlabel="East (m)", ylabel="Height (m)")
placed.set_aspect("equal")
placed.legend(frameon=False, loc="upper right")
placed.set_title(f"{len(position)} simulated chirps across the edge, strongest bin on the axis", fontsize="medium")
figure.savefig("fig13_edge_error.png", dpi=150, bbox_inches="tight")
