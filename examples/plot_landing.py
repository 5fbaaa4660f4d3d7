"""
Landing a helicopter through its own dust
=========================================

A published simulation (IEEE Antennas and Propagation Magazine 50-2, 2008, pp. 13-25) scans the ground under a
helicopter with a real-aperture radar between 70 and 220 GHz: two-scale rough ground with a hump in the middle, seen
through the dust that the rotor raises. Only its abstract and the page of its laboratory could be read, and they give no
more than this sentence. Assumed here: 94 GHz, a beam of 1 deg, 40 m above the ground at 8 m/s; undulation of 0.1 m RMS
over 12 m; the small scale as backscatter alone (desert, constant gamma); a hump 1.5 m high and 8 m across; dust in
which one sees 5 m, the densest that the weather takes, about 7 g/m3; 10 dBm and a noise figure of 15 dB; a place 10 m
wide.
"""

# %%
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from sionna_radar import CustomParts, Raster, landing_sites, parse_scenario, prepare, run, write_survey
from sionna_radar.report import colour_bar, empty_patch, finish_map, show_raster
from sionna_radar.studies.landing import Limits

SMALL = "SIONNA_RADAR_SMALL" in os.environ
SPACING_M, SIDE_M = (1.0, 200.0) if SMALL else (0.5, 200.0)
cells = round(SIDE_M / SPACING_M) + 1
x, y = np.meshgrid(*[np.linspace(-SIDE_M / 2, SIDE_M / 2, cells)] * 2)
undulation = gaussian_filter(np.random.default_rng(1).standard_normal(x.shape), 12.0 / SPACING_M / np.sqrt(2))
height_m = 0.1 * undulation / undulation.std() + 1.5 * np.exp(-(x**2 + y**2) / (2 * (8.0 / 2.355) ** 2))
ground = Raster.from_array(height_m, SPACING_M)

# %%
# In clear air and in the dust. As published, each range is a height: `linear`. The other limits are the defaults.
SCENARIO = {
    "terrain": {"kind": "flat", "size_m": [SIDE_M, SIDE_M]},
    "materials": {"ground": {"model": "constant_gamma", "terrain_class": "desert"}},
    "platform": {"altitude_m": 40.0, "speed_mps": 8.0, "start_m": [-65.0, 0.0], "length_m": 8.0 if SMALL else 50.0},
    "radar": {
        "carrier_hz": 94e9,
        "transmit_power_dbm": 10.0,
        "noise_figure_db": 15.0,
        "antenna": {"beamwidth_deg": 1.0},
    },
    "dem": {"method": "linear"},
}
AIR = {"Clear air": {}, "Dust, one sees 5 m": {"dust_visibility_m": 5.0}}
LIMITS = Limits(footprint_m=10.0, clearance_m=7.5)


def landed(weather):
    survey = run(prepare(parse_scenario(SCENARIO | {"weather": weather}), CustomParts(terrain=ground)))
    with TemporaryDirectory() as folder:
        write_survey(survey, Path(folder) / "flight")
        return survey, landing_sites(Path(folder) / "flight", LIMITS, draws=200)


figure = Figure(figsize=(11.0, 4.2 * len(AIR)), layout="constrained")
for (name, weather), (left, right) in zip(AIR.items(), figure.subplots(len(AIR), 2), strict=True):
    survey, landing = landed(weather)
    check, extent_m = landing.check, survey.truth.grid.extent_m
    print(f"{name}: RMS of the map {survey.lit_error.rms_m:.3f} m; {check.stated} places stated fit at 99 %")
    print(f"    {check.precision:.1%} of them are, and {check.recall:.1%} of {check.fit} fit places are among them")
    heights, chance = Normalize(-0.4, 1.6), Normalize(0, 1)
    show_raster(left, survey.dem, "terrain", heights)
    finish_map(left, extent_m, f"{name}: the map")
    colour_bar(left, ScalarMappable(heights, "terrain"), "m", 4.0)
    show_raster(right, landing.probability, "RdYlGn", chance)
    finish_map(right, extent_m, "Probability that a place is fit")
    colour_bar(right, ScalarMappable(chance, "RdYlGn"), "", 4.0)
    for rank, site in enumerate(landing.sites, start=1):
        right.annotate(str(rank), (site.east_m, site.north_m), ha="center", va="center", fontsize=8)
right.legend(handles=[empty_patch("unknown")], loc="lower left", fontsize=8)
figure.savefig("landing.png", dpi=150, bbox_inches="tight")
