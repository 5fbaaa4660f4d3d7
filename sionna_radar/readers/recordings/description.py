"""Recordings of other programs, described by a TOML file beside them: arrays, and raw captures of TI's DCA1000.

    [recording]
    samples = "adc_data.bin"            # .npy, .npz, .nc, or .bin of the capture card
    config = "profile.cfg"              # of a .bin: the chirp configuration (.cfg), or mmWave Studio's .mmwave.json
    receiver = 1

    [sweep]                             # of an array: what the radar sent, see `RecordedRadar`
    carrier_hz = 77.6e9
    bandwidth_hz = 3.0e9
    sampling_rate_hz = 2.5e6
    pulse_rate_hz = 100.0

An array may hold range profiles instead: `_of_powers` says how powers are read. Ranges that an altimeter read stand in
`[readings]` in place of `[recording]` and `[sweep]`.

    [poses]                             # a flight log, in any format that `platform.log` takes
    log = "flight.csv"

    [processing]                        # further tables as in a scenario: processing, dem, radar.antenna, ...

With `[radar.array]` all receivers are read, and a pulse is a frame of chirps.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from jaxtyping import Complex, Float, Num
from pydantic import ValidationError

from sionna_radar.elevation.local_frame import MapFrame, frame_at
from sionna_radar.flight.frames import conical_from_antenna, world_from_body
from sionna_radar.flight.pulses import Pose
from sionna_radar.flight.recorded import LogPart, recorded_route
from sionna_radar.flight.scan import LOOKS
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text, regular_file, shown
from sionna_radar.foundation.raster import Georeference
from sionna_radar.radar.mimo_array import channel_response
from sionna_radar.readers.captures.capture_file import (
    CONFIG_REMEDY,
    bytes_after_frames,
    capture_config,
    capture_frames,
    frame_bytes,
    inferred_lanes,
    receiver_samples,
)
from sionna_radar.readers.logs.reader import read_log
from sionna_radar.readers.recordings.numpy_file import readable, stored_arrays
from sionna_radar.scenario.problems import translate
from sionna_radar.scenario.receiver import ArrayTable
from sionna_radar.scenario.recorded import DescribedRecording, PosesTable, RecordedRadar, RecordingTable, SweepTable
from sionna_radar.survey.recordings.described import WHOLE_CELLS, DescribedRanges, DescribedSignals, PoseAt
from sionna_radar.survey.recordings.netcdf import open_netcdf
from sionna_radar.survey.recordings.signal_file import MAX_PULSES, MAX_SAMPLES, MIN_SAMPLES, sweeps_of

REMEDY = "give a recording's description in TOML; the page on recordings has one"
MAX_BYTES = 64_000_000_000
# Pulses in which swapped axes are looked for, and how much more the strongest line stands out along pulses.
SWAP_PULSES, SWAPPED_CONTRAST = 4096, 30.0


@contextmanager
def open_described(path: Path) -> Iterator[DescribedSignals | DescribedRanges]:
    """Open a recording that a TOML file describes; raises InputFileError or ScenarioError if it cannot be used."""
    table = _description(path)
    yield _signals(path, table, table.recording) if table.recording else _ranges(table)


def _signals(path: Path, table: DescribedRecording, settings: RecordingTable) -> DescribedSignals:
    array = table.radar.array
    if array is not None and settings.values != "complex":
        raise ScenarioError.of("recording.values", "powers have no phase; an array needs 'complex'", str(path))
    channel = _read(path, settings, table.sweep, array)
    samples, radar, background = channel.samples, channel.radar, None
    if settings.background is not None and settings.values == "complex":
        sky = _read(path, settings.model_copy(update={"samples": settings.background}), table.sweep, array)
        if np.iscomplexobj(sky.samples) != np.iscomplexobj(samples):
            _fail(settings.background, f"holds {sky.samples.dtype}, and the recording {samples.dtype}; give both alike")
        background = sky.samples.mean(axis=0, dtype=np.result_type(sky.samples, np.float64))
        if background.shape != samples.shape[1:]:
            _fail(settings.background, f"has {background.shape} samples a pulse, and the recording {samples.shape[1:]}")
    if settings.used_samples is not None:
        first, end = settings.used_samples
        count = samples.shape[-1]
        if not 0 <= first < end <= count:
            _fail(path, f"recording.used_samples = {list(settings.used_samples)}: give first and end within {count}")
        radar = _partial_sweep(radar, first, end, count)
        samples, background = samples[..., first:end], None if background is None else background[..., first:end]
    if not (0 < len(samples) <= MAX_PULSES and MIN_SAMPLES <= samples.shape[-1] <= MAX_SAMPLES):
        _fail(
            settings.samples, f"has {len(samples):,} pulses of {samples.shape[-1]:,} samples; they cannot be processed"
        )
    response = None
    if array is not None and (settings.channel_gain_db or settings.channel_phase_deg):
        turns = len(array.transmitters_wavelengths) if array.multiplexing == "tdm" else 1
        response = channel_response(settings.channel_gain_db, settings.channel_phase_deg, turns, *samples.shape[1:-1])
    (chirp,) = sweeps_of(radar, samples.shape[-1], np.iscomplexobj(samples))
    if abs(settings.range_zero_m) >= (reach_m := chirp.max_range_m - chirp.gate_m):
        message = f"{settings.range_zero_m:g} m is beyond the {reach_m:.1f} m that the samples reach; give metres"
        raise ScenarioError.of("recording.range_zero_m", message, str(path))
    if settings.values != "complex" and chirp.lead_cells:
        message = f"{radar.gate_delay_us:g} ends {chirp.lead_cells:.2g} cells before one, and powers keep their cells; "
        message += (
            f"set {1e6 * chirp.first_cell / chirp.bandwidth_hz:.9g}, and recording.range_zero_m for the difference"
        )
        raise ScenarioError.of("sweep.gate_delay_us", message, str(path))
    time_s = channel.time_s if table.poses is None else channel.time_s + table.poses.first_pulse_s
    pose_at, georeference = (None, None) if table.poses is None else _poses(table.poses, time_s)
    return DescribedSignals(
        samples=samples,
        radar=radar,
        time_s=time_s,
        background=background,
        response=response,
        range_zero_m=settings.range_zero_m if settings.values == "complex" else 0.0,
        powers=settings.values != "complex",
        pose_at=pose_at,
        georeference=georeference,
        settings=table.settings() | (WHOLE_CELLS if settings.values != "complex" else {}),
        files=_files(table, settings.samples, settings.config, settings.background),
        warnings=channel.warnings,
    )


def _files(table: DescribedRecording, *own: Path | None) -> tuple[Path, ...]:
    log = None if table.poses is None else table.poses.log
    return tuple(file for file in (*own, log) if file is not None)


def _ranges(table: DescribedRecording) -> DescribedRanges:
    """Return described ranges: their times count from the first one, or with poses from the log's first position."""
    own = table.readings
    assert own is not None
    known = _columns(own.file, own.columns)
    time_s, range_m = known["time_s"], known["range_m"] - own.range_zero_m
    if not (0 < len(time_s) <= MAX_PULSES and np.isfinite(time_s).all() and (np.diff(time_s) > 0).all()):
        _fail(own.file, "has times that are missing or do not increase; sort the readings by time")
    if not np.isfinite(range_m).any() or np.nanmin(range_m) <= 0:
        _fail(own.file, "has no range, or one that is not positive; leave those cells empty (nan)")
    sigma_m = known.get("sigma_m", np.zeros(len(time_s)))
    if not (sigma_m[np.isfinite(range_m)] >= 0).all():
        _fail(own.file, "has a sigma_m that is negative or missing; give metres, or leave the column out")
    time_s = time_s - time_s[0] + (0.0 if table.poses is None else table.poses.first_pulse_s)
    pose_at, georeference = (None, None) if table.poses is None else _poses(table.poses, time_s)
    return DescribedRanges(
        range_m=range_m,
        sigma_m=sigma_m,
        time_s=time_s,
        cell_m=own.range_cell_m,
        pose_at=pose_at,
        georeference=georeference,
        settings=table.settings(),
        files=_files(table, own.file),
    )


