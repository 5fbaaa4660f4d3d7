"""Antennas that rotate steadily about one axis, or are fixed."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import conical_from_antenna, whisk_broom_from_antenna
from sionna_radar.flight.scan import Pointing, register_scan
from sionna_radar.scenario.radar import ScanTable


@dataclass(frozen=True, kw_only=True)
class RotatingScan:
    """An antenna that rotates steadily and transmits inside a sector about the middle.

    whisk_broom rotates about the forward axis, at a constant angle from the plane across the track;
    conical rotates about the downward axis, at a constant angle from nadir; fixed does not rotate.
    """

    mode: Literal["whisk_broom", "conical", "fixed"]
    incidence_rad: float
    half_swath_rad: float
    rotation_rad_s: float
    start_rad: float
    stabilised: bool

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""
        angle = self.start_rad + self.rotation_rad_s * time_s
        scan = np.mod(angle + np.pi, 2 * np.pi) - np.pi
        build = conical_from_antenna if self.mode == "conical" else whisk_broom_from_antenna
        # A scan angle on the sector's edge must not fall outside by rounding.
        active = np.abs(scan) <= self.half_swath_rad + 1e-9
        turn = np.floor((angle + np.pi) / (2 * np.pi)) - np.floor((self.start_rad + np.pi) / (2 * np.pi))
        return Pointing(build(self.incidence_rad, scan), scan, active, turn.astype(np.int64))

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the largest distance between neighbouring beam centres on level ground."""
        if self.rotation_rad_s == 0:
            return speed_mps / chirp_rate_hz
        line = speed_mps * 2 * np.pi / self.rotation_rad_s
        step = self.rotation_rad_s / chirp_rate_hz
        if self.mode == "conical":
            across = height_m * np.tan(self.incidence_rad) * step
        else:
            across = height_m / np.cos(self.half_swath_rad) ** 2 / np.cos(self.incidence_rad) * step
        return float(max(line, across))


@register_scan("whisk_broom", ScanTable)
@register_scan("conical", ScanTable)
@register_scan("fixed", ScanTable)
def rotating_scan(table: ScanTable) -> RotatingScan:
    """Return the scan of a scenario's table; a fixed one does not rotate."""
    assert table.mode != "side_looking"
    turns = 0.0 if table.mode == "fixed" else table.rotation_rpm / 60
    return RotatingScan(
        mode=table.mode,
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        half_swath_rad=np.pi if table.mode == "fixed" else float(np.deg2rad(table.half_swath_deg)),
        rotation_rad_s=2 * np.pi * turns,
        start_rad=float(np.deg2rad(table.start_deg)),
        stabilised=table.stabilised,
    )
