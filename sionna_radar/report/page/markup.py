"""HTML of a page: its pieces, and the self-contained document around them.

All text given to the pieces is plain and is escaped here. The document holds style, scripts, numbers and plotly.js, and
loads nothing from anywhere.

Plotly rather than pyvista's export: it draws maps and spectra too, and installs 40 MB where VTK installs 564; to write
one surface of 160 x 200 cells takes pyvista 4.0 s and 2.4 MB, the whole page of `hills` 0.5 s and 3.9 MB. Of the plotly
package only plotly.js is used: its Python half takes half a second for a first figure.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.page.scene_data import compressed


@dataclass(frozen=True, kw_only=True)
class Tile:
    """A large number with its name, and a line that says more."""

    value: str
    name: str
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A cell of a table: its text, and where it is a number of a document its key and exact value."""

    text: str
    key: str = ""
    value: float | int | None = None


def head(kind: str, title: str, sections: Mapping[str, str]) -> str:
    """Return the head of a page, with links to its sections by their anchors."""
    links = "".join(f'<a href="#{escape(name)}">{escape(text)}</a>' for name, text in sections.items())
    return (
        f'<header><p class="kind">sionna_radar &middot; {escape(kind)}</p><h1>{escape(title)}</h1></header>'
        f"<nav><div>{links}</div></nav>\n"
    )


def code(text: str) -> str:
    """Return a command line."""
    return f"<pre>{escape(text)}</pre>"


def swipe(name: str) -> str:
    """Return the room of two maps over one another, with the bar between them."""
    return (
        f'<div class="swipe" id="{escape(name)}"><div class="plot under"></div><div class="plot over"></div>'
        '<span class="name first"></span><span class="name second"></span>'
        '<div class="bar"></div><div class="grip" title="drag to compare">&#8596;</div></div>'
    )


def map_room(number: int) -> str:
    """Return the room of one of the page's maps, by its number."""
    return f'<div class="plot map" data-map="{number}"></div>'


def section(name: str, title: str, *parts: str) -> str:
    """Return a section with an anchor."""
    return f'<section id="{escape(name)}"><h2>{escape(title)}</h2>\n' + "\n".join(parts) + "</section>"


def paragraph(text: str, style: str = "") -> str:
    """Return a paragraph."""
    return f'<p class="{escape(style)}">{escape(text)}</p>' if style else f"<p>{escape(text)}</p>"


def tiles(shown: Iterable[Tile]) -> str:
    """Return the large numbers of a page."""
    cards = [
        f'<div class="tile"><b>{escape(tile.value)}</b><span>{escape(tile.name)}</span>'
        f"<small>{escape(tile.note)}</small></div>"
        for tile in shown
    ]
    return f'<div class="tiles">{"".join(cards)}</div>'


def pairs(rows: Mapping[str, str]) -> str:
    """Return names with their values."""
    inside = "".join(f"<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>" for name, value in rows.items())
    return f'<dl class="pairs">{inside}</dl>'


def table(head: Sequence[str], rows: Iterable[Sequence[Cell | str]], caption: str = "", style: str = "") -> str:
    """Return a table whose first column names the rows, with a caption under it."""
    top = "".join(f'<th scope="col">{escape(name)}</th>' for name in head)
    body = "".join(f"<tr>{_row(row)}</tr>" for row in rows)
    under = paragraph(caption, "note") if caption else ""
    return (
        f'<div class="scroll"><table class="{escape(style)}"><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>{under}"
    )


def _row(row: Sequence[Cell | str]) -> str:
    first, *rest = [cell if isinstance(cell, Cell) else Cell(text=cell) for cell in row]
    return f'<th scope="row">{escape(first.text)}</th>' + "".join(map(_cell, rest))


def _cell(cell: Cell) -> str:
    if not cell.key:
        return f"<td>{escape(cell.text)}</td>"
    value = "" if cell.value is None else repr(cell.value)
    return f'<td data-key="{escape(cell.key)}" data-value="{value}">{escape(cell.text)}</td>'


def warnings(texts: Iterable[str]) -> str:
    """Return warnings as boxes."""
    return "".join(f'<p class="warning"><b>Warning</b> {escape(text)}</p>' for text in texts)


def folded(title: str, text: str) -> str:
    """Return a long text that a click opens."""
    return f"<details><summary>{escape(title)}</summary><pre>{escape(text)}</pre></details>"


def choice(name: str, label: str, options: Sequence[str], chosen: int = 0) -> str:
    """Return a choice of options, whose value is the number of the one chosen."""
    inside = "".join(
        f'<option value="{i}"{" selected" if i == chosen else ""}>{escape(text)}</option>'
        for i, text in enumerate(options)
    )
    return f'<label>{escape(label)} <select data-control="{escape(name)}">{inside}</select></label>'


def switch(name: str, label: str, *, on: bool = True) -> str:
    """Return a box to tick."""
    state = " checked" if on else ""
    return f'<label><input type="checkbox" data-control="{escape(name)}"{state}> {escape(label)}</label>'


def slider(name: str, label: str, last: int, at: int) -> str:
    """Return a slider over whole numbers from 0, with room for what is chosen."""
    return (
        f'<label class="slider"><span>{escape(label)}</span><input type="range" min="0" max="{last}" value="{at}" '
        f'data-control="{escape(name)}"></label><output data-shows="{escape(name)}"></output>'
    )


def controls(*parts: str) -> str:
    """Return a row of controls."""
    return f'<div class="controls">{"".join(parts)}</div>'


def plot(name: str, style: str = "") -> str:
    """Return the room of a plot."""
    return f'<div class="plot {escape(style)}" id="{escape(name)}"></div>'


# Nothing but what is inside the page may be used; plotly.js compiles its WebGL programs by `new Function`.
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:; worker-src blob:"
)
MAX_BYTES = 15_000_000


def document(title: str, body: str, numbers: str, scripts: tuple[str, ...]) -> str:
    """Return a page.

    Parameters
    ----------
    title:
        Plain text.
    body:
        HTML, in which all text of the user's is escaped already.
    numbers:
        What the scripts draw; see `scene_data`.
    scripts:
        Names of scripts of this folder besides `core.js`, which starts what they register.

    Raises
    ------
    OutputError
        The page is larger than `MAX_BYTES`; or plotly.js is not installed.

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
    if len(text) > MAX_BYTES:
        message = f"the page has {len(text):,} bytes, more than {MAX_BYTES:,}; write it without (--no-report)"
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
