"""Pages made from the program itself, so that they cannot grow stale: keys, commands, and the Python interface.

Keys and options are objects of Sphinx as functions are, so that the search lists them before words in a text.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from docutils import nodes
from sphinx.application import Sphinx
from typer.cli import get_docs_for_click
from written import write

from sionna_radar.cli.app import app as commands
from sionna_radar.scenario.reference import reference


def setup(app: Sphinx) -> dict[str, bool]:
    """Make the pages before Sphinx looks for pages."""
    app.connect("builder-inited", make_pages, priority=100)
    app.connect("doctree-read", index_names)
    app.add_object_type("scenario-key", "scenario-key", objname="key of a scenario")
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def make_pages(app: Sphinx) -> None:
    """Write every made page."""
    made = Path(app.srcdir) / "generated"
    # One level of headings: the list beside the page then has every table.
    write(made / "keys.md.txt", reference().replace("\n### `[", "\n## `["))
    write(made / "commands.md.txt", commands_reference())
    top = importlib.import_module("sionna_radar")
    write(made / "api" / "sionna_radar.rst", package_page(top, set()))
    for package in rooms_of(top):
        path = package.__name__.removeprefix(f"{top.__name__}.").replace(".", "/")
        write(made / "api" / f"{path}.rst", package_page(package, set(top.__all__)))


def rooms_of(top: ModuleType) -> Iterator[ModuleType]:
    """Yield the packages below another that export names."""
    for found in pkgutil.walk_packages(top.__path__, f"{top.__name__}."):
        if found.ispkg and getattr(package := importlib.import_module(found.name), "__all__", ()):
            yield package


def index_names(app: Sphinx, document: nodes.document) -> None:
    """Make the keys and the options of a page objects, which the search knows by name."""
    page = app.env.docname
    if page not in ("keys", "commands"):
        return
    kind, places = ("scenario-key", nodes.row) if page == "keys" else ("cmdoption", nodes.list_item)
    for section in document.findall(nodes.section):
        if any(isinstance(child, nodes.section) for child in section):
            continue  # its sections are met for themselves
        title = section[0].astext()
        for place in section.findall(places):
            words = next((literal.astext() for literal in place.findall(nodes.literal)), "").split()
            if page == "keys":
                name = f"{title.strip('[]')}.{words[0]}" if title.startswith("[") and words else None
            else:
                option = next((word.strip(",") for word in words if word.startswith("--")), None)
                name = option and f"{title} {option}"
            if name:
                place["ids"].append(nodes.make_id(name))
                app.env.domains.standard_domain.note_object(kind, name, nodes.make_id(name), location=place)


def commands_reference() -> str:
    """Return the help of every command as Markdown, one heading of the third level each."""
    group: Any = typer.main.get_command(commands)
    parts = []
    with typer.Context(group, info_name="sionna-radar") as context:
        for name in group.list_commands(context):
            command = group.get_command(context, name)
            parts.append(
                get_docs_for_click(obj=command, ctx=context, indent=2, name=f"sionna-radar {name}", title=f"`{name}`")
            )
    return "\n".join(parts)


def package_page(package: ModuleType, elsewhere: set[str]) -> str:
    """Return a page of a package: a table of its public names, then each of them.

    elsewhere: names that `sionna_radar` itself exports; a room only points to them there.
    """
    name = package.__name__
    here = [public for public in package.__all__ if public not in elsewhere]
    lines = [f"``{name}``", "=" * (len(name) + 4), "", f".. automodule:: {name}", "   :no-members:", ""]
    lines += [f".. currentmodule:: {name}", ""]
    if elsewhere and len(here) < len(package.__all__):
        also = ", ".join(f":py:obj:`~sionna_radar.{public}`" for public in package.__all__ if public in elsewhere)
        lines += [f"In ``sionna_radar`` itself: {also}.", ""]
    lines += [".. autosummary::", "   :nosignatures:", "", *(f"   {public}" for public in here), ""]
    for public in here:
        lines += directive(package, public)
    return "\n".join(lines)


def directive(package: ModuleType, public: str) -> list[str]:
    """Return the directive that documents a public name."""
    thing = getattr(package, public)
    path = f"{package.__name__}.{public}"
    if inspect.isclass(thing):
        return [f".. autoclass:: {path}", "   :members:", "   :exclude-members: model_config", ""]
    if inspect.isfunction(thing) or hasattr(thing, "__wrapped__"):
        return [f".. autofunction:: {path}", ""]
    return [f".. autodata:: {path}", "   :no-value:", ""]
