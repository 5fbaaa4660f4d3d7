"""Correlation of speckle between pulses, from geometry, beam and motion of the ground.

The field in a range cell is the sum over fixed random scatterers on the ground, weighted with the beam's gain
and the phase of their range. The fields of pulses p and q correlate by the overlap of their
beams and the uniformity of the phase difference over the cell; sums are over directions:

    rho = sum a_p a_q exp(4 pi j (r_q - r_p) / wavelength) / sqrt(sum a_p^2 sum a_q^2),   a^2 = gain^2 / r^2,

and the powers by |rho|^2 (Goodman 2007, "Speckle Phenomena in Optics", section 5). With a slowly turning beam along the
flight direction, speckle persists for many pulses; abeam it decorrelates in centimetres. Overlap and phase are
both nearly Gaussian in pulse separation, so one number per pulse suffices: range errors of pulses n apart have the
correlation exp(-n^2 / reach^2). The ground is a level plane at the echo's range.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.threads import chunks_of_bytes
from sionna_radar.inference.echo.beam import BeamNodes
from sionna_radar.radar.chirp import Chirp
from sionna_radar.surfaces.motion import Windblown

# Directions across the beam, and pulses for which the correlation is computed; others take that of the most similar.
# The directions are random, but always the same.
DIRECTIONS, SAMPLED_PULSES, SEED = 1200, 200, 2007
# Double the lag while the correlation exceeds the first value, up to the second, pulses.
STILL_ALIKE, LONGEST_LAG = 0.7, 256
MIN_CORRELATION = 1e-2
LONG_REACH = 4.0
# Pulses whose poses are held at once: it bounds the memory.

PoseOf = Callable[[Int[np.ndarray, " row"]], Pose]


@dataclass(frozen=True, kw_only=True)
class SpeckleMemory:
    """Temporal decorrelation of the ground's speckle: `tracing.speckle`, `tracing.decorrelation_time_s`.

    decorrelation_s: lag at which the field correlation 1 / (1 + (b t)^2) is 1 / e; infinite for static ground,
        0 for independent speckle in each pulse.
    plants: what the wind moves on the ground; None for nothing.
    """

    decorrelation_s: float = np.inf
    plants: Windblown | None = None

    def correlation(self, lag_s: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the power correlation at a lag, given the motion of scatterers."""
        if self.decorrelation_s == 0:
            return np.where(lag_s == 0, 1.0, 0.0)
        field = 1 / (1 + (np.e - 1) * (lag_s / self.decorrelation_s) ** 2)
        return field**2 if self.plants is None else (field * self.plants.field_correlation(lag_s)) ** 2


STILL = SpeckleMemory()


