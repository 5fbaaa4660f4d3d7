"""Errors of an instrument: derivatives against differences, closed forms of what is told, and readings over planes."""

from dataclasses import replace

import numpy as np
import pytest

from calibration_surveys import every_echo_of, ground_of, straight
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, InstrumentErrors, stretches
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.kernels import fit_level
from sionna_radar.inference.echo.likelihood import EchoLikelihood, mean_ranges
from sionna_radar.inference.echo.power_kernels import echo_level
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles, Stage, _taken_by_level
from sionna_radar.mapping.navigation.joint import MeasuredPlaces
from sionna_radar.mapping.navigation.range_rates import RangeRates
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.calibration.estimation import (
    MAX_POSTERIOR_RATIO,
    Posterior,
    continued,
    solve,
    solve_over_unknown_ground,
)
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes, Readings
from sionna_radar.survey.preparation import prepare

HILLS = {"platform.length_m": 10.0, "dem.method": "refined", "terrain.seed": 4}


@pytest.fixture(scope="module")
def over_hills():
    """Whole echoes of a short flight over hills, and the hills."""
    prepared = prepare(load_scenario("hills", HILLS))
    return every_echo_of(prepared), ground_of(prepared)


@pytest.mark.parametrize("name", UNKNOWNS)
def test_the_change_of_the_mean_range_is_that_of_predictions_at_both_sides(over_hills, name):
    echoes, surface = over_hills
    # A turn and a gain of speed, so that every term takes part.
    motion = BelievedMotion(
        **{
            **vars(echoes.motion),
            "turn_rad_s": np.tile([0.1, -0.2, 0.3], (len(echoes), 1)),
            "acceleration_mps2": np.tile([1.0, 2.0, -1.0], (len(echoes), 1)),
        }
    )
    echoes = RangeProfiles(sightings=echoes.sightings, motion=motion, reach=echoes.reach)
    at = InstrumentErrors.of({"pitch": 0.003, "time_offset": 0.002, "range_scale": 1e-4})
    sightings, moved = echoes.without(at)
    slope = echoes._change(sightings, moved, surface, [name])[:, 0]
    step = 1e-3 * UNKNOWNS[name].prior * UNKNOWNS[name].si
    base = {"pitch": 0.003, "time_offset": 0.002, "range_scale": 1e-4}
    sides = []
    for sign in (-1, 1):
        errors = InstrumentErrors.of(base | {name: base.get(name, 0.0) + sign * step})
        sides.append(EchoLikelihood(echoes.without(errors)[0], surface).centroid_m())
    difference = (sides[1] - sides[0]) / (2 * step)
    # The mean is that of the power, whose share of each part of the beam changes as well, by a few percent.
    scale = np.abs(difference).max()
    # Ranges do not change at all with the slope of the backscatter, which both say.
    assert np.abs(slope - difference).max() <= 0.06 * scale


def test_the_score_of_whole_echoes_is_zero_on_the_average_at_the_truth(over_hills):
    echoes, surface = over_hills
    step = echoes.step(InstrumentErrors(), surface, ["range_bias"], Stage.FINE)
    total = float(step.summed()[0][0, 0])
    # A survey of 1000 pulses: the mean residual within four of its standard deviations.
    assert abs(step.score.sum() / total) < 4 / np.sqrt(total)
    shifted = echoes.step(InstrumentErrors(range_bias_m=-0.1), surface, ["range_bias"], Stage.FINE)
    assert shifted.score.sum() / total == pytest.approx(0.1, abs=0.04)


def test_known_errors_of_the_range_are_taken_out_of_whole_echoes(over_hills):
    echoes, surface = over_hills
    plain, errors = echoes.sightings, InstrumentErrors(range_bias_m=0.3, range_scale=1e-3)
    sightings, _ = echoes.without(errors)
    np.testing.assert_allclose(mean_ranges(sightings).range_m, errors.true_m(mean_ranges(plain).range_m), atol=1e-9)
    # Predictions are what is read: of each part of the beam.
    moved = EchoLikelihood(sightings, surface).footprints.shift_m - EchoLikelihood(plain, surface).footprints.shift_m
    range_m = EchoLikelihood(plain, surface).footprints.range_m
    met = np.isfinite(range_m)
    np.testing.assert_allclose(moved[met], (errors.read_m(range_m) - range_m)[met], atol=1e-9)


