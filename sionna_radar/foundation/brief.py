"""Results that show themselves: a few lines in a terminal, a table and a map in a notebook."""

import html
from importlib import import_module


class Brief:
    """A result whose `repr` is a few lines.

    In a notebook it is what the report makes of it, which is loaded then.
    """

    def _repr_html_(self) -> str:
        drawn: str | None = import_module("sionna_radar.report.notebook").html_of(self)
        return drawn or f"<pre>{html.escape(repr(self))}</pre>"
