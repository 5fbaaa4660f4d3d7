"""A second receiver, for the angle of arrival inside the beam: `[radar.second_receiver]`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from sionna_radar.scenario.table import Real, Table, refuse


class SecondReceiverTable(Table):
    """What a second receiver sees beside the first, which stays as it is; both have the noise of one.

    kind: "interferometer" has the antenna's pattern and a phase centre of its own; "monopulse" the difference of the
        antenna's two halves, its sum being the first receiver's; "row" stands for several like an interferometer's,
        evenly spaced with the first: receivers, or virtual ones of a MIMO radar that tells its transmitters apart.
    receivers: of a row, with the first.
    axis: along which its phase centre lies, or the halves do: the antenna's elevation (up) or azimuth (left); "both"
        adds a third receiver, so that each axis has its own; a row then lies along the elevation, with one receiver
        beside it.
    baseline_wavelengths: between the phase centres of an interferometer; without it such that the phase scatters by a
        quarter of a radian over the two-way beam. Between neighbours in a row; without it half of the longest that is
        unambiguous.
    baseline_error_wavelengths: by how much the phase centre lies farther out than processing believes.
    phase_error_deg: of a second receiver against the first, not calibrated out; not for "monopulse".
    """

    kind: Literal["interferometer", "monopulse", "row"] = "interferometer"
    receivers: Annotated[int, Field(strict=True, ge=3, le=32)] | None = None
    axis: Literal["elevation", "azimuth", "both"] = "both"
    baseline_wavelengths: Annotated[Real, Field(ge=0.05, le=1000)] | None = None
    baseline_error_wavelengths: Annotated[Real, Field(ge=-1, le=1)] = 0.0
    phase_error_deg: Annotated[Real, Field(ge=-180, le=180)] = 0.0

    @model_validator(mode="after")
    def _halves_have_no_baseline(self) -> SecondReceiverTable:
        if self.kind == "row" and self.receivers is None:
            raise refuse("receivers", "missing; give how many a row has, for example 8")
        if self.kind != "row" and self.receivers is not None:
            raise refuse("receivers", f"{self.receivers} has no effect on kind = {self.kind!r}; set kind = 'row'")
        if self.kind != "monopulse":
            return self
        given = {"baseline_wavelengths": None, "baseline_error_wavelengths": 0.0, "phase_error_deg": 0.0}
        for name, usual in given.items():
            if getattr(self, name) != usual:
                message = f"has no effect on kind = 'monopulse', whose halves are the antenna's own; remove {name}"
                raise refuse(name, message)
        return self
