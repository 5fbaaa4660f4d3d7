"""Levels of the ground's echo from place to place: two fields, one ground, and rain over both."""

import numpy as np
import pytest

from sionna_radar import load_scenario, run
from sionna_radar.detection.volume.nearby_levels import nearby_levels

LEVEL_DB = np.arange(0.0, 20.0, 2.0)
WEAK_DB, STRONG_DB, SIGMA_DB = 7.0, 13.0, 4.0


def sampled(strong, seed, pulses=256):
    """Places, and likelihoods of levels of pulses that each know their own to 4 dB."""
    rng = np.random.default_rng(seed)
    place_m = rng.uniform(0.0, 100.0, (pulses, 2))
    level_db = np.where(strong(place_m), STRONG_DB, WEAK_DB) + SIGMA_DB * rng.standard_normal(pulses)
    likelihood = np.exp(-0.5 * ((LEVEL_DB - level_db[:, None]) / SIGMA_DB) ** 2)
    weight = np.full(len(LEVEL_DB), 1 / len(LEVEL_DB))
    for _ in range(300):
        probability = weight * likelihood
        weight = (probability / probability.sum(axis=1, keepdims=True)).mean(axis=0) + 1e-9
        weight /= weight.sum()
    return place_m, likelihood, weight


@pytest.mark.parametrize("seed", range(3))
def test_each_field_gets_its_own_level(seed):
    place_m, likelihood, survey = sampled(lambda at: at[:, 0] > 50.0, seed)
    nearby = nearby_levels(likelihood, survey, np.arange(256), place_m)
    assert 3.0 < nearby.reach_m < 50.0
    assert 3.0 < nearby.together < 256.0
    inside = np.array([[20.0, 50.0], [30.0, 20.0], [70.0, 50.0], [80.0, 80.0]])
    weight = nearby.weight(survey, np.arange(1000, 1004), inside)
    np.testing.assert_allclose(weight.sum(axis=1), 1.0)
    np.testing.assert_allclose(weight @ LEVEL_DB, [WEAK_DB, WEAK_DB, STRONG_DB, STRONG_DB], atol=2.0)


def test_ground_of_one_kind_keeps_the_level_of_the_survey():
    """Halves that tell each other nothing: a place seems to matter by chance alone, and then by little."""
    apart_db = []
    for seed in range(12):
        place_m, likelihood, survey = sampled(lambda at: at[:, 0] > 500.0, seed)
        nearby = nearby_levels(likelihood, survey, np.arange(256), place_m)
        if nearby is not None:
            apart_db.append(np.std(nearby.weight(survey, np.arange(1000, 1256), place_m) @ LEVEL_DB))
    assert len(apart_db) <= 3
    assert max(apart_db, default=0.0) < 0.5


def test_a_pulse_is_no_evidence_for_itself():
    place_m, likelihood, survey = sampled(lambda at: at[:, 0] > 50.0, 1)
    nearby = nearby_levels(likelihood, survey, np.arange(256), place_m)
    alone = nearby_levels(
        np.delete(likelihood, 7, axis=0), survey, np.delete(np.arange(256), 7), np.delete(place_m, 7, 0)
    )
    own = nearby.weight(survey, np.array([7]), place_m[7:8])
    other = nearby.weight(survey, np.array([700]), place_m[7:8])
    assert not np.allclose(own, other)
    # What is left of it is in what it told its neighbours.
    np.testing.assert_allclose(own, alone.weight(survey, np.array([7]), place_m[7:8]), atol=0.03)


def test_pulses_at_one_place_have_the_level_of_the_survey():
    _, likelihood, survey = sampled(lambda at: at[:, 0] > 50.0, 1)
    assert nearby_levels(likelihood, survey, np.arange(256), np.ones((256, 2))) is None


def test_rain_over_two_fields_does_not_move_them():
    """Fields 3 dB apart under a wide slanting beam: one level for both moves them 0.5 to 0.65 m apart (three seeds)."""
    changes = {
        "weather.rain_rate_mm_per_h": 2.0,
        "processing.volume.rain_rate_mm_per_h": 2.0,
        "platform.altitude_m": 60.0,
        "platform.start_m": [-60.0, 0.0],
        "platform.length_m": 20.0,
        "radar.bandwidth_hz": 300e6,
        "radar.chirp_rate_hz": 700.0,
        "radar.samples_per_chirp": 1024,
        "radar.antenna.beamwidth_deg": 4.0,
        "radar.scan": {"mode": "conical", "incidence_deg": 60.0, "half_swath_deg": 40.0, "rotation_rpm": 397.0},
        "dem.method": "smooth",
        "tracing.paths_per_pulse": 96,
        "seed": 34,
    }
    survey = run(load_scenario("two_fields", changes))
    error = np.where(survey.lit, survey.error.height_m, np.nan)
    strong, weak = (np.nanmean(error[side]) for side in (survey.error.grid.y_m > 10.0, survey.error.grid.y_m < -10.0))
    assert abs(strong - weak) < 0.4
    assert survey.lit_error.rms_m < 0.22
