"""The way of a panoramic radar and the map around it as files, table and figures."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sionna_radar.report.colours import ORANGE, RED
from sionna_radar.report.drawing import ReportFigure
from sionna_radar.report.files.contents import csv_text
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.studies.panorama.document import REACH, show_power, write_power
from sionna_radar.studies.slam.study import Slam

# Pixels of the map, relative to a range cell.
PIXEL_CELLS = 1.0
COLUMNS = (
    "time_s", "east_m", "north_m", "heading_deg", "ahead_mps", "right_mps", "yaw_deg_s",
    "east_sigma_m", "north_sigma_m", "heading_sigma_deg", "lost",
)  # fmt: skip


def map_figure(found: Slam) -> Figure:
    """Draw the map of echo power with the way through it."""
    figure = ReportFigure(figsize=(7.5, 7.0), layout="constrained")
    axes = figure.subplots()
    images, way = found.images, found.way
    reach_m = REACH * float(images.range_m[-1])
    grid = images.grid(way, PIXEL_CELLS * images.chirp.range_resolution_m, reach_m)
    picture = show_power(axes, images.mosaic(grid, way, reach_m), grid)
    if found.true_state is not None:
        axes.plot(*found.true_state[:, :2].T, color="white", lw=1.0, ls="--", label="True way")
    axes.plot(*found.state[:, :2].T, color=RED, lw=1.2, label="Way by SLAM")
    if found.lost.any():
        axes.plot(*found.state[found.lost, :2].T, "x", color=ORANGE, label="Lost")
    axes.legend(loc="upper right", fontsize="small")
    figure.colorbar(picture, ax=axes, label="Power, scaled to one range (dB)", extend="both", shrink=0.8)
    return figure


def error_figure(found: Slam) -> Figure:
    """Draw the errors of place and heading over time, with what was stated of them."""
    assert found.true_state is not None
    figure = ReportFigure(figsize=(8.0, 5.0), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    error = found.state[:, :3] - found.true_state[:, :3]
    error[:, 2] = np.mod(error[:, 2] + np.pi, 2 * np.pi) - np.pi
    time_s = found.time_s - found.time_s[0]
    for column, (name, colour) in enumerate((("East", RED), ("North", ORANGE))):
        upper.plot(time_s, error[:, column], color=colour, label=name)
        upper.fill_between(
            time_s, -1.96 * found.sigma[:, column], 1.96 * found.sigma[:, column], color=colour, alpha=0.15
        )
    lower.plot(time_s, np.rad2deg(error[:, 2]), color=RED)
    band = np.rad2deg(1.96 * found.sigma[:, 2])
    lower.fill_between(time_s, -band, band, color=RED, alpha=0.15)
    upper.set_ylabel("Error of the place (m)")
    upper.legend(fontsize="small")
    lower.set(xlabel="Time (s)", ylabel="Error of the heading (deg)")
    upper.set_title("Errors, and the stated intervals of 95 %", fontsize="medium")
    return figure


def slam_numbers(found: Slam) -> dict[str, Any]:
    """Return the numbers."""
    drift = found.drift
    return {
        "turns": len(found.state),
        "way_m": found.way_m,
        "loops": len(found.loops),
        "lost": np.flatnonzero(found.lost),
        "end_sigma_m": found.sigma[-1, :2],
        "end_heading_sigma_deg": np.rad2deg(found.sigma[-1, 2]),
        "odometer": None if found.odometer is None else {
            "scale_percent": 100 * found.odometer[0],
            "yaw_rate_bias_deg_s": np.rad2deg(found.odometer[1]),
        },
        "drift": None if drift is None else {
            "translation_percent": 100 * drift.translation,
            "rotation_deg_per_100m": np.rad2deg(100 * drift.rotation_rad_per_m),
            "end_m": drift.end_m,
            "parts": drift.parts,
        },
        "loop_pairs": found.loops,
    }  # fmt: skip


def sentences(found: Slam) -> list[str]:
    """Return length, loops, what was lost, and the drift."""
    lines = [
        f"{len(found.state)} turns over {found.way_m:.0f} m; {len(found.loops)} pairs of turns at places that it "
        f"came back to; its end is known to {np.hypot(*found.sigma[-1, :2]):.2g} m and "
        f"{np.rad2deg(found.sigma[-1, 2]):.2g} deg"
    ]
    if found.odometer is not None:
        lines.append(
            f"odometry: scale {100 * found.odometer[0]:+.2f} %, bias of the yaw rate "
            f"{np.rad2deg(found.odometer[1]):+.3f} deg/s"
        )
    if found.lost.any():
        numbers = np.flatnonzero(found.lost)
        lines.append(
            f"lost in {len(numbers)} turns (the first is {numbers[0]}): what stands there does not lie on what was "
            "seen before, and the way goes on as it did"
        )
    if found.drift is not None:
        drift = found.drift
        lines.append(
            f"drift over parts of 100 to 800 m: {100 * drift.translation:.2f} % and "
            f"{np.rad2deg(100 * drift.rotation_rad_per_m):.2f} deg per 100 m; the end is {drift.end_m:.2f} m off"
            if drift.parts
            else f"the end is {drift.end_m:.2f} m off; the way is too short for a drift"
        )
    return lines


def way_csv(found: Slam) -> str:
    """Return the way as a table, a row a turn."""
    state, sigma = found.state.copy(), found.sigma.copy()
    state[:, [2, 5]], sigma[:, 2] = np.rad2deg(state[:, [2, 5]]), np.rad2deg(sigma[:, 2])
    rows = np.column_stack([found.time_s, state, sigma])
    lost = found.lost.astype(int)
    return csv_text(
        COLUMNS, ([*(f"{value:.6g}" for value in row), int(at)] for row, at in zip(rows, lost, strict=True))
    )


def write_map(found: Slam, folder: Path) -> None:
    """Write the map of echo power along the way."""
    images, way = found.images, found.way
    reach_m = REACH * float(images.range_m[-1])
    grid = images.grid(way, PIXEL_CELLS * images.chirp.range_resolution_m, reach_m)
    write_power(folder / "map.tif", grid, images.mosaic(grid, way, reach_m), "echo power, scaled to one range")


DOCUMENT = StudyDocument[Slam](
    marker="slam.json",
    suffix="_slam",
    numbers=slam_numbers,
    opening=sentences,
    figures=lambda found: {"map": map_figure} | ({} if found.true_state is None else {"errors": error_figure}),
    notebook=["map"],
    texts={"way.csv": way_csv},
    files=[write_map],
)