def test_ground_that_is_surveyed_at_many_places_tells_nearly_what_the_whole_ground_does(over_hills):
    echoes, surface = over_hills
    echoes = echoes.rows(np.arange(len(echoes)) % 2 == 0)
    names, own = ["roll", "pitch", "range_bias"], Grid.covering(-80.0, -60.0, -20.0, 60.0, 10.0)
    around = np.meshgrid(np.arange(-90.0, -20.0, 4.0), np.arange(-60.0, 60.0, 4.0))
    place_m = np.stack([axis.ravel() for axis in around], axis=1)
    sigma_m = np.full(len(place_m), 0.01)
    places = MeasuredPlaces(place_m=place_m, height_m=surface.at(*place_m.T), sigma_m=sigma_m)
    surveyed, _ = solve_over_unknown_ground(echoes, own, names, places=places)
    over = solve(CombinedEchoes(parts=(echoes,)), surface, names)
    assert surveyed.observable.all()
    assert (np.abs(surveyed.value) < 4 * surveyed.sigma).all()
    # An error of this one line that is not of the flight: the longest known part of the bias is lost.
    drifting, _ = solve_over_unknown_ground(echoes, own, names, places=places, between={"range_bias": 0.1})
    np.testing.assert_allclose(drifting.sigma[2] ** 2, surveyed.sigma[2] ** 2 + 0.1**2, rtol=0.02)
    np.testing.assert_allclose(drifting.sigma[:2], surveyed.sigma[:2], rtol=0.02)
    # Speckle counts alike in both, but over known ground as its scores scattered.
    ratio = surveyed.sigma / (over.sigma * np.sqrt(surveyed.scatter / over.scatter))
    assert (ratio > 0.95).all()
    assert (ratio < 3.0).all()


def test_echoes_of_several_recordings_say_what_they_say_in_one(over_hills):
    echoes, surface = over_hills
    first = np.arange(len(echoes)) < len(echoes) // 2
    parts = [echoes.rows(first), echoes.rows(~first)]
    both = RangeProfiles.joined(parts)
    np.testing.assert_array_equal(np.unique(both.motion.line), [0, 1])
    assert (np.diff(both.sightings.profiles.pulse) > 0).all()
    names = ["roll", "range_bias"]
    one, other = (each.step(InstrumentErrors(), surface, names, Stage.FINE) for each in (echoes, both))
    np.testing.assert_allclose(other.score, one.score, rtol=1e-9, atol=1e-9)


def posterior(information, prior=(1.0, 1.0)) -> Posterior:
    return Posterior(names=("time_offset", "lever_nose"), prior=np.array(prior), information=np.array(information))


def test_two_errors_that_do_the_same_are_not_told_apart():
    known = posterior([[1e6, 1e6], [1e6, 1e6]])
    assert not known.observable.any()
    # Half of the prior's variance each is left.
    np.testing.assert_allclose(known.sigma, np.sqrt(0.5), rtol=1e-5)
    assert known.correlation[0, 1] == pytest.approx(-1, abs=1e-5)
    (direction,) = known.null_space
    assert direction["time_offset"] == pytest.approx(-direction["lever_nose"])


def test_an_error_that_is_held_adds_its_own_uncertainty():
    """y = t + 0.2 l with noise s; t is told, l is held: var t = s^2 / (1 + s^2) + (0.2 / (1 + s^2))^2 to the prior."""
    s = 0.01
    information = np.array([[1.0, 0.2], [0.2, 0.04]]) / s**2
    known = posterior(information)
    np.testing.assert_array_equal(known.observable, [True, False])
    expected = s**2 / (1 + s**2) + (0.2 / (1 + s**2)) ** 2
    assert known.considered(known.observable)[0, 0] == pytest.approx(expected, rel=1e-9)
    # Drawn: what is estimated with the other left at zero.
    rng = np.random.default_rng(1)
    t, held = rng.standard_normal((2, 100_000))
    found = (t + 0.2 * held + s * rng.standard_normal(100_000)) / (1 + s**2)
    assert np.var(found - t) == pytest.approx(expected, rel=0.02)


def test_more_information_tells_what_was_not():
    known = posterior([[100.0, 0.0], [0.0, 1.0]])
    np.testing.assert_array_equal(known.observable, [True, False])
    assert known.sigma[1] == pytest.approx(np.sqrt(0.5))
    assert known.with_more(np.diag([0.0, 10.0])).observable.all()
    assert 1 / np.sqrt(1 + 8.0) == pytest.approx(MAX_POSTERIOR_RATIO)


def plane(slope: float = 0.0) -> Heightfield:
    grid = Grid.covering(-400.0, -400.0, 400.0, 400.0, 4.0)
    return Heightfield(grid=grid, height_m=np.tile(slope * grid.x_m, (grid.rows, 1)))


