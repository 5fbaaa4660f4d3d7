"""
A survey of your own DEM
========================

Any elevation file will do: a GeoTIFF, an Esri ASCII grid, an SRTM tile. Run it as
`python examples/plot_elevation_file.py my_dem.tif`; without a file it flies the SRTM tile that matplotlib ships.
"""

# %%
import sys

from sionna_radar import load_scenario, run
from sionna_radar.report import draw_dem

own = sys.argv[1] if len(sys.argv) > 1 else None
scenario = load_scenario("own_dem", {"terrain.path": own}) if own else load_scenario("jacksboro")
survey = run(scenario)
lit = survey.lit_error
print(f"{len(survey.points)} echoes, {lit.coverage:.1%} of lit cells mapped, elevation error {lit.rms_m:.2f} m RMS")

# %%
draw_dem(survey).savefig("elevation_file.png")
