"""Tracking of the ground behind volume clutter: height below each pulse, given its neighbours in the scan line.

Each pulse has a log-likelihood of ground for every range cell. Its measured pose turns a range into a height on the
beam's axis. From pulse to pulse heights change by slope times distance, two-sided exponential about zero, or jump
anywhere (a wall, an edge) with a small probability. Forward and backward messages along the line give the evidence
of all neighbours for each pulse's height; their product with the pulse's own likelihood is the posterior. The forward
messages add up to the likelihood of the line, by which slopes are told apart.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.detection.echoes import MIN_SIGMA_CELLS
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.foundation.numerics import log_sum_exp

# Probability that the height jumps from one pulse to the next.
JUMP_PROBABILITY = 0.03
# Posterior cells farther than this from the strongest belong to another surface.
SAME_SURFACE_CELLS = 20


@dataclass(frozen=True, kw_only=True)
class AxisHeights:
    """The beam's axis from the measured pose: a height is `position_m[2] - down * (range - shift_m)`.

    shift_m: increase of the measured range by the platform's motion (Doppler shift).
    """

    position_m: Float[np.ndarray, "pulse 3"]
    boresight: Float[np.ndarray, "pulse 3"]
    shift_m: Float[np.ndarray, " pulse"]

    @property
    def down(self) -> Float[np.ndarray, " pulse"]:
        """Cosine of the angle from nadir."""
        return -self.boresight[:, 2]

    @property
    def top_m(self) -> Float[np.ndarray, " pulse"]:
        """Height at the measured range 0."""
        return self.position_m[:, 2] + self.down * self.shift_m


@dataclass(frozen=True, kw_only=True)
class TrackedRanges:
    """Range of each pulse in cells, its standard deviation, and the probability of the surface it lies on.

    evidence: log-likelihood of ground on that surface against no ground, neighbours included.
    alone: standard deviation of the range from the pulse's own evidence.
    """

    cell: Float[np.ndarray, " pulse"]
    sigma: Float[np.ndarray, " pulse"]
    probability: Float[np.ndarray, " pulse"]
    evidence: Float[np.ndarray, " pulse"]
    alone: Float[np.ndarray, " pulse"]

    @property
    def reach(self) -> Float[np.ndarray, " pulse"]:
        """Correlation length of range errors in pulses, as neighbours share their evidence.

        Errors of pulses n apart have about the correlation exp(-n^2 / reach^2). Heights in a random walk from pulse to
        pulse, each measured with the variance s^2, have after smoothing the variance P and errors of the correlation
        l^n with P / s^2 = (1 - l) / (1 + l) (the inverse of their tridiagonal information matrix). The correlations add
        up to s^2 / P; they are approximated by the Gaussian of the same sum.
        """
        total = np.maximum((self.alone / self.sigma) ** 2, 1.0)
        return np.where(total > 1.2, total / np.sqrt(np.pi), 0.0)

    def with_variance(self, fraction: Float[np.ndarray, " pulse"]) -> "TrackedRanges":
        """Return the same ranges, with a fraction of the variance that each pulse alone has.

        For the steps of variance q of that random walk x = P / s^2 obeys x^2 / (1 - x^2) = q / (4 s^2).
        """
        smoothed = np.clip((self.sigma / self.alone) ** 2, 1e-6, 1 - 1e-6)
        steps = smoothed**2 / (1 - smoothed**2) / fraction
        sigma = self.alone * np.sqrt(fraction * np.sqrt(steps / (1 + steps)))
        return replace(self, sigma=np.maximum(sigma, MIN_SIGMA_CELLS), alone=self.alone * np.sqrt(fraction))


def track(
    evidence: Float[np.ndarray, "pulse cell"],
    heights: AxisHeights,
    cell_m: float,
    line: Int[np.ndarray, " pulse"],
    slope: float,
    step_m: float,
) -> TrackedRanges:
    """Return the most probable ranges of the pulses of whole scan lines.

    Parameters
    ----------
    evidence:
        Log-likelihood of ground at each cell against no ground; -inf where ruled out.
    heights:
        Conversion of ranges to heights, from the measured poses.
    cell_m:
        Length of a range cell.
    line:
        Scan line of each pulse; lines are independent.
    slope:
        Root-mean-square slope of the ground in any direction.
    step_m:
        Between the heights that are tried.

    """
    posterior = np.empty(evidence.shape)
    for rows in np.split(np.arange(len(line)), np.flatnonzero(np.diff(line)) + 1):
        if len(rows):
            posterior[rows] = evidence[rows] + _neighbours(evidence[rows], heights, cell_m, rows, slope, step_m)
    total = log_sum_exp(posterior, axis=1)
    probability_of_cell = np.exp(posterior - total[:, None])
    cell = np.arange(evidence.shape[1])
    same = np.abs(cell - probability_of_cell.argmax(axis=1)[:, None]) <= SAME_SURFACE_CELLS
    on_surface = np.where(same, probability_of_cell, 0.0)
    probability = on_surface.sum(axis=1)
    mean = on_surface @ cell / probability
    sigma = np.sqrt(np.sum(on_surface * (cell - mean[:, None]) ** 2, axis=1) / probability)
    sigma = np.maximum(sigma, MIN_SIGMA_CELLS)
    alone = np.maximum(_alone(evidence, same, mean), MIN_SIGMA_CELLS)
    return TrackedRanges(cell=mean, sigma=sigma, probability=probability, evidence=total, alone=alone)


def _alone(
    evidence: Float[np.ndarray, "pulse cell"], same: Bool[np.ndarray, "pulse cell"], mean: Float[np.ndarray, " pulse"]
) -> Float[np.ndarray, " pulse"]:
    """Return the standard deviation of each range from the pulse's own evidence near the chosen surface."""
    likelihood = np.where(
        same, np.exp(evidence - np.max(evidence, axis=1, where=same, initial=-np.inf, keepdims=True)), 0.0
    )
    square = (np.arange(evidence.shape[1]) - mean[:, None]) ** 2
    return np.sqrt(np.sum(likelihood * square, axis=1) / likelihood.sum(axis=1))


