"""Model fit of ranges: the mean echo of a sloping plane through a beam, fitted to measured powers.

On a plane whose normal makes the angle t with the boresight, a ray turned by the small angles of sines s in the plane
of incidence and u across it has the range r0 / (sqrt(1 - s^2 - u^2) - s tan t), with u^2 replaced by its mean over the
beam. What it is off the mean spreads the ranges by r (u^2 - mean) / 2, to first order alike for all s. The echo power
falls with the square of the range (constant gamma). Over the beam's two-way power along s this gives the mean echo: its
position is the boresight range r0, its width follows from the slope. Speckle makes each power exponential about its
mean mu, echo plus background, so the fit maximises their likelihood, -sum(P / mu + log mu), by Fisher scoring over r0,
log tan t and the level, from the best of a ladder of slopes.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.foundation.compiled import compiled
from sionna_radar.radar.antenna import FOLLOWED, Antenna, lobe_samples

SAMPLES = 65
SLOPES = np.geomspace(0.1, 5.0, 8)
ITERATIONS = 12
MARGIN = 6
# Power outside the main echo from side lobes of the beam and the window, relative to the echo's level.
PEDESTAL = 2e-2


@dataclass(frozen=True)
class BeamProfile:
    """The beam in the plane of incidence, and the window's response.

    sine: sines of the angle from boresight; power: two-way power there, summing to one.
    across: mean square of the sine across the plane of incidence.
    across_excess, across_power: squares of that sine less their mean, and the two-way power there, summing to one.
    response: power response of the spectrum to a point target, on bins from -half to half.
    """

    sine: Float[np.ndarray, " sample"]
    power: Float[np.ndarray, " sample"]
    across: float
    across_excess: Float[np.ndarray, " side"]
    across_power: Float[np.ndarray, " side"]
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
    power = cut.at(sine) ** 4
    azimuth = antenna.azimuth
    across = float(azimuth.voltage**4 @ azimuth.cosine**2 / np.sum(azimuth.voltage**4))
    side = azimuth.cosine[lobe_samples(azimuth, FOLLOWED)]
    side = side[0] + (np.arange(SAMPLES) + 0.5) * (side[-1] - side[0]) / SAMPLES
    weight = azimuth.at(side) ** 4 / np.sum(azimuth.at(side) ** 4)
    excess = side**2 - weight @ side**2
    return BeamProfile(sine, power / power.sum(), across, excess, weight, response / response.sum())


def fit_echo(
    beam: BeamProfile,
    power: Float[np.ndarray, "pulse bin"],
    noise: Float[np.ndarray, "pulse bin"],
    row: Int[np.ndarray, " echo"],
    start: Int[np.ndarray, " echo"],
    stop: Int[np.ndarray, " echo"],
    centroid: Float[np.ndarray, " echo"],
    gate: int = 0,
) -> EchoFit:
    """Fit each echo in its span of bins and a margin around it; `gate` bins lie before the first one."""
    centre, sigma = np.empty(len(row)), np.empty(len(row))
    across = beam.across, beam.across_excess, beam.across_power
    plane = beam.sine, beam.power, *across, beam.response, SLOPES, ITERATIONS, MARGIN, PEDESTAL
    fit_planes(*plane, power, noise, row, start, stop, centroid + gate, centre, sigma, gate)
    return EchoFit(centre - gate, sigma)


MIN_CLOSING = 0.2
MIN_SHAPE = 1e-6
LEVEL_STEPS = 6
# Steps over which the echo's shape is differentiated: range in bins, and logarithm of the slope.
RANGE_STEP, SLOPE_STEP = 0.05, 0.02
MAX_RANGE, MAX_SLOPE = 3.0, 0.7
DONE = 1e-4
MIN_VARIANCE = 1e-4


@compiled
@no_type_check
def _shape(sine, beam_power, across, response, first_bin, boresight, log_slope, place, edge, below, spread, result):
    """Write the unit-power echo on the bins from `first_bin`; return the mean range of the beam's power."""
    samples, slope, mean = len(sine), np.exp(log_slope), 0.0
    for k in range(samples):
        closing = np.sqrt(max(1 - sine[k] ** 2 - across, 0.0)) - sine[k] * slope
        range_of = boresight / max(closing, MIN_CLOSING)
        mean += beam_power[k] * range_of
        place[k] = range_of - first_bin
    # Samples represent intervals: the power between two of them is spread evenly over the bins they span.
    edge[0] = 1.5 * place[0] - 0.5 * place[1]
    edge[samples] = 1.5 * place[samples - 1] - 0.5 * place[samples - 2]
    total = 0.0
    below[0] = 0.0
    for k in range(samples):
        if k:
            edge[k] = (place[k] + place[k - 1]) / 2
        total += beam_power[k] * (boresight / (place[k] + first_bin)) ** 2
        below[k + 1] = total
    bins, half, previous, k = len(result), len(response) // 2, 0.0, 0
    for b in range(bins + 1):
        at = b - 0.5
        while k <= samples and edge[k] <= at:
            k += 1
        if k == 0:
            reached = 0.0
        elif k > samples:
            reached = 1.0
        else:
            fraction = (at - edge[k - 1]) / (edge[k] - edge[k - 1])
            reached = (below[k - 1] + fraction * (below[k] - below[k - 1])) / total
        if b:
            spread[b - 1] = reached - previous
        previous = reached
    for b in range(bins):
        result[b] = 0.0
        for tap in range(len(response)):
            if 0 <= b + half - tap < bins:
                result[b] += response[tap] * spread[b + half - tap]
    return mean