def altimeter(count: int, seed: int, tilt_deg: float = 0.0, sigma_m: float = 0.5) -> Readings:
    """A flight 100 m over a plane that looks down, or ahead, with ranges too long by 1.8 m."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(count) / 5
    position = np.column_stack([np.linspace(-200, 200, count), np.zeros(count), np.full(count, 100.0)])
    sine, cosine = np.sin(np.deg2rad(tilt_deg)), np.cos(np.deg2rad(tilt_deg))
    tilt = np.array([[sine, 0.0, cosine], [0.0, 1.0, 0.0], [-cosine, 0.0, sine]])
    motion = straight(position, 10.0, tilt, time_s)
    read = 100 / cosine + 1.8 + sigma_m * rng.standard_normal(count)
    return Readings(range_m=read, sigma_m=np.full(count, sigma_m), motion=motion, reach_m=300.0)


def test_readings_over_a_plane_tell_their_bias_as_a_mean_does():
    found = solve(CombinedEchoes(parts=(altimeter(400, 1),)), plane(), ["range_bias"], {"range_bias": 10.0})
    # The factor on the variance is known to a share of sqrt(2 / 15 stretches).
    assert found.sigma[0] == pytest.approx(0.5 / 20, rel=0.6)
    assert found.value[0] == pytest.approx(1.8, abs=4 * 0.5 / 20)
    assert found.observable.all()


def test_a_bias_that_drifts_from_line_to_line_is_known_as_a_mean_of_lines_is():
    """Of lines of n readings: d ~ N(0, s^2), so that the mean of a line varies by s^2 + sigma^2 / n about the bias."""
    count, sigma_m, between_m, apart_m = [400, 100, 50], 0.5, 0.2, [0.1, -0.3, 0.25]
    lines = [altimeter(n, k + 1) for k, n in enumerate(count)]
    lines = [replace(line, range_m=line.range_m + d) for line, d in zip(lines, apart_m, strict=True)]
    found = solve(
        CombinedEchoes(parts=tuple(lines)), plane(), ["range_bias"], {"range_bias": 10.0}, {"range_bias": between_m}
    )
    # Readings count by how well they fit.
    weight = np.split(found.step.weight, np.cumsum(count)[:-1])
    mean = np.array([np.average(line.range_m - 100.0, weights=w) for line, w in zip(lines, weight, strict=True)])
    own = sigma_m**2 / np.array([w.sum() for w in weight])
    drawn = between_m**2 / (between_m**2 + own)
    mean_of_lines = drawn @ mean / (drawn.sum() + between_m**2 / 10.0**2)
    assert found.value[0] == pytest.approx(mean_of_lines, abs=0.02 * found.sigma[0])
    # What a line has apart: its mean, drawn toward that of all.
    np.testing.assert_allclose(found.line_offsets[:, 0], drawn * (mean - found.value[0]), atol=0.02 * found.sigma[0])
    own *= found.scatter
    drawn = between_m**2 / (between_m**2 + own)
    variance = 1 / (drawn.sum() / between_m**2 + 1 / 10.0**2)
    assert found.sigma[0] == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert found.sigma[0] > between_m / np.sqrt(3)
    np.testing.assert_allclose(found.line_offsets_sigma[:, 0], np.sqrt(drawn * own + drawn**2 * variance), rtol=1e-6)


def test_over_level_ground_the_heading_is_not_told_and_bias_and_pitch_are_one():
    one = CombinedEchoes(parts=(altimeter(400, 1, tilt_deg=30.0),))
    found = solve(one, plane(), ["pitch", "heading", "range_bias"])
    assert not found.observable.any() or not found.observable[1]
    assert not found.observable[1]
    assert not (found.observable[0] and found.observable[2])
    assert {"pitch", "range_bias"} in [set(direction) for direction in found.before.null_space]
    assert found.value[1] == 0.0


def test_what_a_walk_goes_on_to_is_within_what_is_stated():
    """Noise and walks in all proportions, as they are taken beforehand: 14 stretches, and the mean of 14 more."""
    rng, deviation = np.random.default_rng(7), []
    for angle in rng.uniform(0, np.pi / 2, 400):
        means = np.cumsum(np.sin(angle) * rng.standard_normal(28)) + np.cos(angle) * rng.standard_normal(28)
        mean, sigma = continued(means[:14] + 5.0)
        deviation.append((means[14:].mean() + 5.0 - mean) / sigma)
    # Four standard deviations of a mean, a variance and a share of 400; of several laws the middle is the likelier.
    assert abs(np.mean(deviation)) < 0.2
    assert np.var(deviation) == pytest.approx(1, abs=0.35)
    assert np.mean(np.abs(deviation) < 1.96) == pytest.approx(0.95, abs=0.044)
    assert np.mean(np.abs(deviation) < 1) > 0.6
    # A level that only steps stays where it was last; of noise alone the mean is more than the last.
    steady = 1.0 + 1e-3 * rng.standard_normal(14)
    assert continued(steady)[0] == pytest.approx(1.0, abs=2e-3)
    assert continued(10 * steady)[1] == pytest.approx(10 * continued(steady)[1], rel=1e-9)


def test_stretches_stay_within_lines():
    line = np.repeat([0, 1, 2], [100, 50, 300])
    number = stretches(line)
    assert all(len(np.unique(line[number == k])) == 1 for k in np.unique(number))


def test_range_rates_stand_beside_the_ranges_of_their_lines(over_hills):
    """Rates that are far better known than ranges decide pitch and heading, and tell as much as they do alone."""
    echoes, surface = over_hills
    names, truth = ("pitch", "heading", "range_bias"), {"pitch": 0.004, "heading": -0.006}
    motion = echoes.motion.rows(np.arange(3, len(echoes), 7))
    ones = np.ones(len(motion))
    still = RangeRates(rate_mps=0 * ones, sigma_mps=1e-4 * ones, spread=np.outer(ones, [0.01, 0.01]), motion=motion)
    rates = replace(still, rate_mps=-still.linearised(InstrumentErrors.of(truth), ())[1])
    both = replace(echoes, rates=rates)
    alone, found = (solve(CombinedEchoes(parts=(each,)), surface, names) for each in (echoes, both))
    np.testing.assert_allclose(found.value[:2], [*truth.values()], atol=1e-5)
    change = rates.linearised(found.errors, names[:2])[0] / 1e-4
    covariance = np.linalg.inv(change.T @ change)
    np.testing.assert_allclose(found.covariance[:2, :2], covariance, rtol=0.05, atol=0.05 * covariance.min())
    # What the ranges say of pitch they now say of the range's bias.
    assert found.sigma[2] < alone.sigma[2]
    drifting = solve(CombinedEchoes(parts=(both,)), surface, names, between={"pitch": 1e-3})
    assert drifting.sigma[0] == pytest.approx(1e-3, rel=0.05)

    twice = RangeProfiles.joined([both, echoes, both])
    assert np.unique(twice.rates.motion.line).tolist() == [0, 2]
    assert len(twice.rows(twice.motion.line == 1).rates) == 0
    information, score = twice.doppler_information(InstrumentErrors(), names)
    once = both.doppler_information(InstrumentErrors(), names)
    np.testing.assert_allclose(information, 2 * once[0])
    np.testing.assert_allclose(score, 2 * once[1])


@pytest.mark.parametrize("spread_cells", [1.5, 2.5])
def test_the_mean_score_of_an_echos_width_is_what_its_fitted_level_takes(spread_cells):
    """Speckle of a Gaussian echo under a Hann window; level and weights as they are fitted to it."""
    rng, draws = np.random.default_rng(6), 20_000
    place, fine = np.arange(24) - 11.5, np.arange(-13.0, 13.0, 0.25)
    window = np.array([0.5, 1.0, 0.5])
    field = sum(factor * np.sinc(place[:, None] - fine - k) for factor, k in zip(window, (-1, 0, 1), strict=True))
    lit = np.exp(-0.5 * (fine / spread_cells) ** 2)
    scatterers = (rng.standard_normal((draws, len(fine))) + 1j * rng.standard_normal((draws, len(fine)))) * lit**0.5
    shape, common = 2 * field**2 @ lit, (np.convolve(window, window) / 1.5) ** 2
    noise, nothing, mean, weight = 1e-6 * shape.max(), np.zeros(len(place)), np.empty(len(place)), np.empty(len(place))
    score, taken = np.zeros(draws), np.zeros(draws)
    for number, power in enumerate(np.abs(scatterers @ field.T) ** 2):
        fit_level(power, shape, nothing, noise, echo_level(power, noise, nothing), mean, weight)
        own = weight > 1e-4
        # The change of a width, without what a change of the level explains.
        change = weight[own] * (place[own] ** 2 - np.average(place[own] ** 2, weights=weight[own]))
        score[number] = change @ (power[own] / mean[own] - 1)
        taken[number] = change @ _taken_by_level(weight[own], common)
    scatter = score.std() / draws**0.5
    assert -taken.mean() == pytest.approx(score.mean(), abs=0.06 * score.mean() + 3 * scatter)
    assert scatter < 0.06 * score.mean()
