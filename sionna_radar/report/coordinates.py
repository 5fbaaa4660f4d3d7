"""Coordinates of figures: those of the local frame, or map coordinates with heights above the vertical datum."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, MaxNLocator

from sionna_radar.foundation.georeference import Georeference


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


def frame_of(place: Georeference | None, coordinates: Coordinates) -> Frame:
    """Return the frame in which figures are drawn."""
    if place is None or coordinates is Coordinates.LOCAL:
        return LOCAL_FRAME
    height = f"{place.vertical_name or 'Height above datum'} (m)"
    # Labels of six or seven digits: no more than four fit side by side.
    return Frame(origin_m=place.origin_m, east="Easting (m)", north="Northing (m)", height=height, most_ticks=4)


class _ShiftedLocator(MaxNLocator):
    """Ticks at round numbers of a shifted axis."""

    def __init__(self, shift: float, nbins: int) -> None:
        super().__init__(nbins=nbins, steps=[1, 2, 5, 10])
        self._shift = shift

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        return [tick - self._shift for tick in super().tick_values(vmin + self._shift, vmax + self._shift)]


def shift_ticks(axis: Axis, shift: float, most: int) -> None:
    """Label an axis with its values plus a shift, at round numbers and without a separate offset."""
    axis.set_major_locator(_ShiftedLocator(shift, most))
    # To a micrometre: round-off of the shift is not shown.
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{round(value + shift, 6):.12g}"))
