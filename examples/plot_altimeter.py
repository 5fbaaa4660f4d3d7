"""
Held against a flown altimeter
==============================

A 4.3 GHz altimeter and a laser flew side by side over farmland and woods in Arkansas. The surface that the laser met,
extruded across the track, is flown here at the same heights with `radar.preset = "alt_4300"`, first as bare ground,
then as ground under plants; what the simulated altimeter reads is set against what the real one read. What comes of it
is told in `examples/ALTIMETER.md`. Another line of such a file: its path in the environment as
SIONNA_RADAR_ALTIMETER. With SIONNA_RADAR_SMALL=1 the flights are short ones.
"""

# %%
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import grey_closing, grey_opening

from sionna_radar import CustomParts, Raster, load_scenario, prepare
from sionna_radar.detection import Echoes, RangeLoop, Ranges

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
HERE = Path(globals().get("__file__", "script")).resolve()  # the gallery has no __file__, and runs in a folder of docs
SHIPPED = [folder / "examples" / "data" / "altimeter_trees.npz" for folder in HERE.parents]
LINE = np.load(os.environ.get("SIONNA_RADAR_ALTIMETER") or next(path for path in SHIPPED if path.is_file()))
READINGS = 40 if SMALL else len(LINE["utc_s"])
time_s = LINE["utc_s"][:READINGS] - LINE["utc_s"][0]
laser_m, radar_m, surface_m = (LINE[name][:READINGS] for name in ("laser_m", "radar_m", "dtm_m"))
along_m = np.hypot(np.diff(LINE["easting_m"]), np.diff(LINE["northing_m"])).cumsum()
along_m = np.concatenate([[0.0], along_m])[:READINGS] - along_m[READINGS - 2] / 2

# %%
# The flight, on a straight track, and the ground: what the laser met, or the ground below it and plants up to it.
CHIRPS, SPACING_M, MARGIN_M = 8, 10.0, 400.0
TIME_CONSTANT_S = 0.09  # of the tracker: data sheet of the ALT-50A
columns = {
    "time_s": time_s, "east_m": along_m, "north_m": 0 * time_s, "up_m": surface_m + laser_m,
    "roll_deg": LINE["roll_deg"][:READINGS], "pitch_deg": LINE["pitch_deg"][:READINGS], "heading_deg": 90 + 0 * time_s,
}  # fmt: skip
np.savetxt("flight.csv", np.column_stack(list(columns.values())), "%.4f", ",", header=",".join(columns), comments="")
SCENARIO = {
    "platform.log": "flight.csv",
    "platform.log_height": "datum",
    "radar": {"preset": "alt_4300", "samples_per_chirp": 1024},
    "materials.ground": {
        "model": "kirchhoff",
        "medium": {
            "kind": "soil", "temperature_c": 15.0, "sand_percent": 40.0, "clay_percent": 20.0, "water_fraction": 0.2,
            "specific_gravity": 2.65,
        },
        "rms_height_m": 0.02, "correlation_length_m": 0.12,
    },
    "tracing.speckle": "per_pulse",
    "processing.ranging": "threshold",
    "processing.average": {"chirps": CHIRPS, "mode": "incoherent"},
    "processing.cfar.kind": "CA",
    "processing.volume_clutter": "off",
    "dem": {"method": "linear", "spacing_m": 25.0},
}  # fmt: skip


def extruded(heights_m):
    """Return the raster of a profile along the track, smooth between its points and the same across."""
    east_m = np.arange(along_m[0] - MARGIN_M, along_m[-1] + MARGIN_M, SPACING_M)
    profile_m = PchipInterpolator(along_m, heights_m)(np.clip(east_m, along_m[0], along_m[-1]))
    return Raster.from_array(np.tile(profile_m, (int(2 * MARGIN_M / SPACING_M) + 1, 1)), SPACING_M)


