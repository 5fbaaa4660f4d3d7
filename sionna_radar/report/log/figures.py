"""The figure of a log: its way over the ground, and height, speed and attitude against time."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sionna_radar.report.colours import BLUE, ORANGE, PURPLE, RED
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of
from sionna_radar.report.figure_files import ReportFigure
from sionna_radar.report.maps import colour_bar, finish_map, height_limits, map_bounds, map_size
from sionna_radar.report.shading import shaded
from sionna_radar.studies.log_inspection import LogInspection

MOST_DRAWN = 5000
MAP_IN = (5.6, 5.2)


def draw_log(found: LogInspection) -> Figure:
    """Draw a log: a map with its speed, and its heights, speeds and attitudes; times that would be refused in red."""
    place = found.clean.positions.place
    frame = frame_of(found.georeference, Coordinates.MAP)
    extent = found.ground.grid.extent_m if found.ground else (*_ends(place[:, 0]), *_ends(place[:, 1]))
    bounds = map_bounds(extent, place)
    width, height = map_size(bounds, MAP_IN)
    figure = ReportFigure(figsize=(width + 7.0, max(height + 1.2, 5.2)), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[width + 2.5, 4.5])
    _draw_map(left.subplots(), found, frame, bounds, width)
    heights, speeds, angles = right.subplots(3, 1, sharex=True)
    _draw_heights(heights, found, frame)
    time_s = found.clean.positions.time_s
    step = _thin(len(time_s))
    speeds.plot(time_s[step], found.speed_mps[step], color=BLUE, lw=1.0)
    speeds.set(ylabel="Speed (m/s)", ylim=(0.0, 1.05 * max(float(found.speed_mps.max()), 0.1)))
    step = _thin(len(found.attitude_s))
    for column, (name, colour) in enumerate((("roll", ORANGE), ("pitch", PURPLE))):
        angles.plot(found.attitude_s[step], found.euler_deg[step, column], color=colour, lw=0.8, label=name)
    angles.set(xlabel="Time in the log (s)", ylabel="Attitude (deg)", xlim=_ends(time_s))
    title = "" if found.log.attitudes else "No attitude in the log: level flight assumed"
    angles.set_title(title, fontsize="small")
    angles.legend(loc="upper right", fontsize="small", ncols=2, frameon=False)
    for axes in (heights, speeds, angles):
        axes.spines[["top", "right"]].set_visible(False)
        for finding in found.clean.findings:
            axes.axvline(finding.time_s, color=RED, lw=0.8, alpha=0.6)
    return figure


def _draw_map(
    axes: Axes, found: LogInspection, frame: Frame, bounds: tuple[float, float, float, float], width: float
) -> None:
    if found.ground is not None and found.ground.filled.any():
        limits = height_limits(found.ground)
        axes.imshow(shaded(found.ground, limits, "Greys_r"), origin="lower", extent=found.ground.grid.extent_m)
    place, scale = found.clean.positions.place, Normalize(0.0, max(float(found.speed_mps.max()), 0.1))
    step = _thin(len(place))
    points = place[step, :2]
    halo = [withStroke(linewidth=4.0, foreground="white")]
    lines = LineCollection(
        np.stack([points[:-1], points[1:]], axis=1), cmap="viridis", norm=scale, lw=2.2, path_effects=halo
    )
    lines.set_array(found.speed_mps[step][:-1])
    axes.add_collection(lines)
    for end, marker, colour, name in ((0, "^", ORANGE, "Start"), (-1, "s", BLUE, "End")):
        axes.plot(*place[end, :2], ls="", marker=marker, ms=8, mfc=colour, mec="black", label=name, zorder=4)
    axes.legend(loc="lower right", fontsize="small")
    finish_map(axes, bounds, f"{found.path.name}: {found.log.kind}", frame)
    colour_bar(axes, lines, "Speed over the ground (m/s)", width)


def _draw_heights(axes: Axes, found: LogInspection, frame: Frame) -> None:
    time_s, place = found.clean.positions.time_s, found.clean.positions.place
    step = _thin(len(time_s))
    up = frame.origin_m[2]
    if found.ground_under_m is not None and found.moved_m is None:
        ground = found.ground_under_m[step] + up
        axes.fill_between(time_s[step], ground, np.nanmin(np.append(ground, place[step, 2] + up)), color="0.75", lw=0)
        axes.plot(time_s[step], ground, color="0.35", lw=1.0, label="Terrain")
        axes.legend(loc="upper right", fontsize="small", frameon=False)
    axes.plot(time_s[step], place[step, 2] + up, color="black", lw=1.2)
    level = {"unknown": "Height (m)", "take-off": "Height above take-off (m)"}
    axes.set(ylabel=level.get(found.log.datum, "Height above sea level (m)"))


def _thin(count: int) -> np.ndarray:
    """Return rows to draw: all, or an even share."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST_DRAWN)).round().astype(int))


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    pad = max(1.0 - (high - low), 0.0) / 2
    return low - pad, high + pad
