"""Results in a notebook: a table, and a map or curve below it."""

import base64
import html
import io
from collections.abc import Sequence

from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from sionna_radar.report.drawing import png_of

# For screens, beside text; files for print are finer.
DPI = 80
PRE = "<pre style='line-height: 1.2'>{code}</pre>"


def html_of(views: Sequence[Table | Figure], warnings: Sequence[str] = ()) -> str:
    """Return tables and figures as HTML, with the warnings of their result."""
    parts = [_html_of_table(view) if isinstance(view, Table) else _html_of_figure(view) for view in views]
    parts += [f"<p>warning: {html.escape(warning)}</p>" for warning in warnings]
    return "\n".join(parts)


def _html_of_table(table: Table) -> str:
    screen = Console(
        record=True, file=io.StringIO(), width=1000, markup=False, emoji=False, highlight=False, force_jupyter=False
    )
    screen.print(table)
    return screen.export_html(inline_styles=True, code_format=PRE)


def _html_of_figure(figure: Figure) -> str:
    return f'<img src="data:image/png;base64,{base64.b64encode(png_of(figure, DPI)).decode("ascii")}"/>'
