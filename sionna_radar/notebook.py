"""Results in notebooks: a table and a picture, drawn by `sionna_radar.report.notebook` when one is shown."""

import sys
from typing import Any

# By module and class, so that none is loaded before it is used.
SHOWN = (
    ("sionna_radar.survey.result", "Survey"),
    ("sionna_radar.studies.sweep", "Sweep"),
    ("sionna_radar.studies.crosscheck", "CrossCheck"),
    ("sionna_radar.studies.budget", "Budget"),
    ("sionna_radar.studies.images", "Imagery"),
)


def register_with_ipython() -> None:
    """Have IPython show results as HTML, if this is one of its sessions."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython

    shell = get_ipython()
    if shell is None:
        return
    formatter = shell.display_formatter.formatters["text/html"]
    for module, name in SHOWN:
        formatter.for_type_by_name(module, name, _html_of)


def _html_of(result: Any) -> str:
    from sionna_radar.report.notebook import html_of

    return html_of(result)
