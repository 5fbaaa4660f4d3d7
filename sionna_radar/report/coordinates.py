"""Coordinates in which pages and figures show a survey: those of a map, or local ones."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from jaxtyping import Float

from sionna_radar.foundation.raster import Georeference


class Coordinates(StrEnum):
    """Coordinates to show; MAP falls back to local ones if the scene is not georeferenced."""

    MAP = "map"
    LOCAL = "local"


@dataclass(frozen=True, kw_only=True)
class Frame:
    """The offset of local coordinates (east, north, up), and the names of the axes."""

    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    east: str = "East (m)"
    north: str = "North (m)"
    height: str = "Height (m)"
    most_ticks: int = 7


LOCAL_FRAME = Frame()
# Of rasters whose coordinates are those of the map; labels have six or seven digits: at most four fit side by side.
MAP_FRAME = Frame(east="Easting (m)", north="Northing (m)", most_ticks=4)


def frame_of(place: Georeference | None, coordinates: Coordinates) -> Frame:
    """Return the frame in which figures are drawn."""
    if place is None or coordinates is Coordinates.LOCAL:
        return LOCAL_FRAME
    height = f"{place.vertical_name or 'Height above datum'} (m)"
    return replace(MAP_FRAME, origin_m=place.origin_m, height=height)


# Largest ratio of the sides of a map.
MAX_ASPECT = 3.0


def map_bounds(
    extent_m: tuple[float, float, float, float], position_m: Float[np.ndarray, "n 3"]
) -> tuple[float, float, float, float]:
    """Return the edges (west, east, south, north) of a map of a grid and some positions."""
    west, east, south, north = extent_m
    if len(position_m):
        pad = 0.03 * max(east - west, north - south)
        low, high = position_m.min(axis=0) - pad, position_m.max(axis=0) + pad
        west, east = min(west, low[0]), max(east, high[0])
        south, north = min(south, low[1]), max(north, high[1])
    # Widen narrow strips, for the ticks and the colour bar.
    shortest = max(east - west, north - south) / MAX_ASPECT
    across, along = max(0.0, shortest - (east - west)) / 2, max(0.0, shortest - (north - south)) / 2
    return float(west - across), float(east + across), float(south - along), float(north + along)
