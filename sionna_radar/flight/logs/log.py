"""What is in a log of a flight, whatever its format.

Times are seconds from the first position. Positions are east, north, up in metres about an origin of the log's own, or
longitude, latitude (WGS 84, degrees) and height. Velocities are east, north, up. Attitudes rotate body axes (nose,
right, down) to north, east, down; north is that of the positions: true north for longitude and latitude.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

Datum = Literal["mean sea level", "unknown", "take-off"]


@dataclass(frozen=True, kw_only=True)
class Positions:
    """Positions with the source they come from.

    place: degrees and metres, or metres; see the module.
    velocity_mps: None where the source has none.
    """

    source: str
    time_s: Float[np.ndarray, " n"]
    place: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"] | None = None

    def rows(self, wanted: Bool[np.ndarray, " n"]) -> "Positions":
        """Return some of the rows."""
        velocity = None if self.velocity_mps is None else self.velocity_mps[wanted]
        return replace(self, time_s=self.time_s[wanted], place=self.place[wanted], velocity_mps=velocity)


@dataclass(frozen=True, kw_only=True)
class Attitudes:
    """Attitudes as unit quaternions (x, y, z, w) from body to north-east-down."""

    source: str
    time_s: Float[np.ndarray, " n"]
    quaternion: Float[np.ndarray, "n 4"]

    def rows(self, wanted: Bool[np.ndarray, " n"]) -> "Attitudes":
        """Return some of the rows."""
        return replace(self, time_s=self.time_s[wanted], quaternion=self.quaternion[wanted])


@dataclass(frozen=True, kw_only=True)
class Spreads:
    """Standard deviations that a log states, or that its innovations show.

    position_m, velocity_mps: east, north, up; attitude_rad: roll, pitch, heading. NaN where the log does not know.
    """

    source: str
    time_s: Float[np.ndarray, " n"]
    position_m: Float[np.ndarray, "n 3"]
    velocity_mps: Float[np.ndarray, "n 3"]
    attitude_rad: Float[np.ndarray, "n 3"]

    def rows(self, wanted: Bool[np.ndarray, " n"]) -> "Spreads":
        """Return some of the rows."""
        return replace(
            self,
            time_s=self.time_s[wanted],
            position_m=self.position_m[wanted],
            velocity_mps=self.velocity_mps[wanted],
            attitude_rad=self.attitude_rad[wanted],
        )


@dataclass(frozen=True, kw_only=True)
class Source:
    """A stream of a log: how many rows it has, and over which time."""

    name: str
    rows: int
    duration_s: float

    @property
    def rate_hz(self) -> float:
        """Mean rate."""
        return (self.rows - 1) / self.duration_s if self.rows > 1 and self.duration_s > 0 else 0.0


@dataclass(frozen=True, kw_only=True)
class FlightLog:
    """A log as it was read.

    kind: the format, in words; on_map: whether positions are longitude and latitude.
    datum: what heights count from. sources: all streams that were found; notes: what was done to read them.
    """

    kind: str
    on_map: bool
    datum: Datum
    positions: Positions
    attitudes: Attitudes | None
    spreads: Spreads | None
    sources: tuple[Source, ...]
    notes: tuple[str, ...] = ()


def source_of(name: str, time_s: Float[np.ndarray, " n"]) -> Source:
    """Return the source of some rows."""
    finite = time_s[np.isfinite(time_s)]
    return Source(name=name, rows=len(time_s), duration_s=float(np.ptp(finite)) if len(finite) else 0.0)


def spreads_of(
    source: str,
    time_s: Float[np.ndarray, " n"],
    position_m: Float[np.ndarray, "n 3"] | None = None,
    velocity_mps: Float[np.ndarray, "n 3"] | None = None,
    attitude_rad: Float[np.ndarray, "n 3"] | None = None,
) -> Spreads:
    """Return standard deviations, of which those not given are unknown."""
    unknown = np.full((len(time_s), 3), np.nan)
    return Spreads(
        source=source,
        time_s=time_s,
        position_m=unknown if position_m is None else position_m,
        velocity_mps=unknown if velocity_mps is None else velocity_mps,
        attitude_rad=unknown if attitude_rad is None else attitude_rad,
    )


def running_rms(
    time_s: Float[np.ndarray, " n"], value: Float[np.ndarray, "n 3"], span_s: float = 10.0
) -> Float[np.ndarray, "n 3"]:
    """Return the root mean square of values over a span of time about each; NaN counts for nothing.

    Innovations, the differences between measured and predicted positions, hold the errors of both: their RMS is an
    upper bound of the error of the estimate as long as the two are independent.
    """
    order = np.argsort(time_s, kind="stable")
    sorted_s = time_s[order]
    known = np.isfinite(value[order])
    total = np.vstack([np.zeros((1, 3)), np.cumsum(np.where(known, value[order], 0.0) ** 2, axis=0)])
    count = np.vstack([np.zeros((1, 3)), np.cumsum(known, axis=0)])
    low = np.searchsorted(sorted_s, sorted_s - span_s / 2, side="left")
    high = np.searchsorted(sorted_s, sorted_s + span_s / 2, side="right")
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt(np.maximum(total[high] - total[low], 0.0) / (count[high] - count[low]))
    back: Float[np.ndarray, "n 3"] = np.empty_like(rms)
    back[order] = rms
    return back
