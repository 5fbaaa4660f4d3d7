"""Results that show themselves: a few lines in a terminal, a table and a map in a notebook."""

import html
from importlib import import_module


class Brief:
    """A result with a short `repr`.

    In a notebook it is shown by the report, which is loaded on demand.
    """

    def _repr_html_(self) -> str:
        drawn: str | None = import_module("sionna_radar.report.notebook").html_of(self)
        return drawn or f"<pre>{html.escape(repr(self))}</pre>"
