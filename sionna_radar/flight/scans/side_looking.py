"""An antenna pointing to one side of the track."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from sionna_radar.flight.frames import conical_from_antenna
from sionna_radar.flight.scan import Pointing, register_scan
from sionna_radar.scenario.radar import ScanTable


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


@register_scan("side_looking", ScanTable)
def side_looking_scan(table: ScanTable) -> SideLookingScan:
    """Return the scan of a scenario's table."""
    return SideLookingScan(
        side=table.side,
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        stabilised=table.stabilised,
    )
