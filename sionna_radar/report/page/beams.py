"""The beams of some pulses: rays inside the main lobe to where they meet the scene, and the outline at half power."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import LIT, reach_of_power
from sionna_radar.report.page.packing import Pack
from sionna_radar.survey.preparation import Prepared

RAYS, OUTLINE_RAYS = 72, 24
# Two-way power that the rays leave out: the outermost are about 15 dB down.
OUTSIDE = 0.03
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
    left, up = (min(reach, 0.7) for reach in reach_of_power(antenna, OUTSIDE))
    turn = GOLDEN_RAD * np.arange(RAYS)
    out = np.sqrt((np.arange(RAYS) + 0.5) / RAYS)
    u, v = left * out * np.cos(turn), up * out * np.sin(turn)
    spread = np.column_stack([np.sqrt(np.maximum(1 - u**2 - v**2, 0.0)), u, v])
    direction = np.concatenate([[[1.0, 0.0, 0.0]], _outline(antenna), spread])
    ratio = np.maximum(antenna.gain(direction) / antenna.peak_gain, 1e-5)
    return Fan(direction=direction, gain_db=20 * np.log10(ratio))


def _outline(antenna: Antenna) -> Float[np.ndarray, "ray 3"]:
    """Return the directions around the boresight in which the gain first falls to half of the peak's."""
    around = 2 * np.pi * np.arange(OUTLINE_RAYS) / OUTLINE_RAYS
    # Steps grow with the angle: beams are one degree wide or fifty.
    off = WIDEST_RAD * np.linspace(0.0, 1.0, OUTLINE_STEPS + 1)[1:] ** 3
    angle, turn = np.meshgrid(off, around)
    direction = np.stack([np.cos(angle), np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn)], axis=-1)
    gain = antenna.gain(direction.reshape(-1, 3)).reshape(angle.shape)

    level = 20 * np.log10(np.maximum(gain / antenna.peak_gain, 1e-9)) - 10 * np.log10(LIT)
    rows, first = np.arange(OUTLINE_RAYS), np.maximum((level < 0).argmax(axis=1), 1)
    first[~(level < 0).any(axis=1)] = OUTLINE_STEPS - 1
    before, after = level[rows, first - 1], level[rows, first]
    share = np.clip(before / np.maximum(before - after, 1e-9), 0.0, 1.0)
    out = off[first - 1] + share * (off[first] - off[first - 1])
    return np.column_stack([np.cos(out), np.sin(out) * np.cos(around), np.sin(out) * np.sin(around)])


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
