"""Which coordinates figures show: those of the local frame, or of the map with the heights of its datum."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from matplotlib.axis import Axis
from matplotlib.ticker import FuncFormatter, MaxNLocator

from sionna_radar.foundation.georeference import Georeference


class Coordinates(StrEnum):
    """Coordinates to show; MAP where the world has a place on the map, else the local ones."""

    MAP = "map"
    LOCAL = "local"


@dataclass(frozen=True, kw_only=True)
class Frame:
    """What is added to local coordinates (east, north, up), and how the axes are called."""

    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    east: str = "East (m)"
    north: str = "North (m)"
    height: str = "Height (m)"
    most_ticks: int = 7


LOCAL_FRAME = Frame()


def frame_of(place: Georeference | None, coordinates: Coordinates) -> Frame:
    """Return the frame that figures of a world are drawn in."""
    if place is None or coordinates is Coordinates.LOCAL:
        return LOCAL_FRAME
    height = f"{place.vertical_name or 'Height above datum'} (m)"
    # Six or seven digits: no more than four of them fit side by side.
    return Frame(origin_m=place.origin_m, east="Easting (m)", north="Northing (m)", height=height, most_ticks=4)


class _ShiftedLocator(MaxNLocator):
    """Ticks at round numbers of a shifted axis."""

    def __init__(self, shift: float, nbins: int) -> None:
        super().__init__(nbins=nbins, steps=[1, 2, 5, 10])
        self._shift = shift

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        return [tick - self._shift for tick in super().tick_values(vmin + self._shift, vmax + self._shift)]


def shift_ticks(axis: Axis, shift: float, most: int) -> None:
    """Label an axis with its values plus a shift, at round numbers and without an offset beside it."""
    axis.set_major_locator(_ShiftedLocator(shift, most))
    # A micrometre: what the shift leaves of round-off is not shown.
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{round(value + shift, 6):.12g}"))
