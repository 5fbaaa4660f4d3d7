"""Ranges along a scan line, tracked from neighbour to neighbour: how far they share their errors, how steep it is."""

import numpy as np
import pytest

from sionna_radar.detection.volume.ground import SLOPES
from sionna_radar.detection.volume.height_track import AxisHeights, TrackedRanges, line_likelihood, track
from sionna_radar.inference.echo.speckle import repeats

PULSES, CELLS, CELL_M = 600, 160, 0.3
# Own evidence of each pulse, and slope of the ground times the distance of neighbours, in cells.
SPREAD, STEP = 6.0, 1.5


@pytest.fixture(scope="module")
def tracked():
    """Ranges of ground that wanders from pulse to pulse, seen from straight above with much noise."""
    rng = np.random.default_rng(2)
    place = np.arange(PULSES, dtype=float)
    wander = rng.laplace(size=PULSES).cumsum() * STEP / 3
    true = 80 + wander - np.linspace(wander[0], wander[-1], PULSES)
    seen = true + SPREAD * rng.standard_normal(PULSES)
    evidence = -(((np.arange(CELLS) - seen[:, None]) / SPREAD) ** 2) / 2
    heights = AxisHeights(
        position_m=np.column_stack([place, np.zeros(PULSES), np.full(PULSES, 100.0)]),
        boresight=np.tile([0.0, 0.0, -1.0], (PULSES, 1)),
        shift_m=np.zeros(PULSES),
    )
    slope = np.sqrt(np.pi / 2) * STEP * CELL_M / 3
    found = track(evidence, heights, CELL_M, np.zeros(PULSES, dtype=int), slope, CELL_M)
    return found, true


def test_errors_of_neighbours_repeat_as_far_as_their_means_scatter(tracked):
    """Means over many pulses scatter as the sum of the correlations says: here, by the sum of those of the errors."""
    found, true = tracked
    error = found.cell - true
    error -= error.mean()
    correlation = [np.mean(error[lag:] * error[: len(error) - lag]) / np.mean(error**2) for lag in range(1, 13)]
    assert correlation[0] > 0.5
    stated = float(np.median(repeats(found.reach)))
    assert stated == pytest.approx(1 + 2 * np.sum(np.maximum(correlation, 0.0)), rel=0.5)


def test_pulses_that_see_the_ground_by_themselves_share_nothing(tracked):
    found, true = tracked
    sharp = -(((np.arange(CELLS) - true[:, None]) / 0.5) ** 2) / 2
    heights = AxisHeights(
        position_m=np.column_stack([50.0 * np.arange(PULSES), np.zeros(PULSES), np.full(PULSES, 100.0)]),
        boresight=np.tile([0.0, 0.0, -1.0], (PULSES, 1)),
        shift_m=np.zeros(PULSES),
    )
    alone = track(sharp, heights, CELL_M, np.zeros(PULSES, dtype=int), 0.15, CELL_M)
    assert np.all(alone.reach < 0.8)
    assert np.median(found.reach) > 1.0


@pytest.mark.parametrize(("steps", "share"), [(0.3, 0.5), (2.0, 0.2)])
def test_sharper_pulses_are_smoothed_as_a_random_walk_is(steps, share):
    """Variance and correlations of heights in a random walk, from the inverse of their information matrix."""

    def smoothed(noise):
        walk = (2 * np.eye(201) - np.eye(201, k=1) - np.eye(201, k=-1)) / steps
        return np.linalg.inv(walk + np.eye(201) / noise)[100, 100]

    alone = np.ones(1)
    known = TrackedRanges(cell=alone, sigma=np.sqrt([smoothed(1.0)]), probability=alone, evidence=alone, alone=alone)
    sharper = known.with_variance(np.array([share]))
    assert sharper.sigma[0] ** 2 == pytest.approx(smoothed(share), rel=1e-3)
    assert sharper.alone[0] ** 2 == pytest.approx(share)


def likelihoods_of(true, spread_cells):
    """The log-likelihoods of `SLOPES` in a line of pulses that look straight down, 1.5 m apart."""
    rng = np.random.default_rng(3)
    seen = true + spread_cells * rng.standard_normal(len(true))
    evidence = -(((np.arange(CELLS) - seen[:, None]) / spread_cells) ** 2) / 2
    heights = AxisHeights(
        position_m=np.column_stack([1.5 * np.arange(len(true)), np.zeros(len(true)), np.full(len(true), 100.0)]),
        boresight=np.tile([0.0, 0.0, -1.0], (len(true), 1)),
        shift_m=np.zeros(len(true)),
    )
    return np.array([line_likelihood(evidence, heights, CELL_M, slope, CELL_M / 10) for slope in SLOPES])


@pytest.mark.parametrize("number", range(3, 6))
def test_a_line_tells_how_steep_a_hillside_is(number):
    """From 0.1 on, where a pulse climbs by more than the scatter of its height."""
    climb = np.arange(60) - 29.5
    change_m = np.sqrt(2 / np.pi) * SLOPES[number] * 1.5
    assert likelihoods_of(80 + change_m * climb / CELL_M, 0.3).argmax() == number


def test_heights_lost_in_noise_tell_no_slopes():
    of_slopes = likelihoods_of(np.full(60, 80.0), 20.0)
    assert np.ptp(of_slopes[:4]) < 1.0
    sharp = likelihoods_of(np.full(60, 80.0), 0.3)
    assert sharp[0] > sharp[3] + 5 > sharp[5] + 10
