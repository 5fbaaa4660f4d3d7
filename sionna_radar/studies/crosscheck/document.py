"""A cross-check of two engines as files, table and figures."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from rich.table import Table

from sionna_radar.foundation.decibels import decibels
from sionna_radar.foundation.raster import Raster
from sionna_radar.report.colours import BLUE, ERRORS, HEIGHTS, ORANGE
from sionna_radar.report.drawing import ReportFigure, map_size, show_raster
from sionna_radar.report.page.sections import limit_of
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import number
from sionna_radar.studies.crosscheck.study import INCIDENCE_STEP_DEG, CrossCheck

GREY = "0.45"
MAP_BOX_IN = (4.0, 4.0)


def power(check: CrossCheck) -> Figure:
    """Draw the power of every pulse against its incidence for both engines, and the difference."""
    figure = ReportFigure(figsize=(8.0, 7.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1.2, 1.0])
    incidence_deg = np.rad2deg(check.sionna.incidence_rad)
    rings = {"mfc": "none", "mec": BLUE, "ms": 7.0, "label": "Sionna engine"}
    dots = {"mfc": ORANGE, "mew": 0, "ms": 3.5, "label": "Gamma engine"}
    for run, style in ((check.sionna, rings), (check.gamma, dots)):
        upper.plot(incidence_deg, decibels(run.power), ls="", marker="o", **style)
    upper.set_ylabel("Power of an echo (dB rel. to transmitted)")
    upper.set_title("Power of each pulse, summed incoherently over its paths", fontsize="medium")
    upper.legend(frameon=False)
    difference = check.power_difference_db
    lower.plot(incidence_deg, difference, ls="", marker="o", ms=2, mew=0, color=GREY, alpha=0.5, label="Pulse")
    bins = check.by_incidence()
    lower.plot(
        [b.incidence_deg for b in bins],
        [b.mean_power_difference_db for b in bins],
        ls="",
        marker="D",
        ms=6,
        mfc=ORANGE,
        mec="black",
        label=f"Mean power in {INCIDENCE_STEP_DEG:g} deg",
    )
    tolerance = check.tolerances.mean_power_db
    lower.axhspan(-tolerance, tolerance, color=BLUE, alpha=0.12, lw=0, label=f"Tolerance ±{tolerance:g} dB")
    reach = limit_of(np.append(difference, tolerance))
    lower.set_ylim(-1.3 * reach, 1.3 * reach)
    lower.axhline(0.0, color="black", lw=0.8)
    lower.set(xlabel="Mean local incidence (deg)", ylabel="Gamma minus Sionna (dB)")
    title = f"Difference of power: mean {number(check.mean_power_difference_db, '+.3f', ' dB')}"
    lower.set_title(title, fontsize="medium")
    lower.legend(frameon=False, ncols=3, loc="upper left")
    for axes in (upper, lower):
        axes.grid(alpha=0.3)
    return figure


def ranges(check: CrossCheck) -> Figure:
    """Draw the range differences of the engines: before speckle, and as detected, with two seeds of one."""
    figure = ReportFigure(figsize=(9.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    paths = check.gamma.range_m - check.sionna.range_m
    _histogram(left, [(100 * paths, BLUE, "Gamma minus Sionna")], "Difference of power-weighted range", "cm")
    left.set_title("Difference of a pulse's mean range,\nbefore speckle", fontsize="medium")
    echoes = check.gamma.echo_range_m - check.sionna.echo_range_m
    seeds = check.sionna_again.echo_range_m - check.sionna.echo_range_m
    shown = [(echoes, BLUE, "Gamma minus Sionna"), (seeds, ORANGE, "Sionna, two seeds")]
    _histogram(right, shown, "Difference of the strongest echo's range", "m")
    right.set_title("Difference of the detected range,\nwith speckle", fontsize="medium")
    return figure


def dems(check: CrossCheck) -> Figure:
    """Draw the DEMs of both engines on one colour scale, and their difference."""
    rasters = [check.sionna.dem, check.gamma.dem, check.dem_difference]
    width, height = map_size(check.gamma.dem.grid.extent_m, MAP_BOX_IN)
    size = 3 * (max(width, 2.0) + 1.6), max(height, 1.5) + 1.7
    figure = ReportFigure(figsize=size, layout="constrained")
    filled = np.concatenate([r.height_m[r.filled] for r in rasters[:2]])
    heights = Normalize(*(np.percentile(filled, [0.5, 99.5]) if len(filled) else (0.0, 1.0)))
    reach = limit_of(rasters[2].height_m.ravel())
    engines, seeds = (number(v, ".3f", " m") for v in (check.dem_rms_difference_m, check.dem_speckle_rms_m))
    speckle = f"RMS {engines},\nspeckle alone {seeds}"
    titles = "DEM of the Sionna engine", "DEM of the gamma engine", f"Difference, gamma minus Sionna\n{speckle}"
    styles = [(HEIGHTS, heights, "Height (m)")] * 2 + [(ERRORS, Normalize(-reach, reach), "Difference (m)")]
    for axes, raster, title, style in zip(figure.subplots(1, 3), rasters, titles, styles, strict=True):
        _map(axes, raster, *style)
        axes.set_title(title, fontsize="medium")
    return figure


def _map(axes: Axes, raster: Raster, colours: str, scale: Normalize, label: str) -> None:
    show_raster(axes, raster, colours, scale)
    axes.set(xlabel="East (m)", ylabel="North (m)")
    axes.figure.colorbar(ScalarMappable(scale, colours), ax=axes, extend="both", label=label, shrink=0.8)


def _histogram(axes: Axes, shown: list[tuple[Float[np.ndarray, " n"], str, str]], label: str, unit: str) -> None:
    """Draw distributions on common bins that cover 99 % of the first."""
    reach = limit_of(shown[0][0])
    edges = np.linspace(-reach, reach, 61)
    for values, colour, name in shown:
        finite = values[np.isfinite(values)]
        percentage = 100 * np.histogram(finite, bins=edges)[0] / max(len(finite), 1)
        spread = f"{name}\nmean {finite.mean():+.3f} {unit}, std {finite.std():.3f} {unit}" if len(finite) else name
        axes.stairs(percentage, edges, fill=True, color=colour, alpha=0.5, label=spread)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set(xlabel=f"{label} ({unit})", ylabel="Share of pulses (%)", xlim=(-reach, reach))
    axes.xaxis.set_major_locator(MaxNLocator(nbins=5))
    axes.set_ylim(top=1.6 * axes.get_ylim()[1])
    axes.legend(frameon=False, loc="upper right", fontsize="small")
    axes.spines[["top", "right"]].set_visible(False)


SPECKLE = (
    "Powers are sums of |gain|^2 over a pulse's paths, free of speckle. The DEMs are not: two seeds of one "
    "engine already differ. dem_rms_difference_m is over all four pairs of a Sionna and a gamma run; "
    "dem_speckle_rms_m, over the pairs of one engine, is the part due to speckle alone; dem_probability is the "
    "probability of such a difference by speckle alone (randomisation test over dem_tiles tiles of the map)."
)
SHARED = (
    "Both engines share the ray casting, the antenna, the backscatter models, the point targets and the mirror "
    "reflections; the cross-check does not test those."
)


def crosscheck_numbers(check: CrossCheck) -> dict[str, Any]:
    """Return the numbers of the comparison."""
    repeat_m = check.sionna_again.echo_range_m
    return {
        "agrees": check.agrees,
        "mean_power_difference_db": check.mean_power_difference_db,
        "p95_abs_power_difference_db": check.p95_abs_power_difference_db,
        "mean_power_scatter_db": check.mean_power_scatter_db,
        "p95_power_scatter_db": check.p95_power_scatter_db,
        "power_difference_db": _spread(check.power_difference_db),
        "power_trend_db_per_10deg": check.power_trend_db_per_10deg(),
        "power_by_incidence": check.by_incidence(),
        "range_difference_m": _spread(check.gamma.range_m - check.sionna.range_m),
        "echo_range_difference_m": _spread(check.gamma.echo_range_m - check.sionna.echo_range_m),
        "echo_range_difference_of_seeds_m": _spread(repeat_m - check.sionna.echo_range_m),
        "dem_rms_difference_m": check.dem_rms_difference_m,
        "dem_mean_difference_m": check.mean_m(),
        "dem_speckle_rms_m": check.dem_speckle_rms_m,
        "dem_probability": check.dem_test.probability,
        "dem_tiles": check.dem_test.tiles,
        "dem_rms_of_sionna_seeds_m": check.rms_m(check.sionna_again, check.sionna),
        "dem_rms_of_gamma_seeds_m": check.rms_m(check.gamma_again, check.gamma),
        "dem_cells": int(check.common().sum()),
        "pulses": len(check.sionna.power),
        "seeds": [check.sionna.seed, check.sionna_again.seed],
        "tolerances": check.tolerances,
        "verdict": check.verdict(),
        "speckle": SPECKLE,
        "shared": SHARED,
        "scenario": check.scenario,
    }


def _spread(values: Float[np.ndarray, " n"]) -> dict[str, float]:
    """Return the centre and the width of a distribution, without and with outliers."""
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return dict.fromkeys(("mean", "std", "median", "p95_abs"), math.nan)
    return {
        "mean": float(finite.mean()),
        "std": float(finite.std()),
        "median": float(np.median(finite)),
        "p95_abs": float(np.percentile(np.abs(finite), 95)),
    }


def _verdict(agrees: bool, difference: float) -> str:
    return "agrees" if agrees else "DIFFERS" if math.isfinite(difference) else "not comparable"


VERDICT = Columns[dict[str, Any]](
    [
        Column(key="name", heading="difference"),
        Column(key="value", heading="value", form="+.4f"),
        Column(key="tolerance", heading="within", form=".4f"),
        Column(key="agrees", heading="", value=lambda row: _verdict(row["agrees"], row["value"])),
        Column(
            key="probability",
            heading="by speckle alone",
            text=lambda row: f"p = {row['probability']:.4f}" if "probability" in row else "",
        ),
    ]
)


def verdict_table(check: CrossCheck) -> Table:
    """Return each difference with its tolerance and verdict."""
    rows = ({"name": name, **entry} for name, entry in check.verdict().items())
    return VERDICT.table(f"The engines {'agree' if check.agrees else 'DIFFER'}", rows)


DOCUMENT = StudyDocument[CrossCheck](
    marker="crosscheck.json",
    suffix="_crosscheck",
    numbers=crosscheck_numbers,
    tables=lambda check: [verdict_table(check)],
    lines=lambda _: ["shared by both, so not checked: ray casting, antenna, backscatter models, targets, mirrors"],
    figures=lambda _: {"power": power, "ranges": ranges, "dems": dems},
    notebook=["dems"],
)
