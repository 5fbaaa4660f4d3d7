"""
Flights as they are flown: logs, gusts and crossing lines
=========================================================

A log of a flight takes the place of the planned one: `[platform] log = "flight.csv"`. Here the log is written first:
a loop over hills at 10 m/s whose attitude shakes as in gusts, with what the filter says of its own errors. It is flown
with an antenna that is stabilised and with one that is fixed to the body, with the exact pose and with errors as large
as the log says; then as GPX, which has no attitude. Below, several lines over one area in one survey: what one
line leaves in the shadow of buildings, lines to and fro and crossing ones reach.
"""

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter1d

from sionna_radar import Survey, load_scenario, run
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster

small = os.environ.get("SIONNA_RADAR_SMALL") == "1"
COARSE = {"tracing.paths_per_pulse": 64, "radar.chirp_rate_hz": 90.0} if small else {}

# %%
# The log: a wide turn over the hills, the aircraft banked into it and shaken by 2 deg in roll and pitch.
RATE_HZ, SECONDS, RADIUS_M, SPEED_MPS = 20.0, 2.0 if small else 14.0, 70.0, 10.0
time_s = np.arange(round(RATE_HZ * SECONDS) + 1) / RATE_HZ
course = np.deg2rad(30.0) + SPEED_MPS / RADIUS_M * time_s
east, north = -60.0 - RADIUS_M * (np.cos(course) - np.cos(course[0])), RADIUS_M * (np.sin(course) - np.sin(course[0]))
shaken = gaussian_filter1d(np.random.default_rng(4).standard_normal((len(time_s), 3)), 0.4 * RATE_HZ, axis=0)
shaken *= np.array([2.5, 2.0, 1.0]) / shaken.std(axis=0)
bank_deg = np.rad2deg(np.arctan(SPEED_MPS**2 / (9.81 * RADIUS_M)))
attitude_deg = np.column_stack([np.full(len(time_s), bank_deg), np.full(len(time_s), 2.0), np.rad2deg(course)]) + shaken
one = np.ones(len(time_s))
columns = {
    "time_s": time_s, "east_m": east, "north_m": north - 40.0, "up_m": 50.0 * one,
    "roll_deg": attitude_deg[:, 0], "pitch_deg": attitude_deg[:, 1], "heading_deg": attitude_deg[:, 2],
    "sigma_east_m": 0.1 * one, "sigma_north_m": 0.1 * one, "sigma_up_m": 0.15 * one,
    "sigma_roll_deg": 0.4 * one, "sigma_pitch_deg": 0.4 * one, "sigma_heading_deg": 0.6 * one,
}  # fmt: skip
rows = [",".join(f"{value:.5f}" for value in row) for row in np.column_stack(list(columns.values()))]
Path("flight.csv").write_text("\n".join([",".join(columns), *rows]) + "\n", encoding="utf-8")

# A receiver beside it wrote GPX, once a second, on the map: 47 N, 8 E.
degree_m = np.deg2rad(1.0) * 6371e3
points = "".join(
    f'<trkpt lat="{47.0 + columns["north_m"][i] / degree_m:.8f}" '
    f'lon="{8.0 + east[i] / degree_m / np.cos(np.deg2rad(47.0)):.8f}">'
    f"<ele>450.0</ele><time>2024-05-01T10:00:{i / RATE_HZ:06.3f}Z</time></trkpt>"
    for i in range(0, len(time_s), 4)
)
Path("flight.gpx").write_text(
    f'<gpx version="1.1" creator="example" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk>'
    "</gpx>",
    encoding="utf-8",
)

# %%
# The same log, flown in four ways. The GPX is of a flight elsewhere: it is moved to the middle of the hills.
COARSE |= {"terrain.size_m": [440.0, 440.0], "terrain.spacing_m": 4.0 if small else 0.5}
LOG = {"platform.log": "flight.csv"}
WAYS = {
    "stabilised antenna": LOG,
    "antenna fixed to the body": LOG | {"radar.scan.stabilised": False},
    "fixed, errors from the log": LOG | {"radar.scan.stabilised": False, "platform.navigation": "from_log"},
    "GPX: no attitude": {"platform.log": "flight.gpx", "platform.log_shift": "to_terrain", "platform.log_height": 50.0},
}
flights = {name: run(load_scenario("hills", COARSE | keys)) for name, keys in WAYS.items()}
for name, survey in flights.items():
    print(f"{name:28} {survey.lit_error.rms_m:.3f} m RMS, coverage {survey.lit_error.coverage:.1%}")

