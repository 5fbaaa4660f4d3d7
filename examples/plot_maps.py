"""
Maps that know their beam
=========================

The same pulses made into a DEM in two ways. A linear map puts every echo on the beam's axis and draws triangles between
the points. `dem.method = "refined"` moves the surface until the echoes that it would send back, beam and all, are the
measured ones. `"stepped"` is for built-up ground: it finds where the surface breaks, from what all echoes say for
and against every height, and maps each level between the walls by itself.
"""

# %%
import os

from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar import load_scenario, run
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster

SMALL = "SIONNA_RADAR_SMALL" in os.environ
LENGTH = {"platform.length_m": 6.0, "terrain.spacing_m": 2.0} if SMALL else {}
# What is flown, how far the colours of height and error reach, and the maps made of it.
FLIGHTS = {
    "hills": ((0.0, 8.0), 0.5, {"linear": "Points on the axis, linear map", "refined": "Refined map"}),
    "buildings": ((0.0, 10.0), 5.0, {"linear": "Points on the axis, linear map", "stepped": "Stepped map"}),
}


# %%
def words(survey):
    """What a map's title says of its error."""
    error = survey.lit_error
    beside = f", {survey.off_wall_error.rms_m:.2f} m off the walls" if survey.off_wall_error else ""
    return f"RMS {error.rms_m:.3f} m{beside}, {error.coverage:.0%} covered"


figure = Figure(figsize=(14.5, 9.0), layout="constrained")
figure.get_layout_engine().set(wspace=0.06)
rows = figure.subplots(2, 3)
for axes, (name, (heights, reach, maps)) in zip(rows, FLIGHTS.items(), strict=True):
    scale, off = Normalize(*heights), Normalize(-reach, reach)
    for panel, (method, title) in zip(axes[1:], maps.items(), strict=True):
        changes = {"dem.method": method, "processing.ranging": "centroid"}
        survey = run(load_scenario(name, LENGTH | changes))
        print(f"{name}, {method}: {words(survey)} (lit cells); all cells of the DEM {survey.dem_error.rms_m:.3f} m")
        show_raster(panel, survey.error, "RdBu_r", off)
        finish_map(panel, survey.truth.grid.extent_m, f"{title}\n{words(survey)}")
        panel.set_ylabel("")
    show_raster(axes[0], survey.truth, "viridis", scale)
    finish_map(axes[0], survey.truth.grid.extent_m, f"{name.capitalize()}: true surface")
    colour_bar(axes[0], ScalarMappable(scale, "viridis"), "Height (m)", 2.4)
    colour_bar(axes[2], ScalarMappable(off, "RdBu_r"), "DEM minus truth (m)", 2.4, extend="both")
figure.legend(handles=[empty_patch()], loc="outside lower center", frameon=False)
figure.savefig("maps.png", dpi=150, bbox_inches="tight")
