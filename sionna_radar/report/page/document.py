"""One self-contained HTML document: style, scripts, numbers and plotly.js inside, and nothing loaded from anywhere.

Plotly rather than pyvista's export: it draws maps and spectra too, and installs 40 MB where VTK installs 564; to write
one surface of 160 x 200 cells takes pyvista 4.0 s and 2.4 MB, the whole page of `hills` 0.5 s and 3.9 MB. Of the plotly
package only plotly.js is used: its Python half takes half a second for a first figure.
"""

from functools import cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.page.packing import compressed

# Nothing but what is inside the page may be used; plotly.js compiles its WebGL programs by `new Function`.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)
MOST_BYTES = 15_000_000


def document(title: str, body: str, numbers: str, scripts: tuple[str, ...]) -> str:
    """Return a page.

    Parameters
    ----------
    title:
        Plain text.
    body:
        HTML, in which all text of the user's is escaped already.
    numbers:
        What the scripts draw; see `packing`.
    scripts:
        Names of scripts of this folder besides `core.js`, which starts what they register.

    Raises
    ------
    OutputError
        The page is larger than `MOST_BYTES`; or plotly.js is not installed.

    """
    code = "\n".join(_asset(name) for name in ("core.js", *scripts))
    text = "\n".join(
        [
            "<!doctype html>",
            '<html lang="en"><head><meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="generator" content="sionna-radar">',
            f"<title>{escape(title)}</title>",
            f"<style>{_asset('page.css')}</style></head><body>",
            body,
            '<p id="trouble" hidden></p>',
            f'<script id="numbers" type="text/plain">{numbers}</script>',
            f'<script id="plotly" type="text/plain">{_plotly()}</script>',
            f"<script>{code}\nstart();</script></body></html>\n",
        ]
    )
    if len(text) > MOST_BYTES:
        message = f"the page has {len(text):,} bytes, more than {MOST_BYTES:,}; write it without (--no-report)"
        raise OutputError(message)
    return text


@cache
def _asset(name: str) -> str:
    return files("sionna_radar.report.page").joinpath(name).read_text(encoding="utf-8")


@cache
def _plotly() -> str:
    """Return plotly.js, compressed; found without importing the package, whose other half is large."""
    found = find_spec("plotly")
    places = list(found.submodule_search_locations or ()) if found else []
    path = Path(places[0]) / "package_data" / "plotly.min.js" if places else Path()
    if not path.is_file():
        message = "the package plotly, which draws pages, is not installed whole; install it, or give --no-report"
        raise OutputError(message)
    return compressed(path.read_bytes())
