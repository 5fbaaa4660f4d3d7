"""
Two radar lines and a lidar as one map
======================================

Two neighbouring lines fly a radar through rain of 4 mm/h over the same hills, with a gap between their swaths. A lidar,
in clear air on another day, covers the gap and a part of both. `fuse` tests the three for consistency, and makes one
elevation model of them: weighted by what each states of its errors, with the source of every cell. Prints the RMS error
of each class of cells beside that of the better source there. With SIONNA_RADAR_SMALL=1 in the environment the flights
are short ones.
"""

# %%
import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from sionna_radar import Raster, fuse, load_scenario, run, write_survey
from sionna_radar.report import colour_bar, finish_map, show_raster

SMALL = os.environ.get("SIONNA_RADAR_SMALL") == "1"
COMMON = {"dem.method": "smooth", "platform.length_m": 10.0 if SMALL else 60.0, "tracing.paths_per_pulse": 128}
LIDAR = {"sensor": "lidar", "lidar.range_noise_m": 0.05}
FLIGHTS = {
    "radar south": ("rain", {"platform.start_m": [-40.0, -70.0], "seed": 1}),
    "radar north": ("rain", {"platform.start_m": [-40.0, 70.0], "seed": 2}),
    "lidar": ("hills", {"platform.start_m": [-40.0, 0.0], "radar.scan.half_swath_deg": 35.0, "seed": 3, **LIDAR}),
}
surveys = {name: run(load_scenario(base, COMMON | keys)) for name, (base, keys) in FLIGHTS.items()}
with TemporaryDirectory() as folder:
    for name, survey in surveys.items():
        write_survey(survey, Path(folder) / name)
    fused = fuse([Path(folder) / name for name in surveys])
for pair in fused.pairs:
    print(f"{pair.first} - {pair.second}: {pair.cells} cells, chi2 {pair.chi2:.2f}, {pair.findings or 'agree'}")

# %%
# Cells by the sources that made them: RMS error of the fused map and of the best of its sources, and how often the
# truth lies in intervals of 68 and 95 %.
grid = fused.dem.grid


def on_cells(raster):
    return raster.at(grid.centres_m).reshape(grid.shape)


truth = np.fmax.reduce([on_cells(survey.truth) for survey in surveys.values()])
error = fused.dem.height_m - truth
ratio = np.abs(error / fused.sigma.height_m)
print("| made by | cells | fused RMS | best source | in 68 % | in 95 % |")
print("|---|---|---|---|---|---|")
for value, name in fused.legend.items():
    cells = (fused.source.height_m == value) & np.isfinite(error)
    if cells.any():
        members = [source for source in fused.sources if source.name in name.split(" + ")]
        alone = [np.sqrt(np.nanmean((source.dem.height_m - truth)[cells] ** 2)) for source in members]
        inside = [np.mean(ratio[cells] < limit) for limit in (1.0, 1.96)]
        row = f"{cells.sum():,} | {np.sqrt(np.mean(error[cells] ** 2)):.4f} m | {min(alone):.4f} m"
        print(f"| {name} | {row} | {inside[0]:.0%} | {inside[1]:.0%} |")

# %%
COLOURS = ListedColormap(["#d55e00", "#e69f00", "#cc79a7", "#0072b2", "#56b4e9", "#009e73", "#999999"])
values = list(fused.legend)
place = np.searchsorted(values, fused.source.height_m).astype(float)
made_by = Raster(grid=grid, height_m=np.where(fused.source.filled, place, np.nan), quantity="mask")
off = Raster(grid=grid, height_m=error, quantity="height error")
figure = Figure(figsize=(13.0, 6.8), layout="constrained")
panels = [
    ("Fused map (m)", fused.dem, "terrain", Normalize(*np.nanpercentile(fused.dem.height_m, [1, 99]))),
    ("Sources of each cell", made_by, COLOURS, Normalize(-0.5, COLOURS.N - 0.5)),
    ("Stated standard deviation (m)", fused.sigma, "viridis", Normalize(0.0, 0.1)),
    ("Error (m)", off, "RdBu_r", Normalize(-0.1, 0.1)),
]
for axes, (title, raster, colours, scale) in zip(figure.subplots(1, 4), panels, strict=True):
    show_raster(axes, raster, colours, scale)
    finish_map(axes, grid.extent_m, title)
    if raster is made_by:
        for number, value in enumerate(values):
            axes.plot([], [], "s", color=COLOURS(number), label=fused.legend[value])
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), fontsize=8, frameon=False)
    else:
        colour_bar(axes, ScalarMappable(scale, colours), "", 2.0)
figure.savefig("fusion.png", dpi=110)
