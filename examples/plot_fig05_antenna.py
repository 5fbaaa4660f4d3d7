"""
Paper Fig. 5: the antenna
=========================

A pencil beam as of a phased array: half-power width 2.0 deg in both planes, first side lobe at -20 dB. Both are
measured on the pattern that the simulator uses.
"""

# %%
import os

import numpy as np
from matplotlib.figure import Figure

from sionna_radar.radar import build_antenna
from sionna_radar.scenario import AntennaTable

SMALL = "SIONNA_RADAR_SMALL" in os.environ
BLUE, ORANGE = "#0072b2", "#d55e00"  # safe for colour-blind readers

antenna = build_antenna(AntennaTable(beamwidth_deg=2.0, side_lobe_db=-20.0))
width_deg = np.rad2deg(antenna.beamwidths_rad)
side_lobe_db = 10 * np.log10(antenna.azimuth.side_lobe_level)
print(f"half-power width {width_deg[0]:.3f} x {width_deg[1]:.3f} deg, first side lobe {side_lobe_db:.2f} dB")


def level_db(azimuth_rad, elevation_rad):
    """Gain over the peak's, toward an azimuth to the left and an elevation."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    x = np.cos(elevation) * np.cos(azimuth)
    y, z = np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
    gain = antenna.gain(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)) / antenna.peak_gain
    return 10 * np.log10(np.maximum(gain, 1e-9)).reshape(azimuth.shape)


# %%
# The principal cuts. The array is square, so that both cuts are the same curve.
angle_deg = np.linspace(-15, 15, 6001)
figure = Figure(figsize=(10.5, 4.6), layout="constrained")
cuts = figure.add_subplot(1, 2, 1)
cuts.plot(angle_deg, level_db(np.deg2rad(angle_deg), 0.0), color=BLUE, lw=2.2, label="Azimuth cut")
cuts.plot(angle_deg, level_db(0.0, np.deg2rad(angle_deg)), color=ORANGE, lw=1.2, ls="--", label="Elevation cut")
cuts.axhline(side_lobe_db, color="0.4", lw=0.8, ls=":")
cuts.text(-14.8, side_lobe_db + 0.5, f"First side lobe: {side_lobe_db:.1f} dB", color="0.2")
cuts.annotate("", (-width_deg[0] / 2, -3.01), (width_deg[0] / 2, -3.01), arrowprops={"arrowstyle": "<->", "lw": 1.2})
cuts.annotate(f"Half power: {width_deg[0]:.2f} deg", (width_deg[0] / 2 + 0.3, -3.9), color="0.2")
cuts.set(xlabel="Angle from boresight (deg)", ylabel="Gain over the peak's (dB)", xlim=(-15, 15), ylim=(-50, 3))
cuts.set_title(f"Principal cuts (peak gain {10 * np.log10(antenna.peak_gain):.1f} dBi)", fontsize="medium")
cuts.grid(alpha=0.3)
cuts.legend(loc="upper left", frameon=False, fontsize="small")

# %%
# The pattern over both angles, floor at -50 dB.
half_deg, floor_db = 8.0, -50.0
grid = np.linspace(-half_deg, half_deg, 121 if SMALL else 321)
azimuth_deg, elevation_deg = np.meshgrid(grid, grid)
pattern = np.maximum(level_db(np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)), floor_db)
solid = figure.add_subplot(1, 2, 2, projection="3d")
drawn = solid.plot_surface(
    azimuth_deg, elevation_deg, pattern, cmap="viridis", vmin=floor_db, vmax=0, rstride=1, cstride=1, antialiased=False
)
solid.set(xlabel="Azimuth (deg)", ylabel="Elevation (deg)", zlim=(floor_db, 0))
solid.set_title("Pattern", fontsize="medium")
solid.set_zticks([])
solid.view_init(35, -60)
solid.set_box_aspect((1, 1, 0.7), zoom=0.95)
figure.colorbar(drawn, ax=solid, label="Gain over the peak's (dB)", shrink=0.75, pad=0.02)
figure.savefig("fig05_antenna.png", dpi=150, bbox_inches="tight")