def _columns(path: Path, renamed: Mapping[Any, str]) -> dict[str, Float[np.ndarray, " row"]]:
    regular_file(path, "readings.file =", REMEDY, MAX_BYTES)
    wanted = {name: renamed.get(name, name) for name in ("time_s", "range_m", "sigma_m")}
    if path.suffix.lower() in (".npz", ".nc"):
        found, names = _stored(path, wanted, {"time_s": "s", "range_m": "m", "sigma_m": "m"})
    else:
        with readable(path, "a table"):
            table: np.ndarray = np.genfromtxt(
                path, delimiter=",", names=True, dtype=np.float64, encoding="utf-8", ndmin=1
            )
        names = list(table.dtype.names or ())
        found = {name: table[key] for name, key in wanted.items() if key in names}
    missing = [wanted[name] for name in wanted if name not in found and (name != "sigma_m" or name in renamed)]
    if missing:
        _fail(path, f"has {', '.join(names)}, and not {missing[0]}; name it in [readings.columns]")
    if len({column.shape for column in found.values()}) != 1 or found["time_s"].ndim != 1:
        _fail(path, "has columns of different lengths; give one value a reading")
    if any(column.dtype.kind not in "iuf" for column in found.values()):
        _fail(path, "has columns that are no numbers; give seconds and metres")
    return {name: np.asarray(column, np.float64) for name, column in found.items()}


