"""Figures of a survey, for print.

Each is a plain matplotlib `Figure` outside pyplot: no window, no state shared between figures. Maps show the
local frame with equal scales; sizes follow the shape of the ground, so that a 100 m and a 2 km survey both
fill the page. Colours are safe for colour-blind readers, and an empty cell is plain grey.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.trajectory import Phase
from sionna_radar.raster import Raster
from sionna_radar.report.figure_files import save_figures
from sionna_radar.report.maps import EMPTY, colour_bar, empty_patch, finish_map, show_raster
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.survey import ChirpRecord, Survey

MAX_SCATTER = 20_000
MAX_OVERLAY = 3_000
MAX_SHADED_CELLS = 1_000
BOX_IN = (5.8, 4.8)  # largest width and height of a map on its own
PAIRED_BOX_IN = (4.2, 3.9)  # and of one of two maps
MAX_ASPECT = 3.0
HEIGHTS, POWERS, ERRORS = "viridis", "viridis", "RdBu_r"
ORANGE, BLUE, RED = "#e69f00", "#0072b2", "#d55e00"  # Okabe and Ito


def draw_all(survey: Survey, directory: Path) -> list[Path]:
    """Draw every figure into a directory as PNG, and return the files."""
    figures: dict[str, Callable[[Survey], Figure]] = {
        "environment": environment,
        "chirp": chirp,
        "power_map": power_map,
        "dem": dem,
        "error_map": error_map,
    }
    if survey.chirp is None:
        del figures["chirp"]
    return save_figures(survey, figures, directory)


# --------------------------------------------------------------------------------------- environment


def environment(survey: Survey) -> Figure:
    """Draw the true surface with the flight and the ground that its beam meets, and the flight's profile."""
    trajectory = survey.schedule.trajectory
    flight = trajectory.position(np.linspace(0.0, trajectory.end_s, 2000))
    hits = _boresight_hits(survey)
    bounds = _bounds(survey.truth.grid.extent_m, flight)
    width, height = _map_size(bounds)
    figure = Figure(figsize=(width + 2.0, height + 4.0), layout="constrained")
    plan, profile = figure.subplots(2, 1, height_ratios=[height + 0.7, 2.4])
    limits = _height_limits(survey.truth)
    plan.imshow(_shaded(survey.truth, limits), origin="lower", extent=survey.truth.grid.extent_m)
    halo = [withStroke(linewidth=3.0, foreground="white")]
    size = _dot_size((width, height), len(hits))
    plan.plot(hits[:, 0], hits[:, 1], ls="", marker="o", ms=size, mew=0, color="white", alpha=0.7)
    plan.plot(flight[:, 0], flight[:, 1], color="black", lw=1.5, path_effects=halo)
    _mark_ends(plan, flight[[0, -1], :2])
    finish_map(plan, bounds, "True surface and flight")
    colour_bar(plan, _heights(limits), "Height (m)", width)
    _draw_profile(profile, survey, flight)
    figure.legend(handles=_environment_legend(survey), loc="outside lower center", ncols=3, frameon=False)
    return figure


def _draw_profile(axes: Axes, survey: Survey, flight: Float[np.ndarray, "n 3"]) -> None:
    """Draw height against the distance along the track, and the beam from the middle of the flight."""
    step = np.linalg.norm(np.diff(flight[:, :2], axis=0), axis=1)
    distance = np.concatenate([[0.0], np.cumsum(step)])
    moving = np.flatnonzero(step > 0)
    last = moving[-1] if len(moving) else 0
    ahead = (flight[last + 1, :2] - flight[last, :2]) / max(step[last], 1e-9)
    # The beam looks ahead of the platform, so the ground is drawn beyond the track's end.
    west, east, south, north = survey.truth.grid.extent_m
    beyond = np.linspace(0.0, np.hypot(east - west, north - south), 2000)
    path = np.concatenate([flight[:, :2], flight[-1, :2] + beyond[:, None] * ahead])
    along = np.concatenate([distance, distance[-1] + beyond])
    ground = survey.truth.at(path)
    known = np.isfinite(ground)
    lowest = np.append(ground[known], flight[:, 2]).min()
    floor = lowest - 0.08 * (flight[:, 2].max() - lowest)
    axes.fill_between(along, np.where(known, ground, np.nan), floor, color="0.75", lw=0)
    axes.plot(along, ground, color="0.35", lw=1.2)
    axes.plot(distance, flight[:, 2], color="black", lw=1.5)
    _mark_ends(axes, np.column_stack([distance, flight[:, 2]])[[0, -1]])
    _draw_beam(axes, survey)
    end = max(distance[-1], along[known].max() if known.any() else 0.0, 1.0)
    axes.set(xlim=(-0.02 * end, 1.02 * end), xlabel="Distance along the track (m)", ylabel="Height (m)")
    axes.set_ylim(bottom=floor)
    axes.set_title("Profile along the track", fontsize="medium")
    axes.spines[["top", "right"]].set_visible(False)


