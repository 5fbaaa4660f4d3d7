"""The three-dimensional view of a page: ground, solids, flight, echoes and beams, in local metres."""

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import to_hex

from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.report.drawing import ERRORS, HEIGHTS, Frame
from sionna_radar.report.page.scene_data import HEIGHT_STEP_M, Pack, axes_of
from sionna_radar.survey.preparation import Prepared

MAX_TRACK, MAX_POINTS = 2_000, 15_000
# Margin around the map and the flight, as a share of the longer side.
MARGIN = 0.08
STOPS = 17


def colour_scales() -> dict[str, list[list[Any]]]:
    """Return the colour maps of the figures as plotly's lists of stops."""
    stops = np.linspace(0, 1, STOPS)
    return {
        kind: [[float(stop), to_hex(colormaps[name](stop))] for stop in stops]
        for kind, name in {"height": HEIGHTS, "error": ERRORS, "level": "cividis"}.items()
    }


def frame_of_page(frame: Frame) -> dict[str, Any]:
    """Return the offset of local coordinates and the names of the axes."""
    return {"origin": frame.origin_m, "east": frame.east, "north": frame.north, "height": frame.height}


def track_of(schedule: PulseSchedule) -> Float[np.ndarray, "n 3"]:
    """Return positions along a flight, evenly spaced in time."""
    return schedule.trajectory.position(np.linspace(0.0, schedule.trajectory.end_s, MAX_TRACK))


def box_of(prepared: Prepared) -> tuple[float, float, float, float]:
    """Return the box (west, east, south, north) around a survey's map and flight, no larger than its scene."""
    west, east, south, north = prepared.mapper.grid.extent_m
    track = track_of(prepared.flight)
    (left, low), (right, top) = track[:, :2].min(axis=0), track[:, :2].max(axis=0)
    west, east, south, north = min(west, left), max(east, right), min(south, low), max(north, top)
    pad = MARGIN * max(east - west, north - south)
    (left, low, _), (right, top, _) = prepared.scene.scene.bounds_m
    return (
        float(max(west - pad, left)),
        float(min(east + pad, right)),
        float(max(south - pad, low)),
        float(min(north + pad, top)),
    )


def packed_relief(pack: Pack, raster: Raster, name: str) -> dict[str, Any]:
    """Return a surface for a page."""
    return {"name": name, **axes_of(raster.grid), "z": pack.rounded(raster.height_m, HEIGHT_STEP_M)}


def packed_track(pack: Pack, schedule: PulseSchedule) -> dict[str, Any]:
    """Return a flight for a page: positions and times."""
    return {
        "position": pack.exact(track_of(schedule)),
        "time_s": pack.exact(np.linspace(0.0, schedule.trajectory.end_s, MAX_TRACK)),
    }


def rim_of(grid: Grid) -> Float[np.ndarray, "n 2"]:
    """Return places along the edge of a map."""
    west, east, south, north = grid.extent_m
    corners = np.array([[west, south], [east, south], [east, north], [west, north], [west, south]])
    sides = [np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(corners)]
    return np.concatenate([*sides, corners[:1]])
