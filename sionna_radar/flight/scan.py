"""Antenna scans: where the antenna points at any time.

A custom scan is any object with the method of `Scan`; pass it to `sionna_radar.run(scan=...)`.
"""

from dataclasses import dataclass
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.flight.frames import conical_from_antenna, whisk_broom_from_antenna
from sionna_radar.scenario.radar import ScanTable


@dataclass(frozen=True)
class Pointing:
    """The antenna at some times, in the forward-right-down axes that carry it.

    R_mount_antenna: columns are boresight, left and up of the antenna.
    scan_rad: scan angle, zero in the middle of the sector.
    active: whether the radar sends at that angle.
    scan_number: which scan of the antenna it is, counted from 0; None for one scan without end.
    """

    R_mount_antenna: Float[np.ndarray, "n 3 3"]
    scan_rad: Float[np.ndarray, " n"]
    active: Bool[np.ndarray, " n"]
    scan_number: Int[np.ndarray, " n"] | None = None


@runtime_checkable
class Scan(Protocol):
    """A scan: the antenna's axes against time.

    stabilised: the axes that carry the antenna are level with the platform's heading, or else the body's.
    """

    @property
    def stabilised(self) -> bool:
        """Whether roll and pitch are taken out of the pointing."""
        ...

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""
        ...


@dataclass(frozen=True, kw_only=True)
class RotatingScan:
    """An antenna that turns steadily and sends inside a sector about the middle.

    whisk_broom turns about the forward axis, at a constant angle from the plane across the track;
    conical turns about the downward axis, at a constant angle from nadir; fixed does not turn.
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
        # A scan angle that should lie on the sector's edge must not fall out of it by rounding.
        active = np.abs(scan) <= self.half_swath_rad + 1e-9
        turn = np.floor((angle + np.pi) / (2 * np.pi)) - np.floor((self.start_rad + np.pi) / (2 * np.pi))
        return Pointing(build(self.incidence_rad, scan), scan, active, turn.astype(np.int64))


@dataclass(frozen=True, kw_only=True)
class SideLookingScan:
    """An antenna held to one side of the track, its azimuth cut along the track."""

    side: Literal["left", "right"]
    incidence_rad: float
    stabilised: bool

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""
        turn = np.pi / 2 if self.side == "right" else -np.pi / 2
        axes = conical_from_antenna(self.incidence_rad, np.full(len(time_s), turn))
        return Pointing(axes, np.zeros(len(time_s)), np.ones(len(time_s), dtype=bool))


def build_scan(table: ScanTable) -> Scan:
    """Return the scan of a scenario."""
    if table.mode == "side_looking":
        return SideLookingScan(
            side=table.side,
            incidence_rad=float(np.deg2rad(table.incidence_deg)),
            stabilised=table.stabilised,
        )
    turns = 0.0 if table.mode == "fixed" else table.rotation_rpm / 60
    return RotatingScan(
        mode=table.mode,
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        half_swath_rad=np.pi if table.mode == "fixed" else float(np.deg2rad(table.half_swath_deg)),
        rotation_rad_s=2 * np.pi * turns,
        start_rad=float(np.deg2rad(table.start_deg)),
        stabilised=table.stabilised,
    )
