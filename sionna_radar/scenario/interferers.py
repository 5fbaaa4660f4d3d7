"""Other radars that transmit into ours: `[[interferers]]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.table import NonNegative, Point2, Real, Table, refuse


class Interferer(Table):
    """Another radar, in the line of sight of ours, whose waves our antenna receives directly.

    kind: a linear sweep, or a steady carrier.
    position_m: east and north.
    height_m: above the ground.
    power_dbm: transmitted.
    antenna_gain_db: of its antenna toward ours, dBi, less what its polarization loses.
    carrier_hz: in the middle of its sweep.
    bandwidth_hz: of its sweep.
    chirp_rate_hz: its sweeps a second, each as long as its period.
    sweep: rising or falling.
    offset_s: when a sweep of its begins, after the start of the survey.
    """

    kind: Literal["fmcw", "cw"] = "fmcw"
    position_m: Point2
    height_m: NonNegative = 0.0
    power_dbm: Annotated[Real, Field(ge=-100, le=90)]
    antenna_gain_db: Annotated[Real, Field(ge=-100, le=80)] = 0.0
    carrier_hz: Annotated[Real, Field(ge=1e9, le=300e9)] = 77e9
    bandwidth_hz: Annotated[Real, Field(ge=0, le=1e11)] | None = None
    chirp_rate_hz: Annotated[Real, Field(ge=1e-2, le=1e7)] | None = None
    sweep: Literal["up", "down"] = "up"
    offset_s: Annotated[Real, Field(ge=-1e6, le=1e6)] = 0.0

    @model_validator(mode="after")
    def _sweep_is_given(self) -> Interferer:
        sweep = {"bandwidth_hz": self.bandwidth_hz, "chirp_rate_hz": self.chirp_rate_hz}
        for key, value in sweep.items():
            if self.kind == "fmcw" and value is None:
                raise refuse(key, "missing; give it, or kind = 'cw'")
            if self.kind == "cw" and value is not None:
                raise refuse(key, "a steady carrier has none; remove it, or set kind = 'fmcw'")
        return self
