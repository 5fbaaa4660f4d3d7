"""Polar images of a turning beam, their places on the ground, and the netCDF file that holds them.

The chirp of the azimuth number a of a turn leaves at its own time t_a, from its own place p(t_a), toward its own
bearing b(t_a). With the beam over the horizon the echo of the horizontal distance d along the bearing is read at

    r = d + f0 v_r / (B f_m),   v_r = -v . (sin b, cos b)

on an up-sweep of the bandwidth B, f_m sweeps a second (Rouveure et al. 2017, eq. 2). A picture that takes all chirps
of a turn for simultaneous errs at the ends of the turn by v T / 2 along the way, and everywhere by the Doppler shift.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.io import netcdf_file
from scipy.ndimage import map_coordinates

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.foundation.netcdf_file import write_variable
from sionna_radar.foundation.raster import Georeference, Grid, box_around
from sionna_radar.radar.chirp import Chirp

FORMAT = "sionna_radar panorama 1"
IMAGES = "panorama.nc"
REMEDY = f"give the {IMAGES} of `sionna-radar panorama`"
SWEEP = ("carrier_hz", "bandwidth_hz", "rate_hz", "samples", "sweep", "sampling", "gate_s")
MAX_BYTES = 64_000_000_000
# Of the search for the chirp that looks at a place from where the vehicle is at its time, and when it ends; each gains
# a factor of the vehicle's speed over that of the beam at the place: 0.03 at 30 km/h, 60 rpm and 40 m, 0.3 at 4 m.
ITERATIONS, SETTLED_CHIRPS = 12, 0.1
# Most pixels of a picture on the ground, some 3 GB while it is laid.
MAX_PIXELS = 25_000_000


@dataclass(frozen=True, kw_only=True)
class Way:
    """Place, velocity and bearing of the beam of every chirp, as they were or as somebody estimates them.

    position_m, velocity_mps: east, north and up. bearing_rad: of the beam, clockwise from north, unwrapped in a turn.
    """

    position_m: Float[np.ndarray, "turn azimuth 3"]
    velocity_mps: Float[np.ndarray, "turn azimuth 3"]
    bearing_rad: Float[np.ndarray, "turn azimuth"]

    @staticmethod
    def of(pose: Pose, shape: tuple[int, int]) -> "Way":
        """Return the way of chirps in turns of equal length."""
        east, north, _ = pose.boresight.T
        return Way(
            position_m=pose.position_m.reshape(*shape, 3),
            velocity_mps=pose.velocity_mps.reshape(*shape, 3),
            bearing_rad=np.unwrap(np.arctan2(east, north).reshape(shape), axis=1),
        )


@dataclass(frozen=True, kw_only=True)
class PolarImages:
    """Images of successive turns: power against azimuth and range.

    power_w: received power in each cell; of a beat of power P the peak is P.
    range_m: of the cells, as read for a stationary scatterer.
    time_s: middle of each chirp; scan_rad: angle of the antenna in its mount, clockwise from the nose.
    true: None for a recording without; measured: by the navigation system; None without one.
    chirp, beamwidths_rad: of the radar; azimuth and elevation, half-power, one way.
    """

    chirp: Chirp
    beamwidths_rad: tuple[float, float]
    power_w: Float[np.ndarray, "turn azimuth cell"]
    range_m: Float[np.ndarray, " cell"]
    time_s: Float[np.ndarray, "turn azimuth"]
    scan_rad: Float[np.ndarray, "turn azimuth"]
    true: Way | None
    measured: Way | None
    georeference: Georeference | None = None

    def __len__(self) -> int:
        return len(self.power_w)

    @cached_property
    def turn_s(self) -> float:
        """Time of a turn."""
        count = self.time_s.shape[1]
        return float(np.median(np.ptp(self.time_s, axis=1))) * count / max(count - 1, 1)

    def on_grid(self, turn: int, grid: Grid, way: Way, *, as_one: bool = False) -> Float[np.ndarray, "row column"]:
        """Return the power of a turn in the cells of a grid on the ground, NaN where no chirp of it looked.

        way: of all turns. as_one: takes the turn for simultaneous, in the middle of it, and at rest.
        """
        position, velocity, bearing = way.position_m[turn], way.velocity_mps[turn], way.bearing_rad[turn]
        if as_one:
            middle = len(bearing) // 2
            bearing = np.unwrap(bearing[middle] + self.scan_rad[turn] - self.scan_rad[turn, middle])
            position, velocity = np.broadcast_to(position[middle], position.shape), np.zeros_like(velocity)
        place, number = grid.centres_m, np.arange(len(bearing), dtype=float)
        # The last chirp stands for the step beyond it: the next one is sent from elsewhere.
        step = (bearing[-1] - bearing[0]) / (len(bearing) - 1)
        closed, steps_of = np.append(bearing, bearing[-1] + step), np.append(number, float(len(bearing)))
        order = slice(None) if step > 0 else slice(None, None, -1)
        azimuth, moving = np.full(len(place), len(bearing) / 2), np.arange(len(place))
        for _ in range(ITERATIONS):
            away = place[moving] - _along(azimuth[moving], position)
            wanted = np.arctan2(away[:, 0], away[:, 1])
            wanted = bearing[0] + np.mod((wanted - bearing[0]) * np.sign(step), 2 * np.pi) * np.sign(step)
            found = np.interp(wanted, closed[order], steps_of[order])
            left = np.abs(found - azimuth[moving]) > SETTLED_CHIRPS
            azimuth[moving] = found
            moving = moving[left]
        away = place - _along(azimuth, position)
        distance = np.hypot(*away.T)
        rate = -np.sum(_along(azimuth, velocity) * away, axis=1) / np.maximum(distance, 1e-9)
        read = distance + self.chirp.doppler_range_m(rate)
        cell = (read - self.range_m[0]) / (self.range_m[1] - self.range_m[0])
        rows = np.concatenate([self.power_w[turn], self.power_w[turn, -1:]])
        power = map_coordinates(rows, [azimuth, cell], order=1, mode="constant", cval=np.nan)
        # No chirp of this turn looked there.
        off = np.arctan2(away[:, 0], away[:, 1]) - np.interp(azimuth, steps_of, closed)
        power[np.abs(np.mod(off + np.pi, 2 * np.pi) - np.pi) > np.abs(step) / 2] = np.nan
        return power.reshape(grid.shape)

    def mosaic(self, grid: Grid, way: Way, reach_m: float) -> Float[np.ndarray, "row column"]:
        """Return the mean power of all turns that looked at each cell within a reach, NaN where none did.

        Echoes fall with the fourth power of the range: power is multiplied by (distance / reach)^4, so that a place is
        as bright from everywhere.
        """
        total, count = np.zeros(grid.shape), np.zeros(grid.shape)
        for turn in range(len(self)):
            x, y, _ = way.position_m[turn, self.time_s.shape[1] // 2]
            columns = _within(grid.x_m, x, reach_m)
            rows = _within(grid.y_m, y, reach_m)
            if columns.start == columns.stop or rows.start == rows.stop:
                continue
            part = grid.cut(rows, columns)
            distance = np.hypot(part.x_m[None, :] - x, part.y_m[:, None] - y)
            power = self.on_grid(turn, part, way) * (distance / reach_m) ** 4
            seen = np.isfinite(power) & (distance <= reach_m) & (distance >= self.range_m[0])
            total[rows, columns][seen] += power[seen]
            count[rows, columns][seen] += 1
        with np.errstate(invalid="ignore"):
            return total / np.where(count > 0, count, np.nan)

    def grid(self, way: Way, spacing_m: float, reach_m: float, turn: int | None = None) -> Grid:
        """Return the grid around the whole way, or around one turn; ScenarioError for more than `MAX_PIXELS`."""
        position = way.position_m[:, self.time_s.shape[1] // 2, :2] if turn is None else way.position_m[turn, :, :2]
        width, height = (np.ptp(position, axis=0) + 2 * reach_m) / spacing_m
        if width * height > MAX_PIXELS:
            message = f"{spacing_m:g} m makes {width:,.0f} x {height:,.0f} pixels along this way, more than"
            raise ScenarioError.of("spacing_m", f"{message} {MAX_PIXELS:,}; raise it, or drive a shorter way", "map")
        grid = Grid.covering(*box_around(position, reach_m), spacing_m)
        return replace(grid, georeference=self.georeference)

    def write(self, path: Path) -> None:
        """Write the images as netCDF; `read_images` reads them again."""
        with netcdf_file(path, "w", version=2) as file:
            file.Conventions, file.title, file.source = "CF-1.8", "Panoramic radar images", "sionna-radar"
            file.format = FORMAT
            for name in SWEEP:
                value = getattr(self.chirp, name)
                # A bare float would be stored in single precision.
                setattr(file, f"chirp_{name}", np.float64(value) if isinstance(value, float) else value)
            file.beamwidths_rad = np.array(self.beamwidths_rad)
            if self.georeference:
                file.crs_wkt = self.georeference.crs_wkt.encode()
                file.origin_m = np.array(self.georeference.origin_m)
            turns, azimuths, cells = self.power_w.shape
            for name, size in (("turn", turns), ("azimuth", azimuths), ("cell", cells), ("axis", 3)):
                file.createDimension(name, size)
            write_variable(file, "range", self.range_m, ("cell",), "m", "range of a stationary scatterer")
            write_variable(file, "time", self.time_s, ("turn", "azimuth"), "s", "middle of the chirp")
            write_variable(file, "scan", self.scan_rad, ("turn", "azimuth"), "rad", "antenna, clockwise from the nose")
            write_variable(file, "power", self.power_w, ("turn", "azimuth", "cell"), "W", "received power")
            for kind, way in (("true", self.true), ("measured", self.measured)):
                if way is not None:
                    chirp = ("turn", "azimuth")
                    write_variable(file, f"{kind}_position", way.position_m, (*chirp, "axis"), "m", "east, north, up")
                    write_variable(
                        file, f"{kind}_velocity", way.velocity_mps, (*chirp, "axis"), "m s-1", "east, north, up"
                    )
                    write_variable(file, f"{kind}_bearing", way.bearing_rad, chirp, "rad", "beam, clockwise from north")


def read_images(path: Path) -> PolarImages:
    """Return the images of a file that `PolarImages.write` wrote.

    Raises InputFileError for a file of another kind, cut short, or with gaps that its turns do not explain.
    """
    regular_file(path, "recording", REMEDY, MAX_BYTES)
    try:
        with netcdf_file(path, "r", mmap=False) as file:
            if getattr(file, "format", b"").decode() != FORMAT:
                raise ValueError("they are of another kind")
            values = {
                name: np.array(variable[:], dtype=variable.data.dtype.newbyteorder("="))
                for name, variable in file.variables.items()
            }
            chirp = Chirp(**{name: _native(getattr(file, f"chirp_{name}")) for name in SWEEP})
            azimuth_rad, elevation_rad = (float(width) for width in file.beamwidths_rad)
            place = None
            if hasattr(file, "crs_wkt"):
                x, y, z = (float(value) for value in file.origin_m)
                place = Georeference(crs_wkt=file.crs_wkt.decode(), origin_m=(x, y, z))
    except (OSError, ValueError, TypeError, IndexError, AttributeError, KeyError) as error:
        raise InputFileError(f"{shown(path)}: not readable as panoramic images ({error}); {REMEDY}") from error
    images = PolarImages(
        chirp=chirp,
        beamwidths_rad=(azimuth_rad, elevation_rad),
        power_w=values["power"],
        range_m=values["range"],
        time_s=values["time"],
        scan_rad=values["scan"],
        true=_way(values, "true"),
        measured=_way(values, "measured"),
        georeference=place,
    )
    if not np.all(np.isfinite(images.power_w)) or not np.all(np.diff(images.time_s.ravel()) > 0):
        raise InputFileError(f"{shown(path)}: powers are not finite, or times do not increase; {REMEDY}")
    return images


def _way(values: dict[str, np.ndarray], kind: str) -> Way | None:
    if f"{kind}_position" not in values:
        return None
    return Way(
        position_m=values[f"{kind}_position"],
        velocity_mps=values[f"{kind}_velocity"],
        bearing_rad=values[f"{kind}_bearing"],
    )


def _native(value: Any) -> Any:
    return value.decode() if isinstance(value, bytes) else value.item() if isinstance(value, np.generic) else value


def _along(azimuth: Float[np.ndarray, " n"], column: Float[np.ndarray, "azimuth 3"]) -> Float[np.ndarray, "n 2"]:
    """Return east and north of a turn's places or velocities between its chirps."""
    return np.column_stack([np.interp(azimuth, np.arange(len(column)), column[:, i]) for i in range(2)])


def _within(places_m: Float[np.ndarray, " n"], middle_m: float, reach_m: float) -> slice:
    return slice(*np.searchsorted(places_m, [middle_m - reach_m, middle_m + reach_m]).tolist())
