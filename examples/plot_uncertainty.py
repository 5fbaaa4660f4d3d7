"""
How well the map knows itself
=============================

Every DEM comes with the standard deviation of each of its cells, `dem_sigma.tif`, worked out from the echoes alone:
their speckle and noise, the beam's footprint, the gaps between them, and how rough the ground showed itself to be. The
simulation holds the truth of every cell, so that can be checked: of the cells, 90 % should lie within the interval that
is stated for 90 %.

xDEM, where it is installed (`pip install 'sionna-radar[compare]'`), infers a standard deviation from the same DEM and
the truth itself: the spread of the error by classes of slope. It is right on the average, since it has seen the errors;
it cannot tell which cells of a class are well known. Ours has not seen them.
"""

# %%
import importlib.util
import os
import warnings

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import norm

from sionna_radar import Raster, load_scenario, run
from sionna_radar.report import colour_bar, finish_map, show_raster

SMALL = "SIONNA_RADAR_SMALL" in os.environ
LENGTH = {"platform.length_m": 8.0, "terrain.spacing_m": 2.0} if SMALL else {}
survey = run(load_scenario("ridges", LENGTH | {"dem.method": "smooth", "radar.antenna.beamwidth_deg": 4.0}))
error, sigma, truth = survey.error, survey.dem_sigma, survey.truth
known = error.filled & sigma.filled & survey.lit
check = survey.dem_uncertainty
print(f"RMS of the error {survey.lit_error.rms_m:.3f} m, of the stated sigma {check.cells.sigma_rms_m:.3f} m")
print("inside the stated intervals:", {f"{name} %": f"{share:.1%}" for name, share in check.cells.coverage.items()})
for window in check.means:
    print(f"mean over {window.window_m:g} m: error {window.error_rms_m:.3f} m, stated {window.sigma_rms_m:.3f} m")


# %%
def by_xdem() -> Raster | None:
    """What xDEM infers from the DEM and the truth: the spread of the error by slope."""
    if importlib.util.find_spec("xdem") is None:
        print("xDEM is not installed: no figure of what it infers (pip install 'sionna-radar[compare]')")
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import xdem

        rows = slice(None, None, -1)  # its rasters begin in the north
        slope = np.asarray(xdem.terrain.slope(truth.height_m[rows], resolution=truth.grid.spacing_m))[rows]
        slope = np.where(np.isfinite(slope), slope, np.nanmedian(slope))
        off = np.where(known, error.height_m, np.nan)
        quantiles = np.unique(np.nanquantile(slope[known], np.linspace(0, 1, 9)))
        binned = xdem.spatialstats.nd_binning(
            error.height_m[known],
            list_var=[slope[known]],
            list_var_names=["slope"],
            list_var_bins=[quantiles],
            statistics=["count", xdem.spatialstats.nmad],
        )
        inferred = xdem.spatialstats.interp_nd_binning(binned, ["slope"], statistic="nmad")(slope[..., None])
        print(binned[["slope", "count", "nmad"]].to_string(index=False))
        if importlib.util.find_spec("skgstat") is None:
            print("its variograms need scikit-gstat, which needs an older SciPy than Sionna RT runs with: left out")
        else:
            lags = xdem.spatialstats.sample_empirical_variogram(
                off / inferred, gsd=truth.grid.spacing_m, subsample=500, n_variograms=4, random_state=1
            )
            print(lags[["lags", "exp"]].head(12).to_string(index=False))
    return Raster(grid=error.grid, height_m=np.where(known, inferred, np.nan))


theirs = by_xdem()


# %%
def inside(stated: Raster) -> np.ndarray:
    """The share of cells inside the interval stated for each of some shares."""
    z = np.abs(error.height_m[known] / stated.height_m[known])
    return np.array([np.mean(z <= norm.ppf(0.5 + share / 2)) for share in SHARES])


SHARES = np.linspace(0.02, 0.98, 49)
size = Raster(grid=error.grid, height_m=np.where(known, np.abs(error.height_m), np.nan))
maps = {"Size of the error": size, "Stated by the map (sigma)": sigma.within(known)}
if theirs is not None:
    maps["Inferred by xDEM from error and slope"] = theirs
figure = Figure(figsize=(4.6 * len(maps) + 4.6, 4.6), layout="constrained")
*panels, curve = figure.subplots(1, len(maps) + 1)
scale = Normalize(0, float(np.nanquantile(size.height_m, 0.98)))
for axes, (title, raster) in zip(panels, maps.items(), strict=True):
    show_raster(axes, raster, "magma_r", scale)
    finish_map(axes, truth.grid.extent_m, title)
colour_bar(panels[-1], ScalarMappable(scale, "magma_r"), "m", 2.4, extend="max")
curve.plot([0, 1], [0, 1], color="0.6", lw=1, label="as stated")
curve.plot(SHARES, inside(sigma), color="#0072b2", label="by the map, from echoes alone")
if theirs is not None:
    curve.plot(SHARES, inside(theirs), "--", color="#d55e00", label="by xDEM, from the errors")
curve.set(xlabel="Stated share", ylabel="Share of cells inside", title="Calibration", aspect="equal")
curve.legend(frameon=False)
figure.savefig("uncertainty.png", dpi=150, bbox_inches="tight")
