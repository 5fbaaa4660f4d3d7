"""Arrays that steer their beam by phases, from one direction to the next without turning."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import conical_from_antenna, steering
from sionna_radar.flight.scan import Pointing, register_scan
from sionna_radar.scenario.radar import ElectronicScanTable

LOOKS = {"forward": 0.0, "left": -np.pi / 2, "right": np.pi / 2}


@dataclass(frozen=True, kw_only=True)
class ElectronicScan:
    """A face that stands still in its mount, and beams from its left to its right, one after another.

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
        number = np.floor(scans + 1e-9)
        beam = np.minimum(((scans - number) * self.beams + 1e-6).astype(np.int64), self.beams - 1)
        beam = np.maximum(beam, 0)
        face = conical_from_antenna(self.incidence_rad, np.array([LOOKS[self.look]]))[0]
        axes = np.stack([face @ steering(float(azimuth), 0.0) for azimuth in self.beam_azimuth_rad])
        return Pointing(
            axes[beam],
            -self.beam_azimuth_rad[beam],
            np.ones(len(time_s), dtype=bool),
            number.astype(np.int64),
            beam=beam,
        )

    def spacing_m(self, height_m: float, speed_mps: float, chirp_rate_hz: float) -> float:
        """Return the largest distance between neighbouring beam centres on level ground."""
        face = conical_from_antenna(self.incidence_rad, np.array([LOOKS[self.look]]))[0]
        directions = np.stack([(face @ steering(float(azimuth), 0.0))[:, 0] for azimuth in self.beam_azimuth_rad])
        down = np.maximum(directions[:, 2], np.cos(np.deg2rad(85.0)))
        place = height_m * directions[:, :2] / down[:, None]
        across = float(np.linalg.norm(np.diff(place, axis=0), axis=1).max())
        return max(speed_mps / self.scans_per_s, across)


@register_scan("electronic", ElectronicScanTable)
def electronic_scan(table: ElectronicScanTable) -> ElectronicScan:
    """Return the scan of a scenario's table."""
    return ElectronicScan(
        look=table.look,
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        half_swath_rad=float(np.deg2rad(table.half_swath_deg)),
        beams=table.beams,
        scans_per_s=table.scans_per_s,
        stabilised=table.stabilised,
    )
