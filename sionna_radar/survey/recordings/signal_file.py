"""Reading recorded beat signals: those of a simulated survey, and those of a real radar in the same layout.

The file is netCDF-4. What it must have, and what it may:

- `beat_i` (pulse, sample), (pulse, sweep, sample) for an up- and a down-sweep in each pulse, or (pulse, chirp,
  receiver, sample) for the frames of an array: samples of the beat signal, of any number type; `scale_factor` and
  `add_offset` apply. `beat_q` beside it for I/Q samples. Instead of both, attributes of `radar` name a raw `capture` in
  the same folder, and the `count` of one of its numbers.
- `radar`, a variable whose attributes (or else those of the file) are `carrier_hz`, `bandwidth_hz`,
  `sampling_rate_hz`, and where they differ from the usual `sweep` and `propagation_mps`: see `RecordedRadar`.
- `time` (pulse), s; without it chirps are numbered.
- `measured_position`, `measured_velocity` (pulse, 3) and `measured_rotation` (pulse, 3, 3), without which there are
  ranges, but no points and no DEM. The columns of the rotation are the boresight, left and up of the antenna.
- `crs`, a grid mapping with `crs_wkt` and `local_origin_m` (easting, northing, height): local metres plus these are map
  coordinates.
- `scenario`, `survey`, `true_height`, `lit`, `beside_wall`: of a simulated survey; see `SignalRecorder`.
"""

import json
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Inexact, Int
from pydantic import ValidationError
from pyproj import CRS
from pyproj.exceptions import CRSError

from sionna_radar.flight.pulses import Pose, Pulses, PulseSequence
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import regular_file, shown
from sionna_radar.foundation.raster import Georeference, Grid, MapCells, Raster
from sionna_radar.mapping.mapper import MAX_DEM_CELLS, Extent
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario.problems import translate
from sionna_radar.scenario.readers import CAPTURED_FRAMES
from sionna_radar.scenario.recorded import RecordedRadar
from sionna_radar.survey.recordings.netcdf import NetcdfInput, open_netcdf

MAX_PULSES, MIN_SAMPLES, MAX_SAMPLES = 10_000_000, 32, 2**18
REMEDY = "give a recording of beat signals, as `run --record signals` makes it, or the TOML description of another"
POSE = {"measured_position": (3,), "measured_velocity": (3,), "measured_rotation": (3, 3)}
# The square of a greater sample, summed over a sweep, might have no floating-point number.
GREATEST = 1e15
FARTHEST_M, FASTEST_MPS = 1e6, 1e4
LAYOUT = 1
CAPTURE_SUFFIX, MAX_CAPTURE_BYTES = ".bin", 64_000_000_000
UNITS = {"measured_position": "m", "measured_velocity": "m s-1", "time": "s"}
# Share of pulses that look down, and of the way that positions and velocities agree on, at least; pulses looked at.
MOSTLY, MOTION_PULSES = 0.8, 2000
# How far a rotation matrix may be from orthonormal.
ROUNDING = 1e-6


@dataclass(frozen=True, kw_only=True)
class RecordedFlight:
    """Figures of a simulated flight that maps need.

    ground_extent_m: west, south, east and north of the ground that the beam's axis meets.
    altitude_m: nominal height over it.
    beam_spacing_m: widest distance between neighbouring beams on level ground.
    """

    ground_extent_m: Extent
    altitude_m: float
    beam_spacing_m: float


@dataclass(frozen=True, kw_only=True)
class RecordedTruth:
    """The true surface on the grid of a simulated survey's DEM.

    lit: cells that its beam reached; beside_wall: those within half a footprint of a wall; None where there are none.
    """

    surface: Raster
    lit: Bool[np.ndarray, "row column"]
    beside_wall: Bool[np.ndarray, "row column"] | None


def is_capture(path: Path) -> bool:
    """Return True if a recording is named as a raw capture."""
    return path.suffix.lower() == CAPTURE_SUFFIX


