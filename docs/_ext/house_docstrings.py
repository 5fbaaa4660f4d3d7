"""The docstrings of the house as Sphinx reads them: entries "name: meaning", plain formulas, names of other rooms."""

import importlib
import inspect
import re
from typing import Any

from docutils import nodes
from pydantic import BaseModel
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import make_refnode

NAME = r"(?:[a-z]\w*|[A-Z]\w*_\w+)"
ENTRY = re.compile(rf"^({NAME}(?:(?:, | and ){NAME})*): (\S.*)$")
UNDERLINE = re.compile(r"^-{3,}$")
# Code, in which nothing is to be escaped.
CODE = re.compile(r"(``?[^`]+``?)")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect all."""
    # After napoleon, which knows the sections with underlines.
    app.connect("autodoc-process-docstring", entries_as_fields, priority=900)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("missing-reference", public_name)
    app.connect("doctree-read", colons_for_dashes)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def entries_as_fields(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Turn the paragraphs of entries in the docstring of a class into lists of its fields."""
    paragraphs = re.split(r"\n\s*\n", "\n".join(map(_bars_as_bars, lines)))
    if what == "class":
        paragraphs = [_fields(paragraph.split("\n")) for paragraph in paragraphs]
    lines[:] = "\n\n".join(paragraphs).split("\n")


def _bars_as_bars(line: str) -> str:
    """Escape the bars of |error|, which are no substitutions."""
    if line.lstrip().startswith((">>>", "...", "|", "+")):
        return line
    return "".join(part if part.startswith("`") else part.replace("|", "\\|") for part in CODE.split(line))


def _fields(paragraph: list[str]) -> str:
    """Return a paragraph, made a list of fields if it is one, under its heading if it has one."""
    title = "Fields"
    if len(paragraph) > 2 and UNDERLINE.match(paragraph[1]):
        title, _, *paragraph = paragraph
    if not ENTRY.match(paragraph[0]):
        return "\n".join(paragraph)
    entries: list[list[str]] = []
    for line in paragraph:
        entry = ENTRY.match(line)
        if entry:
            names = re.sub(r"\w+", lambda word: word[0] if word[0] == "and" else f"**{word[0]}**", entry[1])
            entries.append([names, entry[2]])
        else:
            entries[-1].append(line.strip())
    return "\n".join([f":{title}:", *(f"   * {entry[0]}: {' '.join(entry[1:])}" for entry in entries)])


def short_signature(
    app: Sphinx, what: str, name: str, thing: Any, options: Any, signature: str | None, returns: str | None
) -> tuple[str | None, str | None] | None:
    """Leave out the arguments of scenario tables, which the page of keys has, and of protocols, which have none."""
    if what == "class" and inspect.isclass(thing):
        if issubclass(thing, BaseModel) or getattr(thing, "_is_protocol", False):
            return "", None
        if signature and "*values" in signature:  # enumerations
            return "", None
    return None


def colons_for_dashes(app: Sphinx, doctree: nodes.document) -> None:
    """Put a colon between an argument and its meaning; Sphinx leaves two hyphens where quotes are not to be smart."""
    for text in list(doctree.findall(nodes.Text)):
        if text.astext() == " -- ":
            text.parent.replace(text, nodes.Text(": "))


def public_name(app: Sphinx, env: BuildEnvironment, node: pending_xref, text: nodes.Element) -> nodes.Element | None:
    """Lead names, of whatever module, to the public name where it is documented; anything else of Python is code."""
    if node.get("refdomain") != "py":
        return None
    last = node["reftarget"].rpartition(".")[2]
    objects = env.domaindata["py"]["objects"]
    found = [full for full in objects if full.rpartition(".")[2] == last and full.count(".") <= 2]
    if len(found) == 1 and _same(node["reftarget"], found[0]):
        entry = objects[found[0]]
        return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, text, found[0])
    return text


def _same(target: str, full: str) -> bool:
    """Return whether a target, if it names a module, names that of the public thing."""
    module, _, name = target.rpartition(".")
    if not module.startswith("sionna_radar"):
        return True
    package, _, public = full.rpartition(".")
    thing = getattr(importlib.import_module(package), public, None)
    return getattr(thing, "__module__", None) == module and name == public
