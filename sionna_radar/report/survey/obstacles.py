"""Obstacles of a survey in its files: what was seen of each, and what was reported."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sionna_radar.accuracy.obstacles import SeenObstacle
from sionna_radar.foundation.raster import Georeference
from sionna_radar.mapping.obstacles import ReportedObstacles
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.study_document import Column, Columns
from sionna_radar.report.terminal import number
from sionna_radar.scene.wires import ThinObstacle
from sionna_radar.survey.obstacles import ObstacleReport
from sionna_radar.survey.result import Survey

# GeoPackages hold the day of their last change; equal surveys give equal files.
UNDATED = "2000-01-01T00:00:00.000Z"
# Points along thin obstacles on a page, at most, and obstacles in its table.
MAX_DRAWN, MAX_ROWS = 20_000, 200

OBSTACLES: Columns[SeenObstacle] = Columns(
    (
        Column(key="name", heading="obstacle"),
        Column(key="kind"),
        Column(key="seen", heading="seen", text=lambda one: "yes" if one.seen else f"no: {one.hidden_by}"),
        Column(key="hidden_by"),
        Column(key="looks", heading="looks", form=",d"),
        Column(key="visible"),
        Column(key="echoes", heading="echoes", form=",d"),
        Column(key="pd_look", heading="Pd of a look", form=".2f"),
        Column(key="first_s"),
        Column(key="first_range_m", heading="first from", form=".1f", unit=" m"),
        Column(key="warning_s", heading="before it", form=".1f", unit=" s"),
        Column(key="report_warning_s", heading="reported before it", form=".1f", unit=" s"),
        Column(key="height_error_m", heading="height error", form="+.2f", unit=" m"),
        Column(key="position_error_m", heading="position error", form=".2f", unit=" m"),
    )
)
MEANING = (
    "seen: each obstacle of the scene, the pulses whose main beam met it (looks) and those in which nothing hid it "
    "(visible), its echoes, the share of visible looks with an echo (pd_look), time and range of the first and the "
    "time from then, and from the report, to reaching it at the speed over the ground; hidden_by: what kept it from "
    "being heard (beam, shadow, noise, ground clutter, rain, another echo). reported: those of obstacles.gpkg; false "
    "alarms: those whose echoes are mostly of no obstacle; pd_wire, pd_obstacle: share of the wires, and of wires, "
    "poles, fences and targets, of which a report that is no false alarm holds echoes; warning_s: the least time "
    "between the report of one of them and reaching it, or 0"
)


def obstacles_document(report: ObstacleReport) -> dict[str, Any]:
    """Return the obstacles as the summary holds them."""
    return {
        **report.rates(),
        "reported": None if report.reported is None else len(report.reported),
        "seen": [asdict(one) | {"seen": one.seen} for one in report.seen],
    }


def objects_csv(report: ObstacleReport | None) -> str | None:
    """Return the table of all obstacles; None without any."""
    if report is None or not report.seen:
        return None
    return OBSTACLES.csv(report.seen, [column.key for column in OBSTACLES.columns], ".4g")


def obstacle_rows(report: ObstacleReport | None) -> dict[str, str]:
    """Return the obstacles in the table of a survey on the console."""
    if report is None:
        return {}
    rows = {}
    if report.seen:
        unseen = [f"{one.name} ({one.hidden_by})" for one in report.seen if not one.seen]
        listed = f"; not {', '.join(unseen[:4])}{' ...' if len(unseen) > 4 else ''}" if unseen else ""
        rows["obstacles seen"] = f"{len(report.seen) - len(unseen)} of {len(report.seen)}{listed}"
    if report.reported is not None:
        false = 0 if report.of is None else int(np.count_nonzero(report.of < 0))
        rows["obstacles reported"] = (
            f"{len(report.reported)}, {false} of them false: {number(report.false_per_km2, '.3g')} per km2 and "
            f"{number(report.false_per_minute, '.2g')} per minute"
        )
    warning_s = report.rates()["warning_s"]
    if warning_s > 0:
        rows["least warning"] = f"{warning_s:.1f} s before reaching the obstacle"
    return rows


def obstacles_section(report: ObstacleReport | None) -> dict[str, Any]:
    """Return the section of the page."""
    if report is None or not report.seen:
        return {"obstacle_rows": []}
    # What stands out of the ground first, then what was not seen.
    listed = sorted(report.seen, key=lambda one: (one.kind in ("footprints", "vegetation"), one.seen))[:MAX_ROWS]
    return {
        "obstacle_heads": OBSTACLES.heads,
        "obstacle_rows": OBSTACLES.cells(listed, "obstacles."),
        "obstacle_pairs": obstacle_rows(report),
    }


def drawn_obstacles(pack: Pack, survey: Survey) -> dict[str, Any]:
    """Return thin obstacles as broken lines, and the places of reported ones, for the view in three dimensions."""
    drawn: dict[str, Any] = {}
    if survey.prepared.world.scene.thin:
        drawn["thin"] = pack.exact(broken_lines(survey.prepared.world.scene.thin))
    if survey.obstacles is not None and survey.obstacles.reported is not None and len(survey.obstacles.reported):
        drawn["reported"] = pack.exact(survey.obstacles.reported.position_m)
    return drawn


def broken_lines(obstacles: tuple[ThinObstacle, ...]) -> Float[np.ndarray, "n 3"]:
    """Return the wires of obstacles one after another, with NaN between them, no more points than a page draws."""
    wires = [wire for one in obstacles for wire in one.wires][: MAX_DRAWN // 3]
    length_m = sum(float(np.linalg.norm(np.diff(wire.vertex_m, axis=0), axis=1).sum()) for wire in wires)
    spacing_m = max(4 * length_m / MAX_DRAWN, 0.5)
    gap = np.full((1, 3), np.nan)
    return np.concatenate([part for wire in wires for part in (wire.points(spacing_m), gap)])[:MAX_DRAWN]


def write_obstacles(path: Path, reported: ReportedObstacles, place: Georeference | None) -> None:
    """Write reported obstacles as a GeoPackage of points, layer `obstacles`, in the coordinates of the rasters.

    Attributes: id; top_m, its highest echo in the heights of the map; above_m, that over the map, with sigma_m;
    radius_m on the level; echoes; probability; first_range_m.
    """
    import warnings

    import pyogrio
    import shapely

    east, north, up = (0.0, 0.0, 0.0) if place is None else place.origin_m
    position = reported.position_m + np.array([east, north, up])
    columns = {
        "id": np.arange(1, len(reported) + 1),
        "top_m": position[:, 2],
        "above_m": reported.above_m,
        "sigma_m": reported.sigma_m,
        "radius_m": reported.radius_m,
        "echoes": reported.echoes,
        "probability": reported.probability,
        "first_range_m": reported.first_range_m,
    }
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a file without a CRS: local metres
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": UNDATED})
        try:
            pyogrio.raw.write(
                path,
                shapely.to_wkb(shapely.points(position)) if len(position) else np.zeros(0, dtype=object),
                list(columns.values()),
                list(columns),
                layer="obstacles",
                driver="GPKG",
                geometry_type="Point Z",
                crs=None if place is None else place.crs_wkt,
            )
        finally:
            pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
