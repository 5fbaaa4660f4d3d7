"""Prior of the ground's echo behind a volume: its level, learned from a survey, and its slope, from a scan line.

Both shape the echo. On ground whose sigma0 falls with the cosine of incidence (constant gamma) the power of a whole
echo over the volume's in one cell is the same at any range and incidence: both fall as r^-2, and the longer the
footprint the weaker each cell. A survey over a few kinds of ground has few such levels, and a place fewer still.
Slopes make an echo wider or narrower than that of level ground, and heights of neighbouring pulses differ by them. At
steep incidence widths under speckle hardly tell slopes of 0.1 from none, and heights do; at grazing incidence it is the
other way round.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Float32
from numpy.polynomial.hermite_e import hermegauss

from sionna_radar.detection.volume.nearby_levels import EM_ROUNDS, NearbyLevels, nearby_levels
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.pulses import Pulses
from sionna_radar.foundation.numerics import log_sum_exp

# Coarser steps far above the volume, where precision matters little: thin fog is below the noise at the ground's range.
LEVELS = 10.0 ** (np.concatenate([np.arange(-6.0, 55.0, 2.0), np.arange(58.0, 91.0, 4.0)]) / 10)
# Levels of a smaller weight are dropped.
MIN_LEVEL_WEIGHT = 2e-3
# Root-mean-square slopes of the ground in any direction that are tried.
SLOPES = np.geomspace(0.0125, 0.8, 7)
# Standard normal deviates that sample the ground's slopes, and their weights: Gauss-Hermite quadrature.
DEVIATES, DEVIATE_WEIGHTS = (part / scale for part, scale in zip(hermegauss(9), (1.0, np.sqrt(2 * np.pi)), strict=True))


@dataclass(frozen=True, kw_only=True, eq=False)
class GroundBehind:
    """Prior of the ground's echo behind a volume.

    level, level_weight: power of a whole echo over the volume's mean in one cell, and its fraction of the pulses.
    slope_weight: probability of each of `SLOPES`.
    cell: median range of the ground in cells; 0 if unknown. clearance_m: median height of the antenna above it.
    nearby: levels from place to place; None where they do not depend on it.
    """

    level: Float[np.ndarray, " level"]
    level_weight: Float[np.ndarray, " level"]
    slope_weight: Float[np.ndarray, " slope"]
    cell: int = 0
    clearance_m: float = 0.0
    nearby: NearbyLevels | None = None

    @property
    def slope(self) -> float:
        """Mean of the root-mean-square slopes."""
        return float(self.slope_weight @ SLOPES)

    def level_weight_in(self, pulses: Pulses) -> Float[np.ndarray, "pulse level"]:
        """Return the weight of each level in pulses, where their beams meet level ground."""
        if self.nearby is None:
            return np.tile(self.level_weight, (len(pulses), 1))
        return self.nearby.weight(self.level_weight, pulses.index, _place_m(pulses, self.clearance_m))

    def given(self, likelihood: Float[np.ndarray, " slope"]) -> "GroundBehind":
        """Return the posterior of slopes with log-likelihoods."""
        log = np.log(self.slope_weight) + likelihood
        return replace(self, slope_weight=np.exp(log - log_sum_exp(log, axis=None)))


def unknown_ground() -> GroundBehind:
    """Return ground of any level and slope."""
    return GroundBehind(
        level=LEVELS,
        level_weight=np.full(len(LEVELS), 1 / len(LEVELS)),
        slope_weight=np.full(len(SLOPES), 1 / len(SLOPES)),
    )


def learned_ground(
    ground: GroundBehind, likelihood: Float32[np.ndarray, "slope pulse level"], cell: Float[np.ndarray, " pulse"]
) -> GroundBehind:
    """Return ground of the most likely weights of slopes and levels, by expectation maximisation.

    Parameters
    ----------
    ground:
        Candidate levels.
    likelihood:
        Log-likelihood of each pulse for each slope and level, over all ranges and widths.
    cell:
        Most likely range of the ground in each pulse, in cells.

    """
    relative = _relative(likelihood)
    slope, level = (np.full(count, 1 / count) for count in (relative.shape[0], relative.shape[2]))
    for _ in range(EM_ROUNDS):
        of_level = np.tensordot(slope, relative, 1)
        per_pulse = 1 / (of_level @ level)
        of_slope = relative @ level @ per_pulse
        slope, level = _normalised(slope * of_slope), _normalised(level * (per_pulse @ of_level))
    # Keep neighbours of frequent levels: the true level lies between two steps.
    significant = level > MIN_LEVEL_WEIGHT
    significant[1:-1] |= significant[2:] | significant[:-2]
    level = np.where(significant, np.maximum(level, MIN_LEVEL_WEIGHT), 0.0)[significant]
    return GroundBehind(
        level=ground.level[significant],
        level_weight=level / level.sum(),
        slope_weight=slope,
        cell=int(np.median(cell)),
    )


def with_nearby_levels(
    learned: GroundBehind,
    ground: GroundBehind,
    likelihood: Float32[np.ndarray, "slope pulse level"],
    range_m: Float[np.ndarray, " pulse"],
    pulses: Pulses,
) -> GroundBehind:
    """Return learned ground whose levels depend on the place, if they do.

    ground, likelihood: see `learned_ground`. range_m: most likely range of the ground in each of those pulses.
    """
    of_level = np.tensordot(learned.slope_weight, _relative(likelihood), 1)[:, np.isin(ground.level, learned.level)]
    clearance_m = float(np.median(-pulses.measured.boresight[:, 2] * range_m))
    place_m = _place_m(pulses, clearance_m)
    nearby = nearby_levels(np.maximum(of_level, np.finfo(float).tiny), learned.level_weight, pulses.index, place_m)
    return replace(learned, clearance_m=clearance_m, nearby=nearby)


def _relative(likelihood: Float32[np.ndarray, "slope pulse level"]) -> Float[np.ndarray, "slope pulse level"]:
    """Return likelihoods over the largest of each pulse."""
    log = likelihood.astype(np.float64)
    return np.asarray(np.exp(log - log.max(axis=(0, 2), keepdims=True)))


def _place_m(pulses: Pulses, clearance_m: float) -> Float[np.ndarray, "pulse 2"]:
    """Return the places x, y at which the beams' axes meet level ground."""
    pose = pulses.measured
    range_m = clearance_m / np.maximum(-pose.boresight[:, 2], MIN_GRAZING_SINE)
    return pose.position_m[:, :2] + range_m[:, None] * pose.boresight[:, :2]


