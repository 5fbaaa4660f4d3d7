"""Figure of the errors of a flight's navigation that its echoes tell."""

from matplotlib.figure import Figure

from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.mapping.navigation.refinement import RefinedNavigation
from sionna_radar.report.colours import BLUE, ORANGE
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.survey.navigation import WayError, in_words


def draw_errors(navigation: RefinedNavigation, way: WayError | None) -> Figure:
    """Draw the estimated errors of the navigation over time with their intervals, and the true ones if known."""
    count = len(navigation.names)
    figure = ReportFigure(figsize=(8.5, 1.0 + 1.5 * count), layout="constrained")
    panels = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    time_s = navigation.time_s
    for k, (name, axes) in enumerate(zip(navigation.names, panels, strict=True)):
        unit = UNKNOWNS[name]
        value, sigma, before = (a[:, k] / unit.si for a in (navigation.value, navigation.sigma, navigation.before))
        axes.fill_between(time_s, -1.96 * before, 1.96 * before, color="0.9", label="As stated, 95 %")
        low, high = value - 1.96 * sigma, value + 1.96 * sigma
        axes.fill_between(time_s, low, high, color=BLUE, alpha=0.3, lw=0, label="Estimate, 95 %")
        axes.plot(time_s, value, color=BLUE, lw=1.2, label="Estimate")
        if way is not None and name in way.true:
            axes.plot(time_s, way.true[name] / unit.si, color=ORANGE, lw=1.0, ls="--", label="Truth")
        axes.set_ylabel(f"{in_words(name).capitalize()}\n({unit.unit})")
    panels[-1].set_xlabel("Time (s)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle("Errors of the navigation that the echoes tell")
    return figure
