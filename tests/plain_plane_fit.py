"""The fit of a plane's mean echo with NumPy alone: the slow oracle of `plane_fit`."""

from dataclasses import replace

import numpy as np

from sionna_radar.detection.ranging.plane_fit import ITERATIONS, SLOPES, BeamProfile


def fit_plane(
    beam: BeamProfile,
    bins,
    power,
    background: float,
    centroid: float,
) -> tuple[float, float]:
    beam = replace(beam, response=_taps(beam, centroid))
    starts = []
    for slope in np.log(SLOPES):
        mean_range = float(beam.power @ _ranges(beam, 1.0, slope))
        state = np.array([centroid / mean_range, slope])
        starts.append((_loss(beam, bins, power, background, state)[0], state))
    loss, state = min(starts, key=lambda entry: entry[0])
    damping, fisher = 1e-3, np.zeros((2, 2))
    for _ in range(ITERATIONS):
        _, mean, level = _loss(beam, bins, power, background, state)
        jacobian = _jacobian(beam, bins, state) * (level / mean)[:, None]
        # The level is refitted at each step, so the other columns are projected orthogonally to it.
        shape = (mean - background) / mean
        if not shape.any():  # even the best slope puts no power in these bins
            return centroid, float(len(bins))
        jacobian -= np.outer(shape, shape @ jacobian / (shape @ shape))
        fisher = jacobian.T @ jacobian
        step = np.linalg.solve(fisher + damping * np.diag(np.diag(fisher) + 1e-12), jacobian.T @ (power / mean - 1))
        trial = state + np.clip(step, [-3.0, -0.7], [3.0, 0.7])
        trial[1] = np.clip(trial[1], np.log(SLOPES[0]), np.log(SLOPES[-1]))
        trial_loss = _loss(beam, bins, power, background, trial)[0]
        if trial_loss < loss:
            done = loss - trial_loss < 1e-4
            loss, state, damping = trial_loss, trial, damping / 4
            if done:
                break
        else:
            damping = damping * 10 + 1e-2
    variance = np.linalg.pinv(fisher)[0, 0]
    return float(state[0]), float(min(np.sqrt(max(variance, 1e-4)), len(bins)))


def _ranges(beam: BeamProfile, boresight: float, log_slope: float):
    closing = np.sqrt(np.maximum(1 - beam.sine**2 - beam.across, 0.0)) - beam.sine * np.exp(log_slope)
    return boresight / np.maximum(closing, 0.2)


def _shape(beam: BeamProfile, bins, state):
    """Return the echo of unit power."""
    place = _ranges(beam, state[0], state[1]) - bins[0]
    # Samples represent intervals: the power between two of them is spread evenly over the bins they span.
    ends = 1.5 * place[[0, -1]] - 0.5 * place[[1, -2]]
    edge = np.concatenate([ends[:1], (place[1:] + place[:-1]) / 2, ends[1:]])
    share = beam.power * (state[0] / (place + bins[0])) ** 2
    below = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    spread = np.diff(np.interp(np.arange(len(bins) + 1) - 0.5, edge, below))
    half = len(beam.response) // 2
    return np.convolve(spread, beam.response)[half : half + len(bins)]


def _taps(beam: BeamProfile, centroid: float):
    """Return the response spread by the beam's extent across the plane of incidence."""
    delay = centroid * beam.across_excess / 2
    nearest = np.floor(delay + 0.5).astype(int)
    part, reach = delay - nearest, np.abs(nearest).max() + 1
    spread = np.zeros(2 * reach + 1)
    for step, weight in ((0, 1 - part**2), (1, (part**2 + part) / 2), (-1, (part**2 - part) / 2)):
        np.add.at(spread, reach + nearest + step, beam.across_power * weight)
    return np.maximum(np.convolve(spread, beam.response), 0.0)


def _jacobian(beam: BeamProfile, bins, state):
    columns = []
    for step in (np.array([0.05, 0.0]), np.array([0.0, 0.02])):
        columns.append((_shape(beam, bins, state + step) - _shape(beam, bins, state - step)) / (2 * step.sum()))
    return np.column_stack(columns)


def _loss(
    beam: BeamProfile,
    bins,
    power,
    background: float,
    state,
):
    """Return the negative log-likelihood at the best level, the mean powers and that level."""
    shape = _shape(beam, bins, state)
    level = float(power.sum() / max(shape.sum(), 1e-6))
    for _ in range(6):
        mean = level * shape + background
        share = level * shape / mean
        total = float(share.sum())
        if total <= 0:
            break
        level *= float(np.exp(np.clip(share @ (power / mean - 1) / total, -1.0, 1.0)))
    mean = level * shape + background
    return float(np.sum(power / mean + np.log(mean))), mean, level
