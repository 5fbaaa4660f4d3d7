"""Tables of recordings: the description of foreign samples, and the settings with which they are processed."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import InputFileError, Problem, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, read_text, shown
from sionna_radar.scenario.bases import AntennaParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.loading import parse_scenario
from sionna_radar.scenario.overrides import IMPLIED_ANTENNAS, apply_overrides
from sionna_radar.scenario.parts import ANTENNAS
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.processing import DemTable, ProcessingTable
from sionna_radar.scenario.radar import LONGEST_GATE_US, AntennaTable
from sionna_radar.scenario.receiver import ArrayTable, ReceiverTable
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import Conflicts, InputPath, NonNegative, Positive, Real, Table

# Adjustable tables of any recording; additional ones of a recording without a scenario.
OPEN = ("processing", "dem")
RADAR_KEYS = ("radar.antenna", "radar.receiver", "radar.array", "radar.conjugate")
SLOWEST_WAVE_MPS = 1e6


class RecordedRadar(Table):
    """The radar of a recording; attributes of the netCDF variable `radar`."""

    carrier_hz: Annotated[Real, Field(ge=1e6, le=1e12)]
    """Frequency in the middle of the recorded samples."""
    bandwidth_hz: Annotated[Real, Field(ge=1e3, le=1e12)]
    """Bandwidth swept during the recorded samples: slope times samples over the sampling rate."""
    sampling_rate_hz: Annotated[Real, Field(ge=1.0, le=1e12)]
    """Sampling rate of the recorded samples."""
    sweep: Literal["up", "down", "triangular"] = "up"
    """Direction of the sweep; "triangular" for an up- and a down-sweep in each pulse."""
    gate_delay_us: Annotated[Real, Field(ge=0, le=LONGEST_GATE_US)] = 0.0
    """Delay of the sweep that echoes were mixed with, and of the samples, after the transmitted sweep; see
    `radar.gate_delay_us`."""
    propagation_mps: Annotated[Real, Field(ge=SLOWEST_WAVE_MPS, le=speed_of_light)] = speed_of_light
    """Speed of the wave, c / sqrt(permittivity) in a medium such as ice."""
    chirp_period_s: Positive | None = None
    """Time from chirp to chirp within the frames of an array."""
    transmit_power_w: Positive | None = None
    """Transmit power of a simulated radar."""
    noise_power_w: NonNegative | None = None
    """Noise power in a sample of a simulated radar."""

    def _conflicts(self) -> Conflicts:
        if self.bandwidth_hz >= 2 * self.carrier_hz:
            yield "bandwidth_hz", f"{self.bandwidth_hz:g} extends below 0 Hz around carrier_hz; correct the carrier"


class RecordedReception(Table):
    """Properties of the radar that the processing of a real recording needs."""

    antenna: Annotated[AntennaParameters, ChosenBy("kind", ANTENNAS, "taylor", implied=IMPLIED_ANTENNAS)] = (
        AntennaTable()
    )
    """Beam of the antenna."""
    receiver: ReceiverTable = ReceiverTable()
    """High-pass and range gain of the receiver, which calibrated spectra divide out; all else has happened to the
    samples."""
    array: ArrayTable | None = None
    """Transmitters and receivers of the array; a pulse is then a frame of all their chirps."""
    conjugate: bool = False
    """Whether the Q samples have the other sign, so that echoes have negative beats."""

    def _conflicts(self) -> Conflicts:
        unsupported = sorted(self.receiver.model_fields_set - {"high_pass_corner_hz", "high_pass_order", "range_gain"})
        if unsupported:
            yield f"receiver.{unsupported[0]}", "has no effect on recorded samples; only high-pass and range gain apply"


class RecordedSettings(Table):
    """Processing settings of a recording without a scenario: the tables of a scenario that apply."""

    radar: RecordedReception = RecordedReception()
    """Properties of the radar that processing needs."""
    processing: ProcessingTable = Field(default_factory=ProcessingTable)
    """Processing of beat signals to ranges."""
    dem: DemTable = Field(default_factory=DemTable)
    """Mapping of echoes to heights."""


class ReadingsTable(Table):
    """Range readings of an altimeter, which processes its own signals."""

    file: InputPath
    """File of range readings: CSV, .npz or netCDF (.nc) with time_s, range_m (empty or nan without a reading) and
    optionally sigma_m."""
    columns: dict[Literal["time_s", "range_m", "sigma_m"], str] = {}
    """Names of the columns or variables in the file, by ours."""
    range_cell_m: Annotated[Positive, Field(le=1e4)] = 1.0
    """Length of a range cell of the radar: neighbouring readings share errors of the map within some of them."""
    range_zero_m: Annotated[Real, Field(ge=-1e5, le=1e5)] = 0.0
    """Range reading at range zero: cables, filters, internal delay."""


class RecordingTable(Table):
    """The samples of a recording, and their preprocessing."""

    samples: InputPath
    """Sample file: a .npy, .npz or netCDF (.nc) array, or the raw capture (.bin) of TI's DCA1000 card."""
    variable: str = "samples"
    """Name of the array in a .npz or netCDF file."""
    axes: tuple[Literal["pulse", "receiver", "sample", "range", "iq"], ...] = ("pulse", "sample")
    """Axes of the array, the slowest first: "sample" of beat signals, or "range" of range profiles; "iq" holds I and Q,
    unless values are complex."""
    values: Literal["complex", "power", "power_db"] = "complex"
    """Values of range profiles: complex, mean powers (of any number of chirps), or these in dB."""
    config: InputPath | None = None
    """Chirp configuration of a capture: a .cfg file, or mmWave Studio's .mmwave.json."""
    lanes: Literal[2, 4] = 2
    """LVDS lanes of a capture: 2 for xWR16xx, xWR18xx and xWR68xx, 4 for xWR12xx and xWR14xx."""
    receiver: Annotated[int, Field(strict=True, ge=1, le=1024)] = 1
    """Number of the receiver that is processed, counted from 1."""
    transmitter: Annotated[int, Field(strict=True, ge=1, le=16)] = 1
    """Number of the transmitter whose chirps are processed, counted from 1, for transmitters in turn."""
    used_samples: tuple[int, int] | None = None
    """First used sample and the one after the last, where samples at the ends of a sweep are dead."""
    background: InputPath | None = None
    """Recording of the sky or an absorber in the same form. Its mean sweep is subtracted from each, and leakage with
    it; for powers, what its mean exceeds its median over the ranges by."""
    channel_gain_db: tuple[tuple[Annotated[Real, Field(ge=-60, le=60)], ...], ...] = ()
    """Measured gains of an array's channels, which are divided out: a row of receivers for each transmitter in turn, or
    one row for all."""
    channel_phase_deg: tuple[tuple[Annotated[Real, Field(ge=-360, le=360)], ...], ...] = ()
    """Measured phases of an array's channels, which are divided out: a row of receivers for each transmitter in turn,
    or one row for all."""
    range_zero_m: Annotated[Real, Field(ge=-1e5, le=1e5)] = 0.0
    """Range reading at range zero: cables, filters, internal delay."""

    def _conflicts(self) -> Conflicts:
        for key in sorted({"axes", "values", "variable"} & self.model_fields_set) if self.captured else ():
            yield key, "applies to arrays only; the configuration of a capture defines its content"
        kinds = {"sample", "range"} & set(self.axes)
        if len(set(self.axes)) < len(self.axes) or "pulse" not in self.axes or len(kinds) != 1:
            yield "axes", f"{list(self.axes)}: name each axis once, pulse and either sample or range among them"
        if self.values != "complex" and (self.kind == "sample" or "iq" in self.axes):
            yield "values", f"{self.values!r} applies to range profiles only; name their axis range, and no iq"
        if self.kind == "range" and self.used_samples is not None:
            yield "used_samples", "applies to beat signals only; for range profiles set processing.min_range_m"

    @property
    def captured(self) -> bool:
        """Whether the samples are a raw capture of a DCA1000 card."""
        return Path(self.samples).suffix.lower() == ".bin"

    @property
    def kind(self) -> Literal["sample", "range"]:
        """Content of the fast axis of the array."""
        return "range" if "range" in self.axes else "sample"


