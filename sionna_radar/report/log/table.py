"""The table of a log, for the terminal, and its numbers."""

from typing import Any

import numpy as np
from rich.table import Table

from sionna_radar.report.terminal import console
from sionna_radar.studies.log_inspection import LogInspection

MOST_SHOWN = 5


def log_summary(found: LogInspection) -> dict[str, Any]:
    """Return what is in a log, in plain tables."""
    positions, log = found.clean.positions, found.log
    place = positions.place
    height = place[:, 2] + (found.georeference.origin_m[2] if found.georeference else 0.0)
    degrees = log.positions.place[np.isfinite(log.positions.place).all(axis=1)] if log.on_map else None
    above = None if found.ground_under_m is None else place[:, 2] - found.ground_under_m
    clearance = None
    if above is not None and found.moved_m is None and np.isfinite(above).any():
        clearance = [float(f(above)) for f in (np.nanmin, np.nanmedian, np.nanmax)]
    return {
        "path": str(found.path),
        "format": log.kind,
        "duration_s": float(positions.time_s[-1] - positions.time_s[0]),
        "positions": positions.source,
        "velocities": log.positions.velocity_mps is not None,
        "attitudes": log.attitudes.source if log.attitudes else None,
        "errors": log.spreads.source if log.spreads else None,
        "sources": [{"name": s.name, "rows": s.rows, "rate_hz": s.rate_hz} for s in log.sources],
        "lon_deg": None if degrees is None else [float(degrees[:, 0].min()), float(degrees[:, 0].max())],
        "lat_deg": None if degrees is None else [float(degrees[:, 1].min()), float(degrees[:, 1].max())],
        "extent_m": [float(reach) for reach in np.ptp(place[:, :2], axis=0)],
        "heights_count_from": log.datum,
        "height_m": [float(height.min()), float(np.median(height)), float(height.max())],
        "height_above_ground_m": clearance,
        "speed_mps": [float(f(found.speed_mps)) for f in (np.min, np.mean, np.max)],
        "longest_step_s": float(np.diff(positions.time_s).max()),
        "moved_to_terrain_m": found.moved_m,
        "notes": [*log.notes, *found.clean.notes],
        "refused": list(found.refusals),
        "stretches_s": [list(ends) for ends in found.stretches],
    }


def print_log(found: LogInspection) -> None:
    """Print what is in a log, and what would keep it from being flown."""
    numbers = log_summary(found)
    table = Table(title=f"{found.path.name}: {numbers['format']}", title_justify="left", show_header=False)
    for name, value in _rows(numbers).items():
        table.add_row(name, value)
    out = console()
    out.print(table)
    for note in numbers["notes"][:MOST_SHOWN]:
        out.print(f"note: {note}", soft_wrap=True)
    refused = numbers["refused"]
    for refusal in refused[:MOST_SHOWN]:
        out.print(f"would be refused {refusal}", soft_wrap=True)
    if len(refused) > MOST_SHOWN:
        out.print(f"... and {len(refused) - MOST_SHOWN:,} more")
    if not refused:
        out.print("nothing in it would be refused")
        return
    for start_s, stop_s in numbers["stretches_s"]:
        out.print(f"can be flown: log_start_s = {start_s:.2f}, log_stop_s = {stop_s:.2f} ({stop_s - start_s:.1f} s)")
    if not numbers["stretches_s"]:
        out.print("no stretch of it can be flown")


def _rows(numbers: dict[str, Any]) -> dict[str, str]:
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
        "heights": f"{low:.1f} to {high:.1f} m, half above {middle:.1f} (from {numbers['heights_count_from']})",
        "speed": f"{slow:.1f} to {fast:.1f} m/s, mean {mean:.1f}",
    }
    if numbers["lon_deg"]:
        (west, east), (south, north) = numbers["lon_deg"], numbers["lat_deg"]
        rows["place"] = f"{west:.6f} to {east:.6f} deg east, {south:.6f} to {north:.6f} deg north"
    if numbers["height_above_ground_m"]:
        low, middle, high = numbers["height_above_ground_m"]
        rows["above the terrain"] = f"{low:.1f} to {high:.1f} m, half above {middle:.1f}"
    if numbers["moved_to_terrain_m"]:
        east, north = numbers["moved_to_terrain_m"]
        rows["moved to the terrain"] = f"{east:+.1f} m east, {north:+.1f} m north"
    return rows
