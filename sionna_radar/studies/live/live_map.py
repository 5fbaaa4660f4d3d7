"""A map that grows as one flies: windows of the DEM, each mapped anew from the echoes near it when they have changed.

A window is mapped by the scenario's own method, from all echoes in it and around it, on its own cells and a border of
others. One window is the batch map itself. The echoes that came last are held in memory; others, and the heights of
their windows, lie on disk and come back where the radar returns.
"""

from collections import OrderedDict
from dataclasses import dataclass, field, replace
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from weakref import finalize

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.detection.echoes import Profiles, profiles_of
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns, columns_of, packed, table_of
from sionna_radar.foundation.errors import OutputError, PoseError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.raster import Quantity, Raster
from sionna_radar.foundation.threads import equal_chunks
from sionna_radar.mapping.mapper import Mapper
from sionna_radar.mapping.options import LINEAR, SMOOTH
from sionna_radar.mapping.points import Points
from sionna_radar.studies.live.frame import Frame
from sionna_radar.studies.live.radar import Radar

# Echoes held in memory, of all windows together: some 50 MB with their profiles.
ECHOES_IN_MEMORY = 100_000


@dataclass(frozen=True, kw_only=True)
class Heard(Columns):
    """Pulses with an echo: their numbers and measured poses."""

    pulse: Int[np.ndarray, " pulse"]
    pose: Pose


@dataclass
class _Window:
    """A window of the map.

    rows, columns: its own cells in the map's grid; near_m: west, east, south and north of the echoes that it is mapped
    from, infinite at the edge of the map.
    heard, points, profiles: of the echoes, frame by frame, as far as they are in memory.
    height_m, sigma_m: of its own cells, when they were mapped last; None on disk, and before.
    stale: whether echoes came since then.
    stored: number of files of echoes on disk; mapped: whether there is one of heights.
    """

    rows: slice
    columns: slice
    near_m: tuple[float, float, float, float]
    heard: list[Heard] = field(default_factory=list)
    points: list[Points] = field(default_factory=list)
    profiles: list[Profiles] = field(default_factory=list)
    height_m: Float[np.ndarray, "row column"] | None = None
    sigma_m: Float[np.ndarray, "row column"] | None = None
    stale: bool = False
    stored: int = 0
    mapped: bool = False

    def near(self, points: Points) -> Int[np.ndarray, " near"]:
        """Return the pulses with a point near the window."""
        (x, y, _), (west, east, south, north) = points.position_m.T, self.near_m
        return np.unique(points.pulse[(x > west) & (x < east) & (y > south) & (y < north)])


