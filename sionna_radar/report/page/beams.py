"""Beams of a page: the rays of an antenna's main lobe, cast against the scene."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import LIT, Antenna
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.survey.preparation import Prepared

RAYS, OUTLINE_RAYS = 72, 24
# Angle of the outermost rays over the half-power angle; there the two-way gain is about 11 dB down.
REACH = 1.35
# Limit of the search for an outline off the boresight, and its number of steps.
WIDEST_RAD, OUTLINE_STEPS = float(np.deg2rad(80.0)), 60
GOLDEN_RAD = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, kw_only=True)
class Fan:
    """Directions of a beam in its frame: the boresight, then for an antenna the outline and the rays.

    gain_db: two-way, over the peak.
    """

    direction: Float[np.ndarray, "ray 3"]
    gain_db: Float[np.ndarray, " ray"]


AXIS = Fan(direction=np.array([[1.0, 0.0, 0.0]]), gain_db=np.zeros(1))


@dataclass(frozen=True, kw_only=True)
class Beams:
    """Beams of pulses, and the lengths of their rays; NaN without a hit."""

    pulses: Pulses
    fans: tuple[Fan, ...]
    fan: Int[np.ndarray, " pulse"]
    distance_m: Float[np.ndarray, "pulse ray"]

    @property
    def hit_m(self) -> Float[np.ndarray, "pulse ray 3"]:
        """Intersections of the rays with the scene."""
        pose, local = self.pulses.true, np.stack([fan.direction for fan in self.fans])[self.fan]
        direction = np.einsum("pij,pkj->pki", pose.R_world_antenna, local)
        return pose.position_m[:, None] + self.distance_m[..., None] * direction

    @property
    def outline_m(self) -> Float[np.ndarray, "pulse ray 3"]:
        """The outline of each footprint at half power."""
        return self.hit_m[:, 1 : 1 + OUTLINE_RAYS]

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the beams for a page, which computes the ends of the rays."""
        pose = self.pulses.true
        return {
            "pulse": pack.whole(self.pulses.index),
            "time_s": pack.exact(self.pulses.time_s),
            "scan_deg": pack.exact(np.rad2deg(self.pulses.scan_rad)),
            "position": pack.exact(pose.position_m),
            "turn": pack.exact(pose.R_world_antenna),
            "fan": pack.whole(self.fan),
            "directions": pack.exact(np.stack([fan.direction for fan in self.fans])),
            "gain_db": pack.rounded(np.stack([fan.gain_db for fan in self.fans]), 0.1),
            "distance": pack.rounded(self.distance_m, 0.01),
            "outline": min(OUTLINE_RAYS, self.distance_m.shape[1] - 1),
        }


def cast_beams(prepared: Prepared, index: Int[np.ndarray, " pulse"]) -> Beams:
    """Return the beams of some pulses of a survey, cast against its scene; for a lidar the axes only."""
    pulses = prepared.flight.pulses(index)
    steered = bool(prepared.instrument.beams) and pulses.beam is not None
    antennas = prepared.instrument.beams if steered else (prepared.instrument.antenna,)
    fans = (AXIS,) * len(antennas) if prepared.scenario.sensor == "lidar" else tuple(map(fan_of, antennas))
    fan = np.asarray(pulses.beam if steered else np.zeros(len(pulses)), dtype=np.int64)
    local = np.stack([entry.direction for entry in fans])[fan]
    direction = np.einsum("pij,pkj->pki", pulses.true.R_world_antenna, local)
    origin = np.broadcast_to(pulses.true.position_m[:, None], direction.shape)
    range_m = prepared.world.caster.cast(origin.reshape(-1, 3), direction.reshape(-1, 3)).distance_m
    # Hits beyond the sampled ranges give no echo.
    in_range = range_m <= prepared.receiver.chirp.max_range_m
    distance_m = np.where(in_range, range_m, np.nan).reshape(fan.size, -1)
    return Beams(pulses=pulses, fans=fans, fan=fan, distance_m=distance_m)


def fan_of(antenna: Antenna) -> Fan:
    """Return the directions of an antenna's beam, spread evenly over its main lobe (Vogel's spiral)."""
    around = 2 * np.pi * np.arange(OUTLINE_RAYS) / OUTLINE_RAYS
    edge = _half_power_rad(antenna, around)
    turn = np.mod(GOLDEN_RAD * np.arange(RAYS), 2 * np.pi)
    off = REACH * np.sqrt((np.arange(RAYS) + 0.5) / RAYS) * np.interp(turn, around, edge, period=2 * np.pi)
    spread = _directions(np.minimum(off, WIDEST_RAD), turn)
    direction = np.concatenate([[[1.0, 0.0, 0.0]], _directions(edge, around), spread])
    ratio = np.maximum(antenna.gain(direction) / antenna.peak_gain, 1e-5)
    return Fan(direction=direction, gain_db=20 * np.log10(ratio))


def _half_power_rad(antenna: Antenna, around: Float[np.ndarray, " ray"]) -> Float[np.ndarray, " ray"]:
    """Return the half-power angles off the boresight in some directions around it, rad."""
    # Steps grow with the angle: beam widths range from one to fifty degrees.
    off = WIDEST_RAD * np.linspace(0.0, 1.0, OUTLINE_STEPS + 1)[1:] ** 3
    gain = antenna.gain(_directions(*(grid.ravel() for grid in np.meshgrid(off, around))))
    level = 20 * np.log10(np.maximum(gain / antenna.peak_gain, 1e-9)) - 10 * np.log10(LIT)
    level = level.reshape(len(around), len(off))
    rows, crossing = np.arange(len(around)), np.maximum((level < 0).argmax(axis=1), 1)
    crossing[~(level < 0).any(axis=1)] = len(off) - 1
    above, below = level[rows, crossing - 1], level[rows, crossing]
    share = np.clip(above / np.maximum(above - below, 1e-9), 0.0, 1.0)
    return off[crossing - 1] + share * (off[crossing] - off[crossing - 1])


def _directions(off: Float[np.ndarray, " ray"], around: Float[np.ndarray, " ray"]) -> Float[np.ndarray, "ray 3"]:
    """Return unit vectors at angles off the boresight, toward the left and on to up around it."""
    return np.column_stack([np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)])
