"""Recorders of a survey in flight, by kind: beat signals, the range profiles around its echoes, and its traced paths.

The layout of signals is that of recordings of real radars, too: see `SignalFile`. Every recording holds of its survey
the pulses with their poses, the scenario and the place on the map. It appears whole or not at all: it grows in a
staging folder beside its place, and is moved there at the end.
"""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool
from pyproj import CRS

from sionna_radar.accuracy.truth import Comparison
from sionna_radar.execution.staging import abandoned, staged
from sionna_radar.execution.workers import versions
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.errors import OutputError, PluginError, ScenarioError
from sionna_radar.foundation.raster import Georeference, Raster
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario import to_toml
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.scenario.readers import CAPTURE_WRITER
from sionna_radar.survey.observation import Recorder, SampleType
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.recordings.netcdf import NetcdfFile, check_room
from sionna_radar.survey.recordings.signal_file import LAYOUT, files_of, is_capture
from sionna_radar.survey.sensors.sensor import Observation
from sionna_radar.tracing.paths import BOUNCED, FIRST_OBSTACLE, VOLUME

POSES = ("true", "measured")


def new_recording(path: Path, prepared: Prepared, kind: str, title: str) -> NetcdfFile:
    """Return a new recording of a survey, with columns of its pulses that `write_pulses` fills."""
    scenario = prepared.scenario
    file = NetcdfFile(
        path,
        {
            "title": title,
            "source": f"sionna-radar {versions()['sionna-radar']}",
            # Undated, so that the same survey gives the same file.
            "history": "recorded while the survey was flown",
            "comment": scenario.description or "no description",
            "recording": kind,
            "layout": LAYOUT,
            "seed": scenario.seed,
            "replaced": json.dumps(prepared.custom.described()),
            "versions": json.dumps(versions()),
        },
    )
    file.text("scenario", to_toml(scenario), "scenario with all values resolved, TOML")
    _add_place(file, prepared.world.scene.georeference)
    _add_pulses(file, prepared)
    return file


def write_pulses(file: NetcdfFile, pulses: Pulses) -> None:
    """Fill in the columns of a block of pulses."""
    for name, values, *_ in _columns(pulses):
        file.write(name, int(pulses.index[0]), values)


def _columns(pulses: Pulses) -> Iterator[tuple[str, np.ndarray, tuple[str, ...], str, str | None]]:
    """Yield the columns of pulses: name, values, axes of each value, meaning and unit."""
    yield "time", pulses.time_s, (), "time of the middle of the chirp since the start of the flight", "s"
    yield "scan_angle", pulses.scan_rad, (), "scan angle of the antenna, zero in the middle of its sector", "rad"
    if pulses.scan_number is not None:
        yield "scan_number", pulses.scan_number, (), "scan of the antenna that the pulse belongs to, from 0", None
    if pulses.beam is not None:
        yield "beam", pulses.beam, (), "beam of the electronic scan", None
    for name, whose in zip(POSES, ("true", "as the navigation system reports it"), strict=True):
        pose, way = getattr(pulses, name), "east, north, up"
        place, velocity = (f"{what} of the antenna ({whose}): {way}" for what in ("position", "velocity"))
        yield f"{name}_position", pose.position_m, ("axis",), f"{place} of the local origin", "m"
        yield f"{name}_velocity", pose.velocity_mps, ("axis",), velocity, "m s-1"
        turn = f"axes of the antenna ({whose}), in columns: boresight, left and up of the antenna, each {way}"
        yield f"{name}_rotation", pose.R_world_antenna, ("axis", "antenna_axis"), turn, "1"


def _add_pulses(file: NetcdfFile, prepared: Prepared) -> None:
    file.dimension("pulse", len(prepared))
    file.dimension("axis", 3)
    file.dimension("antenna_axis", 3)
    for name, values, axes, meaning, units in _columns(prepared.flight.pulses(np.zeros(1, dtype=np.int64))):
        kind = np.result_type(values.dtype, np.int64)  # whole numbers and real ones have 64 bits
        file.variable(name, ("pulse", *axes), dtype=kind, long_name=meaning, units=units)


def _add_column(
    file: NetcdfFile,
    dimension: str,
    name: str,
    kind: type,
    long_name: str,
    units: str | None = None,
    **attributes: Any,
) -> None:
    file.variable(name, (dimension,), dtype=np.dtype(kind), long_name=long_name, units=units, **attributes)