class LiveMap:
    """A DEM of the echoes so far, by the method of the scenario.

    Parameters
    ----------
    radar:
        The radar whose frames are added, or a mapper of its own.
    folder:
        Where windows are kept that are not in memory, as GeoTIFF, with their echoes; None for a temporary folder, which
        goes with the map. The folder must be new, or empty.
    window_m:
        Longest side of a window, m.
    echoes_in_memory:
        Most echoes held in memory; beyond it those of the windows that were flown over the longest ago go to disk.

    Raises
    ------
    OutputError
        The folder is not empty, or cannot be written.

    Examples
    --------
    >>> radar = Radar(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> live = LiveMap(radar)
    >>> for step in range(11):
    ...     frame = radar.step(0.1 * step, (step - 100.0, 0.0, 60.0), (0.0, 0.0, 1.5708), (10.0, 0.0, 0.0))
    ...     live.add(frame)
    >>> bool(live.dem().filled.any()), live.changed() is not None, live.changed() is None
    (True, True, True)
    """

    def __init__(
        self,
        radar: Radar | Mapper,
        folder: str | Path | None = None,
        *,
        window_m: float = SMOOTH.tile_m,
        echoes_in_memory: int = ECHOES_IN_MEMORY,
    ) -> None:
        self.mapper, self._most = radar if isinstance(radar, Mapper) else radar.mapper, echoes_in_memory
        self._folder = self._made(folder)
        grid = self.mapper.grid
        self._border = int(np.ceil(self.mapper.max_gap_m / grid.spacing_m)) + 1
        margin_m = max(SMOOTH.overlap_m, 2 * LINEAR.longest_side_gaps * self.mapper.max_gap_m)
        self._windows = [
            _Window(
                rows=slice(*along),
                columns=slice(*across),
                near_m=(*_reach(grid.x_m, across, margin_m), *_reach(grid.y_m, along, margin_m)),
            )
            for along in _sides(grid.rows, window_m / grid.spacing_m)
            for across in _sides(grid.columns, window_m / grid.spacing_m)
        ]
        # Echoes in memory by window, the one that was flown over last at the end.
        self._held: OrderedDict[int, int] = OrderedDict()
        self._changed: tuple[slice, slice] | None = None
        self._last_pulse = -1

    def _made(self, folder: str | Path | None) -> Path:
        """Return the folder for windows; a temporary one goes with the map."""
        if folder is None:
            path = Path(mkdtemp(prefix="sionna-radar-live-"))
            finalize(self, rmtree, path, ignore_errors=True)
            return path
        path = Path(folder)
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise OutputError(f"{shown(path)}: is there already; give the live map a new folder, or an empty one")
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{shown(path)} cannot be made ({error.strerror}); name another folder") from error
        return path

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self._windows)

    def add(self, frame: Frame) -> None:
        """Add the echoes of a frame; the map is made when it is asked for.

        Raises PoseError for a frame that does not follow those in the map.
        """
        points, profiles = frame.points, frame.profiles
        if len(points) == 0:
            return
        first, last = int(frame.pulses.index[0]), int(frame.pulses.index[-1])
        if first <= self._last_pulse:
            message = f"its pulses {first} to {last} do not follow {self._last_pulse}, which is in the map"
            raise PoseError(f"frame: {message}; add the frames of one radar, each once and in order")
        self._last_pulse = last
        heard = Heard(pulse=frame.pulses.index, pose=frame.pulses.measured)
        for number, window in enumerate(self._windows):
            pulse = window.near(points)
            if len(pulse) == 0:
                continue
            window.heard.append(heard.rows(np.isin(heard.pulse, pulse)))
            window.points.append(points.rows(np.isin(points.pulse, pulse)))
            if profiles is not None:
                window.profiles.append(profiles.rows(np.flatnonzero(np.isin(profiles.pulse, pulse))))
            window.stale = True
            self._changed = _around(self._changed, (window.rows, window.columns))
            self._held[number] = self._held.get(number, 0) + len(window.points[-1])
            self._held.move_to_end(number)
        if sum(self._held.values()) > self._most:
            while sum(self._held.values()) > self._most / 2:
                self._close(next(iter(self._held)))

    def changed(self) -> tuple[slice, slice] | None:
        """Return rows and columns around the windows that may have changed since the last call; None for none."""
        changed, self._changed = self._changed, None
        return changed

    def dem(self) -> Raster:
        """Return the DEM of the echoes so far; NaN where nothing was seen."""
        return self._whole("height")

    def sigma(self) -> Raster | None:
        """Return the standard deviations of its cells; None for a method that states none."""
        sigma = self._whole("standard deviation of the height")
        return sigma if sigma.filled.any() else None

    def _whole(self, quantity: Quantity) -> Raster:
        whole = np.full(self.mapper.grid.shape, np.nan)
        for number, window in enumerate(self._windows):
            if window.stale or window.mapped:
                heights = self._mapped(number)
                whole[window.rows, window.columns] = heights[0 if quantity == "height" else 1]
        return Raster(grid=self.mapper.grid, height_m=whole, quantity=quantity)

    def _mapped(self, number: int) -> tuple[Float[np.ndarray, "row column"], Float[np.ndarray, "row column"]]:
        """Return heights and standard deviations of a window's own cells, mapped anew if echoes came."""
        window = self._windows[number]
        if not window.stale:
            if window.height_m is not None and window.sigma_m is not None:
                return window.height_m, window.sigma_m
            stored = columns_of(self._path(number, "heights.npz").read_bytes())
            return stored["height_m"], stored["sigma_m"]
        heard, points, profiles = self._echoes(number)
        grid = self.mapper.grid
        rows = _widened(window.rows, self._border, grid.rows)
        columns = _widened(window.columns, self._border, grid.columns)
        mapper = replace(self.mapper, grid=grid.cut(rows, columns))
        estimate = mapper.map(points, profiles, lambda index: heard.pose.rows(np.searchsorted(heard.pulse, index)))
        own = (
            slice(window.rows.start - rows.start, window.rows.stop - rows.start),
            slice(window.columns.start - columns.start, window.columns.stop - columns.start),
        )
        height_m = estimate.dem.height_m[own]
        sigma_m = np.full(height_m.shape, np.nan) if estimate.sigma is None else estimate.sigma.height_m[own]
        window.stale, window.mapped = False, True
        if number in self._held:
            window.height_m, window.sigma_m = height_m, sigma_m
        else:
            self._store_heights(number, height_m, sigma_m)
        return height_m, sigma_m

    def _echoes(self, number: int) -> tuple[Heard, Points, Profiles | None]:
        """Return all echoes near a window, those on disk first."""
        window = self._windows[number]
        stored = [columns_of(self._path(number, f"echoes_{k}.npz").read_bytes()) for k in range(window.stored)]
        heard = [
            *(table_of(Heard, "heard", each, pose=table_of(Pose, "heard.pose", each)) for each in stored),
            *window.heard,
        ]
        points = [*(table_of(Points, "points", each) for each in stored), *window.points]
        profiles = [*filter(None, (profiles_of(each) for each in stored)), *window.profiles]
        joined = Profiles.concatenate(profiles) if profiles else None
        return Heard.concatenate(heard), Points.concatenate(points), joined

    def _close(self, number: int) -> None:
        """Write a window's echoes and heights to disk, and release its memory."""
        window = self._windows[number]
        content = packed(
            heard=Heard.concatenate(window.heard),
            points=Points.concatenate(window.points),
            profiles=Profiles.concatenate(window.profiles) if window.profiles else None,
        )
        self._path(number, f"echoes_{window.stored}.npz").write_bytes(content)
        window.stored += 1
        window.heard, window.points, window.profiles = [], [], []
        if window.height_m is not None and window.sigma_m is not None:
            self._store_heights(number, window.height_m, window.sigma_m)
            window.height_m = window.sigma_m = None
        del self._held[number]

    def _store_heights(
        self, number: int, height_m: Float[np.ndarray, "row column"], sigma_m: Float[np.ndarray, "row column"]
    ) -> None:
        """Write the heights of a window: exactly, and as a GeoTIFF for other programs."""
        window = self._windows[number]
        self._path(number, "heights.npz").write_bytes(packed(height_m=height_m, sigma_m=sigma_m))
        grid = self.mapper.grid.cut(window.rows, window.columns)
        picture = self._path(number, "dem.tif")
        picture.unlink(missing_ok=True)
        Raster(grid=grid, height_m=height_m).to_geotiff(picture)

    def _path(self, number: int, name: str) -> Path:
        return self._folder / f"window_{number:04d}_{name}"


def _widened(side: slice, border: int, most: int) -> slice:
    return slice(max(side.start - border, 0), min(side.stop + border, most))


def _sides(cells: int, most: float) -> list[tuple[int, int]]:
    return equal_chunks(cells, int(np.ceil(cells / max(most, 1.0))))


def _reach(centre_m: Float[np.ndarray, " cell"], cells: tuple[int, int], margin_m: float) -> tuple[float, float]:
    """Return the bounds of a window's echoes along an axis, m; infinite at the edge of the map."""
    low, end = cells
    return (
        -np.inf if low == 0 else float(centre_m[low]) - margin_m,
        np.inf if end == len(centre_m) else float(centre_m[end - 1]) + margin_m,
    )


def _around(one: tuple[slice, slice] | None, other: tuple[slice, slice]) -> tuple[slice, slice]:
    if one is None:
        return other
    rows, columns = (slice(min(a.start, b.start), max(a.stop, b.stop)) for a, b in zip(one, other, strict=True))
    return rows, columns
