"""The figure of a survey's environment: the true surface, the flight over it, and where its beam meets the ground."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.trajectory import Phase
from sionna_radar.report.colours import BLUE, ORANGE, RED
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of, shift_ticks
from sionna_radar.report.figure_files import ReportFigure
from sionna_radar.report.maps import (
    colour_bar,
    dot_size,
    finish_map,
    height_colours,
    height_limits,
    map_bounds,
    map_size,
)
from sionna_radar.report.shading import shaded
from sionna_radar.survey.result import Survey

MAX_OVERLAY = 3_000
# Width of a figure that takes three entries of the legend side by side.
LEAST_WIDE_IN = 6.5


def draw_environment(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> Figure:
    """Draw the true surface with the flight and the ground that its beam meets, and the flight's profile."""
    trajectory = survey.schedule.trajectory
    flight = trajectory.position(np.linspace(0.0, trajectory.end_s, 2000))
    hits = _boresight_hits(survey)
    bounds = map_bounds(survey.truth.grid.extent_m, flight)
    width, height = map_size(bounds)
    figure = ReportFigure(figsize=(width + 2.0, height + 4.0), layout="constrained")
    plan, profile = figure.subplots(2, 1, height_ratios=[height + 0.7, 2.4])
    limits, frame = height_limits(survey.truth), frame_of(survey.georeference, coordinates)
    plan.imshow(shaded(survey.truth, limits), origin="lower", extent=survey.truth.grid.extent_m)
    halo = [withStroke(linewidth=3.0, foreground="white")]
    size = dot_size((width, height), len(hits))
    plan.plot(hits[:, 0], hits[:, 1], ls="", marker="o", ms=size, mew=0, color="white", alpha=0.7)
    plan.plot(flight[:, 0], flight[:, 1], color="black", lw=1.5, path_effects=halo)
    _mark_ends(plan, flight[[0, -1], :2])
    finish_map(plan, bounds, "True surface and flight", frame)
    colour_bar(plan, height_colours(limits, frame), frame.height, width)
    _draw_profile(profile, survey, flight, frame)
    columns = 3 if width + 2.0 >= LEAST_WIDE_IN else 2
    figure.legend(handles=_environment_legend(survey), loc="outside lower center", ncols=columns, frameon=False)
    return figure


def _draw_profile(axes: Axes, survey: Survey, flight: Float[np.ndarray, "n 3"], frame: Frame) -> None:
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
    axes.set(xlim=(-0.02 * end, 1.02 * end), xlabel="Distance along the track (m)", ylabel=frame.height)
    shift_ticks(axes.yaxis, frame.origin_m[2], 6)
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
    hit = _meet_ground(pose, survey)[pick]
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
    # Regular steps would alias with the rotation of the antenna and show a false pattern.
    chosen = np.random.default_rng(0).permutation(len(schedule))[:MAX_OVERLAY]
    hits = _meet_ground(schedule.pulses(np.sort(chosen)).true, survey)
    met: Float[np.ndarray, "hit 3"] = hits[np.isfinite(hits).all(axis=1)]
    return met


def _meet_ground(pose: Pose, survey: Survey) -> Float[np.ndarray, "pulse 3"]:
    """Return where the beam axes meet the scene; NaN where they do not."""
    distance_m = survey.prepared.scene.caster.cast(pose.position_m, pose.boresight).distance_m
    distance_m = np.where(np.isfinite(distance_m), distance_m, np.nan)
    return pose.position_m + distance_m[:, None] * pose.boresight
