"""Figures written to a folder, for print."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

DPI = 150

Subject = TypeVar("Subject")


def save_figures(subject: Subject, drawings: Mapping[str, Callable[[Subject], Figure]], directory: Path) -> list[Path]:
    """Draw a subject in several ways into `NAME.png` of a directory, one after the other, and return the files."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{name}.png" for name in drawings]
    for path, draw in zip(paths, drawings.values(), strict=True):
        draw(subject).savefig(path, dpi=DPI)
    return paths
