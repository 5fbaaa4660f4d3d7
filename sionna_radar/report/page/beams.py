"""The beams of some pulses: rays inside the main lobe to where they meet the scene, and the outline at half power."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import LIT
from sionna_radar.report.page.packing import Pack
from sionna_radar.survey.preparation import Prepared

RAYS, OUTLINE_RAYS = 72, 24
# The rays reach so much farther than half power: the outermost are about 11 dB down, there and back.
REACH = 1.35
# An outline is searched so far from the boresight, in so many steps.
WIDEST_RAD, OUTLINE_STEPS = float(np.deg2rad(80.0)), 60
GOLDEN_RAD = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, kw_only=True)
class Fan:
    """Directions of a beam in its frame: first the boresight, then for an antenna the outline, then the rays.

    gain_db: two-way, over the peak.
    """

    direction: Float[np.ndarray, "ray 3"]
    gain_db: Float[np.ndarray, " ray"]


AXIS = Fan(direction=np.array([[1.0, 0.0, 0.0]]), gain_db=np.zeros(1))


@dataclass(frozen=True, kw_only=True)
class Beams:
    """Beams of pulses, and how far their rays go; NaN for one that meets nothing."""

    pulses: Pulses
    fans: tuple[Fan, ...]
    fan: Int[np.ndarray, " pulse"]
    distance_m: Float[np.ndarray, "pulse ray"]

    @property
    def hit_m(self) -> Float[np.ndarray, "pulse ray 3"]:
        """Where the rays meet the scene."""
        directions = np.stack([fan.direction for fan in self.fans])[self.fan]
        return _ends(self.pulses, directions, self.distance_m)

    @property
    def outline_m(self) -> Float[np.ndarray, "pulse ray 3"]:
        """The outline of each footprint at half power."""
        return self.hit_m[:, 1 : 1 + OUTLINE_RAYS]

    def packed(self, pack: Pack) -> dict[str, Any]:
        """Return the beams for a page, which computes the ends of the rays itself."""
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
    """Return the beams of some pulses of a survey, cast against its scene; of a lidar the axes alone."""
    pulses = prepared.flight.pulses(index)
    steered = bool(prepared.beams) and pulses.beam is not None
    antennas = prepared.beams if steered else (prepared.antenna,)
    fans = (AXIS,) * len(antennas) if prepared.scenario.sensor == "lidar" else tuple(map(fan_of, antennas))
    fan = np.asarray(pulses.beam if steered else np.zeros(len(pulses)), dtype=np.int64)
    local = np.stack([each.direction for each in fans])[fan]
    direction = np.einsum("pij,pkj->pki", pulses.true.R_world_antenna, local)
    origin = np.broadcast_to(pulses.true.position_m[:, None], direction.shape)
    found = prepared.scene.caster.cast(origin.reshape(-1, 3), direction.reshape(-1, 3)).distance_m
    # Beyond the sampled ranges a ray hears nothing.
    heard = found <= prepared.receiver.chirp.max_range_m
    distance_m = np.where(heard, found, np.nan).reshape(fan.size, -1)
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
    """Return how far from the boresight, toward some sides, the gain first falls to half of the peak's."""
    # Steps grow with the angle: beams are one degree wide or fifty.
    off = WIDEST_RAD * np.linspace(0.0, 1.0, OUTLINE_STEPS + 1)[1:] ** 3
    gain = antenna.gain(_directions(*(grid.ravel() for grid in np.meshgrid(off, around))))
    level = 20 * np.log10(np.maximum(gain / antenna.peak_gain, 1e-9)) - 10 * np.log10(LIT)
    level = level.reshape(len(around), len(off))
    rows, first = np.arange(len(around)), np.maximum((level < 0).argmax(axis=1), 1)
    first[~(level < 0).any(axis=1)] = len(off) - 1
    before, after = level[rows, first - 1], level[rows, first]
    share = np.clip(before / np.maximum(before - after, 1e-9), 0.0, 1.0)
    return off[first - 1] + share * (off[first] - off[first - 1])


def _directions(off: Float[np.ndarray, " ray"], around: Float[np.ndarray, " ray"]) -> Float[np.ndarray, "ray 3"]:
    """Return unit vectors at angles off the boresight, toward the left and on to up around it."""
    return np.column_stack([np.cos(off), np.sin(off) * np.cos(around), np.sin(off) * np.sin(around)])


def _ends(
    pulses: Pulses, local: Float[np.ndarray, "pulse ray 3"], distance_m: Float[np.ndarray, "pulse ray"]
) -> Float[np.ndarray, "pulse ray 3"]:
    direction = np.einsum("pij,pkj->pki", pulses.true.R_world_antenna, local)
    return pulses.true.position_m[:, None] + distance_m[..., None] * direction


def spread_pulses(count: int, most: int) -> Int[np.ndarray, " pulse"]:
    """Return pulses spread over a survey by the golden ratio's steps, which no rotation of an antenna repeats."""
    if count <= most:
        return np.arange(count)
    step = count / most
    # A regular step would alias with the scan; each pulse is drawn from its own part of the survey.
    within = (np.arange(most) * (np.sqrt(5) - 1) / 2) % 1.0
    return np.unique(np.floor((np.arange(most) + within) * step).astype(np.int64))
