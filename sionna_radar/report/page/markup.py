"""HTML of a page: its templates, and the self-contained document.

Jinja templates, beside this file, escape all text. The document contains style, scripts, numbers and plotly.js, and
loads no other file.

Plotly is used instead of pyvista's export: it draws maps and spectra too, and installs 40 MB instead of VTK's 564; one
surface of 160 x 200 cells takes pyvista 4.0 s and 2.4 MB, the whole page of `hills` 0.5 s and 3.9 MB. Of the plotly
package only plotly.js is used: its Python half takes half a second for a first figure.
"""

import json
import shlex
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.page.scene_data import compressed


class TableCell(NamedTuple):
    """A table cell with a number of a document: its text, its key and its exact value."""

    text: str
    key: str
    value: float | int | None


# The page may use only its own contents; plotly.js compiles its WebGL programs by `new Function`.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)
MAX_BYTES = 15_000_000


PACKAGE = "sionna_radar.report.page"


def document(template: str, numbers: str, scripts: tuple[str, ...], package: str = PACKAGE, **shown: Any) -> str:
    """Return a page.

    template: name of a template of this folder, or of a package.
    numbers: data for the scripts; see `scene_data`.
    scripts: names of scripts besides `core.js`, which starts them; of this folder, or of the package.
    package: that of a study with its own template and scripts.
    shown: variables of the template, which escapes text.

    Raises OutputError if the page is larger than `MAX_BYTES`, or if plotly.js is not installed.
    """
    text = (
        _templates(package)
        .get_template(template)
        .render(
            policy=POLICY,
            style=_asset("page.css"),
            code="\n".join(_asset(name, package) for name in ("core.js", *scripts)),
            numbers=numbers,
            plotly=_plotly(),
            **shown,
        )
    )
    size = len(text.encode())
    if size > MAX_BYTES:
        raise OutputError(f"the page has {size:,} bytes, more than {MAX_BYTES:,}; use --no-report to run without it")
    return text


def command_line(words: Iterable[str], overrides: Mapping[str, Any]) -> str:
    """Return the command of a page that repeats its result, with `--set` for each override."""
    changes = [word for key, value in overrides.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    return shlex.join(["sionna-radar", *words, *changes])


@cache
def _templates(package: str) -> Environment:
    return Environment(
        loader=ChoiceLoader([PackageLoader(name, ".") for name in dict.fromkeys((package, PACKAGE))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


@cache
def _asset(name: str, package: str = PACKAGE) -> str:
    own = files(package).joinpath(name)
    return (own if own.is_file() else files(PACKAGE).joinpath(name)).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return plotly.js, compressed; located without importing the large package."""
    spec = find_spec("plotly")
    places = list(spec.submodule_search_locations or ()) if spec else []
    path = Path(places[0]) / "package_data" / "plotly.min.js" if places else Path()
    if not path.is_file():
        message = "the package plotly, which draws pages, is missing or incomplete; install it, or use --no-report"
        raise OutputError(message)
    return compressed(path.read_bytes())
