"""Where the texts of a figure are drawn."""

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text


def texts_outside(figure: Figure) -> list[str]:
    """Return titles, labels and legend entries that the edge of a figure cuts; ticks off their axis are not drawn."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer, page = canvas.get_renderer(), figure.bbox.padded(1.0)
    axes = [*figure.axes, *(child for a in figure.axes for child in a.child_axes)]
    ticks = {text for a in axes for axis in (a.xaxis, a.yaxis) for text in axis.findobj(Text) if text is not axis.label}
    cut = []
    for text in figure.findobj(Text):
        if text not in ticks and text.get_visible() and text.get_text().strip():
            box = text.get_window_extent(renderer)
            if not (page.contains(box.x0, box.y0) and page.contains(box.x1, box.y1)):
                cut.append(text.get_text())
    return cut
