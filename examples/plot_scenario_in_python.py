"""
A mission in one script
=======================

A scenario is a set of nested tables: terrain, platform, radar. Here one is written in Python, flown, and mapped; then
other beams show what the beamwidth costs: the wider the beam, the worse the DEM (paper Table 3).
"""

# %%
# The scenario. Every key has a unit in its name and a default; the same tables as TOML make a file.
from matplotlib.figure import Figure

from sionna_radar import parse_scenario, run


def hills(beamwidth_deg: float, length_m: float = 60.0):
    """Return a survey of seeded hills with a given beam."""
    return parse_scenario(
        {
            "seed": 7,
            "terrain": {"kind": "hills", "size_m": [300.0, 300.0], "spacing_m": 1.0, "seed": 3},
            "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "start_m": [-80.0, 0.0], "length_m": length_m},
            "radar": {"snr_db": 30.0, "antenna": {"beamwidth_deg": beamwidth_deg}},
        }
    )


# %%
# The flight. `run` traces every pulse, makes its beat signal, finds and places its echoes, maps the points, and
# compares the map with the ground that was flown over.
beamwidths_deg = [1.0, 2.0, 4.0]
surveys = [run(hills(width)) for width in beamwidths_deg]
errors = [survey.lit_error for survey in surveys]
for width, error in zip(beamwidths_deg, errors, strict=True):
    print(f"beam {width:g} deg: RMS {error.rms_m:.2f} m, mean {error.mean_m:+.2f} m, {error.coverage:.1%} of lit cells")

# %%
# The map and its error with the beam of 2 deg, and what other beams make of it.
survey = surveys[1]
figure = Figure(figsize=(11, 3.6), layout="constrained")
maps, differences, axes = figure.subplots(1, 3)
for where, raster, colours, title in (
    (maps, survey.dem, "terrain", "Elevation model, 2 deg"),
    (differences, survey.error, "RdBu_r", "Its error, DEM minus truth"),
):
    reach = {} if raster is survey.dem else {"vmin": -0.4, "vmax": 0.4}
    image = where.imshow(raster.height_m, origin="lower", extent=raster.grid.extent_m, cmap=colours, **reach)
    where.set(xlabel="East (m)", ylabel="North (m)", title=title)
    figure.colorbar(image, ax=where, label="m")
axes.plot(beamwidths_deg, [error.rms_m for error in errors], "o-")
axes.set(xlabel="Half-power beamwidth (deg)", ylabel="RMS error of lit cells (m)", ylim=(0, None), title="Other beams")
figure.savefig("beamwidths.png", dpi=120)