@compiled
@no_type_check
def _loss(shape, power, background, mean):
    """Return the negative log-likelihood at the optimal level, and this level; write the mean powers."""
    bins, level, unit = len(power), 0.0, 0.0
    for b in range(bins):
        level += power[b]
        unit += shape[b]
    level /= max(unit, MIN_SHAPE)
    for _ in range(LEVEL_STEPS):
        total, pull = 0.0, 0.0
        for b in range(bins):
            expected = level * shape[b] + background
            signal_share = level * shape[b] / expected
            total += signal_share
            pull += signal_share * (power[b] / expected - 1)
        if total <= 0:
            break
        level *= np.exp(min(max(pull / total, -1.0), 1.0))
    loss = 0.0
    for b in range(bins):
        mean[b] = level * shape[b] + background
        loss += power[b] / mean[b] + np.log(mean[b])
    return loss, level


@compiled
@no_type_check
def _centre_variance(a, b, c):
    """Return the first element of the pseudo-inverse of the matrix ((a, b), (b, c))."""
    determinant, size = a * c - b * b, a + c
    if size <= 0:
        return 0.0
    if determinant > 1e-15 * size * size:
        return c / determinant
    # Of rank one: a vector times itself.
    return a / (size * size)


@compiled
@no_type_check
def _best_of_slopes(beam, slopes, centroid, first_bin, power, background, room, trial, mean):
    """Return boresight range, logarithm of the slope, loss and level of the likeliest slope; write the mean powers.

    room: for the places and edges of the samples, and the powers below and between these; trial: for shape and mean.
    """
    sine, beam_power, across, response = beam
    place, edge, below, spread = room
    trial_shape, trial_mean = trial
    boresight, log_slope, loss, level = 0.0, 0.0, np.inf, 0.0
    for slope in slopes:
        unit_range = _shape(
            sine, beam_power, across, response, first_bin, 1.0, np.log(slope), place, edge, below, spread, trial_shape
        )
        at = centroid / unit_range
        _shape(
            sine, beam_power, across, response, first_bin, at, np.log(slope), place, edge, below, spread, trial_shape
        )
        trial_loss, trial_level = _loss(trial_shape, power, background, trial_mean)
        if trial_loss < loss:
            boresight, log_slope, loss, level = at, np.log(slope), trial_loss, trial_level
            for b in range(len(power)):
                mean[b] = trial_mean[b]
    return boresight, log_slope, loss, level


@compiled
@no_type_check
def _differentiate(beam, boresight, log_slope, first_bin, room, trial_shape, by):
    """Write the derivatives of the echo's shape by the boresight range and by the logarithm of the slope."""
    sine, beam_power, across, response = beam
    place, edge, below, spread = room
    for column in range(2):
        dr, ds = (RANGE_STEP, 0.0) if column == 0 else (0.0, SLOPE_STEP)
        for sign in (1, -1):
            _shape(
                sine, beam_power, across, response, first_bin, boresight + sign * dr, log_slope + sign * ds, place,
                edge, below, spread, trial_shape,
            )  # fmt: skip
            for b in range(len(trial_shape)):
                by[column, b] = trial_shape[b] if sign > 0 else (by[column, b] - trial_shape[b]) / (2 * (dr + ds))