def _add_place(file: NetcdfFile, place: Georeference | None) -> None:
    """Add the place of the local frame on the map, as a grid mapping."""
    if place is None:
        return
    cells = place.cells
    whole = CRS.from_wkt(place.crs_wkt)
    flat = whole.sub_crs_list[0] if whole.is_compound else whole.to_2d()
    attributes = {key: value for key, value in flat.to_cf().items() if value is not None}
    file.variable(
        "crs",
        (),
        np.int32(0),
        **attributes
        | {
            "long_name": "map coordinates are local ones plus the local origin",
            "local_frame_wkt": place.crs_wkt,
            "local_origin_m": np.array(place.origin_m),
            "cell_corner_m": None if cells is None else np.array(cells.corner_m),
            "cell_size_m": None if cells is None else np.array(cells.size_m),
        },
    )


FULL_SCALE = 2**15 - 1
PACKED_AT_ONCE = 4_000_000


class SignalRecorder:
    """Writes the beat signals of each block, of an array those of all chirps and receivers, and the true heights.

    Samples of 64 bits give the same ranges, points and DEM again, bit for bit. Those of 16 bits are packed after the
    flight, when the greatest is known: until then they lie beside the recording in 32 bits. Those of a raw capture go
    into that, and all else into a netCDF file beside it.
    """

    def __init__(self, path: Path, prepared: Prepared, sample_type: SampleType = "float64") -> None:
        array = prepared.instrument.module
        chirp, self._sweeps = prepared.receiver.chirp, len(prepared.receiver.sweeps)
        self._parts = ("beat_i", "beat_q") if chirp.sampling == "iq" else ("beat_i",)
        self._capture = None
        if array is not None and is_capture(path):
            noise_w, rate_hz = prepared.receiver.noise_power_w / len(self._parts), prepared.instrument.pulse_rate_hz
            self._capture = CAPTURE_WRITER(path, noise_w, array, chirp, rate_hz, len(prepared))
            path = path.with_suffix(".nc")
        kind = "cube" if prepared.scenario.sensor == "mimo" else "signals"
        self._file = new_recording(path, prepared, kind, "beat signals of a simulated FMCW radar")
        self._prepared = prepared
        packed = sample_type == "int16" and self._capture is None
        self._loose = {name: path.with_suffix(f".{name}") for name in self._parts} if packed else {}
        self._greatest = 0.0
        self._axes = {"sweep": self._sweeps} if self._sweeps > 1 else {}
        if array is not None:
            self._axes = {"chirp": array.chirps, "receiver": len(array.receiver_m)}
        self._axes |= {"sample": chirp.samples}
        samples = len(prepared) * math.prod(self._axes.values()) * len(self._parts)
        check_room(path.parent, samples * (4 + 2 if self._loose else np.dtype(sample_type).itemsize))
        for name, size in self._axes.items():
            self._file.dimension(name, size)
        self._add_radar()
        if array is not None:
            self._add_array(array)
        if self._capture is None and not self._loose:
            self._add_samples(np.dtype(sample_type))

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and their beat signals."""
        write_pulses(self._file, pulses)
        samples = self._samples(pulses, seen)
        if self._capture is not None:
            self._capture.write(pulses.index, samples)
            return
        for name, values in zip(self._parts, (samples.real, samples.imag), strict=False):
            if self._loose:
                self._greatest = max(self._greatest, float(np.abs(values).max(initial=0.0)))
                with self._loose[name].open("ab") as loose:
                    loose.write(np.ascontiguousarray(values, dtype="<f4").tobytes())
            else:
                self._file.write(name, int(pulses.index[0]), values)

    def finish(self, comparison: Comparison) -> None:
        """Add the truth on the DEM's grid, pack the samples if they are to be, and close the file."""
        self._add_truth(comparison.truth)
        self._add_mask("lit", comparison.lit, "whether the main beam reached the cell", "unlit lit")
        if comparison.beside_wall is not None:
            meaning = "whether a wall lies within half a footprint of the cell"
            self._add_mask("beside_wall", comparison.beside_wall, meaning, "away_from_walls beside_wall")
        if self._loose:
            self._pack()
        self.close()

    def _add_mask(self, name: str, cells: Bool[np.ndarray, "row column"], meaning: str, flags: str) -> None:
        self._file.variable(
            name,
            ("y", "x"),
            cells.astype(np.int8),
            long_name=meaning,
            flag_values=np.array([0, 1], dtype=np.int8),
            flag_meanings=flags,
        )

    def _add_truth(self, truth: Raster) -> None:
        """Add the true heights over the origin; on the map their cells have its coordinates, otherwise local ones.

        Attributes keep the local grid exactly.
        """
        place, grid = self._prepared.world.scene.georeference, truth.grid
        east_m, north_m, _ = place.origin_m if place else (0.0, 0.0, 0.0)
        for name, values, way in (("x", grid.x_m + east_m, "east"), ("y", grid.y_m + north_m, "north")):
            self._file.dimension(name, len(values))
            self._file.variable(
                name,
                (name,),
                values,
                long_name=f"centre of a cell: {way}ing" if place else f"centre of a cell, {way} of the origin",
                standard_name=f"projection_{name}_coordinate" if place else None,
                units="m",
            )
        self._file.variable(
            "true_height",
            ("y", "x"),
            truth.height_m,
            long_name="true height over the height of the local origin",
            units="m",
            grid_mapping="crs" if place else None,
            local_west_m=grid.west_m,
            local_south_m=grid.south_m,
            spacing_m=grid.spacing_m,
        )

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        if self._capture is not None:
            self._capture.close()

    def _samples(self, pulses: Pulses, seen: Observation) -> np.ndarray:
        """Return the samples of a block as the file has them."""
        if seen.frames is not None:
            return seen.frames
        if seen.beats is None:
            message = f"{self._prepared.scenario.sensor!r} makes no beat signals to record; record 'paths' instead"
            raise ScenarioError.of("sensor", message)
        wanted = (len(pulses), self._prepared.receiver.chirp.samples)
        if len(seen.beats) != self._sweeps or any(np.shape(beat) != wanted for beat in seen.beats):
            raise PluginError(f"sensor: beats are to be {self._sweeps} arrays of {wanted}, one for each sweep")
        return seen.beats[0] if self._sweeps == 1 else np.stack(list(seen.beats), axis=1)

    def _add_array(self, array: MimoArray) -> None:
        for name in ("transmitter", "receiver"):
            places, text = getattr(array, f"{name}_m"), f"places of the {name}s along boresight, left and up"
            if name not in self._axes:
                self._file.dimension(name, len(places))
            self._file.variable(f"{name}_place", (name, "axis"), places, long_name=text, units="m")
        self._file.dimension("code", len(array.code))
        for part, factor in (("real", array.code.real), ("imaginary", array.code.imag)):
            text = f"{part} part of each transmitter's factor in the chirps of a block"
            self._file.variable(f"code_{part}", ("code", "transmitter"), factor.copy(), long_name=text, units="1")

    def _add_radar(self) -> None:
        prepared, file = self._prepared, self._file
        receiver, chirp = prepared.receiver, prepared.receiver.chirp
        file.variable(
            "sample_time",
            ("sample",),
            chirp.sample_time_s,
            long_name="time of the sample from the middle of its sweep",
            units="s",
        )
        flight, radar = prepared.plan.flown, prepared.local.radar
        rate_hz = prepared.instrument.mean_rate_hz
        capture, array = self._capture, prepared.instrument.module
        file.variable(
            "radar",
            (),
            np.int32(0),
            long_name="the radar, by its attributes",
            carrier_hz=chirp.carrier_hz,
            bandwidth_hz=chirp.bandwidth_hz,
            sampling_rate_hz=chirp.sampling_rate_hz,
            sweep=radar.sweep,
            gate_delay_us=radar.gate_delay_us or None,
            propagation_mps=chirp.propagation_mps,
            transmit_power_w=receiver.transmit_power_w,
            noise_power_w=receiver.noise_power_w,
            chirp_period_s=array.period_s if array else None,
            capture=capture.name if capture else None,
            count=capture.per_count if capture else None,
        )
        file.variable(
            "survey",
            (),
            np.int32(0),
            long_name="what maps need of the flight, by attributes: the ground that is mapped (west, south, east, "
            "north), the height over it, and the widest spacing of neighbouring beams on level ground",
            ground_extent_m=np.array(prepared.plan.ground_extent_m),
            altitude_m=flight.altitude_m,
            beam_spacing_m=prepared.flight.scan.spacing_m(flight.altitude_m, flight.speed_mps, rate_hz),
        )

    def _add_samples(self, kind: np.dtype, **attributes: float) -> None:
        dimensions = ("pulse", *self._axes)
        relative = self._prepared.local.radar.snr_db is not None
        for name, part in zip(self._parts, ("in-phase", "quadrature"), strict=False):
            self._file.variable(
                name,
                dimensions,
                dtype=kind,
                long_name=f"beat signal, {part} part" if len(self._parts) > 1 else "beat signal",
                units="1" if relative else "V",
                comment="its mean square is the received power"
                + (", relative to the transmitted one" if relative else " in W, as across 1 ohm"),
                coordinates="time sample_time",
                **attributes,
            )

    def _pack(self) -> None:
        """Write the loose samples as whole numbers of 16 bits, the greatest at full scale."""
        scale = (self._greatest or 1.0) / FULL_SCALE
        self._add_samples(np.dtype(np.int16), scale_factor=scale, add_offset=0.0)
        shape = tuple(self._axes.values())
        step = max(1, PACKED_AT_ONCE // math.prod(shape))
        for name, loose in self._loose.items():
            kept = np.memmap(loose, dtype="<f4", mode="r").reshape(-1, *shape)
            for start in range(0, len(kept), step):
                self._file.write(name, start, np.rint(kept[start : start + step] / scale).astype(np.int16))
            del kept
            loose.unlink()


class _Rows:
    """Writes rows of a netCDF file, of which none is known only at the end of the flight."""

    _file: NetcdfFile

    def finish(self, comparison: Comparison) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class ProfileRecorder(_Rows):
    """Writes the profiles of each block: a contiguous ragged array of CF, `row_size` values of `power` a profile."""

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "profiles", "range profiles of a simulated FMCW radar")
        self._sensor = prepared.scenario.sensor
        file.dimension("profile")
        file.dimension("value")
        power_unit = "1" if prepared.local.radar.snr_db is not None else "W"

        column = partial(_add_column, file, "profile")
        column("profile_pulse", np.int64, "pulse of the profile", "1", instance_dimension="pulse")
        column("first_cell", np.int64, "range cell of the profile's first value", "1")
        column("row_size", np.int64, "values of the profile", "1", sample_dimension="value")
        column("noise", np.float64, "power of the receiver's noise in a cell", power_unit)
        file.variable(
            "power",
            ("value",),
            dtype=np.dtype(np.float32),
            long_name="power of a range cell, calibrated: a beat of power P peaks at P; ranges with Doppler shift",
            units=power_unit,
            cell_m=prepared.receiver.chirp.range_resolution_m,
        )

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and its profiles."""
        write_pulses(self._file, pulses)
        profiles = seen.profiles
        if profiles is None:
            message = f"{self._sensor!r}, as it is set, makes no range profiles to record; record 'paths' instead"
            raise ScenarioError.of("sensor", message)
        self._file.append(
            "profile",
            {
                "profile_pulse": profiles.pulse,
                "first_cell": profiles.first,
                "row_size": np.diff(profiles.start),
                "noise": profiles.noise,
            },
        )
        self._file.append("value", {"power": profiles.power})


class PathRecorder(_Rows):
    """Writes the paths of each block: delay, complex gain, range rate, incidence, hit point and surface.

    An indexed ragged array of CF: `path_pulse` is the pulse of each path.
    """

    def __init__(self, path: Path, prepared: Prepared) -> None:
        self._file = file = new_recording(path, prepared, "paths", "paths of a simulated FMCW radar")
        file.dimension("path")
        names = [f"{number} {surface.name}" for number, surface in enumerate(prepared.world.scene.surfaces)]

        column = partial(_add_column, file, "path")
        column("path_pulse", np.int64, "pulse of the path", "1", instance_dimension="pulse")
        column("delay", np.float64, "two-way delay at the middle of the chirp", "s")
        column("gain_i", np.float32, "received over transmitted wave, real part; the phase excludes the delay", "1")
        column("gain_q", np.float32, "received over transmitted wave, imaginary part", "1")
        column("range_rate", np.float32, "range rate, positive when receding", "m s-1")
        column("incidence", np.float32, "angle between ray and surface normal; NaN for targets and volumes", "rad")
        column(
            "surface", np.int32, f"surface hit; {VOLUME} volume cell, {BOUNCED} two, {FIRST_OBSTACLE}... obstacle", "1",
            comment="; ".join(names),
        )  # fmt: skip
        file.variable(
            "hit", ("path", "axis"), dtype=np.dtype(np.float64), units="m",
            long_name="where the surface is hit: east, north, up of the local origin",
        )  # fmt: skip

    def write(self, pulses: Pulses, seen: Observation) -> None:
        """Write a block of pulses and its paths."""
        write_pulses(self._file, pulses)
        paths = seen.paths
        self._file.append(
            "path",
            {
                "path_pulse": paths.pulse,
                "delay": paths.delay_s,
                "gain_i": paths.gain.real,
                "gain_q": paths.gain.imag,
                "range_rate": paths.range_rate_mps,
                "incidence": paths.incidence_rad,
                "surface": paths.surface,
                "hit": paths.hit_m,
            },
        )


Kind = Literal["signals", "paths", "profiles", "cube"]
KINDS: tuple[Kind, ...] = ("signals", "paths", "profiles", "cube")


@contextmanager
def recorders(
    wanted: Mapping[str, Path], prepared: Prepared, sample_type: SampleType = "float64"
) -> Iterator[Sequence[Recorder]]:
    """Yield the recorders of a survey by kind; their files are in place when the block ends without an error.

    Raises ScenarioError if there is no such kind, OutputError if a file exists, or its folder cannot be written.
    """
    files = checked_files(wanted)
    refuse_average(prepared.scenario.processing, "a recording")
    for kind, of_array in (("cube", True), ("signals", False), ("profiles", False)):
        if kind in files and (prepared.scenario.sensor == "mimo") != of_array:
            own = "sensor = 'mimo'" if of_array else "single chirps"
            raise ScenarioError.of("record", f"{kind!r} is of {own}; give another kind, or change the sensor")
    makers: dict[str, Callable[[Path], Recorder]] = {
        "signals": lambda path: SignalRecorder(path, prepared, sample_type),
        "paths": lambda path: PathRecorder(path, prepared),
        "profiles": lambda path: ProfileRecorder(path, prepared),
        "cube": lambda path: SignalRecorder(path, prepared, sample_type),
    }
    with ExitStack() as stack:
        made, places = [], []
        try:
            for kind, path in files.items():
                folder = stack.enter_context(staged(path.parent))
                recorder = makers[kind](folder / path.name)
                stack.callback(recorder.close)
                made.append(recorder)
                places += [(folder / file.name, file) for file in files_of(kind, path)]
            yield made
            for written, path in places:
                if path.exists():
                    raise OutputError(f"recording {path} has come into being during the flight; name another file")
                written.rename(path)
        except OutputError:
            raise
        except OSError as error:
            names = ", ".join(str(path) for path in files.values())
            reason = error.strerror or str(error)
            message = f"recording {names} cannot be written ({reason}); free some space or name another file"
            raise OutputError(message) from error


def checked_files(wanted: Mapping[str, Path]) -> dict[str, Path]:
    """Return the resolved paths of recordings by kind; ScenarioError for an unknown one, OutputError for a file."""
    files = {kind: _checked(kind, path) for kind, path in wanted.items()}
    if len(set(files.values())) < len(files):
        raise OutputError(f"recordings {', '.join(files)} go to one file; give each one of its own")
    return files


def _checked(kind: str, path: Path) -> Path:
    if kind not in KINDS:
        raise ScenarioError.of("record", f"{kind!r} is not recorded; give one of {', '.join(KINDS)}", "run")
    try:
        path = path.expanduser().resolve()
        for file in files_of(kind, path):
            if file.exists():
                raise OutputError(f"recording {file} exists already; move it away or name another file")
        if not path.parent.is_dir():
            raise OutputError(f"recording {path} cannot be written: there is no folder {path.parent}; make it first")
        for _ in abandoned(path.parent):
            pass  # leftovers of killed runs are removed
    except (RuntimeError, ValueError) as error:
        raise OutputError(f"recording {path} cannot be written ({error}); name another file") from error
    return path
