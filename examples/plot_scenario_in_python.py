"""
A scenario without a file
=========================

A scenario is a set of nested tables. Here one is written in Python, flown with three beamwidths, and the
elevation error compared: the wider the beam, the worse the DEM (paper Table 3).
"""

# %%
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
beamwidths_deg = [1.0, 2.0, 4.0]
errors = [run(hills(width)).lit_error for width in beamwidths_deg]
for width, error in zip(beamwidths_deg, errors, strict=True):
    print(f"beam {width:g} deg: RMS {error.rms_m:.2f} m, mean {error.mean_m:+.2f} m, {error.coverage:.1%} of lit cells")

# %%
figure = Figure(figsize=(5, 3.5), layout="constrained")
axes = figure.add_subplot()
axes.plot(beamwidths_deg, [error.rms_m for error in errors], "o-")
axes.set(xlabel="Half-power beamwidth (deg)", ylabel="Elevation error of lit cells, RMS (m)", ylim=(0, None))
figure.savefig("beamwidths.png")
