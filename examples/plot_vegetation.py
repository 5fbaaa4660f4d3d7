"""
Plants over the ground
======================

A stand of plants, 6 m high, on hills: from open to dense, a twentieth of what it takes always comes back as echo.
The map reads the middle of an open stand, whose echo outshines the ground's, and the tops of a dense one; the truth is
the bare ground. With SIONNA_RADAR_SMALL=1 in the environment the flights are short ones.
"""

# %%
import os

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, prepare, run
from sionna_radar.report import colour_bar, finish_map, show_raster

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
SIZE = {"platform.length_m": 5.0, "tracing.paths_per_pulse": 64, "terrain.spacing_m": 2.0} if SMALL else {}
EXTINCTIONS = [0.3, 3.0] if SMALL else [0.1, 0.3, 1.0, 3.0]
HEIGHT_M, ALBEDO = 6.0, 0.05
STAND = [[-70.0, -20.0], [-10.0, -20.0], [-10.0, 30.0], [-70.0, 30.0]]


def over_stand(extinction_db_per_m):
    returned = ALBEDO * np.log(10.0) / 10.0 * extinction_db_per_m
    stand = {
        "polygon_m": STAND,
        "height_m": HEIGHT_M,
        "extinction_db_per_m": extinction_db_per_m,
        "backscatter_db_per_m": 10.0 * np.log10(returned),
    }
    return load_scenario("hills", {"vegetation": [stand], **SIZE})


# %%
# The map less the bare ground, and how high among the plants it lies.
figure = Figure(figsize=(3.7 * len(EXTINCTIONS) + 1.2, 7.6), layout="constrained")
(maps, chirps) = figure.subplots(2, len(EXTINCTIONS), height_ratios=[1.4, 1.0])
scale = Normalize(-HEIGHT_M, HEIGHT_M)
for axes, lower, extinction in zip(maps, chirps, EXTINCTIONS, strict=True):
    survey = run(over_stand(extinction))
    reading = survey.canopy_reading
    outside = np.abs(survey.error.height_m[np.isfinite(survey.error.height_m)])
    print(
        f"{extinction:g} dB/m: {reading.above_ground_m:+.2f} m over the ground among plants ({reading.share:.0%} of "
        f"their height), RMS to the ground {reading.ground_rms_m:.2f} m, to their tops {reading.top_rms_m:.2f} m; "
        f"half of all cells within {np.median(outside):.3f} m"
    )
    show_raster(axes, survey.error, "RdBu_r", scale)
    axes.plot(*np.array([*STAND, STAND[0]]).T, color="black", lw=1.0)
    finish_map(axes, survey.truth.grid.extent_m, f"{extinction:g} dB/m: reads {reading.share:.0%} of the height")
    # The power of ground and plants in front of it, from one look straight into the stand.
    prepared = prepare(over_stand(extinction))
    pulses = prepared.flight.pulses(np.arange(len(prepared)))
    aim = pulses.true.position_m + 70.7 * pulses.true.boresight
    one = int(np.argmin(np.hypot(aim[:, 0] + 40.0, aim[:, 1] - 5.0)))
    paths = prepared.sensor_inputs().tracer().trace(prepared.flight.pulses(np.array([one])))
    range_m, power = paths.delay_s * 299792458.0 / 2, np.abs(paths.gain) ** 2
    edges = np.arange(40.0, 110.0, 0.5)
    for surface, name, colour in ((paths.surface >= 0, "Ground", "#8c510a"), (paths.surface < 0, "Plants", "#1b7837")):
        height = np.histogram(range_m[surface], edges, weights=power[surface])[0]
        lower.stairs(
            10 * np.log10(np.where(height > 0, height, np.nan)), edges, color=colour, label=name, lw=1.5, baseline=None
        )
    lower.set(xlabel="Range (m)", ylim=(-160, -85), title="Echo power in half a metre")
    lower.grid(alpha=0.3)
maps[0].set_ylabel("North (m)")
chirps[0].set_ylabel("dB rel. to transmitted")
chirps[0].legend(frameon=False)
colour_bar(maps[-1], ScalarMappable(scale, "RdBu_r"), "DEM minus bare ground (m)", 2.6, extend="both")
figure.suptitle(f"A stand {HEIGHT_M:g} m high on hills, 2 deg beam at 77 GHz from 50 m: ground or tops?")
figure.savefig("vegetation.png", dpi=110, bbox_inches="tight")
