"""Results in notebooks: tables and figures, drawn when one is shown."""

import sys
from collections.abc import Iterator
from importlib import import_module
from typing import Any

from sionna_radar.cli.discovery import installed_studies, study_module


def register_with_ipython() -> None:
    """Have IPython show surveys and the records of studies as HTML, if this is one of its sessions."""
    if "IPython" not in sys.modules:
        return
    from IPython import get_ipython

    shell = get_ipython()
    if shell is None:
        return
    formatter = shell.display_formatter.formatters["text/html"]
    for module, name in _records():
        formatter.for_type_by_name(module, name, html_of)


def _records() -> Iterator[tuple[str, str]]:
    """Yield module and class of each result that notebooks show; none is loaded before it is used."""
    yield "sionna_radar.survey.result", "Survey"
    for study in installed_studies():
        name = getattr(study_module(study), "RECORD", None)
        if name is not None:
            yield f"sionna_radar.studies.{study}.study", name


def html_of(result: Any) -> str:
    """Return a result as HTML: the tables and figures of its document."""
    from sionna_radar.report.notebook import html_of as html_of_views

    room = type(result).__module__.rpartition(".")[0]
    module = "sionna_radar.report.survey.products" if room == "sionna_radar.survey" else f"{room}.document"
    views = import_module(module).DOCUMENT.views(result)
    return html_of_views(views, getattr(result, "warnings", ()))