def flown(ground_m, keys):
    """Return the times of the pulses that have an echo, and their ranges."""
    prepared = prepare(load_scenario("hills", SCENARIO | keys), CustomParts(terrain=extruded(ground_m)))
    index = np.arange(len(prepared))
    echoes = Echoes.concatenate([prepared.echoes(part) for part in np.array_split(index, 1 + len(index) // 512)])
    return prepared.flight.time_s[echoes.pulse], Ranges(range_m=echoes.range_m, sigma_m=echoes.range_sigma_m)


def read(flight, time_constant_s=TIME_CONSTANT_S):
    """Return what the altimeter reads at the times of the line, as `processing.ranging = "tracker"` smooths ranges."""
    pulse_s, ranges = flight
    smoothed_m = RangeLoop(time_constant_s=time_constant_s).follow(pulse_s, ranges).range_m
    return smoothed_m[np.maximum(np.searchsorted(pulse_s, time_s, side="right") - 1, 0)]


# %%
# Bare ground, and stands of four densities between what opening and closing make of the laser's profile: where it met
# the ground, and where it met tops. A stand returns a twentieth of what it takes.
EXTINCTIONS_DB_PER_M = (0.3,) if SMALL else (0.1, 0.3, 1.0, 3.0)
flights = {"bare surface": flown(surface_m, {})}
below_m, top_m = grey_opening(surface_m, 5), grey_closing(surface_m, 5)
Path("plants.tif").unlink(missing_ok=True)
extruded(top_m - below_m).to_geotiff("plants.tif")
for extinction in EXTINCTIONS_DB_PER_M if np.any(top_m - below_m > 2.0) else ():
    returned_db = 10 * np.log10(0.05 * np.log(10) / 10 * extinction)
    stand = {"path": "plants.tif", "least_height_m": 2.0, "extinction_db_per_m": extinction}
    stand["backscatter_db_per_m"] = float(returned_db)
    flights[f"stand, {extinction:g} dB/m"] = flown(below_m, {"vegetation": [stand]})

# %%
# Radar minus laser, measured and predicted. The mean is fitted, on the first half alone; the second half is predicted.
HALVES = {"first": slice(0, READINGS // 2), "second": slice(READINGS // 2, READINGS)}
measured_m = radar_m - laser_m


def correlation(values, lag):
    """Return the correlation of a series with itself some readings later."""
    values = values - values.mean()
    return float(np.mean(values[lag:] * values[:-lag]) / np.mean(values**2))


def described(label, values, compared=None):
    text = f"{label:20} mean {values.mean():+.2f}, std {values.std():.2f}, lags"
    text += "".join(f" {correlation(values, lag):+.2f}" for lag in (1, 2, 5))
    if compared is not None:
        text += f", left {np.std(compared - values):.2f}, correlation {np.corrcoef(values, compared)[0, 1]:+.2f}"
    return text


first, predicted_m = HALVES["first"], {}
for name, flight in flights.items():
    read_m = read(flight)
    bias_m = np.mean((radar_m - read_m)[first])
    predicted_m[name] = read_m + bias_m - laser_m
    print(f"{name}: bias {bias_m:+.2f} m")
for half, rows in HALVES.items():
    print(described(f"{half}: measured", measured_m[rows]))
    for name, values in predicted_m.items():
        print(described(name, values[rows], measured_m[rows]))

# %%
# The time constant of the tracker that leaves least on the first half, and what it leaves on the second.
for name, flight in flights.items():
    left_m = {
        time_constant_s: [np.std((radar_m - read(flight, time_constant_s))[rows]) for rows in HALVES.values()]
        for time_constant_s in (TIME_CONSTANT_S, *np.geomspace(0.02, 2.0, 21))
    }
    best_s = min(left_m, key=lambda time_constant_s: left_m[time_constant_s][0])
    told = [f"{s:.2f} s leaves {left_m[s][0]:.2f} and {left_m[s][1]:.2f} m" for s in (best_s, TIME_CONSTANT_S)]
    print(f"{name:20} best tracker: {told[0]}, {told[1]}")

# %%
# A plain guess beside them: the mean height of what the laser met within 30 m, the two-way half-power beam.
around_m = PchipInterpolator(along_m, surface_m)(
    np.clip(along_m[:, None] + np.linspace(-30.0, 30.0, 13), along_m[0], along_m[-1])
).mean(axis=1)
mean_m = surface_m - around_m
mean_m += np.mean((measured_m - mean_m)[first])
for half, rows in HALVES.items():
    print(described(f"{half}: mean height", mean_m[rows], measured_m[rows]))

# %%
# What both depend on: the height flown, and the slope along the track.
slope = np.abs(np.gradient(surface_m, along_m))
steep = slope > np.median(slope)
for name, values in ({"measured": measured_m} | predicted_m).items():
    by_height = 10 * np.polyfit(laser_m, values, 1)[0]
    level_m, steep_m = values[~steep].std(), values[steep].std()
    print(f"{name:20} {by_height:+.2f} m per 10 m of height; std {level_m:.2f} m level, {steep_m:.2f} m steep")

# %%
figure = Figure(figsize=(11, 7), layout="constrained")
profile, series, scatter, lagged = figure.subplot_mosaic("aa;bb;cd", height_ratios=[0.7, 1, 1.3]).values()
best = min(predicted_m, key=lambda name: np.std((measured_m - predicted_m[name])[first]))
COLOURS = {"bare surface": "#0072b2"} | ({} if best == "bare surface" else {best: "#d55e00"})
shown = slice(READINGS // 10, READINGS // 10 + 200)
profile.plot(along_m[shown] / 1e3, surface_m[shown], color="black", lw=0.8, label="what the laser met")
profile.plot(along_m[shown] / 1e3, below_m[shown], color="#8c510a", label="ground under plants")
profile.set(ylabel="Height (m)", title="Part of the line")
series.plot(along_m[shown] / 1e3, measured_m[shown], color="black", lw=1.5, label="measured")
lags = np.arange(1, min(15, READINGS // 2))
lagged.plot(lags * np.median(np.diff(time_s)), [correlation(measured_m, lag) for lag in lags], "k.-")
second = HALVES["second"]
for name, colour in COLOURS.items():
    values = predicted_m[name]
    series.plot(along_m[shown] / 1e3, values[shown], color=colour, lw=1.0, label=name)
    lagged.plot(lags * np.median(np.diff(time_s)), [correlation(values, lag) for lag in lags], ".-", color=colour)
    scatter.plot(values[second], measured_m[second], ".", ms=2, color=colour, label=name)
scatter.axline((0, 0), slope=1, color="grey", lw=0.8)
series.set(xlabel="Along the track (km)", ylabel="Radar - laser (m)")
scatter.set(xlabel="Predicted (m)", ylabel="Measured (m)", title="Second half of the line, radar minus laser")
lagged.set(xlabel="Time between readings (s)", ylabel="Correlation of radar minus laser", title="Along the track")
for axes in (profile, series, scatter):
    axes.legend(frameon=False, fontsize="small")
figure.savefig("altimeter.png", dpi=110)
