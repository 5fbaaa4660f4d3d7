"""Flight logs as a table, a figure and a file."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from sionna_radar.report.colours import BLUE, ORANGE, PURPLE, RED
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of, map_bounds
from sionna_radar.report.drawing import ReportFigure, colour_bar, finish_map, map_size, shaded
from sionna_radar.report.page.sections import span_of
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.report.terminal import table_of_values
from sionna_radar.studies.log.study import LogInspection

MAX_SHOWN = 5


def log_numbers(inspection: LogInspection) -> dict[str, Any]:
    """Return the contents of a flight log."""
    positions, log = inspection.clean.positions, inspection.log
    place = positions.place
    height = place[:, 2] + (inspection.georeference.origin_m[2] if inspection.georeference else 0.0)
    degrees = log.positions.place[np.isfinite(log.positions.place).all(axis=1)] if log.on_map else None
    above = None if inspection.ground_under_m is None else place[:, 2] - inspection.ground_under_m
    clearance = None
    if above is not None and inspection.moved_m is None and np.isfinite(above).any():
        clearance = [f(above) for f in (np.nanmin, np.nanmedian, np.nanmax)]
    return {
        "path": str(inspection.path),
        "format": log.kind,
        "duration_s": positions.time_s[-1] - positions.time_s[0],
        "positions": positions.source,
        "velocities": log.positions.velocity_mps is not None,
        "attitudes": log.attitudes.source if log.attitudes else None,
        "errors": log.spreads.source if log.spreads else None,
        "sources": [{"name": s.name, "rows": s.rows, "rate_hz": s.rate_hz} for s in log.sources],
        "lon_deg": None if degrees is None else [degrees[:, 0].min(), degrees[:, 0].max()],
        "lat_deg": None if degrees is None else [degrees[:, 1].min(), degrees[:, 1].max()],
        "extent_m": np.ptp(place[:, :2], axis=0),
        "heights_count_from": log.datum,
        "height_m": [height.min(), np.median(height), height.max()],
        "height_above_ground_m": clearance,
        "speed_mps": [f(inspection.speed_mps) for f in (np.min, np.mean, np.max)],
        "longest_step_s": np.diff(positions.time_s).max(),
        "moved_to_terrain_m": inspection.moved_m,
        "notes": [*log.notes, *inspection.clean.notes],
        "refused": inspection.refusals,
        "stretches_s": inspection.stretches,
        "moving_s": inspection.moving,
    }


def sentences(numbers: Mapping[str, Any]) -> list[str]:
    """Return the notes of a log, what hinders flying it, and which stretches can be flown."""
    refused = numbers["refused"]
    found = [f"note: {note}" for note in numbers["notes"][:MAX_SHOWN]]
    found += [f"cannot be flown: {refusal}" for refusal in refused[:MAX_SHOWN]]
    if len(refused) > MAX_SHOWN:
        found.append(f"... and {len(refused) - MAX_SHOWN:,} more")
    moving, flyable = numbers["moving_s"], numbers["stretches_s"]
    rest_s = sum(stop - start for start, stop in flyable) - sum(stop - start for start, stop in moving)
    if not refused and moving == flyable:
        return [*found, "the whole log can be flown"]
    if not refused:
        found.append(f"the whole log can be flown; the vehicle is stationary for {rest_s:.1f} s of it, and moves in")
    found += [
        f"can be flown: log_start_s = {start_s:.2f}, log_stop_s = {stop_s:.2f} ({stop_s - start_s:.1f} s)"
        for start_s, stop_s in moving
    ]
    return found if moving else [*found, "no stretch of it can be flown"]


def _rows(numbers: Mapping[str, Any]) -> dict[str, str]:
    low, middle, high = numbers["height_m"]
    slow, mean, fast = numbers["speed_mps"]
    east, north = numbers["extent_m"]
    rows = {
        "duration": f"{numbers['duration_s']:.1f} s, longest step {numbers['longest_step_s']:.2g} s",
        "positions": f"{numbers['positions']}, {'with' if numbers['velocities'] else 'without'} velocities",
        "attitudes": numbers["attitudes"] or "none: level, and heading where it moves",
        "errors": numbers["errors"] or "none stated",
        "streams": ", ".join(f"{s['name']} {s['rate_hz']:.3g} Hz" for s in numbers["sources"]),
        "extent": f"{east:.0f} m east x {north:.0f} m north",
        "heights": f"{low:.1f} to {high:.1f} m, median {middle:.1f} (datum: {numbers['heights_count_from']})",
        "speed": f"{slow:.1f} to {fast:.1f} m/s, mean {mean:.1f}",
    }
    if numbers["lon_deg"]:
        (west, east), (south, north) = numbers["lon_deg"], numbers["lat_deg"]
        rows["place"] = f"{west:.6f} to {east:.6f} deg east, {south:.6f} to {north:.6f} deg north"
    if numbers["height_above_ground_m"]:
        low, middle, high = numbers["height_above_ground_m"]
        rows["above the terrain"] = f"{low:.1f} to {high:.1f} m, median {middle:.1f}"
    if numbers["moved_to_terrain_m"]:
        east, north = numbers["moved_to_terrain_m"]
        rows["moved to the terrain"] = f"{east:+.1f} m east, {north:+.1f} m north"
    return rows


MAX_DRAWN = 5000
MAP_IN = (5.6, 5.2)


def draw_log(inspection: LogInspection) -> Figure:
    """Draw a log: a map with its speed, and its heights, speeds and attitudes; refused times in red."""
    place = inspection.clean.positions.place
    frame = frame_of(inspection.georeference, Coordinates.MAP)
    extent = inspection.ground.grid.extent_m if inspection.ground else (*_ends(place[:, 0]), *_ends(place[:, 1]))
    bounds = map_bounds(extent, place)
    width, height = map_size(bounds, MAP_IN)
    figure = ReportFigure(figsize=(width + 7.0, max(height + 1.2, 5.2)), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=[width + 2.5, 4.5])
    _draw_map(left.subplots(), inspection, frame, bounds, width)
    heights, speeds, angles = right.subplots(3, 1, sharex=True)
    _draw_heights(heights, inspection, frame)
    time_s = inspection.clean.positions.time_s
    step = _thin(len(time_s))
    speeds.plot(time_s[step], inspection.speed_mps[step], color=BLUE, lw=1.0)
    speeds.set(ylabel="Speed (m/s)", ylim=(0.0, 1.05 * max(float(inspection.speed_mps.max()), 0.1)))
    step = _thin(len(inspection.attitude_s))
    for column, (name, colour) in enumerate((("roll", ORANGE), ("pitch", PURPLE))):
        angles.plot(inspection.attitude_s[step], inspection.euler_deg[step, column], color=colour, lw=0.8, label=name)
    angles.set(xlabel="Time in the log (s)", ylabel="Attitude (deg)", xlim=_ends(time_s))
    title = "" if inspection.log.attitudes else "No attitude in the log: level flight assumed"
    angles.set_title(title, fontsize="small")
    angles.legend(loc="upper right", fontsize="small", ncols=2, frameon=False)
    for axes in (heights, speeds, angles):
        axes.spines[["top", "right"]].set_visible(False)
        for finding in inspection.clean.findings:
            axes.axvline(finding.time_s, color=RED, lw=0.8, alpha=0.6)
    return figure


def _draw_map(
    axes: Axes, inspection: LogInspection, frame: Frame, bounds: tuple[float, float, float, float], width: float
) -> None:
    if inspection.ground is not None and inspection.ground.filled.any():
        limits = span_of(inspection.ground.height_m)
        axes.imshow(
            shaded(inspection.ground, limits, "Greys_r"), origin="lower", extent=inspection.ground.grid.extent_m
        )
    place, scale = inspection.clean.positions.place, Normalize(0.0, max(float(inspection.speed_mps.max()), 0.1))
    step = _thin(len(place))
    points = place[step, :2]
    halo = [withStroke(linewidth=4.0, foreground="white")]
    lines = LineCollection(
        np.stack([points[:-1], points[1:]], axis=1), cmap="viridis", norm=scale, lw=2.2, path_effects=halo
    )
    lines.set_array(inspection.speed_mps[step][:-1])
    axes.add_collection(lines)
    for end, marker, colour, name in ((0, "^", ORANGE, "Start"), (-1, "s", BLUE, "End")):
        axes.plot(*place[end, :2], ls="", marker=marker, ms=8, mfc=colour, mec="black", label=name, zorder=4)
    axes.legend(loc="lower right", fontsize="small")
    finish_map(axes, bounds, f"{inspection.path.name}: {inspection.log.kind}", frame)
    colour_bar(axes, lines, "Speed over the ground (m/s)", width)


def _draw_heights(axes: Axes, inspection: LogInspection, frame: Frame) -> None:
    time_s, place = inspection.clean.positions.time_s, inspection.clean.positions.place
    step = _thin(len(time_s))
    up = frame.origin_m[2]
    if inspection.ground_under_m is not None and inspection.moved_m is None:
        ground = inspection.ground_under_m[step] + up
        axes.fill_between(time_s[step], ground, np.nanmin(np.append(ground, place[step, 2] + up)), color="0.75", lw=0)
        axes.plot(time_s[step], ground, color="0.35", lw=1.0, label="Terrain")
        axes.legend(loc="upper right", fontsize="small", frameon=False)
    axes.plot(time_s[step], place[step, 2] + up, color="black", lw=1.2)
    level = {
        **{"unknown": "Height (m)", "take-off": "Height above take-off (m)"},
        "ellipsoid": "Height above the ellipsoid (m)",
    }
    axes.set(ylabel=level.get(inspection.log.datum, "Height above sea level (m)"))


def _thin(count: int) -> np.ndarray:
    """Return rows to draw: all, or an even share."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_DRAWN)).round().astype(int))


def _ends(values: np.ndarray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    pad = max(1.0 - (high - low), 0.0) / 2
    return low - pad, high + pad


DOCUMENT = StudyDocument[LogInspection](
    marker="log.json",
    suffix="_log",
    numbers=log_numbers,
    tables=lambda log: [table_of_values(f"{log.path.name}: {log.log.kind}", _rows(log_numbers(log)))],
    lines=lambda log: sentences(log_numbers(log)),
    figures=lambda _: {"flight": draw_log},
    notebook=["flight"],
)