def files_of(kind: str, path: Path) -> list[Path]:
    """Return the files of a recording: of a raw capture also its configuration, and all but its samples in netCDF."""
    return [path, *(path.with_suffix(end) for end in (".cfg", ".nc") if kind == "cube" and is_capture(path))]


@contextmanager
def open_signals(path: Path) -> Iterator["SignalFile"]:
    """Open a recording of beat signals; InputFileError, then or while it is read, for a file that is none."""
    if is_capture(path):
        regular_file(path, "recording", REMEDY, MAX_CAPTURE_BYTES)
        if not path.with_suffix(".nc").exists():
            message = f"recording {shown(path)} is a raw capture, and needs a description of its radar; write one with"
            raise InputFileError(f"{message} `sionna-radar process {shown(path)} --describe profile.cfg`")
        path = path.with_suffix(".nc")
    with open_netcdf(path, "recording", REMEDY) as file:
        yield SignalFile(file, path.parent)


class SignalFile:
    """An open recording of beat signals."""

    def __init__(self, file: NetcdfInput, folder: Path) -> None:
        self._file, self._beat, self._capture = file, [], None
        if "capture" in (kept := file.attributes_of("radar")):
            place = folder / Path(str(kept["capture"])).name
            regular_file(place, "radar:capture =", REMEDY, MAX_CAPTURE_BYTES)
            (count,), capture = self._vector(kept, "count", 1), CAPTURED_FRAMES(place)
            if capture.leftover_bytes:
                file.fail(f"its capture {shown(place)} ends within a frame; get the whole file")
            self._capture, self._iq = (capture, count), capture.config.complex_samples
            self._shape: tuple[int, ...] = capture.shape
            self._check_kind()
        else:
            self._beat = [file.variable(name) for name in ("beat_i", "beat_q") if name == "beat_i" or name in file]
            self._check_kind()
            self._shape, self._iq = self._beat[0].shape, len(self._beat) == 2
        shape, kinds = self._shape, {beat.dtype.kind for beat in self._beat}
        if len(shape) not in (2, 3, 4) or not kinds <= set("fiu"):
            file.fail(f"beat_i is {self._beat[0].dtype} of the shape {shape}; it is to hold numbers, (pulse, sample)")
        if any(beat.shape != shape for beat in self._beat):
            file.fail("beat_q has another shape than beat_i; both are (pulse, sample)")
        self.radar = self._radar()
        pair = self.radar.sweep == "triangular"
        if (len(shape), *shape[1:-1]) != ((3, 2) if pair else (2,)) and (pair or len(shape) != 4):
            file.fail(f"beat_i has the shape {shape}, which is not that of radar:sweep = {self.radar.sweep!r}")
        if not (0 < shape[0] <= MAX_PULSES):
            file.fail(f"beat_i has {shape[0]:,} pulses; 1 to {MAX_PULSES:,} can be processed")
        if not (MIN_SAMPLES <= shape[-1] <= MAX_SAMPLES):
            file.fail(f"beat_i has {shape[-1]:,} samples a sweep; {MIN_SAMPLES} to {MAX_SAMPLES:,} can be used")

    def __len__(self) -> int:
        return int(self._shape[0])

    @cached_property
    def sweeps(self) -> tuple[Chirp, ...]:
        """The sweeps of one pulse."""
        return sweeps_of(self.radar, int(self._shape[-1]), self._iq)

    @cached_property
    def scenario(self) -> str | None:
        """The scenario of a simulated survey, TOML; None for a recording of a real radar."""
        return self._file.text("scenario") if "scenario" in self._file else None

    @cached_property
    def replaced(self) -> dict[str, str]:
        """Custom parts of the flight, by the keys of the scenario that they replaced."""
        try:
            found = json.loads(str(self._file.attributes.get("replaced", "{}")))
        except ValueError:
            found = None
        if not isinstance(found, dict):
            self._file.fail("the attribute replaced is not a JSON table; record it again")
        return {str(key): str(what) for key, what in found.items()}

    @cached_property
    def pulses(self) -> "RecordedPulses":
        """The pulses."""
        given = [name for name in POSE if name in self._file]
        missing = ", ".join(name for name in POSE if name not in given)
        if given and missing:
            self._file.fail(f"has {given[0]} and lacks {missing}; poses need all of them")
        number, beam = (self._column(name) for name in ("scan_number", "beam"))
        time_s, scan_rad = self._column("time"), self._column("scan_angle")
        if time_s is not None and not (np.diff(time_s) > 0).all():
            later = int(np.argmin(np.diff(time_s) > 0)) + 1
            self._file.fail(f"time of pulse {later} is not after that of the one before; sort the pulses by time")
        return RecordedPulses(
            poses=self.pose if given else None,
            time_s=np.arange(len(self), dtype=np.float64) if time_s is None else time_s,
            scan_rad=np.zeros(len(self)) if scan_rad is None else scan_rad,
            scan_number=None if number is None else number.astype(np.int64),
            beam=None if beam is None else beam.astype(np.int64),
        )

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What its user should know of the poses of a real radar: whether they contradict themselves or look up."""
        if self.scenario is not None or not self.pulses.located:
            return ()
        some = np.unique(np.linspace(0, len(self) - 1, MOTION_PULSES).astype(np.int64))
        pose, warnings = self.pose(some), []
        up = float(np.mean(pose.boresight[:, 2] >= 0))
        if up > MOSTLY:
            reason = "the first column of measured_rotation is the boresight: east, north, up"
            warnings.append(f"the beam looks to the horizon or above it in {up:.0%} of the pulses; {reason}")
        told_m = np.trapezoid(pose.velocity_mps, self.pulses.time_s[some], axis=0)
        moved_m = pose.position_m[-1] - pose.position_m[0]
        contradicted_m = np.linalg.norm(told_m - moved_m)
        if "time" in self._file and contradicted_m > (1 - MOSTLY) * max(map(np.linalg.norm, (told_m, moved_m))):
            ways = (" ".join(f"{metres:+.1f}" for metres in way) for way in (moved_m, told_m))
            reason = "positions move {} m (east, north, up), and velocities {} m".format(*ways)
            warnings.append(f"{reason}; look at signs, axes and units of measured_position, measured_velocity and time")
        return tuple(warnings)

    @cached_property
    def flight(self) -> RecordedFlight | None:
        """Figures of a simulated flight that maps need; None for a recording without poses, or of a real radar."""
        kept = self._file.attributes_of("survey")
        if not kept or not self.pulses.located:
            return None
        west, south, east, north = self._vector(kept, "ground_extent_m", 4)
        (altitude_m,), (beam_spacing_m,) = (self._vector(kept, name, 1) for name in ("altitude_m", "beam_spacing_m"))
        if west > east or south > north or altitude_m <= 0 or beam_spacing_m <= 0:
            self._file.fail("the attributes of survey describe no flight; record it again")
        return RecordedFlight(
            ground_extent_m=(west, south, east, north), altitude_m=altitude_m, beam_spacing_m=beam_spacing_m
        )

    @cached_property
    def georeference(self) -> Georeference | None:
        """The place of local metres on the map; None without one."""
        kept = self._file.attributes_of("crs")
        if not kept:
            return None
        # CF tools take heights by the CRS that they find; local ones count from the local origin.
        wkt = str(kept.get("local_frame_wkt", kept.get("crs_wkt")))
        try:
            CRS.from_wkt(wkt)
        except CRSError:
            self._file.fail("crs:crs_wkt is missing or no WKT; give one, or leave crs out")
        east, north, height = self._vector(kept, "local_origin_m", 3)
        cells = None
        if "cell_corner_m" in kept and "cell_size_m" in kept:
            corner, size = self._vector(kept, "cell_corner_m", 2), self._vector(kept, "cell_size_m", 2)
            cells = MapCells(corner_m=(corner[0], corner[1]), size_m=(size[0], size[1]))
        return Georeference(crs_wkt=wkt, origin_m=(east, north, height), cells=cells)

    @cached_property
    def truth(self) -> "RecordedTruth | None":
        """The true surface; None for a recording of a real radar."""
        if not all(name in self._file for name in ("true_height", "lit")):
            return None
        shape = self._file.variable("true_height").shape
        if len(shape) != 2 or math.prod(shape) > MAX_DEM_CELLS:
            self._file.fail(f"true_height has the shape {shape}; it is (y, x), of at most {MAX_DEM_CELLS:,} cells")
        kept, names = self._file.attributes_of("true_height"), ("local_west_m", "local_south_m", "spacing_m")
        west_m, south_m, spacing_m = (self._vector(kept, name, 1)[0] for name in names)
        grid = Grid(
            west_m=west_m,
            south_m=south_m,
            spacing_m=spacing_m,
            columns=shape[1],
            rows=shape[0],
            georeference=self.georeference,
        )
        return RecordedTruth(
            surface=Raster(grid=grid, height_m=np.asarray(self._file.variable("true_height")[...], dtype=np.float64)),
            lit=self._file.numbers("lit", shape) > 0,
            beside_wall=self._file.numbers("beside_wall", shape) > 0 if "beside_wall" in self._file else None,
        )

    @property
    def channels(self) -> tuple[int, ...]:
        """Chirps of a frame and receivers of an array; none for a single one."""
        return self._shape[1:3] if len(self._shape) == 4 else ()

    def beats(self, pulses: Pulses) -> list[Inexact[np.ndarray, "pulse *channel sample"]]:
        """Return the beat signals of sweeps, or of chirps and receivers of an array; InputFileError for no numbers."""
        if self._capture is not None:
            capture, count = self._capture
            return [capture.samples(pulses.index) * count]
        parts = [self._file.unpacked(beat, self._file.rows(beat, pulses.index)) for beat in self._beat]
        beat = parts[0] + 1j * parts[1] if len(parts) == 2 else parts[0]
        # False for samples that are no numbers, too.
        sound = (np.abs(beat) < GREATEST).all(axis=tuple(range(1, beat.ndim)))
        if not sound.all():
            wrong = pulses.index[int(np.argmin(sound))]
            self._file.fail(f"the samples of pulse {wrong} are no finite numbers below {GREATEST:g}; leave it out")
        return [beat] if beat.ndim != 3 else [np.ascontiguousarray(beat[:, n]) for n in range(beat.shape[1])]

    def pose(self, index: Int[np.ndarray, " pulse"]) -> Pose:
        """Return the measured poses of pulses."""
        position_m, velocity_mps, rotation = (
            self._file.finite(self._file.rows(self._file.variable(name, (len(self), *shape)), index), name)
            for name, shape in POSE.items()
        )
        for name, values, most, unit in (
            ("measured_position", position_m, FARTHEST_M, "m from the local origin; put that into crs:local_origin_m"),
            ("measured_velocity", velocity_mps, FASTEST_MPS, "m/s"),
        ):
            far = np.abs(values).max(axis=1) > most
            if far.any():
                self._file.fail(f"{name} of pulse {index[int(np.argmax(far))]} is more than {most:g} {unit}")
        turned = bool((np.abs(rotation) <= 1 + ROUNDING).all())
        if not turned or np.abs(rotation @ rotation.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) > ROUNDING:
            self._file.fail("measured_rotation holds matrices that are no rotations; give orthonormal ones")
        return Pose(position_m=position_m, velocity_mps=velocity_mps, R_world_antenna=rotation)

    def _check_kind(self) -> None:
        """Refuse another kind of recording, and a layout that is not known yet."""
        kept = self._file.attributes
        if kept.get("recording", "signals") not in ("signals", "cube"):
            self._file.fail(f"holds {kept['recording']}, not beat signals; {REMEDY}")
        if kept.get("layout", LAYOUT) != LAYOUT:
            self._file.fail(f"has the layout {kept['layout']!r}, and this version reads {LAYOUT}; take the newer one")
        for name, unit in UNITS.items():
            self._file.check_unit(name, unit)

    def _radar(self) -> RecordedRadar:
        given = {**self._file.attributes, **self._file.attributes_of("radar")}
        known = {key: given[key] for key in RecordedRadar.model_fields if key in given}
        whole = {key: float(value) for key, value in known.items() if isinstance(value, int)}
        try:
            return RecordedRadar.model_validate(known | whole)
        except ValidationError as error:
            self._file.fail("; ".join(f"radar:{problem}" for problem in translate(error.errors(), RecordedRadar)))

    def _column(self, name: str) -> Float[np.ndarray, " pulse"] | None:
        """Return a column of the pulses; None if there is none."""
        return self._file.numbers(name, (len(self),)) if name in self._file else None

    def _vector(self, attributes: Any, name: str, length: int) -> list[float]:
        try:
            values = [float(value) for value in np.ravel(attributes.get(name))]
        except (TypeError, ValueError):
            values = []
        if len(values) != length or not all(map(math.isfinite, values)):
            self._file.fail(f"the attribute {name} is not {length} finite numbers; record it again")
        return values


def sweeps_of(radar: RecordedRadar, samples: int, iq: bool) -> tuple[Chirp, ...]:
    """Return the sweeps of one pulse of a recorded radar."""
    directions: tuple[Literal["up", "down"], ...]
    directions = ("up", "down") if radar.sweep == "triangular" else (radar.sweep,)
    pair = len(directions) == 2
    return tuple(
        Chirp(
            carrier_hz=radar.carrier_hz,
            bandwidth_hz=radar.bandwidth_hz,
            rate_hz=radar.sampling_rate_hz / samples,
            samples=samples,
            sweep=direction,
            sampling="iq" if iq else "real",
            centre_s=(number - 0.5) * samples / radar.sampling_rate_hz if pair else 0.0,
            propagation_mps=radar.propagation_mps,
            gate_s=1e-6 * radar.gate_delay_us,
        )
        for number, direction in enumerate(directions)
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordedPulses(PulseSequence):
    """The pulses of a recording; processing knows only what was measured, so true poses are left in the file.

    poses: returns the measured poses of pulses; None if they are not known. time_s: of each chirp.
    scan_number, beam, scan_rad: see `Pulses`.
    """

    poses: Callable[[Int[np.ndarray, " pulse"]], Pose] | None
    time_s: Float[np.ndarray, " pulse"]
    scan_rad: Float[np.ndarray, " pulse"]
    scan_number: Int[np.ndarray, " pulse"] | None
    beam: Int[np.ndarray, " pulse"] | None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def located(self) -> bool:
        """Whether the poses are known."""
        return self.poses is not None

    @property
    def scan_numbers(self) -> Int[np.ndarray, " pulse"] | None:
        """Scan of the antenna that each pulse belongs to; None for a continuous scan."""
        return self.scan_number

    def pulses(self, index: Int[np.ndarray, " pulse"]) -> Pulses:
        """Return some of the pulses; poses that are not known are NaN."""
        pose = self.poses(index) if self.poses else _unknown(len(index))
        return Pulses(
            index=index,
            time_s=self.time_s[index],
            scan_rad=self.scan_rad[index],
            true=pose,
            measured=pose,
            scan_number=None if self.scan_number is None else self.scan_number[index],
            beam=None if self.beam is None else self.beam[index],
        )


def _unknown(count: int) -> Pose:
    nowhere = np.full((count, 3), np.nan)
    return Pose(position_m=nowhere, velocity_mps=nowhere, R_world_antenna=np.full((count, 3, 3), np.nan))
