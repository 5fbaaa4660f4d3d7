"""
Two bounces beside a wall
=========================

A hall clad with metal sheets, on flat ground. Its wall returns little where it is, but it mirrors: radar, wall, ground,
radar, and the other way round. All of these echoes have the range of the wall's foot, whichever part of wall and
ground a beam lights, and a map places them on the beam's axis: below the ground before the wall, inside the hall above
it. With SIONNA_RADAR_SMALL=1 in the environment the flights are short ones.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.report import colour_bar, finish_map, show_raster
from sionna_radar.tracing import BOUNCED

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.start_m": [-62.0, 0.0], "platform.length_m": 6.0, "tracing.paths_per_pulse": 64} if SMALL else {}
FRONT_M, BACK_M, TOP_M = -8.0, 8.0, 12.0
CLAD = {
    "model": "constant_gamma",
    "gamma_db": -30.0,
    "specular": True,
    "medium": {"kind": "metal"},
    "rms_height_m": 1e-4,
}


def hall(bounces):
    return load_scenario(
        "buildings",
        {
            "buildings": [{"position_m": [0.0, 0.0], "size_m": [50.0, BACK_M - FRONT_M, TOP_M], "heading_deg": 0.0}],
            "materials.building": CLAD,
            "tracing.bounces": bounces,
            "radar.antenna.beamwidth_deg": 4.0,
            "radar.scan.half_swath_deg": 25.0,
            "radar.chirp_rate_hz": 720.0,
            "platform.start_m": [-90.0, 0.0],
            "platform.length_m": 60.0,
            "processing.echoes": "all",
            "dem.method": "linear",
            **SIZE,
        },
    )


# %%
# Two surveys, alike but for the second bounce.
surveys = {bounces: run(hall(bounces)) for bounces in (1, 2)}
figure = Figure(figsize=(12.5, 8.6), layout="constrained")
(maps, lower) = figure.subplots(2, 2)
scale = Normalize(-3.0, 3.0)
for axes, (bounces, survey) in zip(maps, surveys.items(), strict=True):
    place = survey.points.position_m
    before = (np.abs(place[:, 1]) < 24.0) & (place[:, 0] < FRONT_M) & (place[:, 0] > FRONT_M - 10.0)
    inside = (np.abs(place[:, 1]) < 24.0) & (place[:, 0] > FRONT_M) & (place[:, 0] < BACK_M)
    error = survey.error.height_m
    x, y = survey.error.grid.centres_m.T.reshape(2, *error.shape)
    strip = (np.abs(y) < 24.0) & (x < FRONT_M) & (x > FRONT_M - 6.0) & np.isfinite(error)
    print(
        f"{bounces} bounce{'s' if bounces > 1 else ''}: {np.mean(place[before, 2] < -1.0):.1%} of {before.sum()} "
        "echoes in the 10 m before the wall lie over 1 m below the ground, "
        f"the deepest {-place[before, 2].min():.1f} m; "
        f"inside the hall {np.sum(place[inside, 2] < TOP_M - 2)}; map in the 6 m before the wall: "
        f"mean {np.mean(error[strip]):+.2f} m, RMS {np.sqrt(np.mean(error[strip] ** 2)):.2f} m; "
        f"lit cells {survey.lit_error.rms_m:.2f} m RMS"
    )
    show_raster(axes, survey.error, "RdBu_r", scale)
    axes.plot(np.array([FRONT_M, BACK_M])[[0, 1, 1, 0, 0]], [-25, -25, 25, 25, -25], color="black", lw=1.0)
    finish_map(axes, survey.truth.grid.extent_m, f"DEM error, {'one bounce' if bounces == 1 else 'two bounces'}")
colour_bar(maps[-1], ScalarMappable(scale, "RdBu_r"), "DEM minus truth (m)", 3.0, extend="both")

# %%
# Where echoes are placed, in a section through the hall.
section, chirp = lower
for bounces, colour, size in ((2, "#b2182b", 5), (1, "#2166ac", 3)):
    place = surveys[bounces].points.position_m
    near = np.abs(place[:, 1]) < 22.0
    section.scatter(
        *place[near][:, [0, 2]].T, s=size, color=colour, lw=0, label=("One bounce", "Two bounces")[bounces - 1]
    )
section.plot([-60, FRONT_M, FRONT_M, BACK_M, BACK_M, 40], [0, 0, TOP_M, TOP_M, 0, 0], color="black", lw=1.0)
section.set(xlim=(-30, 22), ylim=(-14, 16), xlabel="East (m)", ylabel="Height (m)", title="Echoes, placed on the axis")
section.legend(frameon=False, loc="lower left")

# %%
# One chirp that looks at the foot of the wall: what comes back at which range.
prepared = prepare(hall(2))
pulses = prepared.flight.pulses(np.arange(len(prepared)))
aim = pulses.true.position_m - pulses.true.position_m[:, 2:] / pulses.true.boresight[:, 2:] * pulses.true.boresight
one = int(np.argmin(np.hypot(aim[:, 0] - FRONT_M + 2.0, aim[:, 1])))
paths = prepared.sensor_inputs().tracer().trace(prepared.flight.pulses(np.array([one])))
range_m = paths.delay_s * 299792458.0 / 2
edges = np.arange(range_m.min() - 0.5, range_m.max() + 0.5, 0.3)
parts = {
    "Ground": (paths.surface == 0, "#8c510a"),
    "Wall": (paths.surface == 1, "#2166ac"),
    "Two bounces": (paths.surface == BOUNCED, "#b2182b"),
}
for name, (own, colour) in parts.items():
    # The two orders of a path add up as fields, in phase: here every path has its mean share of their power.
    power = np.abs(paths.gain[own]) ** 2 * (2.0 if name == "Two bounces" else 1.0)
    level = np.histogram(range_m[own], edges, weights=power)[0]
    level = 10 * np.log10(np.where(level > 0, level, np.nan))
    chirp.stairs(level, edges, color=colour, label=name, lw=1.5, baseline=None)
    print(f"{name}: {10 * np.log10(max(power.sum(), 1e-30)):.1f} dB of what was sent")
position = pulses.true.position_m[one]
chirp.axvline(np.hypot(FRONT_M - position[0], position[2]), color="grey", ls=":", label="Foot of the wall")
chirp.set(xlabel="Range (m)", ylabel="dB rel. to transmitted", title="Echo power in 0.3 m, axis 2 m before the wall")
chirp.set(xlim=(64, 76), ylim=(-150, -100))
chirp.legend(frameon=False)
chirp.grid(alpha=0.3)
figure.suptitle("A metal-clad hall on flat ground, 4 deg beam at 77 GHz from 50 m: one bounce or two")
figure.savefig("double_bounce.png", dpi=110, bbox_inches="tight")