class SweepTable(RecordedRadar):
    """The sweep of recorded samples, and the pulse rate."""

    pulse_rate_hz: Annotated[Positive, Field(le=1e9)]
    """Rate of the recorded pulses."""

    def _conflicts(self) -> Conflicts:
        yield from super()._conflicts()
        if self.sweep == "triangular":
            yield "sweep", "'triangular' has two sweeps in a pulse; write a netCDF file instead"


class PosesTable(Table):
    """The flight during a recording, from a log."""

    log: InputPath
    """Log of the flight, in any format that `platform.log` takes."""
    log_columns: dict[str, str] = {}
    """Columns of a CSV log by our names; see `platform.log_columns`."""
    log_crs: str | None = None
    """Coordinate reference system of a CSV log; see `platform.log_crs`."""
    log_gap_s: Annotated[Positive, Field(le=3600.0)] = 2.0
    """Longest time without a position or an attitude that is interpolated; see `platform.log_gap_s`."""
    first_pulse_s: NonNegative = 0.0
    """Time of the first pulse in the log, counted from its first position."""
    incidence_deg: Annotated[Real, Field(ge=-180.0, le=180.0)] = 0.0
    """Angle of the antenna's boresight from nadir toward `look`."""
    look: Literal["forward", "left", "right"] = "forward"
    """Direction that the antenna looks: toward the nose, or to a side."""


