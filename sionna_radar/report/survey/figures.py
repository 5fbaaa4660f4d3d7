"""Figures of a survey, for print: its environment, a chirp, and its maps.

Each is a matplotlib figure outside pyplot (`ReportFigure`), displayed in notebooks. Maps have equal scales, and map
coordinates if the world is georeferenced and no local ones are requested; sizes follow the shape of the ground, so that
a 100 m and a 2 km survey both fill the page. Colours are safe for colour-blind readers, and empty cells are plain grey.

The figure of the environment shows the true surface, the flight over it, and the beam's hits on the ground.
"""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from textwrap import wrap

import numpy as np
from jaxtyping import Float, Int
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import NullLocator

from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.trajectory import Phase
from sionna_radar.foundation.decibels import decibels
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.report.colours import BLUE, ERRORS, GREEN, HEIGHTS, ORANGE, POWERS, PURPLE, RED, SKY
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of, map_bounds
from sionna_radar.report.drawing import (
    ReportFigure,
    colour_bar,
    dot_size,
    empty_patch,
    finish_map,
    head,
    height_colours,
    map_size,
    shaded,
    shift_ticks,
    show_raster,
)
from sionna_radar.report.page.scene_data import points_to_draw
from sionna_radar.report.page.sections import HEAVY_TAILS, exponent_of, limit_of, span_of
from sionna_radar.report.survey.navigation_figure import draw_errors
from sionna_radar.report.terminal import number
from sionna_radar.scenario.loading import leaves
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scene.raycast import truth_dem
from sionna_radar.survey.result import Survey
from sionna_radar.survey.sensors.sweeps import ChirpRecord

# Cells of the surface that are drawn at most.
MAX_CELLS = 1_000_000
# Minimum width of a figure with three columns in its legend.
MIN_WIDE_IN = 6.5