def line_likelihood(
    evidence: Float[np.ndarray, "pulse cell"], heights: AxisHeights, cell_m: float, slope: float, step_m: float
) -> float:
    """Return the log-likelihood of ground of a slope in all pulses of one scan line.

    Parameters are those of `track`.
    """
    chain = _Chain.of(evidence, heights, cell_m, np.arange(len(evidence)), step_m)
    if chain is None:
        return float(log_sum_exp(evidence, axis=1).sum())
    return float(evidence.max(axis=1).sum()) + _passed(chain.likelihood, chain.decay(slope))[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Chain:
    """Pulses of one scan line: the likelihood of each height, and the distances from pulse to pulse.

    looks_down: whether a pulse's range determines a height.
    """

    height_m: Float[np.ndarray, " height"]
    likelihood: Float[np.ndarray, "pulse height"]
    distance_m: Float[np.ndarray, " step"]
    looks_down: Bool[np.ndarray, " pulse"]
    step_m: float

    @classmethod
    def of(
        cls,
        evidence: Float[np.ndarray, "pulse cell"],
        heights: AxisHeights,
        cell_m: float,
        rows: Int[np.ndarray, " pulse"],
        step_m: float,
    ) -> "_Chain | None":
        """Return the chain of some pulses; None where fewer than two of them determine a height."""
        count, cells = evidence.shape
        top, down = heights.top_m[rows], heights.down[rows]
        looks_down = down >= MIN_GRAZING_SINE
        if looks_down.sum() < 2:
            return None
        low = float(np.min(top - np.maximum(down, MIN_GRAZING_SINE) * (cells - 1) * cell_m))
        height = np.arange(low, float(top.max()) + step_m, step_m)
        likelihood = np.zeros((count, len(height)))
        for row in np.flatnonzero(looks_down):
            peak = evidence[row].max()
            at = (top[row] - height) / (down[row] * cell_m)
            likelihood[row] = np.interp(at, np.arange(cells), np.exp(evidence[row] - peak), left=0.0, right=0.0)
        return cls(
            height_m=height,
            likelihood=likelihood,
            distance_m=_distances(evidence, heights, cell_m, rows),
            looks_down=looks_down,
            step_m=step_m,
        )

    def decay(self, slope: float) -> Float[np.ndarray, " step"]:
        """Return the ratio of probabilities of a change of height and of one a step smaller, from pulse to pulse."""
        mean_m = np.sqrt(2 / np.pi) * slope * self.distance_m
        return np.exp(-self.step_m / np.maximum(mean_m, self.step_m))


def _neighbours(
    evidence: Float[np.ndarray, "pulse cell"],
    heights: AxisHeights,
    cell_m: float,
    rows: Int[np.ndarray, " pulse"],
    slope: float,
    step_m: float,
) -> Float[np.ndarray, "pulse cell"]:
    """Return the log-probability of each cell given the other pulses of the line; uniform without such evidence."""
    cells = evidence.shape[1]
    out = np.full(evidence.shape, -np.log(cells))
    chain = _Chain.of(evidence, heights, cell_m, rows, step_m)
    if chain is None:
        return out
    decay = chain.decay(slope)
    forward, _ = _passed(chain.likelihood, decay)
    backward, _ = _passed(chain.likelihood[::-1], decay[::-1])
    messages = forward * backward[::-1]
    top, down = heights.top_m[rows], heights.down[rows]
    range_m = np.arange(cells) * cell_m
    for row in np.flatnonzero(chain.looks_down):
        prior = np.interp(top[row] - down[row] * range_m, chain.height_m, messages[row])
        out[row] = np.log(np.maximum(prior / max(prior.sum(), 1e-300), 1e-30))
    return out


def _passed(
    likelihood: Float[np.ndarray, "pulse height"], decay: Float[np.ndarray, " step"]
) -> tuple[Float[np.ndarray, "pulse height"], float]:
    """Return the message that reaches each pulse from those before it, and the log-likelihood of all pulses."""
    message = np.full(likelihood.shape, 1 / likelihood.shape[1])
    log = 0.0
    for step in range(len(likelihood)):
        belief = message[step] * likelihood[step]
        total = belief.sum()
        log += float(np.log(total)) if total > 0 else 0.0
        if total > 0 and step + 1 < len(likelihood):
            message[step + 1] = _moved(belief / total, decay[step])
    return message, log


def _distances(
    evidence: Float[np.ndarray, "pulse cell"], heights: AxisHeights, cell_m: float, rows: Int[np.ndarray, " pulse"]
) -> Float[np.ndarray, " step"]:
    """Return the distances between consecutive beam centres on level ground at the line's median height."""
    down = np.maximum(heights.down[rows], MIN_GRAZING_SINE)
    clearance_m = float(np.median(down * evidence.argmax(axis=1) * cell_m))
    place = heights.position_m[rows] + (clearance_m / down)[:, None] * heights.boresight[rows]
    return np.linalg.norm(np.diff(place, axis=0), axis=1)


def _moved(belief: Float[np.ndarray, " height"], decay: float) -> Float[np.ndarray, " height"]:
    """Return the probability of a pulse's heights, given that of its neighbour's."""
    # SciPy's signal package is slow to import.
    from scipy.signal import lfilter

    up = lfilter([1.0], [1.0, -decay], belief)
    back = lfilter([1.0], [1.0, -decay], belief[::-1])[::-1]
    spread = (up + back - belief) * (1 - decay) / (1 + decay)
    return (1 - JUMP_PROBABILITY) * spread + JUMP_PROBABILITY / len(belief)
