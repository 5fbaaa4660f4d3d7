"""The motion of a volume whose echo is drawn from its law, and the ground that a survey learns behind it."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar.detection.volume.clutter import (
    VolumeCells,
    VolumeClutter,
    estimated_motion,
    expected_motion,
    law_information,
    rain_rate_of,
)
from sionna_radar.detection.volume.ground import LEVELS, SLOPES, learned_ground, unknown_ground
from sionna_radar.flight.frames import R_WORLD_NED, whisk_broom_from_antenna
from sionna_radar.weather.rain import rain_attenuation_db_per_km, rain_reflectivity_per_m

CARRIER_HZ, RAIN_MM_PER_H = 77e9, 5.0
# A scan 40 deg to each side, 45 deg forward, of a platform that heads north.
SCAN_RAD = np.deg2rad(np.linspace(-40, 40, 20))
LINE = (R_WORLD_NED @ whisk_broom_from_antenna(np.pi / 4, SCAN_RAD))[:, :, 0]


SEEDS = range(20)
SHIFT_M, NEAR_FIELD_M = 0.41, 1.6
RANGE_M = np.arange(3.3, 58.0, 0.3)
# Two-way, of 5 mm/h.
ATTENUATION = 1.4e-3


def echoes(velocity_mps, seed=7, *, lines=10, nearest_m=0.0, noise=1e-6, sign=1.0, cells_m=RANGE_M):
    """Powers of a volume that moves; approaching drops fold onto positive frequencies."""
    boresight = np.tile(LINE, (lines, 1))
    platform_mps = -10.0 * boresight[:, 1]
    shift_m = sign * SHIFT_M * (boresight @ np.asarray(velocity_mps, dtype=float) + platform_mps)

    def mean(measured_m):
        range_m = measured_m - shift_m[:, None]
        return np.where(range_m > 0, np.exp(-ATTENUATION * range_m) / (range_m**2 + NEAR_FIELD_M**2), 0.0)

    power = mean(cells_m) + mean(-cells_m) + noise
    far = nearest_m <= cells_m
    return VolumeCells(
        power=np.random.default_rng(seed).exponential(power)[:, far],
        noise=np.full((len(boresight), 1), noise),
        range_m=cells_m[far],
        shift_m=sign * SHIFT_M,
        boresight=boresight,
        platform_mps=platform_mps,
        looks=1.0,
        margin_m=1.0,
        near_field_m=NEAR_FIELD_M,
        uneven=0.0,
    )


def found_motion(*given, **named):
    return estimated_motion(CARRIER_HZ, RAIN_MM_PER_H, echoes(*given, **named))


def test_rain_in_still_air_is_kept():
    """Of 40 surveys at most one shows another motion."""
    rain = expected_motion(CARRIER_HZ, RAIN_MM_PER_H)
    found = [found_motion(rain.velocity_mps, seed).velocity_mps for seed in range(40)]
    assert sum(not np.array_equal(velocity_mps, rain.velocity_mps) for velocity_mps in found) <= 1


def test_drops_of_heavier_rain_fall_faster():
    """Mean Doppler velocities at vertical incidence, 77 GHz: 4.1 m/s in 1 mm/h, 4.9 m/s in 25 mm/h."""
    fall = [-expected_motion(CARRIER_HZ, rate).velocity_mps[2] for rate in (1.0, 25.0)]
    assert fall == pytest.approx([4.1, 4.9], abs=0.1)


@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0, 100.0])
@pytest.mark.parametrize("range_m", [0.0, 40.0])
def test_the_strength_of_its_echo_tells_the_rain(rate, range_m):
    straight_down = {"elevation_rad": -np.pi / 2, "tilt_rad": np.pi / 2}
    loss_db = 2e-3 * range_m * rain_attenuation_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=rate, **straight_down)
    echo = rain_reflectivity_per_m(CARRIER_HZ, rain_rate_mm_per_h=rate, temperature_k=283.0)
    assert rain_rate_of(echo * 10 ** (-loss_db / 10), range_m, CARRIER_HZ) == pytest.approx(rate, rel=2e-3)


def test_echoes_beyond_any_rain_are_taken_for_the_least_and_the_most():
    assert rain_rate_of(1e-12, 10.0, CARRIER_HZ) == pytest.approx(0.5)
    assert rain_rate_of(1.0, 10.0, CARRIER_HZ) == pytest.approx(150.0, rel=1e-4)


def test_from_afar_the_lesser_of_two_rates_is_told_and_none_beyond_the_strongest():
    """Over 350 m the loss takes more than heavier rain returns: 12 and 3 mm/h appear alike."""
    straight_down = {"elevation_rad": -np.pi / 2, "tilt_rad": np.pi / 2}
    rates, range_m = np.geomspace(0.5, 150.0, 18), 350.0
    loss_db = [
        2e-3 * range_m * rain_attenuation_db_per_km(CARRIER_HZ, rain_rate_mm_per_h=rate, **straight_down)
        for rate in rates
    ]
    echo = [rain_reflectivity_per_m(CARRIER_HZ, rain_rate_mm_per_h=rate, temperature_k=283.0) for rate in rates]
    received = np.array(echo) * 10 ** (-np.array(loss_db) / 10)
    strongest = int(received.argmax())
    assert 3 < strongest < 15
    told = [rain_rate_of(power, range_m, CARRIER_HZ) for power in received]
    np.testing.assert_allclose(told[: strongest - 1], rates[: strongest - 1], rtol=2e-3)
    assert max(told) < rates[strongest + 1]
    assert rain_rate_of(10 * received[strongest], range_m, CARRIER_HZ) == pytest.approx(rates[strongest], rel=0.1)


@pytest.mark.parametrize("rate", [0.5, 30.0, 150.0])
def test_a_wrong_rain_is_no_reason_to_find_no_motion(rate):
    """Its loss over 450 m is up to 13 nepers beside the one seen."""
    velocity = expected_motion(CARRIER_HZ, RAIN_MM_PER_H).velocity_mps + np.array([0.0, 6.0, 0.0])
    afar = echoes(velocity, lines=20, noise=1e-12, cells_m=np.arange(3.3, 460.0, 0.6))
    found = estimated_motion(CARRIER_HZ, rate, afar)
    error_mps, sigma_mps = found.range_rate_mps(LINE) - LINE @ velocity, found.sigma_mps(LINE)
    assert np.mean((error_mps / sigma_mps) ** 2) < 4.0
    assert sigma_mps.max() < 1.0


@pytest.mark.parametrize(
    ("wind_mps", "sign"),
    [((-10.0, 0.0), 1.0), ((-10.0, 0.0), -1.0), ((0.0, 10.0), 1.0), ((0.0, -10.0), -1.0), ((7.0, 7.0), 1.0)],
)
def test_the_wind_is_found(wind_mps, sign):
    """By 1,200 pulses, also where drops approach (their echo is folded) and in a sweep downwards."""
    velocity = expected_motion(CARRIER_HZ, RAIN_MM_PER_H).velocity_mps + np.array([*wind_mps, 0.0])
    found = found_motion(velocity, lines=60, sign=sign)
    assert np.abs(found.range_rate_mps(LINE) - LINE @ velocity).mean() < 0.6


def test_range_rates_have_no_bias():
    velocity = expected_motion(CARRIER_HZ, RAIN_MM_PER_H).velocity_mps + np.array([0.0, 6.0, 0.0])
    errors = [np.mean(found_motion(velocity, seed, lines=20).range_rate_mps(LINE) - LINE @ velocity) for seed in SEEDS]
    assert abs(np.mean(errors)) < 3 * np.std(errors) / len(SEEDS) ** 0.5
    assert np.std(errors) < 0.6


@pytest.mark.parametrize("fall_mps", [0.8, 1.1, 1.5])
def test_snow_falls_as_snow(fall_mps):
    found = found_motion([0.0, 0.0, -fall_mps], lines=50)
    assert np.abs(found.range_rate_mps(LINE) + fall_mps * LINE[:, 2]).max() < 0.7


def test_uneven_rain_shows_no_wind():
    """Strength near and far in a pulse differ by a third and by chance: taken for even rain it is a wind of 2 m/s."""
    rain = expected_motion(CARRIER_HZ, RAIN_MM_PER_H)
    even = echoes(rain.velocity_mps, lines=50)
    change = 0.33 * np.random.default_rng(2).normal(size=(len(even.power), 1))
    changed = replace(even, power=even.power * np.exp(change * (1 - even.range_m / 30)))
    for uneven, kept in ((0.0, False), (0.1, True)):
        found = estimated_motion(CARRIER_HZ, RAIN_MM_PER_H, replace(changed, uneven=uneven))
        assert np.array_equal(found.velocity_mps, rain.velocity_mps) == kept


def test_what_the_motion_is_not_told_is_its_covariance():
    """Errors in 16 winds over what is stated have a mean square of one; cells that say nothing leave the prior."""
    rain = expected_motion(CARRIER_HZ, RAIN_MM_PER_H)
    squares = []
    for seed in range(16):
        wind = np.random.default_rng(seed).normal(0, [5.0, 5.0, 0.5])
        found = found_motion(rain.velocity_mps + wind, seed, lines=2, noise=3e-4)
        off_mps = found.range_rate_mps(LINE) - LINE @ (rain.velocity_mps + wind)
        squares.append(np.mean((off_mps / found.sigma_mps(LINE)) ** 2))
    assert 0.5 < np.mean(squares) < 2.0
    nothing = found_motion(rain.velocity_mps, nearest_m=60.0)
    np.testing.assert_allclose(np.sqrt(np.diag(nothing.covariance)), [3.54, 3.54, 0.5], atol=0.01)
    sure = found_motion(rain.velocity_mps, noise=1e-9, lines=40)
    assert sure.sigma_mps(LINE).max() < 0.6


@pytest.mark.parametrize("told", [{"noise": 1.0}, {"nearest_m": 50.0}, {"nearest_m": 60.0}])
def test_cells_that_say_little_keep_rain(told):
    """Far from the radar, and in noise a hundred times as strong as the volume, a shift changes little."""
    found = found_motion([-5.0, 0.0, -1.0], **told)
    np.testing.assert_array_equal(found.velocity_mps, expected_motion(CARRIER_HZ, RAIN_MM_PER_H).velocity_mps)


def test_the_levels_and_slopes_of_the_ground_are_learned():
    """Each pulse is sure of its own level to half a step, and likes one of two slopes by 3 nepers."""
    shares = {4.0: 0.7, 20.0: 0.25, 36.0: 0.05}
    own = np.repeat(list(shares), [round(100 * share) for share in shares.values()])
    off_db = 10 * np.log10(LEVELS) - own[:, None]
    steep = np.arange(100) % 4 == 0
    off_slope = np.abs(np.arange(len(SLOPES))[:, None] - np.where(steep, 5, 2))
    likelihood = -0.5 * off_db**2 - 3.0 * off_slope[..., None]
    ground = learned_ground(unknown_ground(), likelihood.astype(np.float32), np.arange(100.0))
    assert ground.cell == 49
    np.testing.assert_allclose(ground.slope_weight[[2, 5]], [0.75, 0.25], atol=0.02)
    assert ground.slope == pytest.approx(0.75 * SLOPES[2] + 0.25 * SLOPES[5], rel=0.05)
    for weight in (ground.level_weight, ground.slope_weight):
        assert weight.sum() == pytest.approx(1.0)
    level_db = 10 * np.log10(ground.level)
    for level, share in shares.items():
        about = np.abs(level_db - level) < 3
        assert ground.level_weight[about].sum() == pytest.approx(share, abs=0.02)
    # What is between frequent levels stays out, but for the neighbours of each.
    assert np.all(np.abs(level_db[:, None] - list(shares)).min(axis=1) < 2.5)


def test_pulses_without_preference_leave_all_levels_and_slopes():
    likelihood = np.zeros((len(SLOPES), 50, len(LEVELS)), dtype=np.float32)
    ground = learned_ground(unknown_ground(), likelihood, np.full(50, 90.0))
    np.testing.assert_allclose(ground.level, LEVELS)
    np.testing.assert_allclose(ground.level_weight, 1 / len(LEVELS), rtol=1e-6)
    np.testing.assert_allclose(ground.slope_weight, 1 / len(SLOPES), rtol=1e-6)


def test_a_line_outweighs_what_the_survey_says_of_slopes():
    ground = unknown_ground()
    likely = ground.given(-np.abs(np.arange(len(SLOPES)) - 1.0) * 10)
    assert likely.slope == pytest.approx(SLOPES[1], rel=1e-3)
    steep = likely.given(-np.abs(np.arange(len(SLOPES)) - 5.0) * 30)
    assert steep.slope == pytest.approx(SLOPES[5], rel=1e-3)


NEAR, CELLS, PULSES = (10, 60), 80, 400


def volume_seen(strength):
    """A volume with powers that are exponential about its mean times a strength for each pulse."""
    range_cells = np.maximum(np.arange(CELLS), 1.0)
    volume = VolumeClutter(mean=100.0 / range_cells**2, noise=1e-4, near=NEAR)
    rng = np.random.default_rng(11)
    return volume, rng.exponential(strength[:, None] * volume.mean + volume.noise)


def uneven(volume, power):
    return VolumeClutter(
        mean=volume.mean,
        noise=volume.noise,
        near=volume.near,
        uneven=volume.unevenness(power, looks=1.0, smoothed_cells=8),
    )


def test_a_volume_that_is_the_same_everywhere_has_strength_one():
    volume, power = volume_seen(np.ones(PULSES))
    assert volume.unevenness(power, looks=1.0, smoothed_cells=8) == 0.0
    np.testing.assert_array_equal(uneven(volume, power).strength(power, 1.0, 12), np.ones(PULSES))


def test_a_step_in_strength_is_followed():
    truth = np.where(np.arange(PULSES) < PULSES // 2, 0.4, 1.6)
    volume, power = volume_seen(truth)
    known = uneven(volume, power)
    assert known.uneven == pytest.approx(0.36, rel=0.15)
    found = known.strength(power, 1.0, 12)
    away = np.abs(np.arange(PULSES) - PULSES // 2) > 13
    assert np.abs(found / truth - 1)[away].max() < 0.15
    # A single pulse says less: 50 looks, a seventh of its strength.
    alone = known.strength(power, 1.0, 0)
    assert 0.08 < np.std(alone[away] / truth[away]) < 0.2


def test_too_few_cells_tell_no_strength():
    volume, power = volume_seen(np.where(np.arange(PULSES) < 200, 0.4, 1.6))
    few = VolumeClutter(mean=volume.mean, noise=volume.noise, near=(10, 20))
    assert few.unevenness(power, looks=1.0, smoothed_cells=8) == 0.0
    none = VolumeClutter(mean=volume.mean, noise=volume.noise, near=(10, 10))
    assert none.unevenness(power, looks=1.0, smoothed_cells=8) == 0.0


def test_what_is_known_of_the_mean_is_what_a_fit_of_a_line_leaves():
    volume = VolumeClutter(mean=100.0 / np.maximum(np.arange(CELLS), 1.0) ** 2, noise=1e-9, near=NEAR)
    count = np.where(np.arange(CELLS) < 40, 200, 0)
    cell = np.flatnonzero(count)
    full = np.array([[len(cell), (cell - 70.0).sum()], [(cell - 70.0).sum(), ((cell - 70.0) ** 2).sum()]]) * 400
    assert law_information(volume, count, 2.0, 70) == pytest.approx(1 / np.linalg.inv(full)[0, 0], rel=1e-6)
    assert law_information(volume, np.zeros(CELLS, dtype=int), 2.0, 70) == 0.0
    assert law_information(volume, (np.arange(CELLS) == 30).astype(int), 2.0, 70) == pytest.approx(0.0, abs=1e-9)