def _draw_beam(axes: Axes, survey: Survey) -> None:
    """Draw the boresight of the pulse in mid-flight that looks straight along the track."""
    schedule = survey.schedule
    if len(schedule) == 0:
        return
    middle = np.arange(len(schedule))[len(schedule) // 2 :][:2000]
    pulses = schedule.pulses(middle)
    pick = int(np.argmin(np.abs(pulses.scan_rad)))
    pose, time_s = pulses.true, pulses.time_s[pick]
    hit = _meet_ground(pose, survey.truth)[pick]
    if not np.isfinite(hit).all():
        return
    flown = schedule.trajectory.position(np.linspace(schedule.trajectory.cruise_s()[0], time_s, 500))[:, :2]
    start = float(np.linalg.norm(np.diff(flown, axis=0), axis=1).sum())
    reach = float(np.linalg.norm(hit[:2] - pose.position_m[pick, :2]))
    axes.plot([start, start + reach], [pose.position_m[pick, 2], hit[2]], color=RED, lw=1.2, ls="--")


def _mark_ends(axes: Axes, ends: Float[np.ndarray, "2 2"]) -> None:
    """Mark where the flight begins and ends."""
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


def _boresight_hits(survey: Survey) -> Float[np.ndarray, "hit 3"]:
    schedule = survey.schedule
    # Regular steps would beat with the rotation of the antenna and show a pattern that is not flown.
    chosen = np.random.default_rng(0).permutation(len(schedule))[:MAX_OVERLAY]
    hits = _meet_ground(schedule.pulses(np.sort(chosen)).true, survey.truth)
    met: Float[np.ndarray, "hit 3"] = hits[np.isfinite(hits).all(axis=1)]
    return met


def _meet_ground(pose: Pose, truth: Raster) -> Float[np.ndarray, "pulse 3"]:
    """Return where the beam axes meet the surface; NaN where they meet none of it.

    An axis is followed through the layer between the lowest and the highest ground only.
    """
    low, high = _height_limits(truth)
    down = -pose.boresight[:, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (pose.position_m[:, 2:] - np.array([high + 0.01, low - 0.01])) / down[:, None]
    reach = np.where((down > 1e-3)[:, None], np.maximum(reach, 0.0), np.nan)
    distance = reach[:, :1] + (reach[:, 1:] - reach[:, :1]) * np.linspace(0.0, 1.0, 200)
    along = pose.position_m[:, None] + distance[:, :, None] * pose.boresight[:, None]
    outside = ~np.isfinite(along).all(axis=2).ravel()
    flat = np.where(outside[:, None], 0.0, along.reshape(-1, 3))
    clearance = np.where(outside, np.nan, flat[:, 2] - truth.at(flat[:, :2])).reshape(distance.shape)
    below = (clearance[:, 1:] <= 0) & (clearance[:, :-1] > 0)
    first = np.argmax(below, axis=1)
    row = np.arange(len(first))
    hits: Float[np.ndarray, "pulse 3"] = along[row, first + 1]
    hits[~below[row, first]] = np.nan
    return hits


def _shaded(raster: Raster, limits: tuple[float, float]) -> Float[np.ndarray, "row column 4"]:
    """Return the colours of heights, lit from the north-west; relief is exaggerated where it is faint."""
    step = max(1, int(np.ceil(max(raster.grid.shape) / MAX_SHADED_CELLS)))
    height = raster.height_m[::step, ::step]
    colours: Float[np.ndarray, "row column 4"]
    colours = colormaps[HEIGHTS].with_extremes(bad=EMPTY)(Normalize(*limits)(np.ma.masked_invalid(height)))
    if min(height.shape) < 2:
        return colours
    north, east = np.gradient(height, raster.grid.spacing_m * step)
    filled = np.isfinite(north) & np.isfinite(east)
    slope = np.sqrt(np.mean((north**2 + east**2)[filled])) if filled.any() else 0.0
    exaggeration = min(0.5 / slope, 10.0) if slope > 0 else 1.0
    toward_light = (exaggeration * (east - north) / np.sqrt(2) + 1.0) / np.sqrt(2)
    light = toward_light / np.sqrt(1 + exaggeration**2 * (north**2 + east**2))
    colours[filled, :3] *= np.clip(0.55 + 0.55 * light[filled], 0.4, 1.0)[:, None]
    return colours


# --------------------------------------------------------------------------------------------- chirp


def chirp(survey: Survey) -> Figure:
    """Draw one chirp: its beat signal, and its spectrum with the CFAR threshold and the detections."""
    record = survey.chirp
    if record is None:
        message = "the survey's sensor has no chirps to draw"
        raise ValueError(message)
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    time_axes, range_axes = figure.subplots(2, 1)
    exponent = _exponent(np.abs(record.beat))
    parts = {"In phase": record.beat.real, "Quadrature": record.beat.imag}
    drawn = parts if np.iscomplexobj(record.beat) else {"Beat signal": record.beat}
    for (name, samples), colour in zip(drawn.items(), (BLUE, ORANGE), strict=False):
        time_axes.plot(1e3 * record.sample_time_s, samples / 10.0**exponent, color=colour, lw=0.8, label=name)
    if len(drawn) > 1:
        time_axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=2, frameon=False
        )
    unit = "relative to sent" if survey.scenario.radar.snr_db is not None else r"$\sqrt{\mathrm{W}}$"
    scale = rf"$10^{{{exponent}}}$ " if exponent else ""
    time_axes.set(xlabel="Time in the chirp (ms)", ylabel=f"Beat signal ({scale}{unit})")
    time_axes.set_title(f"Beat signal of pulse {record.pulse}", fontsize="medium")
    time_axes.margins(x=0)
    _draw_spectrum(range_axes, record, survey.scenario.radar)
    return figure


def _draw_spectrum(axes: Axes, record: ChirpRecord, radar: RadarTable) -> None:
    power_db, threshold_db, echo_db = map(_decibels, (record.power, record.threshold, record.echo_power))
    axes.plot(record.range_m, power_db, color=BLUE, lw=0.9, label="Spectrum")
    axes.plot(record.range_m, threshold_db, color=ORANGE, lw=1.5, ls="--", label="CFAR threshold")
    found = ", ".join(f"{r:.1f} m" for r in record.echo_range_m[:4])
    found += ", ..." * (len(record.echo_range_m) > 4)
    label = f"Detections: {found}" if found else "No detection"
    axes.plot(record.echo_range_m, echo_db, ls="", marker="v", ms=9, mfc=RED, mec="black", label=label)
    shown = np.concatenate([power_db, threshold_db, echo_db])
    shown = shown[np.isfinite(shown)]
    if len(shown):
        # Without noise the cells between echoes lie hundreds of dB below them.
        top = shown.max()
        axes.set_ylim(max(np.percentile(shown, 1) - 5, top - 110), top + 10)
    axes.set_xlabel("Range, not corrected for Doppler (m)")
    axes.set_ylabel(_power_label("Power", radar))
    axes.set_title("Range spectrum", fontsize="medium")
    axes.margins(x=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right", framealpha=0.9)


# --------------------------------------------------------------------------------------------- maps


def power_map(survey: Survey) -> Figure:
    """Draw the power of the echoes where they are placed on the ground plan."""
    points = survey.points
    bounds = _bounds(survey.truth.grid.extent_m, points.position_m)
    width, height = _map_size(bounds)
    figure = Figure(figsize=(width + 2.0, height + 1.3), layout="constrained")
    axes = figure.subplots()
    power_db = _decibels(points.power)
    chosen = _thinned(len(points), MAX_SCATTER)
    # A bright point target is a handful of echoes, which thinning might drop.
    brightest = np.argsort(points.power)[-50:]
    chosen = np.union1d(chosen, brightest)
    finite = power_db[np.isfinite(power_db)]
    low, high = np.percentile(finite, [1, 99.5]) if len(finite) else (-1.0, 1.0)
    scale = Normalize(low, max(high, low + 1.0))
    x, y = points.position_m[chosen, :2].T
    side = 2 * _dot_size((width, height), len(chosen))
    axes.scatter(x, y, c=power_db[chosen], s=side**2, marker="o", lw=0, cmap=POWERS, norm=scale)
    axes.set_facecolor("white")
    finish_map(axes, bounds, f"Echo power ({_counted(chosen, points)})")
    bar = ScalarMappable(scale, POWERS)
    colour_bar(axes, bar, _power_label("Echo power", survey.scenario.radar), width, extend="both")
    return figure


def dem(survey: Survey) -> Figure:
    """Draw the true surface and the DEM on one colour scale, with the points that made the DEM."""
    bounds = _bounds(survey.truth.grid.extent_m, np.zeros((0, 3)))
    figure, (left, right), map_in = _map_pair(bounds)
    limits = _height_limits(survey.truth, survey.dem)
    for axes, raster, title in ((left, survey.truth, "True surface"), (right, survey.dem, "DEM")):
        show_raster(axes, raster, HEIGHTS, Normalize(*limits))
        finish_map(axes, bounds, title)
        colour_bar(axes, _heights(limits), "Height (m)", map_in[0])
    chosen = _thinned(len(survey.points), MAX_OVERLAY)
    size = 0.8 * _dot_size(map_in, len(chosen))
    x, y = survey.points.position_m[chosen, :2].T
    right.plot(x, y, ls="", marker="o", ms=size, mew=0, color="white", alpha=0.6)
    drawn = _counted(chosen, survey.points)
    dots = Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec="0.4", label=drawn)
    figure.legend(handles=[dots, empty_patch()], loc="outside lower center", ncols=2, frameon=False)
    return figure


def error_map(survey: Survey) -> Figure:
    """Draw the error of the DEM, and its histogram with the statistics."""
    bounds = _bounds(survey.error.grid.extent_m, np.zeros((0, 3)))
    width, height = _map_size(bounds)
    figure = Figure(figsize=(width + 6.0, max(height + 1.4, 4.6)), layout="constrained")
    plan, histogram = figure.subplots(1, 2, width_ratios=[width + 1.6, 4.0])
    values = survey.error.height_m[survey.error.filled]
    limit = _error_limit(values)
    show_raster(plan, survey.error, ERRORS, Normalize(-limit, limit))
    finish_map(plan, bounds, "DEM minus true surface")
    bar = ScalarMappable(Normalize(-limit, limit), ERRORS)
    colour_bar(plan, bar, "Height error (m)", width, extend="both")
    figure.legend(handles=[empty_patch()], loc="outside lower center", frameon=False)
    _draw_histogram(histogram, values, limit, survey)
    return figure


def _draw_histogram(axes: Axes, values: Float[np.ndarray, " cell"], limit: float, survey: Survey) -> None:
    counts, edges = np.histogram(values, bins=60, range=(-limit, limit))
    share = 100 * counts / max(len(values), 1)
    middle = (edges[1:] + edges[:-1]) / 2
    colours = colormaps[ERRORS](Normalize(-limit, limit)(middle))
    axes.bar(middle, share, width=edges[1] - edges[0], color=colours, edgecolor="0.4", lw=0.3)
    axes.axvline(0.0, ymax=0.6, color="black", lw=0.8)
    e = survey.dem_error
    rows = {"RMS": e.rms_m, "Mean": e.mean_m, "NMAD": e.nmad_m, "LE90": e.le90_m}
    lines = [f"{name:<9}{value:>8.3f} m" for name, value in rows.items() if np.isfinite(value)]
    lines += [f"{'Coverage':<9}{100 * e.coverage:>8.1f} %", f"{'Cells':<9}{e.count:>8d}"]
    # The head room above the tallest bar belongs to the box of numbers.
    axes.set_ylim(0, 1.75 * max(share.max(), 0.5))
    text = axes.text(0.98, 0.98, "\n".join(lines), transform=axes.transAxes, ha="right", va="top")
    text.set(family="monospace", multialignment="left")
    outside = 100 * float(np.mean(np.abs(values) > limit)) if len(values) else 0.0
    note = f" ({outside:.1f} % beyond)" if outside >= 0.05 else ""
    axes.set(xlim=(-limit, limit), xlabel=f"Height error (m){note}", ylabel="Share of cells (%)")
    axes.set_title("Distribution", fontsize="medium")
    axes.spines[["top", "right"]].set_visible(False)


# ----------------------------------------------------------------------------------- parts of figures


def _map_size(
    bounds: tuple[float, float, float, float], box_in: tuple[float, float] = BOX_IN
) -> tuple[float, float]:
    """Return the size in inches of a map that fits the box."""
    width_m, height_m = bounds[1] - bounds[0], bounds[3] - bounds[2]
    scale = min(box_in[0] / width_m, box_in[1] / height_m)
    return width_m * scale, height_m * scale


def _map_pair(
    bounds: tuple[float, float, float, float],
) -> tuple[Figure, tuple[Axes, Axes], tuple[float, float]]:
    """Return a figure of two maps, one above the other where they are wide, and their size in inches."""
    width, height = _map_size(bounds, PAIRED_BOX_IN)
    if width > 1.5 * height:
        figure = Figure(figsize=(width + 2.0, 2 * (height + 0.9) + 0.6), layout="constrained")
        top, bottom = figure.subplots(2, 1)
        return figure, (top, bottom), (width, height)
    figure = Figure(figsize=(2 * (width + 1.9), height + 1.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    return figure, (left, right), (width, height)


def _bounds(
    extent_m: tuple[float, float, float, float], position_m: Float[np.ndarray, "n 3"]
) -> tuple[float, float, float, float]:
    """Return the edges (west, east, south, north) of a map of a grid and some positions."""
    west, east, south, north = extent_m
    if len(position_m):
        pad = 0.03 * max(east - west, north - south)
        low, high = position_m.min(axis=0) - pad, position_m.max(axis=0) + pad
        west, east = min(west, low[0]), max(east, high[0])
        south, north = min(south, low[1]), max(north, high[1])
    # A strip gets room at its sides: a sliver of a map has no place for its ticks and its colour bar.
    shortest = max(east - west, north - south) / MAX_ASPECT
    across, along = max(0.0, shortest - (east - west)) / 2, max(0.0, shortest - (north - south)) / 2
    return float(west - across), float(east + across), float(south - along), float(north + along)


def _heights(limits: tuple[float, float]) -> ScalarMappable:
    return ScalarMappable(Normalize(*limits), HEIGHTS)


def _height_limits(*rasters: Raster) -> tuple[float, float]:
    heights = np.concatenate([r.height_m[r.filled] for r in rasters])
    if len(heights) == 0:
        return 0.0, 1.0
    low, high = float(heights.min()), float(heights.max())
    # A level surface needs a scale too.
    return (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)


def _error_limit(values: Float[np.ndarray, " cell"]) -> float:
    """Return the size of error that 99 cells in 100 stay within: a few outliers must not bleach the map."""
    return max(float(np.percentile(np.abs(values), 99)), 1e-3) if len(values) else 1.0


def _thinned(count: int, most: int) -> Int[np.ndarray, " chosen"]:
    """Return the rows to draw: all, or a fixed random choice that does not beat with the scan."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def _dot_size(map_in: tuple[float, float], count: int) -> float:
    """Return the size of a dot, in points, at which that many leave most of a map to be seen."""
    return float(np.clip(72 * np.sqrt(map_in[0] * map_in[1] / max(count, 1)) / 8, 0.75, 2.5))


def _counted(chosen: Int[np.ndarray, " chosen"], points: object) -> str:
    total = len(points)  # type: ignore[arg-type]
    return f"{total:,} echoes" if len(chosen) == total else f"{len(chosen):,} of {total:,} echoes"


def _decibels(power: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return powers in dB; NaN for none."""
    positive = np.where(power > 0, power, np.nan)
    return 10 * np.log10(positive)


def _power_label(quantity: str, radar: RadarTable) -> str:
    # Under snr_db no transmit power is known, and powers are ratios to it.
    return f"{quantity} (dBW)" if radar.snr_db is None else f"{quantity} (dB rel. to sent)"


def _exponent(size: Float[np.ndarray, " n"]) -> int:
    """Return the power of ten, in threes, that brings a signal near one."""
    largest = float(size.max(initial=0.0))
    return 3 * int(np.floor(np.log10(largest) / 3)) if largest > 0 else 0
