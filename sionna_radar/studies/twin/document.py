"""A recording beside its simulation: `twin.json`, table, figure and page."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.numerics import decibels
from sionna_radar.report.drawing import BLUE, ORANGE, ReportFigure
from sionna_radar.report.files.contents import Report
from sionna_radar.report.files.folder import write_study
from sionna_radar.report.page.markup import TableCell, document
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.terminal import print_whole, say, table_of
from sionna_radar.scenario import to_toml
from sionna_radar.studies.twin.statistics import EXCHANGES, FALSE_ALARM, Row
from sionna_radar.studies.twin.study import Twin

MARKER = "twin.json"
HEAD = ("Row", "Unit", "Measured", "Simulated", "Difference", "Deviation", "p", "Differs", "What it would need")


def write_twin(twin: Twin, directory: Path, *, report: Report = Report.PAGE) -> list[Path]:
    """Write `twin.json`, the scenario, the figure and the page, and return the files; OutputError as `write_folder`."""
    texts, page = {"scenario.toml": to_toml(twin.scenario)}, twin_page if report is Report.PAGE else None
    figures = {"echo": draw_echo} if len(twin.profile_m) else {}
    return write_study(directory, MARKER, twin, twin_document(twin), figures, texts, page)


def twin_document(twin: Twin) -> dict[str, Any]:
    """Return the numbers of a twin."""
    return {
        "recording": twin.source.name,
        "false_alarm_rate": FALSE_ALARM,
        "exchanges": EXCHANGES,
        "blocks": twin.blocks[0],
        "pulses_per_block": twin.blocks[1],
        "pulses": twin.pulses,
        "levels_known": twin.levels_known,
        "rows": [asdict(row) | {"difference": row.difference, "differs": row.differs} for row in twin.rows],
        "echo": {
            "offset_m": twin.profile_m.tolist(),
            "measured": twin.profiles[0].tolist(),
            "simulated": twin.profiles[1].tolist(),
        },
        "warnings": list(twin.warnings),
        "versions": versions(),
    }


def draw_echo(twin: Twin) -> Figure:
    """Draw the mean echo of both sides about the expected range."""
    figure = ReportFigure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for power, name, colour in zip(twin.profiles, ("Measured", "Simulated"), (BLUE, ORANGE), strict=True):
        axes.plot(twin.profile_m, decibels(power), color=colour, lw=1.4, label=name)
    axes.set(xlabel="Range from the expected one (m)", ylabel=f"Mean power ({_unit(twin)})")
    axes.margins(x=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def print_twin(twin: Twin) -> None:
    """Print the rows, and what each that differs would need."""
    columns = "", "unit", "measured", "simulated", "difference", "deviation", "p"
    rows = ([row.name, *list(_texts(row).values())[:-2]] for row in twin.rows)
    print_whole(table_of(f"{twin.source.name} beside its simulation", columns, rows, left=["", "unit"]))
    differing = [f"{row.name} differs: {row.needs}" for row in twin.rows if row.differs]
    say(*(differing or ["no row differs"]), meaning_of(twin))


def meaning_of(twin: Twin) -> str:
    """Return the legend of the columns."""
    text = (
        f"The differences are tested together by exchanging the labels of {twin.blocks[0]} tiles of the ground: two "
        f"that are alike differ in any row in {FALSE_ALARM:.0%} of the cases. The deviation is that of the difference "
        "between two that are alike."
    )
    if twin.levels_known:
        return text
    return f"{text} The recording's unit is unknown: powers count from the noise floor, which is no row of its own."


def twin_page(twin: Twin) -> str:
    """Return the page of a twin as HTML.

    Raises OutputError if plotly is not installed.
    """
    measured, simulated = (decibels(power).tolist() for power in twin.profiles)
    numbers = {
        "echo": None
        if not measured
        else {"offset_m": twin.profile_m.tolist(), "measured_db": measured, "simulated_db": simulated},
        "scores": {
            "name": [row.name for row in twin.rows],
            "value": [row.difference / row.sigma if row.sigma else 0.0 for row in twin.rows],
            "differs": [row.differs for row in twin.rows],
        },
    }
    return document(
        "twin.html",
        Pack().text(numbers),
        ("twin.js",),
        package=__package__,
        title=f"{twin.source.name} and its twin",
        echo=bool(measured),
        warnings=twin.warnings,
        tiles=[
            (str(len(twin.differing)), "rows differ", f"of {len(twin.rows)}"),
            (f"{twin.pulses:,}", "pulses", f"in {twin.blocks[0]} tiles of the ground, about {twin.blocks[1]} each"),
        ],
        head=list(HEAD),
        rows=[[row.name, *_cells(row, number)] for number, row in enumerate(twin.rows)],
        meaning=meaning_of(twin),
        command=shlex.join(["sionna-radar", "twin", twin.source.name, *_changes(twin.overrides)]),
        scenario=to_toml(twin.scenario),
    )


def _changes(overrides: Mapping[str, Any]) -> list[str]:
    return [word for key, value in overrides.items() for word in ("--set", f"{key}={json.dumps(value)}")]


def _texts(row: Row) -> dict[str, str]:
    return {
        "unit": row.unit,
        "measured": f"{row.measured:.4g}",
        "simulated": f"{row.simulated:.4g}",
        "difference": f"{row.difference:+.3g}",
        "sigma": f"{row.sigma:.2g}",
        "p": f"{row.p:.3g}",
        "differs": "yes" if row.differs else "no",
        "needs": row.needs,
    }


def _cells(row: Row, number: int) -> list[TableCell | str]:
    numbers = ("measured", "simulated", "difference", "sigma", "p")
    return [
        TableCell(text, f"rows.{number}.{key}", getattr(row, key)) if key in numbers else text
        for key, text in _texts(row).items()
    ]


def _unit(twin: Twin) -> str:
    return "dB of the recording's unit" if twin.levels_known else "dB over the noise floor"
