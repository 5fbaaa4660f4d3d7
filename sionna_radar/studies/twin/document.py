"""A recording beside its simulation: `twin.json`, table, figure and page."""

from typing import Any

from matplotlib.figure import Figure

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.decibels import decibels
from sionna_radar.report.colours import BLUE, ORANGE
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.page.markup import command_line, document
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.scenario import to_toml
from sionna_radar.studies.twin.statistics import EXCHANGES, FALSE_ALARM, Row
from sionna_radar.studies.twin.study import Twin


def twin_numbers(twin: Twin) -> dict[str, Any]:
    """Return the numbers of a twin."""
    return {
        "recording": twin.source.name,
        "false_alarm_rate": FALSE_ALARM,
        "exchanges": EXCHANGES,
        "blocks": twin.blocks[0],
        "pulses_per_block": twin.blocks[1],
        "pulses": twin.pulses,
        "levels_known": twin.levels_known,
        "rows": ROWS.numbers(twin.rows),
        "echo": {"offset_m": twin.profile_m, "measured": twin.profiles[0], "simulated": twin.profiles[1]},
        "warnings": twin.warnings,
        "versions": versions(),
    }


def draw_echo(twin: Twin) -> Figure:
    """Draw the mean echo of both sides about the expected range."""
    figure = ReportFigure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for power, name, colour in zip(twin.profiles, ("Measured", "Simulated"), (BLUE, ORANGE), strict=True):
        axes.plot(twin.profile_m, decibels(power), color=colour, lw=1.4, label=name)
    unit = "dB of the recording's unit" if twin.levels_known else "dB over the noise floor"
    axes.set(xlabel="Range from the expected one (m)", ylabel=f"Mean power ({unit})")
    axes.margins(x=0)
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    return figure


def meaning_of(twin: Twin) -> str:
    """Return the legend of the columns."""
    text = (
        f"The differences are tested together by exchanging the labels of {twin.blocks[0]} tiles of the ground, "
        f"at a family-wise false-alarm rate of {FALSE_ALARM * 100:g} %. The deviation is the standard deviation of the "
        "difference between two equal signals."
    )
    if twin.levels_known:
        return text
    return f"{text} The recording's unit is unknown: powers count from the noise floor, which is no row of its own."


def twin_page(twin: Twin) -> str:
    """Return the page of a twin as HTML; raises OutputError if plotly is not installed."""
    measured, simulated = (decibels(power).tolist() for power in twin.profiles)
    numbers = {
        "echo": {"offset_m": twin.profile_m, "measured_db": measured, "simulated_db": simulated} if measured else None,
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
        head=ROWS.heads,
        rows=ROWS.cells(twin.rows, "rows."),
        meaning=meaning_of(twin),
        command=command_line(["twin", twin.source.name], twin.overrides),
        scenario=to_toml(twin.scenario),
    )


ROWS = Columns[Row](
    [
        Column(key="name", heading="row"),
        Column(key="unit", heading="unit"),
        Column(key="measured", heading="measured", form=".4g"),
        Column(key="simulated", heading="simulated", form=".4g"),
        Column(key="difference", heading="difference", form="+.3g"),
        Column(key="sigma", heading="deviation", form=".2g"),
        Column(key="p", heading="p-value", form=".3g"),
        Column(key="differs", heading="differs", console=False),
        Column(key="needs", heading="what it would need", console=False),
    ]
)
DOCUMENT = StudyDocument[Twin](
    marker="twin.json",
    suffix="_twin",
    numbers=twin_numbers,
    tables=lambda twin: [ROWS.table(f"{twin.source.name} beside its simulation", twin.rows)],
    lines=lambda twin: [
        *([f"{row.name} differs: {row.needs}" for row in twin.rows if row.differs] or ["no row differs"]),
        meaning_of(twin),
    ],
    figures=lambda twin: {"echo": draw_echo} if len(twin.profile_m) else {},
    notebook=["echo"],
    texts={"scenario.toml": lambda twin: to_toml(twin.scenario)},
    page=twin_page,
)
