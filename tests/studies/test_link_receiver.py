"""Floors and echoes of a receiver as it is built: closed form against the chain."""

import numpy as np
import pytest

from direct_receiver import points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.link import study as link_study
from sionna_radar.studies.link.spectra import floors_of
from sionna_radar.studies.link.study import link_budget as run_link_budget
from surveys import WEAK

CORNER_HZ = 50 * 360.0
HIGH_PASS = {"high_pass_corner_hz": 10e3}
NOISY = {
    "oscillator": {"phase_noise_dbc_hz": [[1e3, -60.0], [1e6, -60.0]]},
    "leakage": [{"delay_ns": 20.0, "level_db": 0.0}],
}
UNLIKE = {"converter": {"iq_gain_db": 3.0, "iq_phase_deg": 10.0}}


def filtered(order):
    return {"anti_alias_corner_hz": CORNER_HZ, "anti_alias_order": order}


def differences_db(keys, sampling, pulses=1000):
    """Return simulated over closed-form floors in the bins, where no echo is."""
    radar = radar_with(keys, sampling=sampling)
    receiver = receiver_of(radar, noise_w=1e-6)
    analyser = SpectrumAnalyser(receiver.chirp, "hann", 1, receiver.high_pass)
    silent = points_at(10.0, 0.0).rows(np.zeros(0, np.int64))
    (beat,) = receiver.beats(silent, make_pulses(pulses))
    expected = sum(floors_of(radar, receiver, analyser).values())
    return 10 * np.log10(analyser.power(beat).mean(axis=0) / expected)


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("keys", [*map(filtered, (1, 2, 3, 4)), filtered(1) | HIGH_PASS, filtered(4) | HIGH_PASS])
def test_noise_folds_with_what_both_filters_let_pass(keys, sampling):
    difference_db = differences_db(keys, sampling)[4:-4]
    # Each bin scatters by 0.14 dB.
    assert np.mean(difference_db) == pytest.approx(0.0, abs=0.05)
    assert np.max(np.abs(difference_db)) < 0.6


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("order", [1, 4])
def test_phase_noise_of_the_leakage_folds_too(order, sampling):
    difference_db = differences_db(NOISY | filtered(order), sampling, pulses=600)[40:-4]
    assert np.mean(difference_db) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("more", [{}, filtered(4), {"leakage": [{"delay_ns": 40.0, "level_db": -20.0}]}])
def test_unlike_parts_add_an_image_of_all_floors(more):
    difference_db = differences_db(UNLIKE | more, "iq")[4:-4]
    assert np.mean(difference_db) == pytest.approx(0.0, abs=0.05)
    assert np.max(np.abs(difference_db)) < 0.6


DRIFT = {"radar.receiver.oscillator.drift_ppm_per_k": 5000.0, "radar.receiver.oscillator.warmer_k": 10.0}
FILTER = {"radar.receiver.anti_alias_corner_hz": 0.25 * 512 * 360.0, "radar.receiver.high_pass_corner_hz": 20e3}
IMAGE = {"radar.receiver.converter.iq_gain_db": 3.0, "radar.receiver.converter.iq_phase_deg": 10.0}


@pytest.mark.parametrize(
    "keys",
    [
        DRIFT,
        FILTER | {"radar.receiver.anti_alias_order": 1},
        FILTER | {"radar.receiver.anti_alias_order": 4},
        FILTER | DRIFT | IMAGE | {"radar.receiver.anti_alias_order": 2, "radar.sampling": "iq"},
    ],
)
def test_ground_is_as_strong_as_the_chain_receives_it(keys, monkeypatch):
    # What the survey's detector makes of these beats takes longer than they do, and is tested in clear air and rain.
    monkeypatch.setattr(link_study, "_survey_detection", lambda *_: 1.0)
    weak = WEAK | {"processing.cfar.kind": "CA"}
    scenario = load_scenario("hills", weak | keys)
    budget = run_link_budget(scenario, incidences_deg=[40.0], rains_mm_per_h=[10.0], pulses=600)
    assert all(one.compared for link in budget.links for one in link.simulated)
    assert budget.largest_difference_db < 0.3
