"""Results in a notebook: a table, and a map or curve below it."""

import base64
import html
import io

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from sionna_radar.report.studies import budget as budget_figures
from sionna_radar.report.studies import crosscheck as crosscheck_figures
from sionna_radar.report.studies import imagery as imagery_figures
from sionna_radar.report.studies.budget import grades_table, limits_table
from sionna_radar.report.studies.crosscheck import crosscheck_table
from sionna_radar.report.studies.imagery import image_table
from sionna_radar.report.studies.sweep import errors, sweep_table
from sionna_radar.report.survey.figures import draw_dem
from sionna_radar.report.survey.summary import survey_table
from sionna_radar.studies.budget import Budget
from sionna_radar.studies.crosscheck import CrossCheck
from sionna_radar.studies.images import Imagery
from sionna_radar.studies.sweep import Sweep
from sionna_radar.survey.result import Survey

# For screens, beside text; files for print are finer.
DPI = 80
PRE = "<pre style='line-height: 1.2'>{code}</pre>"


def html_of(result: object) -> str:
    """Return a result as HTML."""
    parts = [_html_of_table(part) if isinstance(part, Table) else _html_of_figure(part) for part in shown(result)]
    parts += [f"<p>warning: {html.escape(warning)}</p>" for warning in getattr(result, "warnings", ())]
    return "\n".join(parts)


def shown(result: object) -> list[Table | Figure]:
    """Return the tables and figures that show a result."""
    match result:
        case Survey():
            return [survey_table(result), draw_dem(result)]
        case Sweep():
            flown = any(case.trials for case in result.cases)
            return [sweep_table(result), *([errors(result)] if flown else [])]
        case CrossCheck():
            return [crosscheck_table(result), crosscheck_figures.dems(result)]
        case Budget():
            grades = [grades_table(result)] if result.grades else []
            return [limits_table(result), *grades, budget_figures.draw(result)]
        case Imagery():
            return [image_table(result), imagery_figures.slant_range(result)]
    return []


def _html_of_table(table: Table) -> str:
    screen = Console(
        record=True, file=io.StringIO(), width=1000, markup=False, emoji=False, highlight=False, force_jupyter=False
    )
    screen.print(table)
    return screen.export_html(inline_styles=True, code_format=PRE)


def _html_of_figure(figure: Figure) -> str:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=DPI)
    return f'<img src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode("ascii")}"/>'
