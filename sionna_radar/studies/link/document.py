"""A link budget as files, table and figures."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from rich.table import Table

from sionna_radar.foundation.decibels import decibels, to_db
from sionna_radar.report.colours import BLUE, ORANGE, RED
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.files.contents import csv_text
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import number
from sionna_radar.studies.link.spectra import ROUNDING
from sionna_radar.studies.link.study import SURE, TOLERANCE_DB, Link, LinkBudget, Simulated

COLOURS = (BLUE, ORANGE, RED, "tab:purple", "tab:green", "tab:brown", "tab:olive", "tab:cyan")
LINES = ("-", "--", ":", "-.")
MIN_DB = -20.0
# Shown depth below the floors.
DEPTH_DB = 25.0


def draw_link(budget: LinkBudget) -> Figure:
    """Draw signal to noise above, and probabilities below, over range; one column per material."""
    materials = list(dict.fromkeys(link.material for link in budget.links))
    width = max(7.5, 0.8 + 4.6 * len(materials))
    figure = ReportFigure(figsize=(width, 7.2), layout="constrained")
    panels = figure.subplots(2, len(materials), sharex=True, sharey="row", squeeze=False, height_ratios=[1.5, 1.0])
    incidences = sorted({link.incidence_deg for link in budget.links})
    rains = sorted({link.rain_mm_per_h for link in budget.links})
    for column, material in enumerate(materials):
        upper, lower = panels[:, column]
        for link in (entry for entry in budget.links if entry.material == material):
            colour = COLOURS[incidences.index(link.incidence_deg) % len(COLOURS)]
            _draw(upper, lower, link, colour, LINES[rains.index(link.rain_mm_per_h) % len(LINES)])
        upper.axhline(0.0, color="black", lw=0.8)
        upper.set_title(f"Over {material}", fontsize="medium")
        lower.set(xlabel="Range (m)", ylim=(-0.03, 1.03))
        for axes in (upper, lower):
            axes.grid(alpha=0.3)
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")
    panels[0, 0].set_ylabel("SNR of the ground in a range cell (dB)")
    panels[0, 0].set_ylim(bottom=max(panels[0, 0].get_ylim()[0], MIN_DB))
    panels[1, 0].set_ylabel("Probability of detecting the ground\n(lines: by its strongest cell alone)")
    handles = [Line2D([], [], color=COLOURS[i % len(COLOURS)], label=f"{a:g} deg") for i, a in enumerate(incidences)]
    handles += [Line2D([], [], color="0.3", ls=LINES[i % len(LINES)], label=f"{r:g} mm/h") for i, r in enumerate(rains)]
    handles += [Line2D([], [], color="0.3", ls="", marker="o", label="Simulated; below: any echo passes")]
    handles += [Line2D([], [], color="0.3", ls="", marker="D", mfc="none", label="Found by the survey's detector")]
    if any(link.of_ground("clutter").any() for link in budget.links):
        handles += [Line2D([], [], color="0.3", lw=0.7, alpha=0.6, label="Above: air alone; below: any echo passes")]
    figure.legend(handles=handles, loc="outside lower center", ncols=3 if len(materials) > 1 else 2, frameon=False)
    return figure


def draw_floors(budget: LinkBudget) -> Figure:
    """Draw the floors in each range cell under the echo of the survey, with the spectrum of simulated pulses."""
    floors = budget.floors
    figure = ReportFigure(figsize=(8.5, 5.6), layout="constrained")
    axes = figure.subplots()
    shown, envelopes = slice(1, None), floors.envelopes
    total = floors.ground + floors.clutter + np.sum(list(floors.terms.values()), axis=0)
    scale = 1e3 if budget.physical else 1.0
    axes.plot(floors.range_m[shown], _levels(scale * floors.found)[shown], color="0.75", lw=2.5, label="Simulated")
    axes.plot(floors.range_m[shown], _levels(scale * total)[shown], color="black", lw=0.9, label="All together")
    axes.plot(floors.range_m[shown], _levels(scale * floors.ground)[shown], color=BLUE, label="Ground")
    if np.any(floors.clutter > 0):
        axes.plot(floors.range_m[shown], _levels(scale * floors.clutter)[shown], color=ORANGE, label="Echo of the air")
    for index, (name, level) in enumerate(envelopes.items()):
        colour = COLOURS[2 + index % (len(COLOURS) - 2)]
        axes.plot(floors.range_m[shown], _levels(scale * level)[shown], ls="--", color=colour, label=name.capitalize())
    # From some depth below the minimum of the highest floor.
    lowest = float(np.min(_levels(scale * np.max(list(envelopes.values()), axis=0))[shown]))
    highest = float(np.nanmax(_levels(scale * total)[shown]))
    axes.set_ylim(lowest - DEPTH_DB, highest + 5.0)
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    unit = "dBm" if budget.physical else "dB rel. to transmitted"
    axes.set(xlabel="Range (m)", ylabel=f"Mean power in a range cell ({unit})")
    axes.set_title(f"Floors over range, ground at {floors.echo_m:.0f} m", fontsize="medium")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize="small", loc="upper right")
    return figure


def _levels(power: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return decibels(np.where(power > 0, power, np.nan))


def _draw(upper: Axes, lower: Axes, link: Link, colour: str, line: str) -> None:
    snr, clutter = link.of_ground("snr"), link.of_ground("clutter")
    upper.plot(link.range_m, decibels(snr), color=colour, ls=line)
    if np.any(clutter > 0):
        upper.plot(link.range_m, _levels(clutter), color=colour, lw=0.7, alpha=0.6, ls=line)
    lower.plot(link.range_m, link.of_ground("detection"), color=colour, ls=line)
    lower.plot(link.range_m, link.of_ground("passing"), color=colour, lw=0.7, alpha=0.6, ls=line)
    for simulated in link.simulated:
        style = {"marker": "o", "ls": "", "mfc": colour, "mec": "black", "ms": 5}
        upper.plot(simulated.range_m, to_db(max(simulated.found - simulated.ground.clutter, 0.0)), **style)
        lower.plot(simulated.range_m, simulated.passed, **style)
        lower.plot(
            simulated.range_m, simulated.survey_detection, **style | {"marker": "D", "mfc": "none", "mec": colour}
        )


MEANING = (
    "ground_snr_db is the mean power of the ground's strongest range cell over the noise in it, signal_to_clutter_db "
    "over what is in the air there. detection_probability is that of detecting the ground in this cell alone in one "
    "pulse against noise and clutter, false_alarm_probability that the cell passes the CFAR without the ground, "
    "passing_probability that it passes with all that is in it. Under `simulated` passed is the share of simulated "
    "pulses in which it does, survey_detection the share in which the survey's own detector finds the ground, and "
    "difference_db ground and clutter there over the closed form. cell_reach_m is the farthest range up to which "
    "detection_probability is at least reach_probability, survey_reach_m that up to which survey_detection is; with "
    "reaches_the_end the sampled ranges end before one of them does."
)


def link_numbers(budget: LinkBudget) -> dict[str, Any]:
    """Return the numbers."""
    return {
        "agrees": budget.agrees,
        "largest_difference_db": budget.largest_difference_db,
        "tolerance_db": TOLERANCE_DB,
        "dynamic_range_db": budget.dynamic_range_db,
        "reach_probability": SURE,
        "noise_w": budget.noise_w,
        "transmit_power_w": budget.transmit_power_w,
        "floors": _floors(budget),
        "meaning": MEANING,
        "links": [_link(link) for link in budget.links],
        "scenario": budget.scenario,
    }


def link_csv(budget: LinkBudget) -> str:
    """Return the closed form as a table, one row per range."""
    columns = ["material", "incidence_deg", "rain_mm_per_h", "range_m", *budget.links[0].ground[0].numbers()]
    rows = []
    for link in budget.links:
        case = link.material, f"{link.incidence_deg:g}", f"{link.rain_mm_per_h:g}"
        for range_m, ground in zip(link.range_m, link.ground, strict=True):
            values = range_m, *ground.numbers().values()
            rows.append([*case, *(f"{value:.6g}" if np.isfinite(value) else "" for value in values)])
    return csv_text(columns, rows)


def _floors(budget: LinkBudget) -> dict[str, Any]:
    floors = budget.floors
    spectra = {"ground": floors.ground, "clutter": floors.clutter, **floors.terms, "simulated": floors.found}
    return {
        "ground_m": floors.echo_m,
        "unit": "dBW" if budget.physical else "dB over the transmitted power",
        "highest": [{"floor": name, "from_m": start, "to_m": end} for name, start, end in floors.rulers()],
        "range_m": floors.range_m,
        "power_db": {name: decibels(power) for name, power in spectra.items()},
    }


def _link(link: Link) -> dict[str, Any]:
    return {
        "material": link.material,
        "incidence_deg": link.incidence_deg,
        "rain_mm_per_h": link.rain_mm_per_h,
        "cell_reach_m": link.cell_reach_m,
        "survey_reach_m": link.survey_reach_m,
        "reaches_the_end": link.reaches_the_end,
        "range_m": link.range_m,
        **{name: [entry.numbers()[name] for entry in link.ground] for name in link.ground[0].numbers()},
        "simulated": [_simulated(entry) for entry in link.simulated],
    }


def _simulated(simulated: Simulated) -> dict[str, Any]:
    return {
        "range_m": simulated.range_m,
        **simulated.ground.numbers(),
        "difference_db": simulated.difference_db,
        "spread_db": simulated.spread_db,
        "compared": simulated.compared,
        "passed": simulated.passed,
        "echo_passed": simulated.echo_passed,
        "survey_detection": simulated.survey_detection,
        "reason": simulated.reason or None,
    }


# Largest number of printed floors; the file has all.
MAX_RULERS = 6

LEGEND = (
    "cell: the strongest range cell tested alone, in closed form; survey: the survey's detector, simulated,",
    "which behind rain looks for the end of the rain's echo",
    f"reach: farthest range up to which Pd is at least {SURE:g}; Pd: probability of detecting the ground in a pulse;",
    "S/C: signal to clutter; Pfa rain: false alarm from rain alone; diff: simulated over closed form",
)


def sentences(budget: LinkBudget) -> list[str]:
    """Return a legend of the columns, the agreement of closed form and simulation, floors, and what is missing."""
    found = list(LEGEND)
    if any(link.reaches_the_end for link in budget.links):
        found.append("+: the sampled ranges end there, not the reach; raise radar.samples_per_chirp")
    if np.isnan(budget.largest_difference_db):
        found.append("closed form and simulation were not compared: too few pulses, or echoes too far under the noise")
    else:
        word, largest = "agree" if budget.agrees else "DIFFER", number(budget.largest_difference_db, ".2f", " dB")
        found.append(f"closed form and simulation {word}: at most {largest} apart (within {TOLERANCE_DB:g} dB)")
    found.append(f"dynamic range of detected echoes: {number(budget.dynamic_range_db, '.0f', ' dB')}")
    rulers = budget.floors.rulers()
    found += [f"highest floor from {start:.1f} to {end:.1f} m: {name}" for name, start, end in rulers[:MAX_RULERS]]
    sound = budget.largest_difference_db <= TOLERANCE_DB  # also false without any comparison
    if not sound and any(name == ROUNDING for name, _, _ in rulers):
        coarse = "rounding is no noise where echoes and noise are smaller than a step of the converter"
        found.append(f"{coarse}: raise radar.receiver.converter.gain_db, or bits")
    reasons = dict.fromkeys(simulated.reason for link in budget.links for simulated in link.simulated)
    return [*found, *(f"not simulated: {reason}" for reason in reasons if reason)]


def link_table(budget: LinkBudget) -> Table:
    """Return the closed form and the simulation of the ground at the simulated ranges."""
    rows = [(link, simulated) for link in budget.links for simulated in link.simulated]
    table = SIMULATED.table("Echo of the ground in one pulse", rows)
    table.pad_edge, table.padding = False, (0, 0)  # 80 columns
    return table


def _once(text: Callable[[Link], str]) -> Callable[[tuple[Link, Simulated]], str]:
    """Return the text of a link in the first of its rows, nothing in the others."""
    return lambda row: text(row[0]) if row[1] is row[0].simulated[0] else ""


def _reach(link: Link, reach_m: float) -> str:
    return number(reach_m, ".0f") + ("+" if reach_m == link.range_m[-1] else "")


def _of_ground(key: str) -> Callable[[tuple[Link, Simulated]], float]:
    return lambda row: row[1].ground.numbers()[key]


def _false_alarm(row: tuple[Link, Simulated]) -> float:
    ground = row[1].ground
    return ground.numbers()["false_alarm_probability"] if ground.clutter > 0 else float("nan")


SIMULATED = Columns[tuple[Link, Simulated]](
    [
        Column(heading="material", value=_once(lambda link: link.material)),
        Column(heading="inci-\ndence\ndeg", text=_once(lambda link: f"{link.incidence_deg:g}")),
        Column(heading="rain\n\nmm/h", text=_once(lambda link: f"{link.rain_mm_per_h:g}")),
        Column(heading="reach\ncell\nm", text=_once(lambda link: _reach(link, link.cell_reach_m))),
        Column(heading="reach\nsurvey\nm", text=_once(lambda link: _reach(link, link.survey_reach_m))),
        Column(heading="range\n\nm", form=".1f", value=lambda row: row[1].range_m),
        Column(heading="SNR\n\ndB", form=".1f", value=_of_ground("ground_snr_db")),
        Column(heading="S/C\n\ndB", form=".1f", value=_of_ground("signal_to_clutter_db")),
        Column(heading="Pd\ncell", form=".3f", value=_of_ground("detection_probability")),
        Column(heading="Pd\nsurvey", form=".2f", value=lambda row: row[1].survey_detection),
        Column(heading="Pfa\nrain", form=".3f", value=_false_alarm),
        Column(heading="diff\n\ndB", form="+.2f", value=lambda row: row[1].difference_db),
    ]
)
DOCUMENT = StudyDocument[LinkBudget](
    marker="link.json",
    suffix="_link",
    numbers=link_numbers,
    tables=lambda budget: [link_table(budget)],
    lines=sentences,
    figures=lambda _: {"link": draw_link, "floors": draw_floors},
    notebook=["link"],
    texts={"link.csv": link_csv},
)
