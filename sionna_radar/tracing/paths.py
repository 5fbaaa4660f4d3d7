"""The `Paths` table that every engine returns, the interface of engines, and paths without ray tracing.

Each scatterer has a Doppler shift of its own for good, drawn from the two-sided exponential distribution that the
spectra of windblown vegetation show (Billingsley 2002, "Low-Angle Radar Land Clutter"). The shifts turn phases
and do not move the scatterers, which stay where they are in the mean.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.columns import Columns
from sionna_radar.radar.antenna import Antenna
from sionna_radar.scene.raycast import RayCaster

# Values of `Paths.surface` where no surface is hit.
TARGET = -1
VOLUME = -2
VEGETATION = -3
BOUNCED = -4
# Targets and then thin obstacles count down from here, by their number in the scene.
FIRST_OBSTACLE = -16


@dataclass(frozen=True, kw_only=True)
class Paths(Columns):
    """Paths from a radar back to itself, one row each, sorted by pulse; of one bounce but for those marked.

    pulse: index of the pulse in the survey.
    delay_s: two-way delay at the middle of the chirp.
    gain: received over transmitted wave; |gain|^2 is a power ratio, the phase excludes the delay.
    range_rate_mps: positive when receding.
    incidence_rad: angle between the ray and the surface normal; NaN for point targets, volume cells, plants
        and two bounces.
    hit_m: where the surface is hit, world frame; for a volume cell, its position on the boresight. Of two bounces it is
        the last, from where the wave arrives.
    surface: index of the surface in the scene; TARGET (-1) for none, as of leakage, VOLUME (-2) for a volume
        cell: rain, snow, fog, dust; VEGETATION (-3) for plants; BOUNCED (-4) for two surfaces in a row; from
        FIRST_OBSTACLE (-16) down targets, wires, poles and fences, by their number in the scene.
    """

    pulse: Int[np.ndarray, " path"]
    delay_s: Float[np.ndarray, " path"]
    gain: Complex[np.ndarray, " path"]
    range_rate_mps: Float[np.ndarray, " path"]
    incidence_rad: Float[np.ndarray, " path"]
    hit_m: Float[np.ndarray, "path 3"]
    surface: Int[np.ndarray, " path"]

    @classmethod
    def concatenate(cls, tables: Sequence["Paths"]) -> "Paths":
        """Return all rows of some tables, sorted by pulse; equal pulses keep the given order."""
        together = super().concatenate(tables)
        if np.all(together.pulse[1:] >= together.pulse[:-1]):
            return together
        return together.rows(np.argsort(together.pulse, kind="stable"))

    @classmethod
    def none(cls) -> "Paths":
        """Return no paths."""
        index, number = np.zeros(0, dtype=np.int64), np.zeros(0)
        return cls(
            pulse=index,
            delay_s=number,
            gain=number.astype(np.complex128),
            range_rate_mps=number,
            incidence_rad=number,
            hit_m=np.zeros((0, 3)),
            surface=index,
        )

    def read_m(self, shift_s: float) -> Float[np.ndarray, " path"]:
        """Return the ranges that a sweep reads, which shifts them by `shift_s` m for each m/s; negative beats fold."""
        return np.abs(self.delay_s * (speed_of_light / 2) + shift_s * self.range_rate_mps)

    @classmethod
    def to_points(
        cls,
        pulses: Pulses,
        row: Int[np.ndarray, " path"],
        hit_m: Float[np.ndarray, "path 3"],
        *,
        gain: Complex[np.ndarray, " path"],
        incidence_rad: Float[np.ndarray, " path"],
        surface: Int[np.ndarray, " path"],
    ) -> "Paths":
        """Return paths from the true poses of pulses to stationary points, delay and range rate from the geometry.

        Parameters
        ----------
        pulses, row:
            A block of pulses, and the row in it of each path.
        hit_m, gain, incidence_rad, surface:
            See the columns.
        """
        pose = pulses.true
        away = hit_m - pose.position_m[row]
        range_m = np.linalg.norm(away, axis=1)
        return cls(
            pulse=pulses.index[row],
            delay_s=2 * range_m / speed_of_light,
            gain=gain,
            range_rate_mps=-np.einsum("ni,ni->n", pose.velocity_mps[row], away / range_m[:, None]),
            incidence_rad=incidence_rad,
            hit_m=hit_m,
            surface=surface,
        )

    @classmethod
    def along_boresight(
        cls,
        pulses: Pulses,
        row: Int[np.ndarray, " path"],
        range_m: Float[np.ndarray, " path"],
        *,
        gain: Complex[np.ndarray, " path"],
        incidence_rad: Float[np.ndarray, " path"],
        surface: Int[np.ndarray, " path"],
        drift_mps: Float[np.ndarray, " path"] | float = 0.0,
    ) -> "Paths":
        """Return paths along the true boresights of pulses.

        Parameters
        ----------
        pulses, row:
            A block of pulses, and the row in it of each path.
        range_m:
            Range of each path along the boresight.
        gain, incidence_rad, surface:
            See the columns.
        drift_mps:
            Range rate of the scatterer itself, such as falling rain.
        """
        pose = pulses.true
        return cls(
            pulse=pulses.index[row],
            delay_s=2 * range_m / speed_of_light,
            gain=gain,
            range_rate_mps=pose.boresight_range_rate_mps[row] + drift_mps,
            incidence_rad=incidence_rad,
            hit_m=pose.position_m[row] + range_m[:, None] * pose.boresight[row],
            surface=surface,
        )


def wander_hz(decorrelation_time_s: float) -> float:
    """Return the mean size of the Doppler shifts, for the time after which the field's correlation has fallen to 1 / e.

    The characteristic function of the two-sided exponential distribution of mean size s is 1 / (1 + (2 pi s t)^2), the
    correlation of the field with itself a time t later.
    """
    return math.sqrt(math.e - 1) / (2 * math.pi * decorrelation_time_s)


def trace_boresights(pulses: Pulses, caster: RayCaster) -> Paths:
    """Return the paths along the beam axes, with unit gain; a pulse without a hit has none."""
    pose = pulses.true
    hits = caster.cast(pose.position_m, pose.boresight)
    seen = hits.hit
    range_m = hits.distance_m[seen]
    return Paths.along_boresight(
        pulses,
        np.flatnonzero(seen),
        range_m,
        gain=np.ones(len(range_m), dtype=np.complex128),
        incidence_rad=np.arccos(hits.cosine[seen]),
        surface=hits.surface[seen],
    )


# Where the paths of each pulse begin, and where they end.
Spans = tuple[Int[np.ndarray, " pulse"], Int[np.ndarray, " pulse"]]


@dataclass(frozen=True, kw_only=True)
class DevicePaths:
    """The paths of a block of pulses, as arrays of Dr.Jit; see `Paths` for what they hold.

    pulses: the block.
    spans: one or more parts of the arrays, each sorted by pulse.
    delay_s, range_rate_mps, gain: of 64, 32 and twice 32 bits; the gain of a path that is hidden is zero.
    paths: the same in the memory of the host, for whoever compares with the truth.
    """

    pulses: Pulses
    spans: tuple[Spans, ...]
    delay_s: Any
    range_rate_mps: Any
    gain: Any
    paths: Paths


@runtime_checkable
class DeviceTracing(Protocol):
    """An engine whose paths stay in the memory of the ray tracer."""

    def on_device(self, pulses: Pulses) -> Iterator[DevicePaths]:
        """Yield the paths of a block of pulses, a part of the block at a time."""


@dataclass(frozen=True, kw_only=True)
class SampledBeams(Columns):
    """Beams of pulses spread over a survey.

    range_m: along the axis to the surface; infinite for a beam that meets none.
    beam: which of the antennas each looks through.
    """

    position_m: Float[np.ndarray, "look 3"]
    R_world_antenna: Float[np.ndarray, "look 3 3"]
    range_m: Float[np.ndarray, " look"]
    beam: Int[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "look 3"]:
        """Where the axes meet the surface."""
        return self.position_m + self.range_m[:, None] * self.R_world_antenna[:, :, 0]


@runtime_checkable
class Engine(Protocol):
    """Traces the surfaces of a scene."""

    def trace(self, pulses: Pulses) -> Paths:
        """Return the paths of a block of pulses."""


@runtime_checkable
class SteerableEngine(Engine, Protocol):
    """An engine for the beams of an electronic scan."""

    def with_antenna(self, antenna: Antenna) -> Engine:
        """Return the same engine with another antenna."""