# %%
# Several lines over one area, in one survey: turns at a bank of 30 deg, in which the radar is silent.
LENGTH_M = 20.0 if small else 190.0
TABLE = {"count": 2 if small else 3, "spacing_m": 25.0, "length_m": LENGTH_M, "centre_m": [5.0, 0.0]}
CITY = {
    "dem.method": "linear",
    "terrain.size_m": [460.0, 460.0],
    "platform.altitude_m": 40.0,
    "platform.bank_deg": 30.0,
    "dem.max_gap_m": 3.0,
}
LINES = {
    "one line": {"platform.lines": TABLE | {"count": 1}},
    "lines to and fro": {"platform.lines": TABLE},
    "crossing lines": {"platform.lines": TABLE | {"crossing": True}},
}
fewer = {key: value for key, value in COARSE.items() if not key.startswith("terrain")}
surveys = {name: run(load_scenario("buildings", CITY | fewer | keys)) for name, keys in LINES.items()}
BOX = (-45.0, 65.0, -50.0, 50.0)  # west, east, south, north


def reached(survey: Survey) -> float:
    """Return the share of the area about the buildings that the main beam reached."""
    x, y = survey.dem.grid.centres_m.T
    inside = (x > BOX[0]) & (x < BOX[1]) & (y > BOX[2]) & (y < BOX[3])
    cells = (BOX[1] - BOX[0]) * (BOX[3] - BOX[2]) / survey.dem.grid.spacing_m**2
    return float(np.sum(survey.lit.ravel() & inside) / cells)


for name, survey in surveys.items():
    print(f"{name:28} reaches {reached(survey):.1%}, {survey.lit_error.rms_m:.3f} m RMS of lit cells")

# %%
figure = Figure(figsize=(14.5, 9.5), layout="constrained")
upper, lower = figure.subfigures(2, 1, height_ratios=[1.0, 1.05])
shown = list(WAYS)[:3]
maps = upper.subplots(1, 4, width_ratios=[1.15, 1.0, 1.0, 1.0])
steady = flights[shown[1]].schedule
turned = steady.trajectory.euler(np.linspace(0.0, steady.trajectory.end_s, 600))
clock = np.linspace(0.0, steady.trajectory.end_s, 600)
maps[0].plot(clock, np.rad2deg(turned[:, 0]), color="#d55e00", label="roll")
maps[0].plot(clock, np.rad2deg(turned[:, 1]), color="#0072b2", label="pitch")
maps[0].set(xlabel="Time in the log (s)", ylabel="Attitude (deg)", title="What the log holds")
maps[0].legend(frameon=False)
maps[0].spines[["top", "right"]].set_visible(False)
bounds = flights[shown[1]].dem.grid.extent_m
scale = Normalize(-1.0, 1.0)
for axes, name in zip(maps[1:], shown, strict=True):
    survey = flights[name]
    show_raster(axes, survey.error, "RdBu_r", scale)
    way = survey.schedule.trajectory.position(clock)
    axes.plot(way[:, 0], way[:, 1], color="black", lw=1.5)
    finish_map(axes, bounds, f"{name}:\n{survey.lit_error.rms_m:.2f} m RMS")
    axes.label_outer()
colour_bar(maps[3], maps[3].images[0], "Error of the DEM (m)", 3.0)
panels = lower.subplots(1, 3, sharey=True)
for axes, (name, survey) in zip(panels, surveys.items(), strict=True):
    show_raster(axes, survey.dem, "viridis", Normalize(0.0, 10.0))
    for start, end in survey.schedule.trajectory.transmits_s or ():
        line = survey.schedule.trajectory.position(np.linspace(start + 1e-6, end - 1e-6, 50))
        axes.plot(line[:, 0], line[:, 1], color="#d55e00", lw=1.5)
    flown = survey.schedule.trajectory.position(np.linspace(0.0, survey.schedule.trajectory.end_s, 3000))
    axes.plot(flown[:, 0], flown[:, 1], color="#d55e00", lw=0.7, ls=":")
    finish_map(axes, BOX, f"{name}: the beam reaches {reached(survey):.1%}")
    axes.label_outer()
colour_bar(panels[2], panels[2].images[0], "Height of the DEM (m)", 4.0)
panels[0].legend(handles=[empty_patch("in shadow, or no echo")], loc="upper left", fontsize="small")
upper.suptitle("A recorded flight over hills: error of the DEM")
lower.suptitle("Buildings, 40 m up: lines in which the radar transmits (orange), and the DEM of all of them")
figure.savefig("flight_log.png", dpi=110)
