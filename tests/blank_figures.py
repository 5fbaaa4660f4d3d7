"""Figures that stay blank, for tests that look at other results."""

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sionna_radar.report import drawing


def leave_blank(patch: pytest.MonkeyPatch) -> None:
    """Figures are composed and written, but not drawn, which takes longest; other tests draw the same ones."""
    patch.setattr(drawing, "_drawn", _blank)


def _blank(*_: object) -> FigureCanvasAgg:
    canvas = FigureCanvasAgg(drawing.ReportFigure(figsize=(1, 1)))
    canvas.draw()
    return canvas
