"""The table of a link budget, for the terminal: what the closed form expects, and what was found by simulation."""

import numpy as np
from rich.table import Table

from sionna_radar.report.terminal import console, number
from sionna_radar.studies.link_floors import ROUNDING
from sionna_radar.studies.link_result import SURE, TOLERANCE_DB, LinkBudget

# Floors that take turns are all in the file.
MOST_RULERS = 6

LEGEND = (
    "S/C: signal to clutter; Pd: that the ground is detected against noise and clutter; Pfa: that the cell passes",
    "without the ground, by rain; diff: ground and clutter as simulated over the closed form; reach: up to there",
    f"{SURE:.0%} of pulses pass the CFAR in that cell, with more ground than clutter in it",
)


def print_link(budget: LinkBudget) -> None:
    """Print a row for each simulated range, what the columns are, and whether closed form and simulation agree."""
    out = console()
    out.print(link_table(budget))
    for line in LEGEND:
        out.print(line, soft_wrap=True)
    if any(link.reaches_the_end for link in budget.links):
        out.print("+: the sampled ranges end there, not the reach; raise radar.samples_per_chirp", soft_wrap=True)
    if np.isnan(budget.largest_difference_db):
        said = "closed form and simulation were not compared: too few pulses, or echoes too far under the noise"
    else:
        word, largest = "agree" if budget.agrees else "DIFFER", number(budget.largest_difference_db, ".2f", " dB")
        said = f"closed form and simulation {word}: at most {largest} apart (within {TOLERANCE_DB:g} dB)"
    out.print(said, soft_wrap=True)
    out.print(f"dynamic range of detected echoes: {number(budget.dynamic_range_db, '.0f', ' dB')}")
    for name, start, end in budget.floors.rulers()[:MOST_RULERS]:
        out.print(f"highest floor from {start:.1f} to {end:.1f} m: {name}", soft_wrap=True)
    sound = budget.largest_difference_db <= TOLERANCE_DB  # false, too, where nothing was compared
    if not sound and any(name == ROUNDING for name, _, _ in budget.floors.rulers()):
        coarse = "rounding is no noise where echoes and noise are smaller than a step of the converter"
        out.print(f"{coarse}: raise radar.receiver.converter.gain_db, or bits", soft_wrap=True)
    for reason in dict.fromkeys(one.reason for link in budget.links for one in link.simulated if one.reason):
        out.print(f"not simulated: {reason}", soft_wrap=True)


def link_table(budget: LinkBudget) -> Table:
    """Return the ground at the simulated ranges in closed form, and beside it what was simulated."""
    title = "Strongest range cell of the ground in one pulse"
    table = Table(title=title, title_justify="left", pad_edge=False)
    table.add_column("material")
    for name in (
        "beam\ndeg",
        "rain\nmm/h",
        "reach\nm",
        "range\nm",
        "SNR\ndB",
        "S/C\ndB",
        "Pd",
        "Pfa\nrain",
        "diff\ndB",
    ):
        table.add_column(name, justify="right")
    for link in budget.links:
        reach = f"{link.reach_m:.0f}{'+' if link.reaches_the_end else ''}"
        case = link.material, f"{link.incidence_deg:g}", f"{link.rain_mm_per_h:g}", reach
        for place, one in enumerate(link.simulated):
            said = one.ground.numbers()
            alarms = said["false_alarm_probability"] if one.ground.clutter > 0 else float("nan")
            table.add_row(
                *(case if place == 0 else ("", "", "", "")),
                f"{one.range_m:.1f}",
                number(said["snr_db"], ".1f"),
                number(said["signal_to_clutter_db"], ".1f"),
                number(said["detection_probability"], ".3f"),
                number(alarms, ".3f"),
                number(one.difference_db, "+.2f"),
            )
    return table