def speckle_reach(
    pulse: Int[np.ndarray, " pulse"],
    pose_of: PoseOf,
    range_m: Float[np.ndarray, " pulse"],
    beam: BeamNodes,
    chirp: Chirp,
    memory: SpeckleMemory,
    *,
    of_power: bool = False,
) -> Float[np.ndarray, " pulse"]:
    """Return the correlation length of each pulse's speckle, in pulses; 0 if uncorrelated.

    pulse: sorted indices of the pulses in the survey.
    pose_of: returns the measured poses of some of them, by their rows in `pulse`.
    range_m: range of each echo on the axis of the beam.
    beam, chirp, memory: of the radar, and of the ground.
    of_power: of the powers of whole echoes, instead of their mean ranges.
    """
    reach = np.zeros(len(pulse))
    if len(pulse) < 2 or memory.decorrelation_s == 0:
        return reach
    lag, alike = np.ones(len(pulse), dtype=np.int64), np.full(len(pulse), np.nan)
    some = [np.arange(*bounds) for bounds in chunks_of_bytes(len(pulse), 5 * 3 * 8)]
    feature = np.concatenate([_features(pulse, pose_of, range_m, beam, chirp, rows) for rows in some])
    sampled = np.arange(0, len(pulse), max(1, len(pulse) // SAMPLED_PULSES))
    rest, tried = sampled, 1
    while len(rest) and tried <= LONGEST_LAG:
        correlation = _error_correlation(
            pulse, pose_of, range_m, beam, chirp, rest, np.full(len(rest), tried), of_power
        )
        correlation *= memory.correlation(np.full(len(rest), tried / chirp.rate_hz))
        # A lag at which nothing is left says less than the one before it.
        better = np.isfinite(correlation) & ((correlation > MIN_CORRELATION) | (tried == 1))
        lag[rest[better]], alike[rest[better]] = tried, correlation[better]
        rest, tried = rest[better & (correlation > STILL_ALIKE)], 2 * tried
    sampled_valid = sampled[np.isfinite(alike[sampled])]
    if len(sampled_valid) == 0:
        return reach
    squared = -(lag[sampled_valid] ** 2) / np.log(np.clip(alike[sampled_valid], 1e-300, 1 - 1e-9))
    of_known = np.where(alike[sampled_valid] < MIN_CORRELATION, 0.0, np.minimum(np.sqrt(squared), LONGEST_LAG))
    return of_known[KDTree(feature[sampled_valid]).query(feature)[1]]


def repeats(reach: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the variance inflation of a mean by correlated speckle: the sum of correlations over all lags."""
    lags = np.arange(1, int(np.ceil(4 * LONG_REACH)) + 1)
    short = 1 + 2 * np.exp(-((lags / np.clip(reach, 1e-6, LONG_REACH)[:, None]) ** 2)).sum(axis=1)
    # Over many pulses the sum is the integral, to all digits.
    return np.where(reach < LONG_REACH, short, np.sqrt(np.pi) * reach)


def _features(
    pulse: Int[np.ndarray, " pulse"],
    pose_of: PoseOf,
    range_m: Float[np.ndarray, " pulse"],
    beam: BeamNodes,
    chirp: Chirp,
    row: Int[np.ndarray, " row"],
) -> Float[np.ndarray, "row feature"]:
    """Return the predictors of the correlation with the next pulse: motion and turn in the antenna's frame."""
    after = np.minimum(np.append(row, row[-1] + 1), len(pulse) - 1)
    both = pose_of(after)
    pose, ahead = both.rows(slice(0, -1)), both.boresight[1:]
    turn = np.einsum("pji,pj->pi", pose.R_world_antenna, ahead)[:, 1:]
    turn[np.diff(pulse[after]) != 1] = 0.0
    width = np.array([np.ptp(beam.azimuth), np.ptp(beam.elevation)])
    moved = np.einsum("pji,pj->pi", pose.R_world_antenna, pose.velocity_mps) / chirp.rate_hz
    phase = 4 * np.pi * chirp.carrier_hz / chirp.propagation_mps * moved * width.max()
    return np.column_stack([turn / width, phase / 10, np.log(np.maximum(range_m[row], 1e-3)), pose.boresight[:, 2]])


def _error_correlation(
    pulse: Int[np.ndarray, " pulse"],
    pose_of: PoseOf,
    range_m: Float[np.ndarray, " pulse"],
    beam: BeamNodes,
    chirp: Chirp,
    row: Int[np.ndarray, " chosen"],
    lag: Int[np.ndarray, " chosen"],
    of_power: bool,
) -> Float[np.ndarray, " chosen"]:
    """Return the correlation of range errors, or powers, of pulses `lag` apart; NaN where the later one is absent."""
    result = np.full(len(row), np.nan)
    unit = np.random.default_rng(SEED).random((DIRECTIONS, 2))
    low = np.array([beam.azimuth[0], beam.elevation[0]])
    span = np.array([np.ptp(beam.azimuth), np.ptp(beam.elevation)])
    across = low + unit * span
    across = across[np.sum(across**2, axis=1) < 1]
    direction = np.column_stack([np.sqrt(1 - np.sum(across**2, axis=1)), across])
    other = np.minimum(np.searchsorted(pulse, pulse[row] + lag), len(pulse) - 1)
    there = pulse[other] == pulse[row] + lag
    pose, pose_later = pose_of(row[there]), pose_of(other[there])
    away = direction @ pose.R_world_antenna.transpose(0, 2, 1)
    drop = np.maximum(-range_m[row[there]] * pose.boresight[:, 2], 1e-3)
    near = drop[:, None] / np.maximum(-away[..., 2], MIN_GRAZING_SINE)
    # Position errors of a centimetre would hide the phases; the velocity is known better.
    moved = pose.velocity_mps * lag[there, None] / chirp.rate_hz
    later = near[..., None] * away - moved[:, None]
    far = np.linalg.norm(later, axis=-1)
    gain = beam.two_way(direction), beam.two_way(later / far[..., None] @ pose_later.R_world_antenna)
    power, power_later = gain[0] / near**2, gain[1] / far**2
    if there.any():
        result[there] = _echo_correlation(near, far, power, power_later, chirp, of_power)
    return result


def _echo_correlation(
    near: Float[np.ndarray, "pulse n"],
    far: Float[np.ndarray, "pulse n"],
    power: Float[np.ndarray, "pulse n"],
    later: Float[np.ndarray, "pulse n"],
    chirp: Chirp,
    of_power: bool,
) -> Float[np.ndarray, " pulse"]:
    """Return the correlation of the errors of pairs of mean ranges, or powers, from fields in common directions.

    In a power all cells count alike. In a mean range a cell contributes by its distance from that of each pulse:
    where a turning beam climbs in range, what pulls one echo farther pulls the next one nearer.
    """
    field = np.sqrt(power * later) * np.exp(4j * np.pi * chirp.carrier_hz / chirp.propagation_mps * (far - near))
    cell = np.floor(near / chirp.range_resolution_m).astype(np.int64)
    cell -= cell.min(axis=1, keepdims=True)
    pulses, cells = len(cell), int(cell.max()) + 1
    at = (cell + cells * np.arange(pulses)[:, None]).ravel()

    def of_cells(values: Float[np.ndarray, "pulse n"]) -> Float[np.ndarray, "pulse cell"]:
        return np.bincount(at, values.ravel(), pulses * cells).reshape(pulses, cells)

    # Sum over pairs of different directions only: self-pairs bias a small sample.
    both = of_cells(field.real) ** 2 + of_cells(field.imag) ** 2 - of_cells(power * later)
    one, two = of_cells(power), of_cells(later)
    from_one, from_two = (np.ones(each.shape) if of_power else _from_mean(each) for each in (one, two))
    total = np.sqrt(np.sum((from_one * one) ** 2, axis=1) * np.sum((from_two * two) ** 2, axis=1))
    return np.clip(np.sum(from_one * from_two * both, axis=1) / np.maximum(total, 1e-300), 0.0, 1.0)


def _from_mean(power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, "pulse cell"]:
    """Return the offset of each cell from the power-weighted mean cell."""
    cell = np.arange(power.shape[1])
    return cell - (power @ cell / np.maximum(power.sum(axis=1), 1e-300))[:, None]
