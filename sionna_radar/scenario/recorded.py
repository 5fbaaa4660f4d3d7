"""Adjustable settings for the processing of recorded beat signals, and the radar of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator
from scipy.constants import speed_of_light

from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.input_file import parse_toml, shown
from sionna_radar.scenario.bases import AntennaParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.loading import parse_scenario
from sionna_radar.scenario.overrides import IMPLIED_ANTENNAS, apply_overrides
from sionna_radar.scenario.parts import ANTENNAS
from sionna_radar.scenario.problems import nearest, translate
from sionna_radar.scenario.processing import DemTable, ProcessingTable
from sionna_radar.scenario.radar import AntennaTable
from sionna_radar.scenario.receiver import ReceiverTable
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import NonNegative, Positive, Real, Table, refuse

# Adjustable tables of any recording; additional ones of a recording without a scenario.
OPEN, OPEN_BESIDES = ("processing", "dem"), ("radar.antenna", "radar.receiver", "radar.conjugate")
SLOWEST_WAVE_MPS = 1e6


class RecordedRadar(Table):
    """The radar of a recording, by the attributes of its variable `radar`."""

    carrier_hz: Annotated[Real, Field(ge=1e6, le=1e12)]
    """the frequency in the middle of the recorded samples."""
    bandwidth_hz: Annotated[Real, Field(ge=1e3, le=1e12)]
    """swept during the recorded samples: slope times samples over the sampling rate."""
    sampling_rate_hz: Annotated[Real, Field(ge=1.0, le=1e12)]
    """of the recorded samples."""
    sweep: Literal["up", "down", "triangular"] = "up"
    """"triangular" for an up- and a down-sweep in each pulse."""
    propagation_mps: Annotated[Real, Field(ge=SLOWEST_WAVE_MPS, le=speed_of_light)] = speed_of_light
    """speed of the wave, c / sqrt(permittivity) in a medium such as ice."""
    transmit_power_w: Positive | None = None
    """of a simulated radar."""
    noise_power_w: NonNegative | None = None
    """of a sample of a simulated radar."""

    @model_validator(mode="after")
    def _narrow(self) -> RecordedRadar:
        if self.bandwidth_hz >= 2 * self.carrier_hz:
            raise refuse("bandwidth_hz", f"{self.bandwidth_hz:g} reaches below 0 Hz about carrier_hz; give the carrier")
        return self


class RecordedReception(Table):
    """What the processing of a real recording must be told of its radar."""

    antenna: Annotated[AntennaParameters, ChosenBy("kind", ANTENNAS, "taylor", implied=IMPLIED_ANTENNAS)] = (
        AntennaTable()
    )
    """its beam."""
    receiver: ReceiverTable = ReceiverTable()
    """its high-pass and its gain over range, which calibrated spectra divide out; all else has happened to the
    samples."""
    conjugate: bool = False
    """whether the Q samples have the other sign, so that echoes have negative beats."""

    @model_validator(mode="after")
    def _only_the_high_pass(self) -> RecordedReception:
        unsupported = sorted(self.receiver.model_fields_set - {"high_pass_corner_hz", "high_pass_order", "range_gain"})
        if unsupported:
            raise refuse(
                f"receiver.{unsupported[0]}",
                "has no effect on samples that are recorded already; only high-pass and range gain have",
            )
        return self


class RecordedSettings(Table):
    """How a recording without a scenario is processed: the tables of a scenario that apply."""

    radar: RecordedReception = RecordedReception()
    """what must be known of the radar."""
    processing: ProcessingTable = Field(default_factory=ProcessingTable)
    """how beat signals are turned into ranges."""
    dem: DemTable = Field(default_factory=DemTable)
    """how echoes are turned into heights."""


def recorded_scenario(text: str, overrides: Mapping[str, Any], source: str) -> Scenario:
    """Return the scenario of a recording, with values of `processing` and `dem` replaced.

    Raises ScenarioError for any other key, and for values that do not fit.
    """
    _check_open(overrides, OPEN, "is fixed by the recording: only processing and dem can be set; fly it again for more")
    try:
        data = parse_toml(text)
    except ValueError as error:
        raise ScenarioError([Problem("scenario", f"is not TOML: {error}; record it again")], source) from error
    apply_overrides(data, overrides)
    return parse_scenario(data, source)


def recorded_settings(overrides: Mapping[str, Any], source: str) -> RecordedSettings:
    """Return the processing settings of a recording without a scenario.

    Raises ScenarioError for a key that does not apply, and for values that do not fit.
    """
    _check_open(
        overrides,
        OPEN + OPEN_BESIDES,
        f"does not apply to a recording without a scenario; set processing, dem or {', '.join(OPEN_BESIDES)}",
    )
    data: dict[str, Any] = {}
    apply_overrides(data, overrides)
    try:
        return RecordedSettings.model_validate(data)
    except ValidationError as error:
        raise ScenarioError(translate(error.errors(), RecordedSettings), source) from error


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
