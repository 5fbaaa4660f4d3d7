"""Antenna scans and their registry: rotating, fixed, side-looking, and electronically steered."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.flight.frames import conical_from_antenna, steering, whisk_broom_from_antenna


@dataclass(frozen=True)
class Pointing:
    """The antenna at some times, in the forward-right-down axes of its mount.

    R_mount_antenna: columns are boresight, left and up of the antenna.
    scan_rad: scan angle, zero in the middle of the sector.
    active: whether the radar transmits at that angle.
    scan_number: scan of the antenna, from 0; None for a continuous scan.
    beam: index of an array's steered beam (`beam_azimuth_rad`); None for a fixed pattern.
    """

    R_mount_antenna: Float[np.ndarray, "n 3 3"]
    scan_rad: Float[np.ndarray, " n"]
    active: Bool[np.ndarray, " n"]
    scan_number: Int[np.ndarray, " n"] | None = None
    beam: Int[np.ndarray, " n"] | None = None


@runtime_checkable
class Scan(Protocol):
    """A scan: the antenna's axes against time."""

    @property
    def stabilised(self) -> bool:
        """Whether roll and pitch are removed from the pointing: the mount is level, not fixed to the body."""

    @property
    def incidence_rad(self) -> float:
        """Angle of the boresight from nadir in the middle of the scan: the reference of `radar.snr_db`."""

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the largest distance between neighbouring beam centres on level ground: DEM gaps to fill."""


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
        # The tolerance keeps scan angles on the sector's edge inside despite rounding.
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


@dataclass(frozen=True, kw_only=True)
class SideLookingScan:
    """An antenna pointing to one side of the track, its azimuth cut along the track."""

    side: Literal["left", "right"]
    incidence_rad: float
    stabilised: bool

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times."""
        turn = np.pi / 2 if self.side == "right" else -np.pi / 2
        axes = conical_from_antenna(self.incidence_rad, np.full(len(time_s), turn))
        return Pointing(axes, np.zeros(len(time_s)), np.ones(len(time_s), dtype=bool))

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the distance between neighbouring beam centres along the track."""
        return speed_mps / chirp_rate_hz


LOOKS = {"forward": 0.0, "left": -np.pi / 2, "right": np.pi / 2}


@dataclass(frozen=True, kw_only=True)
class ElectronicScan:
    """A face fixed in its mount, with beams stepped from its left to its right.

    The antenna of a pulse is that of its beam: x along it.
    """

    look: Literal["forward", "left", "right"]
    incidence_rad: float
    half_swath_rad: float
    beams: int
    scans_per_s: float
    stabilised: bool

    @cached_property
    def beam_azimuth_rad(self) -> Float[np.ndarray, " beam"]:
        """Azimuth of each beam from the normal of the face, toward the left; equal steps of direction cosine."""
        return np.arcsin(np.linspace(1, -1, self.beams) * np.sin(self.half_swath_rad))

    def point(self, time_s: Float[np.ndarray, " n"]) -> Pointing:
        """Return the pointing at some times, with the beam of each."""
        scans = self.scans_per_s * time_s
        scan_number = np.floor(scans + 1e-9)
        beam = np.minimum(((scans - scan_number) * self.beams + 1e-6).astype(np.int64), self.beams - 1)
        beam = np.maximum(beam, 0)
        face = conical_from_antenna(self.incidence_rad, np.array([LOOKS[self.look]]))[0]
        axes = np.stack([face @ steering(float(azimuth), 0.0) for azimuth in self.beam_azimuth_rad])
        return Pointing(
            axes[beam],
            -self.beam_azimuth_rad[beam],
            np.ones(len(time_s), dtype=bool),
            scan_number.astype(np.int64),
            beam=beam,
        )

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the largest distance between neighbouring beam centres on level ground."""
        face = conical_from_antenna(self.incidence_rad, np.array([LOOKS[self.look]]))[0]
        directions = np.stack([(face @ steering(float(azimuth), 0.0))[:, 0] for azimuth in self.beam_azimuth_rad])
        cos_incidence = np.maximum(directions[:, 2], np.cos(np.deg2rad(85.0)))
        ground_points = height_m * directions[:, :2] / cos_incidence[:, None]
        beam_spacing_m = float(np.linalg.norm(np.diff(ground_points, axis=0), axis=1).max())
        return max(speed_mps / self.scans_per_s, beam_spacing_m)


def sector(scan: Scan, height_m: float, spacing_m: float) -> Float[np.ndarray, "n 3 3"] | None:
    """Return the pointings of a scan's whole sector, in the axes of its mount; None for a scan of another kind.

    Neighbours lie at most `spacing_m` apart on level ground, but for the beams of an electronic scan, which are those
    it has.
    """
    if isinstance(scan, ElectronicScan):
        time_s = (np.arange(scan.beams) + 0.5) / (scan.beams * scan.scans_per_s)
    elif isinstance(scan, RotatingScan) and scan.rotation_rad_s != 0:
        turn_s = 2 * np.pi / abs(scan.rotation_rad_s)
        steps = int(np.ceil(turn_s * abs(scan.spacing_m(height_m, 0.0, 1.0)) / spacing_m))
        time_s = np.linspace(0.0, turn_s, max(steps, 2))
    elif isinstance(scan, RotatingScan | SideLookingScan):
        time_s = np.zeros(1)
    else:
        return None
    pointing = scan.point(time_s)
    return pointing.R_mount_antenna[pointing.active]