class DescribedRecording(RecordedSettings):
    """Description of a foreign recording, in a file beside its samples."""

    recording: RecordingTable | None = None
    """Samples of the recording."""
    readings: ReadingsTable | None = None
    """Range readings, instead of samples."""
    sweep: SweepTable | None = None
    """Transmitted sweep; the configuration of a capture describes it itself."""
    poses: PosesTable | None = None
    """Poses of the antenna. Default: none; there are then ranges, and no map."""

    def _conflicts(self) -> Conflicts:
        if (self.recording is None) == (self.readings is None):
            yield "recording", "give [recording] with samples or [readings] with ranges, one of them"
        if self.sweep is not None and (self.recording is None or self.recording.captured):
            message = "applies to arrays only; readings have no sweep, and the configuration of a capture defines it"
            yield "sweep", message
        for key in ("channel_gain_db", "channel_phase_deg") if self.recording and not self.radar.array else ():
            if getattr(self.recording, key):
                yield f"recording.{key}", "applies to the channels of an array; describe it in [radar.array]"

    def settings(self) -> dict[str, Any]:
        """Return the processing settings that the file contains, by dotted key."""
        values = self.model_dump(mode="json", exclude_unset=True, exclude={"recording", "readings", "sweep", "poses"})
        radar = values.pop("radar", {})
        return values | {f"radar.{key}": value for key, value in radar.items()}


def recorded_scenario(text: str, overrides: Mapping[str, Any], source: str) -> Scenario:
    """Return the scenario of a recording, with values of `processing` and `dem` replaced.

    Raises ScenarioError for any other key, and for values that do not fit.
    """
    _check_open(
        overrides,
        OPEN,
        "cannot be changed for a recording; only processing, dem and radar.conjugate can be set; re-run the "
        "simulation instead",
    )
    try:
        data = parse_toml(text)
    except ValueError as error:
        raise ScenarioError.of("scenario", f"is not TOML: {error}; record the survey again", source) from error
    apply_overrides(data, overrides)
    return parse_scenario(data, source)


def recorded_settings(overrides: Mapping[str, Any], source: str) -> RecordedSettings:
    """Return the processing settings of a recording without a scenario.

    Raises ScenarioError for a key that does not apply, and for values that do not fit.
    """
    _check_open(
        overrides,
        OPEN + RADAR_KEYS,
        f"does not apply to a recording without a scenario; set processing, dem or {', '.join(RADAR_KEYS)}",
    )
    data: dict[str, Any] = {}
    apply_overrides(data, overrides)
    try:
        return RecordedSettings.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(translate(error.errors(), RecordedSettings), source) from error


def results_settings(folder: Path, remedy: str) -> Scenario | RecordedSettings:
    """Return the settings in a folder of `run` or `process`: a scenario, or those of a recording without one.

    Raises InputFileError, with a remedy, for a folder without settings or with damaged ones, ScenarioError for values
    that do not fit.
    """
    path = next((p for name in ("scenario.toml", "settings.toml") if (p := folder / name).is_file()), None)
    if path is None:
        raise InputFileError(f"survey = {shown(folder)} holds no scenario.toml or settings.toml; {remedy}")
    try:
        tables = parse_toml(read_text(path, "settings =", remedy))
        if "terrain" in tables or path.name == "scenario.toml":
            return parse_scenario(tables, shown(path))
        return RecordedSettings.model_validate(tables)
    except ValidationError as error:
        raise ScenarioError(translate(error.errors(), RecordedSettings), shown(path)) from error
    except ScenarioError:
        raise
    except ValueError as error:
        raise InputFileError(f"settings = {shown(path)} is damaged ({error}); {remedy}") from error


def _check_open(overrides: Mapping[str, Any], tables: tuple[str, ...], reason: str) -> None:
    closed = [key for key in overrides if not any(key == table or key.startswith(f"{table}.") for table in tables)]
    if closed:
        options = [*Scenario.model_fields]
        raise ScenarioError([_closed(key, reason, options) for key in closed], "overrides")


def _closed(key: str, reason: str, options: list[str]) -> Problem:
    table = key.split(".")[0]
    if table not in options:
        return Problem(shown(key)[1:-1], f"unknown key; remove it or correct its spelling.{nearest(table, options)}")
    return Problem(shown(key)[1:-1], reason)
