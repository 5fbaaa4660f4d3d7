"""Figures for print and for notebooks, and their files."""

import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar

from matplotlib.figure import Figure

DPI = 150
SCREEN_DPI = 100

Subject = TypeVar("Subject")


class ReportFigure(Figure):
    """A figure outside pyplot: no window, no state shared between figures; a notebook shows it as in print."""

    def _repr_png_(self) -> bytes:
        file = io.BytesIO()
        self.savefig(file, format="png", dpi=SCREEN_DPI)
        return file.getvalue()


def save_figures(subject: Subject, drawings: Mapping[str, Callable[[Subject], Figure]], directory: Path) -> list[Path]:
    """Draw several figures of a subject, each into `NAME.png` of a directory, and return the files."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / f"{name}.png" for name in drawings]
    for path, draw in zip(paths, drawings.values(), strict=True):
        draw(subject).savefig(path, dpi=DPI)
    return paths