def draw_environment(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the true surface with the flight and the beam's hits, and the flight's profile."""
    trajectory = survey.schedule.trajectory
    flight = trajectory.position(np.linspace(0.0, trajectory.end_s, 2000))
    hits = _meet_ground(survey.schedule.pulses(points_to_draw(len(survey.schedule), MAX_OVERLAY)).true, survey)
    hits = hits[np.isfinite(hits).all(axis=1)]
    bounds = map_bounds(survey.truth.grid.extent_m, flight)
    width, height = map_size(bounds)
    figure = ReportFigure(figsize=(width + 2.0, height + 4.0), layout="constrained")
    plan, profile = figure.subplots(2, 1, height_ratios=[height + 0.7, 2.4])
    surface = _surface_within(survey, bounds)
    limits, frame = span_of(surface.height_m), frame_of(survey.georeference, coordinates)
    plan.imshow(shaded(surface, limits), origin="lower", extent=surface.grid.extent_m)
    halo = [withStroke(linewidth=3.0, foreground="white")]
    size = dot_size((width, height), len(hits))
    plan.plot(hits[:, 0], hits[:, 1], ls="", marker="o", ms=size, mew=0, color="white", alpha=0.7)
    plan.plot(flight[:, 0], flight[:, 1], color="black", lw=1.5, path_effects=halo)
    _mark_ends(plan, flight[[0, -1], :2])
    finish_map(plan, bounds, "True surface and flight", frame)
    colour_bar(plan, height_colours(limits, frame), frame.height, width)
    _draw_profile(profile, survey, surface, flight, frame)
    columns = 3 if width + 2.0 >= MIN_WIDE_IN else 2
    figure.legend(handles=_environment_legend(survey), loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _surface_within(survey: Survey, bounds_m: tuple[float, float, float, float]) -> Raster:
    """Return the true surface of a whole map: on the cells of the DEM, which begin where the beam does, and around."""
    west, east, south, north = bounds_m
    grid = survey.truth.grid
    coarser = max(1, int(np.ceil(np.sqrt((east - west) * (north - south) / grid.spacing_m**2 / MAX_CELLS))))
    spacing_m = grid.spacing_m * coarser
    starts = (grid.west_m, west), (grid.south_m, south)
    before = [max(0, int((start - edge) / spacing_m)) for start, edge in starts]
    wider = Grid(
        west_m=grid.west_m - before[0] * spacing_m,
        south_m=grid.south_m - before[1] * spacing_m,
        spacing_m=spacing_m,
        columns=before[0] + 1 + int(np.floor((east - grid.west_m) / spacing_m)),
        rows=before[1] + 1 + int(np.floor((north - grid.south_m) / spacing_m)),
    )
    world = survey.prepared.world
    return truth_dem(world.caster, wider, float(world.scene.bounds_m[1][2]) + 1.0)


def _draw_profile(axes: Axes, survey: Survey, surface: Raster, flight: Float[np.ndarray, "n 3"], frame: Frame) -> None:
    step = np.linalg.norm(np.diff(flight[:, :2], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(step)])
    moving = np.flatnonzero(step > 0)
    last_step = moving[-1] if len(moving) else 0
    ahead = (flight[last_step + 1, :2] - flight[last_step, :2]) / max(step[last_step], 1e-9)
    # The beam points ahead of the platform: draw the ground beyond the track's end.
    west, east, south, north = surface.grid.extent_m
    extension = np.linspace(0.0, np.hypot(east - west, north - south), 2000)
    path = np.concatenate([flight[:, :2], flight[-1, :2] + extension[:, None] * ahead])
    along = np.concatenate([distance, distance[-1] + extension])
    ground = surface.at(path)
    covered = np.isfinite(ground)
    lowest = np.append(ground[covered], flight[:, 2]).min()
    floor = lowest - 0.08 * (flight[:, 2].max() - lowest)
    axes.fill_between(along, np.where(covered, ground, np.nan), floor, color="0.75", lw=0)
    axes.plot(along, ground, color="0.35", lw=1.2)
    axes.plot(distance, flight[:, 2], color="black", lw=1.5)
    _mark_ends(axes, np.column_stack([distance, flight[:, 2]])[[0, -1]])
    _draw_beam(axes, survey)
    end = max(distance[-1], along[covered].max() if covered.any() else 0.0, 1.0)
    axes.set(xlim=(-0.02 * end, 1.02 * end), xlabel="Distance along the track (m)", ylabel=frame.height)
    shift_ticks(axes.yaxis, frame.origin_m[2], 6)
    axes.set_ylim(bottom=floor)
    head(axes, "Profile along the track")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_beam(axes: Axes, survey: Survey) -> None:
    """Draw the boresight of the mid-flight pulse that points straight along the track."""
    schedule = survey.schedule
    if len(schedule) == 0:
        return
    middle = np.arange(len(schedule))[len(schedule) // 2 :][:2000]
    pulses = schedule.pulses(middle)
    pick = int(np.argmin(np.abs(pulses.scan_rad)))
    pose, time_s = pulses.true, pulses.time_s[pick]
    hit = _meet_ground(pose, survey)[pick]
    if not np.isfinite(hit).all():
        return
    flown = schedule.trajectory.position(np.linspace(schedule.trajectory.cruise_s()[0], time_s, 500))[:, :2]
    start = float(np.linalg.norm(np.diff(flown, axis=0), axis=1).sum())
    reach = float(np.linalg.norm(hit[:2] - pose.position_m[pick, :2]))
    axes.plot([start, start + reach], [pose.position_m[pick, 2], hit[2]], color=RED, lw=1.2, ls="--")


def _mark_ends(axes: Axes, ends: Float[np.ndarray, "2 2"]) -> None:
    for (x, y), marker, colour in zip(ends, "^s", (ORANGE, BLUE), strict=True):
        axes.plot(x, y, ls="", marker=marker, ms=8, mfc=colour, mec="black", zorder=4)


def _environment_legend(survey: Survey) -> list[Line2D]:
    grounded = any(phase is Phase.TAKE_OFF for phase, _, _ in survey.schedule.trajectory.phases)
    names = ("Take-off", "Landing") if grounded else ("Start", "End")
    return [
        Line2D([], [], color="black", lw=1.5, label="Flight"),
        Line2D([], [], ls="", marker="^", ms=8, mfc=ORANGE, mec="black", label=names[0]),
        Line2D([], [], ls="", marker="s", ms=8, mfc=BLUE, mec="black", label=names[1]),
        Line2D([], [], ls="", marker="o", ms=5, mfc="white", mec="0.4", label="Beam axis meets ground"),
        Line2D([], [], color=RED, lw=1.2, ls="--", label="Beam axis in mid-flight"),
        Line2D([], [], color="0.35", lw=1.2, label="Ground under the track"),
    ]


def _meet_ground(pose: Pose, survey: Survey) -> Float[np.ndarray, "pulse 3"]:
    """Return the intersections of the beam axes with the scene, m; NaN without one."""
    distance_m = survey.prepared.world.caster.cast(pose.position_m, pose.boresight).distance_m
    distance_m = np.where(np.isfinite(distance_m), distance_m, np.nan)
    return pose.position_m + distance_m[:, None] * pose.boresight


MAX_SCATTER = 20_000
MAX_OVERLAY = 3_000
LETTERS_PER_INCH = 12  # of a small line of text
PAIRED_BOX_IN = (4.2, 3.9)  # largest width and height of one of two maps


def figures_of(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> dict[str, Callable[[Survey], Figure]]:
    """Return the drawings by name."""
    return {
        "environment": partial(draw_environment, coordinates=coordinates),
        **({} if survey.chirp is None else {"chirp": draw_chirp}),
        "power_map": partial(draw_power, coordinates=coordinates),
        "dem": partial(draw_dem, coordinates=coordinates),
        "error_map": partial(draw_error, coordinates=coordinates),
        **({} if survey.readings is None else {"readings": draw_readings}),
        **({} if survey.navigation is None else {"navigation": draw_navigation}),
    }


def draw_navigation(survey: Survey) -> Figure:
    """Draw the errors of the navigation that the echoes tell over time, and the true ones.

    Parameters
    ----------
    survey:
        A survey with `processing.navigation = "refined"`.

    Returns
    -------
    A panel for each error, with the intervals of 95 % before and after.

    Raises
    ------
    ValueError
        The navigation was not refined.
    """
    if survey.navigation is None:
        raise ValueError("the survey's navigation was not refined: set processing.navigation = 'refined'")
    return draw_errors(survey.navigation, survey.way_error)


# --------------------------------------------------------------------------------------------- chirp


def draw_chirp(survey: Survey) -> Figure:
    """Draw a chirp, and its spectrum with the CFAR threshold and the detections; ValueError for a sensor without."""
    record = survey.chirp
    if record is None:
        raise ValueError("the survey's sensor has no chirps to draw")
    figure = ReportFigure(figsize=(9.0, 7.0), layout="constrained")
    time_axes, range_axes = figure.subplots(2, 1)
    exponent = exponent_of(record.beat)
    draw_beat(time_axes, record, 10.0**exponent)
    if np.iscomplexobj(record.beat):
        time_axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2, frameon=False)
    unit = "relative to transmitted" if survey.scenario.radar.snr_db is not None else r"$\sqrt{\mathrm{W}}$"
    scale = rf"$10^{{{exponent}}}$ " if exponent else ""
    time_axes.set(xlabel="Time in the chirp (ms)", ylabel=f"Beat signal ({scale}{unit})")
    head(time_axes, f"Beat signal of pulse {record.pulse}")
    time_axes.margins(x=0)
    _draw_spectrum(range_axes, record, survey.scenario.radar)
    return figure


def draw_beat(axes: Axes, record: ChirpRecord, unit: float = 1.0) -> None:
    """Draw the parts of a beat signal over the time in its sweep."""
    parts = {"In phase": record.beat.real, "Quadrature": record.beat.imag}
    drawn = parts if np.iscomplexobj(record.beat) else {"Beat signal": record.beat}
    for (name, samples), colour in zip(drawn.items(), (BLUE, ORANGE), strict=False):
        axes.plot(1e3 * record.sample_time_s, samples / unit, color=colour, lw=0.8, label=name)


def _draw_spectrum(axes: Axes, record: ChirpRecord, radar: RadarTable) -> None:
    power_db, threshold_db, echo_db = map(decibels, (record.power, record.threshold, record.echo_power))
    axes.plot(record.range_m, power_db, color=BLUE, lw=0.9, label="Spectrum")
    axes.plot(record.range_m, threshold_db, color=ORANGE, lw=1.5, ls="--", label="CFAR threshold")
    ranges = ", ".join(f"{r:.1f} m" for r in record.echo_range_m[:4])
    ranges += ", ..." * (len(record.echo_range_m) > 4)
    label = f"Detections: {ranges}" if ranges else "No detection"
    axes.plot(record.echo_range_m, echo_db, ls="", marker="v", ms=9, mfc=RED, mec="black", label=label)
    shown = np.concatenate([power_db, threshold_db, echo_db])
    shown = shown[np.isfinite(shown)]
    if len(shown):
        # Without noise, cells between echoes are hundreds of dB below them.
        top = shown.max()
        axes.set_ylim(max(np.percentile(shown, 1) - 5, top - 110), top + 10)
    axes.set_xlabel("Range, not corrected for Doppler (m)")
    axes.set_ylabel(_power_label("Power", radar))
    head(axes, "Range spectrum")
    axes.margins(x=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", framealpha=0.9)


# ------------------------------------------------------------------------------------------ readings


def draw_readings(survey: Survey) -> Figure:
    """Draw the readings of a beam that does not scan over time, and their errors by cover; ValueError without any."""
    readings = survey.readings
    if readings is None:
        raise ValueError("the survey makes a map, and has no readings to draw")
    figure = ReportFigure(figsize=(9.0, 7.0), layout="constrained")
    heights, errors = figure.subplots(2, 1, sharex=True)
    time_s, error_m = readings.time_s, readings.reading_m - readings.true_m
    subject = readings.subject[:1].upper() + readings.subject[1:]
    heights.plot(time_s, readings.true_m, color="black", lw=1.2, label=subject)
    heights.plot(time_s, readings.clearance_m, color="0.55", lw=1.0, ls="--", label="Clearance over what stands below")
    heights.plot(time_s, readings.reading_m, color=BLUE, lw=1.0, label="Reading")
    heights.set(ylabel="Metres")
    colours = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)
    names = np.array(readings.cover)
    for number_of, (name, own) in enumerate(readings.by_cover.items()):
        here = names == name
        label = f"{name}: {own.bias_m:+.2f} ± {own.std_m:.2f} m" if np.isfinite(own.bias_m) else f"{name}: no reading"
        errors.plot(time_s[here], error_m[here], ls="", marker=".", ms=4, color=colours[number_of % 6], label=label)
    dropped = time_s[np.isnan(readings.reading_m)]
    if len(dropped):
        label = f"Drop-outs: {len(dropped):,} of {len(time_s):,} pulses"
        bottom = errors.get_ylim()[0]
        errors.plot(dropped, np.full(len(dropped), bottom), ls="", marker="|", ms=9, color=RED, label=label)
    errors.axhline(0.0, color="black", lw=0.8)
    errors.set(xlabel="Time (s)", ylabel=f"Reading less {readings.subject} (m)")
    head(heights, f"Readings; lowest clearance flown {readings.errors.lowest_clearance_m:.1f} m")
    lag = "latency not told" if readings.latency_s is None else f"latency {readings.latency_s:+.3f} s"
    head(errors, f"Errors: 95 % within {number(readings.errors.le95_m, '.2f', ' m')}, {lag}")
    for axes in (heights, errors):
        axes.margins(x=0.01)
        axes.grid(alpha=0.3)
        axes.legend(loc="best", fontsize="small", framealpha=0.9)
    _warn(figure, survey)
    return figure


# --------------------------------------------------------------------------------------------- maps


def draw_power(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the power of the echoes at their positions on the map."""
    points = survey.points
    bounds = map_bounds(survey.truth.grid.extent_m, points.position_m)
    width, height = map_size(bounds)
    figure = ReportFigure(figsize=(width + 2.6, height + 1.3), layout="constrained")
    axes = figure.subplots()
    power_db = decibels(points.power)
    chosen = points_to_draw(len(points), MAX_SCATTER)
    # Keep the few echoes of bright point targets, which thinning might drop.
    brightest = np.argsort(points.power)[-50:]
    chosen = np.union1d(chosen, brightest)
    finite = power_db[np.isfinite(power_db)]
    low, high = np.percentile(finite, [1, 99.5]) if len(finite) else (-1.0, 1.0)
    scale = Normalize(low, max(high, low + 1.0))
    x, y = points.position_m[chosen, :2].T
    side = 2 * dot_size((width, height), len(chosen))
    axes.scatter(x, y, c=power_db[chosen], s=side**2, marker="o", lw=0, cmap=POWERS, norm=scale)
    axes.set_facecolor("white")
    finish_map(
        axes, bounds, f"Echo power ({_counted(chosen, len(points))})", frame_of(survey.georeference, coordinates)
    )
    bar = ScalarMappable(scale, POWERS)
    colour_bar(axes, bar, _power_label("Echo power", survey.scenario.radar), width, extend="both")
    _warn(figure, survey)
    return figure


def draw_dem(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the true surface and the DEM on one colour scale, with the points of the DEM."""
    bounds = map_bounds(survey.truth.grid.extent_m, np.zeros((0, 3)))
    figure, (left, right), map_in = _map_pair(bounds)
    limits, frame = span_of(survey.truth.height_m, survey.dem.height_m), frame_of(survey.georeference, coordinates)
    dem_title = f"DEM, RMS error of lit cells {number(survey.lit_error.rms_m, '.3f', ' m')}"
    for axes, raster, title in ((left, survey.truth, "True surface"), (right, survey.dem, dem_title)):
        show_raster(axes, raster, HEIGHTS, Normalize(*limits))
        finish_map(axes, bounds, title, frame)
        colour_bar(axes, height_colours(limits, frame), frame.height, map_in[0])
    chosen = points_to_draw(len(survey.points), MAX_OVERLAY)
    size = 0.8 * dot_size(map_in, len(chosen))
    x, y = survey.points.position_m[chosen, :2].T
    right.plot(x, y, ls="", marker="o", ms=size, mew=0, color="white", alpha=0.6)
    drawn = _counted(chosen, len(survey.points))
    dots = Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec="0.4", label=drawn)
    figure.legend(handles=[dots, _empty_patch(survey)], loc="outside lower center", ncols=2, frameon=False)
    _warn(figure, survey)
    return figure


def draw_error(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the error of the DEM, and its histogram with the statistics."""
    bounds = map_bounds(survey.error.grid.extent_m, np.zeros((0, 3)))
    width, height = map_size(bounds)
    figure = ReportFigure(figsize=(width + 6.0, max(height + 1.4, 4.6)), layout="constrained")
    plan, histogram = figure.subplots(1, 2, width_ratios=[width + 1.6, 4.0])
    limit = limit_of(survey.error.height_m)
    show_raster(plan, survey.error, ERRORS, Normalize(-limit, limit))
    finish_map(plan, bounds, "DEM minus true surface", frame_of(survey.georeference, coordinates))
    bar = ScalarMappable(Normalize(-limit, limit), ERRORS)
    colour_bar(plan, bar, "Height error (m)", width, extend="both")
    figure.legend(handles=[_empty_patch(survey)], loc="outside lower center", frameon=False)
    _draw_histogram(histogram, survey.error.height_m[survey.error.filled & survey.lit], limit, survey)
    _warn(figure, survey)
    return figure


def _draw_histogram(axes: Axes, values: Float[np.ndarray, " cell"], limit: float, survey: Survey) -> None:
    counts, edges = np.histogram(values, bins=60, range=(-limit, limit))
    share = 100 * counts / max(len(values), 1)
    middle = (edges[1:] + edges[:-1]) / 2
    colours = colormaps[ERRORS](Normalize(-limit, limit)(middle))
    axes.bar(middle, share, width=edges[1] - edges[0], color=colours, edgecolor="0.4", lw=0.3)
    axes.axvline(0.0, ymax=0.5, color="black", lw=0.8)
    e, off_wall = survey.lit_error, survey.off_wall_error
    rows = {"RMS": e.rms_m, "Mean": e.mean_m, "NMAD": e.nmad_m, "LE90*": e.le90_m}
    if off_wall is not None:
        rows["RMS off walls"] = off_wall.rms_m
    lines = [f"{name:<14}{value:>8.3f} m" for name, value in rows.items() if np.isfinite(value)]
    lines += [f"{'Coverage':<14}{100 * e.coverage:>8.1f} %", f"{'Cells filled':<14}{e.count:>8d}"]
    # Leave space above the tallest bar for the box of numbers.
    top = max(float(share.max()), 0.5)
    if limit > HEAVY_TAILS * e.nmad_m:
        # Beside such a narrow peak the few errors at walls would be invisible.
        low = 50 / max(len(values), 1)
        axes.set_yscale("log")
        axes.set_ylim(low, top * top / low)
        decades = 10.0 ** np.arange(np.floor(np.log10(low)), 3)
        axes.set_yticks(decades[decades >= low], [f"{share:g}" for share in decades[decades >= low]])
        axes.yaxis.set_minor_locator(NullLocator())
    else:
        axes.set_ylim(0, 2 * top)
    text = axes.text(0.98, 0.98, "\n".join(lines), transform=axes.transAxes, ha="right", va="top")
    text.set(family="monospace", multialignment="left")
    beyond_percent = 100 * float(np.mean(np.abs(values) > limit)) if len(values) else 0.0
    note = f" ({beyond_percent:.1f} % beyond)" if beyond_percent >= 0.05 else ""
    axes.set(xlim=(-limit, limit), ylabel="Share of lit cells (%)")
    axes.set_xlabel(f"Height error (m){note}\n* 90th percentile of |error|")
    head(axes, f"Error of lit cells: RMS {number(e.rms_m, '.3f', ' m')}")
    axes.spines[["top", "right"]].set_visible(False)


# ----------------------------------------------------------------------------------- parts of figures


def _map_pair(bounds: tuple[float, float, float, float]) -> tuple[Figure, tuple[Axes, Axes], tuple[float, float]]:
    """Return a figure of two maps, stacked if they are wide, and their size in inches."""
    width, height = map_size(bounds, PAIRED_BOX_IN)
    if width > 1.5 * height:
        figure = ReportFigure(figsize=(width + 2.0, 2 * (height + 0.9) + 0.6), layout="constrained")
        top, bottom = figure.subplots(2, 1)
        return figure, (top, bottom), (width, height)
    figure = ReportFigure(figsize=(2 * (width + 1.9), height + 1.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    return figure, (left, right), (width, height)


def _empty_patch(survey: Survey) -> Patch:
    falling = survey.scenario.weather.falling
    return empty_patch(f"shadow, no echo, or an echo of {falling}" if falling else "shadow or no echo")


def _warn(figure: Figure, survey: Survey) -> None:
    letters = int(LETTERS_PER_INCH * figure.get_figwidth())
    told = list(survey.warnings)
    # Files of the scenario by their names alone: figures go elsewhere than their folders.
    values = (str(value) for value in leaves(survey.scenario.model_dump()) if isinstance(value, str | Path))
    for path in sorted(filter(os.path.isabs, values), key=len, reverse=True):
        told = [warning.replace(path, Path(path).name) for warning in told]
    if warnings := [line for warning in told for line in wrap(f"Warning: {warning}", letters)]:
        figure.suptitle("\n".join(warnings), color=RED, fontsize="small", parse_math=False)


def _counted(chosen: Int[np.ndarray, " chosen"], total: int) -> str:
    return f"{total:,} echoes" if len(chosen) == total else f"{len(chosen):,} of {total:,} echoes"


def _power_label(quantity: str, radar: RadarTable) -> str:
    # With snr_db the transmit power is unknown, and powers are relative to it.
    return f"{quantity} (dBW)" if radar.snr_db is None else f"{quantity} (dB rel. to transmitted)"
