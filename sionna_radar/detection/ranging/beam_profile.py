"""The mean echo of a sloping plane through a beam, and its fit to measured powers.

On a plane whose normal makes the angle t with the boresight, a ray turned by the small angles of sines s in the plane
of incidence and u across it has the range r0 / (sqrt(1 - s^2 - u^2) - s tan t), with the mean square for u^2. The
echo power falls with the square of the range (constant gamma). Over the beam's two-way power along s this gives
the mean echo: its position is the boresight range r0, its width follows from the slope. Powers are exponential about
the mean, so the fit maximises their likelihood, -sum(P / mu + log mu), by Fisher scoring over r0, log tan t and the
level, from the best of a ladder of slopes.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.main_lobe import FOLLOWED, lobe_samples

SAMPLES = 65
SLOPES = np.geomspace(0.1, 5.0, 8)
ITERATIONS = 12
MARGIN = 6
# Power outside the main echo from side lobes of the beam and the window, relative to the echo's level.
PEDESTAL = 2e-2


@dataclass(frozen=True)
class BeamProfile:
    """The beam in the plane of incidence, and the window's response.

    sine: sines of the angle from boresight; share: two-way power there, summing to one.
    across: mean square of the sine across the plane of incidence.
    response: power response of the spectrum to a point target, on bins from -half to half.
    """

    sine: Float[np.ndarray, " sample"]
    share: Float[np.ndarray, " sample"]
    across: float
    response: Float[np.ndarray, " bin"]


@dataclass(frozen=True)
class EchoFit:
    """Boresight range in bins and its standard deviation for one look per bin."""

    centre: Float[np.ndarray, " echo"]
    sigma: Float[np.ndarray, " echo"]


def beam_profile(antenna: Antenna, response: Float[np.ndarray, " bin"]) -> BeamProfile:
    """Return the profile of an antenna's elevation cut, the plane in which a forward-tilted beam is inclined."""
    cut = antenna.elevation
    lobe = cut.cosine[lobe_samples(cut, FOLLOWED)]
    low, high = lobe[0], lobe[-1]
    sine = low + (np.arange(SAMPLES) + 0.5) * (high - low) / SAMPLES
    share = cut.at(sine) ** 4
    other = antenna.azimuth
    across = float(other.voltage**4 @ other.cosine**2 / np.sum(other.voltage**4))
    return BeamProfile(sine, share / share.sum(), across, response / response.sum())


def fit_echo(
    beam: BeamProfile,
    power: Float[np.ndarray, "pulse bin"],
    noise: Float[np.ndarray, "pulse bin"],
    row: Int[np.ndarray, " echo"],
    start: Int[np.ndarray, " echo"],
    stop: Int[np.ndarray, " echo"],
    centroid: Float[np.ndarray, " echo"],
) -> EchoFit:
    """Fit each echo in its span of bins and a margin around it."""
    centre, sigma = np.empty(len(row)), np.empty(len(row))
    for i in range(len(row)):
        first, last = max(start[i] - MARGIN, 0), min(stop[i] + MARGIN, power.shape[1])
        bins = np.arange(first, last)
        measured = power[row[i], first:last]
        background = max(float(np.min(noise[row[i], start[i] : stop[i]])), PEDESTAL * float(measured.mean()))
        centre[i], sigma[i] = _fit(beam, bins, measured, background, float(centroid[i]))
    return EchoFit(centre, sigma)


def _fit(
    beam: BeamProfile,
    bins: Int[np.ndarray, " bin"],
    power: Float[np.ndarray, " bin"],
    background: float,
    centroid: float,
) -> tuple[float, float]:
    starts = []
    for slope in np.log(SLOPES):
        mean_range = float(beam.share @ _ranges(beam, 1.0, slope))
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
    return float(state[0]), float(np.sqrt(max(variance, 1e-4)))


def _ranges(beam: BeamProfile, boresight: float, log_slope: float) -> Float[np.ndarray, " sample"]:
    closing = np.sqrt(np.maximum(1 - beam.sine**2 - beam.across, 0.0)) - beam.sine * np.exp(log_slope)
    return boresight / np.maximum(closing, 0.2)


def _shape(
    beam: BeamProfile, bins: Int[np.ndarray, " bin"], state: Float[np.ndarray, "2"]
) -> Float[np.ndarray, " bin"]:
    """Return the echo of unit power."""
    place = _ranges(beam, state[0], state[1]) - bins[0]
    # Samples represent intervals: the power between two of them is spread evenly over the bins they span.
    ends = 1.5 * place[[0, -1]] - 0.5 * place[[1, -2]]
    edge = np.concatenate([ends[:1], (place[1:] + place[:-1]) / 2, ends[1:]])
    share = beam.share * (state[0] / (place + bins[0])) ** 2
    below = np.concatenate([[0.0], np.cumsum(share / share.sum())])
    spread = np.diff(np.interp(np.arange(len(bins) + 1) - 0.5, edge, below))
    half = len(beam.response) // 2
    return np.convolve(spread, beam.response)[half : half + len(bins)]


def _jacobian(
    beam: BeamProfile, bins: Int[np.ndarray, " bin"], state: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "bin 2"]:
    columns = []
    for step in (np.array([0.05, 0.0]), np.array([0.0, 0.02])):
        columns.append((_shape(beam, bins, state + step) - _shape(beam, bins, state - step)) / (2 * step.sum()))
    return np.column_stack(columns)


def _loss(
    beam: BeamProfile,
    bins: Int[np.ndarray, " bin"],
    power: Float[np.ndarray, " bin"],
    background: float,
    state: Float[np.ndarray, "2"],
) -> tuple[float, Float[np.ndarray, " bin"], float]:
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
