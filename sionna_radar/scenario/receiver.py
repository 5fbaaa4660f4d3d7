"""The receiver as it is built, and the oscillator that it shares with the transmitter: `[radar.receiver]`."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from sionna_radar.foundation.input_file import shown
from sionna_radar.scenario.bases import StageParameters
from sionna_radar.scenario.choice import ChosenBy
from sionna_radar.scenario.oscillators import PHASE_NOISE
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.problems import nearest
from sionna_radar.scenario.table import InputPath, NonNegative, Positive, Real, Table, refuse

Order = Annotated[int, Field(strict=True, ge=1, le=4)]
# An offset from the carrier, and the level there in one sideband.
Offset = tuple[Annotated[Real, Field(gt=0, le=1e12)], Annotated[Real, Field(ge=-250, le=0)]]
Place = Literal["mixer", "noise", "filters"]
Stage = Annotated[StageParameters, ChosenBy("stage", RECEIVER_STAGES, by_name=True)]


def _published(name: str) -> str:
    if name not in PHASE_NOISE:
        raise refuse(
            "", f"{shown(name)} is unknown; give one of {', '.join(PHASE_NOISE)}.{nearest(name, list(PHASE_NOISE))}"
        )
    return name


class OscillatorTable(Table):
    """What the frequency of the sweep is besides ideal: echoes are mixed with the same sweep, which has gone on since.

    Errors of frequency are those of the transmitted wave.

    phase_noise_dbc_hz: pairs of an offset from the carrier in Hz and the level of one sideband there, dBc/Hz. Between
        them decibels are linear in the logarithm of the offset, below the first they go on as between the first two,
        beyond the last they stay.
    phase_noise_preset: instead of it, that of a published oscillator.
    quadratic_hz: error of frequency at both ends of the sweep that grows with the square of the time from its middle.
    cubic_hz: error at the end of the sweep that grows with the cube, the negative at its start.
    sinusoidal_hz: amplitude of an error that repeats itself.
    sinusoidal_periods: how often in a sweep.
    settling_hz: error at the start of the sweep that dies away exponentially.
    settling_time_s: in which it falls to 1/e.
    sweep_error: a CSV with the columns time_s, from the start of the sweep, and error_hz, added to these.
    drift_ppm_per_k: of the reference that slope, carrier and sampling follow, for each kelvin.
    warmer_k: temperature over that at which the reference was measured.
    used_window: the shares of the sweep between which samples are used: fewer samples of less bandwidth, at the same
        rate. The time of a pulse is that of their middle.
    """

    phase_noise_dbc_hz: tuple[Offset, ...] = ()
    phase_noise_preset: Annotated[str, AfterValidator(_published)] | None = None
    quadratic_hz: Real = 0.0
    cubic_hz: Real = 0.0
    sinusoidal_hz: Real = 0.0
    sinusoidal_periods: Annotated[Real, Field(gt=0, le=1e4)] = 1.0
    settling_hz: Real = 0.0
    settling_time_s: Positive | None = None
    sweep_error: InputPath | None = None
    drift_ppm_per_k: Annotated[Real, Field(ge=-1e4, le=1e4)] = 0.0
    warmer_k: Annotated[Real, Field(ge=-200, le=200)] = 0.0
    used_window: tuple[Annotated[Real, Field(ge=0, le=1)], Annotated[Real, Field(ge=0, le=1)]] = (0.0, 1.0)

    @model_validator(mode="after")
    def _consistent(self) -> OscillatorTable:
        offsets = [offset for offset, _ in self.phase_noise_dbc_hz]
        if any(b <= a for a, b in pairwise(offsets)):
            raise refuse("phase_noise_dbc_hz", "its offsets must increase from pair to pair; sort them")
        if offsets and self.phase_noise_preset is not None:
            raise refuse("phase_noise_preset", "contradicts phase_noise_dbc_hz; give one of them")
        if (self.settling_hz != 0) != (self.settling_time_s is not None):
            raise refuse("settling_time_s", "goes with settling_hz; give both or none")
        first, last = self.used_window
        if last - first < 0.05:
            raise refuse("used_window", f"{first:g} to {last:g} is less than a twentieth of the sweep; widen it")
        return self

    @property
    def levels_dbc_hz(self) -> tuple[Offset, ...]:
        """Offsets from the carrier and levels of one sideband; none for an oscillator without phase noise."""
        return PHASE_NOISE[self.phase_noise_preset].levels if self.phase_noise_preset else self.phase_noise_dbc_hz

    @property
    def bent(self) -> bool:
        """Whether the sweep is not straight."""
        errors = (self.quadratic_hz, self.cubic_hz, self.sinusoidal_hz, self.settling_hz)
        return any(errors) or self.sweep_error is not None

    @property
    def scale(self) -> float:
        """Ranges that are read over true ones, by the drift of the reference."""
        return 1 + 1e-6 * self.drift_ppm_per_k * self.warmer_k


class ReceiverTable(Table):
    """The receiver between antenna and samples; what is not given is ideal.

    high_pass_corner_hz: of a Butterworth high-pass on the beat signal; 0 for none.
    high_pass_order: of that filter.
    oscillator: phase noise, a sweep that is not straight, drift.
    stages: stages of the receiver that custom ones replace, by their names: mixer, noise, filters.
    """

    high_pass_corner_hz: NonNegative = 0.0
    high_pass_order: Order = 2
    oscillator: OscillatorTable = OscillatorTable()
    stages: dict[Place, Stage] = {}

    @model_validator(mode="after")
    def _consistent(self) -> ReceiverTable:
        usual = type(self).model_fields["high_pass_order"].default
        if self.high_pass_corner_hz == 0 and self.high_pass_order != usual:
            message = f"{self.high_pass_order} has no effect without high_pass_corner_hz; give it"
            raise refuse("high_pass_order", message)
        return self