def _normalised(weight: Float[np.ndarray, " kind"]) -> Float[np.ndarray, " kind"]:
    """Return weights that add up to one, none of them zero."""
    weight = weight / weight.sum() + 1e-6
    return np.asarray(weight / weight.sum())


def slopes_of(slope: float | Float[np.ndarray, "*kind 1"]) -> Float[np.ndarray, "*kind sample"]:
    """Return angles, rad, by which ground of root-mean-square slopes rises from the radar; see `DEVIATE_WEIGHTS`."""
    return np.asarray(np.arctan(slope * DEVIATES))


def mean_tangent(incidence: Float[np.ndarray, " pulse"], slope: float) -> Float[np.ndarray, " pulse"]:
    """Return the mean tangent of the incidence on ground of a root-mean-square slope, as the beam's axis meets it.

    The axis meets slopes in proportion to the area that they turn towards the radar, the cosine of the incidence there.
    incidence: on level ground, rad.
    """
    on_slopes = np.minimum(incidence[:, None] - slopes_of(slope), np.arccos(MIN_GRAZING_SINE))
    mean: Float[np.ndarray, " pulse"] = (np.sin(on_slopes) @ DEVIATE_WEIGHTS) / (np.cos(on_slopes) @ DEVIATE_WEIGHTS)
    return mean
