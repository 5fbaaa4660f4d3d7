"""Figures of a link budget: signal, clutter and probability of detection over range."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sionna_radar.foundation.decibel import decibels, to_db
from sionna_radar.report.colours import BLUE, ORANGE, RED
from sionna_radar.report.figure_files import ReportFigure, save_figures
from sionna_radar.studies.link_result import Link, LinkBudget

COLOURS = (BLUE, ORANGE, RED, "0.35", "tab:green", "tab:purple", "tab:brown", "tab:olive")
LINES = ("-", "--", ":", "-.")
LEAST_DB = -20.0
# What is shown under the floors.
DEPTH_DB = 25.0


def draw_all(budget: LinkBudget, directory: Path) -> list[Path]:
    """Draw every figure into a directory as PNG, and return the files."""
    return save_figures(budget, {"link": draw_link, "floors": draw_floors}, directory)


def draw_link(budget: LinkBudget) -> Figure:
    """Draw signal to noise above, and probabilities below, over range; a column for each material."""
    materials = list(dict.fromkeys(one.material for one in budget.links))
    width = max(7.5, 0.8 + 4.6 * len(materials))
    figure = ReportFigure(figsize=(width, 7.2), layout="constrained")
    panels = figure.subplots(2, len(materials), sharex=True, sharey="row", squeeze=False, height_ratios=[1.5, 1.0])
    incidences = sorted({one.incidence_deg for one in budget.links})
    rains = sorted({one.rain_mm_per_h for one in budget.links})
    for column, material in enumerate(materials):
        upper, lower = panels[:, column]
        for one in (found for found in budget.links if found.material == material):
            colour = COLOURS[incidences.index(one.incidence_deg) % len(COLOURS)]
            _draw(upper, lower, one, colour, LINES[rains.index(one.rain_mm_per_h) % len(LINES)])
        upper.axhline(0.0, color="black", lw=0.8)
        upper.set_title(f"Over {material}", fontsize="medium")
        lower.set(xlabel="Range (m)", ylim=(-0.03, 1.03))
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")
    panels[0, 0].set_ylabel("SNR of the ground in a range cell (dB)")
    panels[0, 0].set_ylim(bottom=max(panels[0, 0].get_ylim()[0], LEAST_DB))
    panels[1, 0].set_ylabel("Probability of detecting the ground")
    handles = [Line2D([], [], color=COLOURS[i % len(COLOURS)], label=f"{a:g} deg") for i, a in enumerate(incidences)]
    handles += [Line2D([], [], color="0.3", ls=LINES[i % len(LINES)], label=f"{r:g} mm/h") for i, r in enumerate(rains)]
    handles += [Line2D([], [], color="0.3", ls="", marker="o", label="Simulated")]
    if any(one.of_ground("clutter").any() for one in budget.links):
        handles += [Line2D([], [], color="0.3", lw=0.7, alpha=0.6, label="Air alone; any echo passes")]
    figure.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 4), frameon=False)
    return figure


def draw_floors(budget: LinkBudget) -> Figure:
    """Draw what every noise leaves in each range cell, under the echo that the survey has, beside simulated pulses."""
    found = budget.floors
    figure = ReportFigure(figsize=(8.5, 5.6), layout="constrained")
    axes = figure.subplots()
    shown, envelopes = slice(1, None), found.envelopes
    every = found.ground + found.clutter + np.sum(list(found.terms.values()), axis=0)
    scale = 1e3 if budget.physical else 1.0
    axes.plot(found.range_m[shown], _levels(scale * found.found)[shown], color="0.75", lw=2.5, label="Simulated")
    axes.plot(found.range_m[shown], _levels(scale * every)[shown], color="black", lw=0.9, label="All together")
    axes.plot(found.range_m[shown], _levels(scale * found.ground)[shown], color=BLUE, label="Ground")
    if np.any(found.clutter > 0):
        axes.plot(found.range_m[shown], _levels(scale * found.clutter)[shown], color=ORANGE, label="Echo of the air")
    for number, (name, level) in enumerate(envelopes.items()):
        colour = COLOURS[2 + number % (len(COLOURS) - 2)]
        axes.plot(found.range_m[shown], _levels(scale * level)[shown], ls="--", color=colour, label=name.capitalize())
    # Where the highest floor is lowest, and some way under it.
    lowest = float(np.min(_levels(scale * np.max(list(envelopes.values()), axis=0))[shown]))
    highest = float(np.nanmax(_levels(scale * every)[shown]))
    axes.set_ylim(lowest - DEPTH_DB, highest + 5.0)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    unit = "dBm" if budget.physical else "dB rel. to transmitted"
    axes.set(xlabel="Range (m)", ylabel=f"Mean power in a range cell ({unit})")
    axes.set_title(f"Floors over range, ground at {found.echo_m:.0f} m", fontsize="medium")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small", loc="upper right")
    return figure


def _levels(power: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return decibels(np.where(power > 0, power, np.nan))


def _draw(upper: Axes, lower: Axes, one: Link, colour: str, line: str) -> None:
    snr, clutter = one.of_ground("snr"), one.of_ground("clutter")
    upper.plot(one.range_m, decibels(snr), color=colour, ls=line)
    if np.any(clutter > 0):
        upper.plot(one.range_m, _levels(clutter), color=colour, lw=0.7, alpha=0.6, ls=line)
    lower.plot(one.range_m, one.of_ground("detection"), color=colour, ls=line)
    lower.plot(one.range_m, one.of_ground("passing"), color=colour, lw=0.7, alpha=0.6, ls=line)
    for each in one.simulated:
        style = {"marker": "o", "ls": "", "mfc": colour, "mec": "black", "ms": 5}
        upper.plot(each.range_m, to_db(max(each.found - each.ground.clutter, 0.0)), **style)
        lower.plot(each.range_m, each.passed, **style)