@compiled
@no_type_check
def _with_across(response, excess, weight, range_bins):
    """Return the response spread by the beam's extent across the plane of incidence, at a range in bins.

    Each delay falls on the three bins around it with weights that keep its mean and its variance.
    """
    reach = 0
    for k in range(len(excess)):
        reach = max(reach, int(abs(0.5 * range_bins * excess[k]) + 0.5))
    longest = reach + 1
    spread, taps = np.zeros(2 * longest + 1), np.zeros(len(response) + 2 * longest)
    for k in range(len(excess)):
        delay = 0.5 * range_bins * excess[k]
        nearest = int(np.floor(delay + 0.5))
        part = delay - nearest
        spread[longest + nearest] += weight[k] * (1 - part * part)
        spread[longest + nearest + 1] += weight[k] * 0.5 * (part * part + part)
        spread[longest + nearest - 1] += weight[k] * 0.5 * (part * part - part)
    for k in range(len(spread)):
        for tap in range(len(response)):
            taps[k + tap] += spread[k] * response[tap]
    return np.maximum(taps, 0.0)


@compiled
@no_type_check
def fit_planes(
    sine, beam_power, across, across_excess, across_power, window_response, slopes, iterations, margin, pedestal,
    powers, noises, rows, starts, stops, centroids, centre, sigma, gate,
):  # fmt: skip
    """Write boresight range in bins, and its standard deviation for one look per bin, of each echo."""
    samples = len(sine)
    place, edge, below = np.empty(samples), np.empty(samples + 1), np.empty(samples + 1)
    for i in range(len(rows)):
        first_bin, last_bin = max(starts[i] - margin, 0), min(stops[i] + margin, powers.shape[1])
        power, bins = powers[rows[i], first_bin:last_bin], last_bin - first_bin
        first_bin += gate
        response = _with_across(window_response, across_excess, across_power, centroids[i])
        beam = sine, beam_power, across, response
        total, noise = 0.0, np.inf
        for b in range(bins):
            total += power[b]
        for b in range(starts[i], stops[i]):
            noise = min(noise, noises[rows[i], b])
        background = max(noise, pedestal * total / bins)
        spread, mean, trial_shape, trial_mean = np.empty(bins), np.empty(bins), np.empty(bins), np.empty(bins)
        by, room = np.empty((2, bins)), (place, edge, below, spread)
        boresight, log_slope, loss, level = _best_of_slopes(
            beam, slopes, centroids[i], first_bin, power, background, room, (trial_shape, trial_mean), mean
        )
        damping, a, c, d, empty = 1e-3, 0.0, 0.0, 0.0, False
        for _ in range(iterations):
            _differentiate(beam, boresight, log_slope, first_bin, room, trial_shape, by)
            # The level is refitted at each step: project the other columns orthogonally to it.
            norm, along_r, along_s = 0.0, 0.0, 0.0
            for b in range(bins):
                level_weight = (mean[b] - background) / mean[b]
                by[0, b] *= level / mean[b]
                by[1, b] *= level / mean[b]
                norm += level_weight * level_weight
                along_r += level_weight * by[0, b]
                along_s += level_weight * by[1, b]
            if norm == 0.0:  # even the best slope puts no power in these bins
                empty = True
                break
            a, c, d, pull_r, pull_s = 0.0, 0.0, 0.0, 0.0, 0.0
            for b in range(bins):
                level_weight, excess = (mean[b] - background) / mean[b], power[b] / mean[b] - 1
                r, s = by[0, b] - level_weight * along_r / norm, by[1, b] - level_weight * along_s / norm
                a, c, d = a + r * r, c + r * s, d + s * s
                pull_r, pull_s = pull_r + r * excess, pull_s + s * excess
            m, n = a + damping * (a + 1e-12), d + damping * (d + 1e-12)
            determinant = m * n - c * c
            step_r, step_s = (n * pull_r - c * pull_s) / determinant, (m * pull_s - c * pull_r) / determinant
            to_r = boresight + min(max(step_r, -MAX_RANGE), MAX_RANGE)
            to_s = log_slope + min(max(step_s, -MAX_SLOPE), MAX_SLOPE)
            to_s = min(max(to_s, np.log(slopes[0])), np.log(slopes[-1]))
            _shape(sine, beam_power, across, response, first_bin, to_r, to_s, place, edge, below, spread, trial_shape)
            trial_loss, trial_level = _loss(trial_shape, power, background, trial_mean)
            if trial_loss < loss:
                done = loss - trial_loss < DONE
                boresight, log_slope, loss, level, damping = to_r, to_s, trial_loss, trial_level, damping / 4
                for b in range(bins):
                    mean[b] = trial_mean[b]
                if done:
                    break
            else:
                damping = damping * 10 + 1e-2
        if empty:
            centre[i], sigma[i] = centroids[i], float(bins)
        else:
            # A slope that nothing tells leaves the range to the bins of the echo.
            fitted = np.sqrt(max(_centre_variance(a, c, d), MIN_VARIANCE))
            centre[i], sigma[i] = boresight, min(fitted, float(bins))