def _stored(
    path: Path, wanted: Mapping[str, str], units: Mapping[str, str] | None = None, axes: tuple[str, ...] = ()
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return arrays of a NumPy or netCDF file by our names, those that it has, and the names of all.

    units, axes: that a netCDF file may not contradict: by our names, and of all arrays.
    """
    if path.suffix.lower() == ".nc":
        with open_netcdf(path, "recording", REMEDY) as file:
            found = {name: file.variable(key) for name, key in wanted.items() if key in file}
            for name, unit in (units or {}).items():
                file.check_unit(wanted[name], unit)
            for variable in found.values():
                names = tuple(axis[0].name.strip("/") if len(axis) else "" for axis in variable.dims)
                if set(names) == set(axes) and names != axes:
                    file.fail(f"has the dimensions {list(names)}; set recording.axes to these")
            return {name: file.unpacked(variable, variable[...]) for name, variable in found.items()}, list(file)
    return stored_arrays(path, wanted)


def _description(path: Path) -> DescribedRecording:
    try:
        data = parse_toml(read_text(path, "recording =", REMEDY))
    except ValueError as error:
        raise InputFileError(f"recording = {shown(path)} is not TOML ({error}); {REMEDY}") from None
    try:
        table = DescribedRecording.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(translate(error.errors(), DescribedRecording), str(path)) from error
    beside = lambda file: None if file is None else path.parent / Path(file).expanduser()  # noqa: E731
    changes: dict[str, Any] = {}
    if table.recording is not None:
        own = {name: beside(getattr(table.recording, name)) for name in ("samples", "config", "background")}
        changes["recording"] = table.recording.model_copy(update=own)
    if table.readings is not None:
        changes["readings"] = table.readings.model_copy(update={"file": beside(table.readings.file)})
    if table.poses is not None:
        changes["poses"] = table.poses.model_copy(update={"log": beside(table.poses.log)})
    return table.model_copy(update=changes)


@dataclass(frozen=True, kw_only=True)
class _Channel:
    """Samples of one receiver, or of the frames of an array, the sweep that they were taken in, and times of pulses."""

    samples: Num[np.ndarray, "pulse *channel sample"]
    radar: RecordedRadar
    time_s: Float[np.ndarray, " pulse"]
    warnings: tuple[str, ...] = ()


def _read(path: Path, settings: RecordingTable, sweep: SweepTable | None, array: ArrayTable | None) -> _Channel:
    """Return the chosen channel of a file of samples, or the frames of an array."""
    regular_file(settings.samples, "recording.samples =", REMEDY, MAX_BYTES)
    if settings.captured:
        if settings.config is None:
            raise ScenarioError.of("recording.config", f"is missing: {CONFIG_REMEDY}", str(path))
        return _capture(settings, settings.config, array)
    if sweep is None:
        message = "is missing: an array does not say what the radar sent; give carrier_hz, bandwidth_hz, ..."
        raise ScenarioError.of("sweep", message, str(path))
    samples = _array(settings, every=array is not None)
    warnings: tuple[str, ...] = ()
    if settings.values != "complex":
        samples, warnings = _of_powers(samples, settings, sweep)
    elif settings.kind == "range":
        samples = np.fft.ifft(samples, norm="forward")
    elif _look_swapped(samples):
        warnings = (
            f"{shown(settings.samples)}: lines stand out along its pulses instead of its samples, as where "
            f"recording.axes = {list(settings.axes)} names the wrong ones; exchange pulse and sample",
        )
    period_s, sweep_s = 1 / sweep.pulse_rate_hz, samples.shape[-1] / sweep.sampling_rate_hz
    if sweep_s > period_s * (1 + 1e-9):
        message = f"lasts {1e3 * sweep_s:.3g} ms with {samples.shape[-1]:,} samples, and pulses follow after "
        message += f"{1e3 * period_s:.3g} ms; look at sampling_rate_hz, pulse_rate_hz and recording.axes"
        raise ScenarioError.of("sweep", message, str(path))
    radar = RecordedRadar(**{**sweep.model_dump(exclude={"pulse_rate_hz"}), "chirp_period_s": period_s})
    chirps = 1 if array is None else array.chirps_per_frame
    if len(samples) % chirps:
        _fail(settings.samples, f"has {len(samples)} chirps, no whole frames of {chirps}; see radar.array.chirps")
    if array is not None:
        samples = samples.reshape(-1, chirps, *samples.shape[1:])
    time_s = period_s * chirps * np.arange(len(samples))
    return _Channel(samples=samples, radar=radar, time_s=time_s, warnings=warnings)


def _look_swapped(samples: Num[np.ndarray, "pulse *receiver sample"]) -> bool:
    """Return True if spectra are flat along the samples of a chirp, and have lines along pulses.

    Echoes are lines along the samples; along pulses they are spread by speckle and motion, or no wider than these.
    """
    beat = samples.reshape(len(samples), -1, samples.shape[-1])[:SWAP_PULSES, 0]
    beat = beat - beat.mean(axis=0) - beat.mean(axis=1, keepdims=True)  # leakage, and offsets
    length, contrast = min(beat.shape), []
    if length < MIN_SAMPLES:
        return False
    for rows in (beat, beat.T):
        parts = rows[:, : rows.shape[1] // length * length].reshape(-1, length)
        power = np.mean(np.abs(np.fft.fft(parts * np.hanning(length))) ** 2, axis=0)
        contrast.append(power.max() / max(np.median(power), np.finfo(float).tiny))
    return bool(contrast[1] > SWAPPED_CONTRAST * contrast[0])


def _check_receiver(settings: RecordingTable, receivers: int) -> None:
    if settings.receiver > receivers:
        _fail(settings.samples, f"has {receivers} receivers; recording.receiver = {settings.receiver} is none of them")


def _array(settings: RecordingTable, every: bool) -> Num[np.ndarray, "pulse *receiver sample"]:
    """Return the samples of a receiver in a file of arrays, or of every one."""
    found, names = _stored(settings.samples, {"samples": settings.variable}, axes=settings.axes)
    if "samples" not in found:
        _fail(settings.samples, f"has {', '.join(names)}; name one as recording.variable")
    values = found["samples"]
    if values.dtype.kind not in "iufc" or values.ndim != len(settings.axes):
        _fail(
            settings.samples,
            f"holds {values.dtype} of the shape {values.shape}; recording.axes names {list(settings.axes)}",
        )
    if not np.isfinite(values).all():
        _fail(settings.samples, "holds samples that are no finite numbers; leave their pulses out")
    if "iq" in settings.axes:
        pair = np.moveaxis(values, settings.axes.index("iq"), -1)
        if pair.shape[-1] != 2:
            _fail(settings.samples, f"has {pair.shape[-1]} values along iq; it holds I and Q")
        values = pair[..., 0] + 1j * pair[..., 1]
    elif settings.kind == "range" and settings.values == "complex" and values.dtype.kind != "c":
        _fail(
            settings.samples, f"holds {values.dtype}, and complex profiles are complex; set recording.values = 'power'"
        )
    named = [axis for axis in settings.axes if axis != "iq"]
    if "receiver" not in named:
        values, named = values[None], ["receiver", *named]
    values = values.transpose([named.index(axis) for axis in ("pulse", "receiver", settings.kind)])
    _check_receiver(settings, values.shape[1])
    return values if every else values[:, settings.receiver - 1]


def _of_powers(
    profiles: Num[np.ndarray, "pulse cell"], settings: RecordingTable, sweep: SweepTable
) -> tuple[Complex[np.ndarray, "pulse sample"], tuple[str, ...]]:
    """Return I/Q samples whose spectra have given powers and no phase, and what is to be said of them.

    An analysis without a window and zero-padding returns the powers as they are. Their ranges are counted from the
    radar's zero here, between cells linearly.
    """
    power, cell = _powers(profiles, settings), np.arange(profiles.shape[1], dtype=np.float64)
    cell_m = sweep.propagation_mps / (2 * sweep.bandwidth_hz)
    gate_m = 1e-6 * sweep.gate_delay_us * sweep.propagation_mps / 2
    warnings: tuple[str, ...] = ()
    if settings.background is not None:
        sky = settings.model_copy(update={"samples": settings.background})
        mean = _powers(_array(sky, every=False), sky).mean(axis=0)
        if mean.shape != cell.shape:
            _fail(settings.background, f"has {len(mean)} cells a pulse, and the recording {len(cell)}")
        # Of a sky most cells hold noise alone; what exceeds it is leakage.
        power = power - (mean - np.median(mean))
        below = (power < 0).mean(axis=0)
        if below.any():
            at = int(np.argmax(below))
            warnings = (
                f"{below.mean():.2g} of the powers are negative without the background, most often at "
                f"{cell_m * at + gate_m - settings.range_zero_m:.2f} m (in {below[at]:.0%} of the pulses), and count "
                "as zero; where its leakage was stronger, record it again",
            )
        power = np.maximum(power, 0.0)
    if settings.range_zero_m:
        power = np.stack([np.interp(cell + settings.range_zero_m / cell_m, cell, row) for row in power])
    return np.fft.ifft(np.sqrt(power), axis=1, norm="forward"), warnings


def _powers(profiles: Num[np.ndarray, "pulse cell"], settings: RecordingTable) -> Float[np.ndarray, "pulse cell"]:
    """Return the powers of profiles, or of these in dB."""
    if profiles.dtype.kind == "c":
        _fail(settings.samples, f"holds {profiles.dtype}, and powers are real; leave recording.values out for profiles")
    power = np.asarray(profiles, dtype=np.float64)
    if settings.values == "power_db":
        with np.errstate(over="ignore"):
            power = 10 ** (power / 10)
        if not np.isfinite(power).all():
            _fail(settings.samples, "holds levels of no power in dB; powers are recording.values = 'power'")
    if not (power >= 0).all():
        _fail(settings.samples, "holds negative powers; those in dB are recording.values = 'power_db'")
    return power


def _capture(settings: RecordingTable, config_file: Path, array: ArrayTable | None) -> _Channel:
    """Return the samples of a raw capture: of one receiver and one transmitter's chirps, or the frames of an array."""
    config = capture_config(config_file)
    _check_receiver(settings, config.receivers)
    chirps = len(config.transmitters)
    raw = capture_frames(settings.samples, config)
    warnings: tuple[str, ...] = ()
    rest = bytes_after_frames(settings.samples, config)
    if rest or config.frames not in (0, len(raw)):
        held = f"{shown(settings.samples)}: {len(raw)} whole frames are read"
        held += f", of the {config.frames} that its configuration states" if config.frames else ""
        if rest:
            held += f", and the {rest:,} bytes after them ({rest / frame_bytes(config):.0%} of a frame) are left out"
        warnings = (f"{held}; the capture was stopped or cut off, or has another configuration",)
    if (lanes := inferred_lanes(raw, config, settings.lanes)) != settings.lanes:
        told = (
            f"{shown(settings.samples)}: echoes have mirror images in I and Q, and none in the order of {lanes} lanes"
        )
        warnings += (f"{told}; if the module has so many, set recording.lanes = {lanes}",)
    chirp_s, duration_s = 1e-6 * config.chirp_us, config.samples / (1e3 * config.rate_ksps)
    frame_s, slope = 1e-3 * config.frame_ms * np.arange(len(raw)), 1e12 * config.slope_mhz_us
    radar = RecordedRadar(
        carrier_hz=1e9 * config.start_ghz + slope * (1e-6 * config.adc_start_us + duration_s / 2),
        bandwidth_hz=abs(slope) * duration_s,
        sampling_rate_hz=1e3 * config.rate_ksps,
        sweep="up" if slope > 0 else "down",
        chirp_period_s=chirp_s,
    )
    if array is not None:
        samples = receiver_samples(raw, config, settings.lanes)
        return _Channel(samples=samples, radar=radar, time_s=frame_s, warnings=warnings)
    sent = [number for number, mask in enumerate(config.transmitters) if mask & 1 << (settings.transmitter - 1)]
    if not sent:
        _fail(config_file, f"no chirp of a frame is sent by recording.transmitter = {settings.transmitter}")
    own_chirps = raw[:, sent[0] :: chirps].reshape(-1, raw.shape[2])
    samples = receiver_samples(own_chirps, config, settings.lanes, settings.receiver - 1)
    time_s = (frame_s[:, None] + chirp_s * (chirps * np.arange(config.loops) + sent[0])).ravel()
    return _Channel(samples=samples, radar=radar, time_s=time_s, warnings=warnings)


def _partial_sweep(radar: RecordedRadar, first: int, end: int, samples: int) -> RecordedRadar:
    """Return the radar of a part of its sweep."""
    share, middle = (end - first) / samples, (first + end) / (2 * samples) - 0.5
    offset_hz = (-middle if radar.sweep == "down" else middle) * radar.bandwidth_hz
    changes = {"bandwidth_hz": share * radar.bandwidth_hz, "carrier_hz": radar.carrier_hz + offset_hz}
    return radar.model_copy(update=changes)


# ---------------------------------------------------------------------------------------------------------------- poses
def _poses(table: PosesTable, time_s: Float[np.ndarray, " pulse"]) -> tuple[PoseAt, Georeference | None]:
    """Return the poses, at times from the first of the log, of a tilted antenna, and the place of local metres."""
    log = read_log(table.log, "poses.log", table.log_columns, table.log_crs)
    frame: MapFrame | None = None
    base_m = 0.0
    if log.on_map:
        known = log.positions.place[np.isfinite(log.positions.place).all(axis=1)]
        frame = frame_at(float(known[0, 0]), float(known[0, 1]))
        base_m = float(np.floor(known[:, 2].min()))
    part = LogPart(path=table.log, gap_s=table.log_gap_s, height="datum")
    route = recorded_route(log, part, lambda: frame)
    trajectory, (start_s, end_s) = route.trajectory(-base_m), route.span_s
    if time_s[0] < start_s or time_s[-1] > end_s:
        message = (
            f"is at {table.first_pulse_s:g} s: pulses are at {time_s[0]:.2f} to {time_s[-1]:.2f} s of the log, and "
            f"{shown(table.log)} has poses from {start_s:.2f} to {end_s:.2f} s; give the log's time of the first pulse"
        )
        raise ScenarioError.of("poses.first_pulse_s", message)

    def pose_at(at_s: Float[np.ndarray, " n"]) -> Pose:
        """Return the poses of the tilted antenna at times of the log."""
        tilt = conical_from_antenna(float(np.deg2rad(table.incidence_deg)), np.full(len(at_s), LOOKS[table.look]))
        return Pose(
            position_m=trajectory.position(at_s - start_s),
            velocity_mps=trajectory.velocity(at_s - start_s),
            R_world_antenna=world_from_body(trajectory.euler(at_s - start_s)) @ tilt,
        )

    if frame is None:
        return pose_at, None
    return pose_at, Georeference(crs_wkt=frame.crs.to_wkt(), origin_m=(*frame.origin_m, base_m))


def _fail(path: Path, reason: str) -> NoReturn:
    raise InputFileError(f"{shown(path)}: {reason}")
