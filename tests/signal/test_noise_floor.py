"""The floor behind a high-pass: what the calibration raises with the echoes, in closed form and as it is received."""

import numpy as np
import pytest

from direct_receiver import points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.detection.build import build_detector
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.signal.build import build_sampled_noise

CELL_HZ, NOISE_W = 360.0, 1e-6
STEEP = {"high_pass_corner_hz": 40 * CELL_HZ, "high_pass_order": 4}
FOLDING = STEEP | {"anti_alias_corner_hz": 110 * CELL_HZ, "anti_alias_order": 2}
ROUNDING = {"high_pass_corner_hz": 30 * CELL_HZ, "converter": {"bits": 6, "full_scale_over_noise_db": 22.0}}
RISING = {"range_gain": {"from_hz": 3 * CELL_HZ, "to_hz": 80 * CELL_HZ, "order": 3}} | {
    "converter": {"bits": 6, "full_scale_over_noise_db": 22.0}
}


def received(radar, pulses, cell=None, power=0.0):
    """Beats of a point at a range cell, or of noise alone."""
    receiver = receiver_of(radar, noise_w=NOISE_W)
    points = points_at((cell or 0) * receiver.chirp.range_resolution_m, np.sqrt(power))
    paths = points.rows(np.zeros(0 if cell is None else pulses, np.int64))
    if cell is not None:
        paths = type(paths)(**{**vars(paths), "pulse": make_pulses(pulses).index})
    return receiver, receiver.beats(paths, make_pulses(pulses))[0]


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("window", ["hann", "boxcar"])
@pytest.mark.parametrize("keys", [STEEP, FOLDING, ROUNDING, RISING], ids=["steep", "folding", "rounding", "rising"])
def test_the_floor_rises_as_the_closed_form_states(keys, window, sampling):
    radar = radar_with(keys, sampling=sampling)
    receiver, beat = received(radar, 1500)
    noise = build_sampled_noise(radar, receiver.sweeps)
    analyser = SpectrumAnalyser(receiver.chirp, window, 2, receiver.high_pass, noise=noise)
    white = NOISE_W * np.sum(analyser.window**2) * (2 if sampling == "real" else 1)
    cells = slice(8, -8)
    difference_db = 10 * np.log10(analyser.power(beat).mean(axis=0) / (white * analyser.noise_rise))[cells]
    assert (10 * np.log10(analyser.noise_rise[8]) > 15) == (keys is not STEEP)
    # Each bin scatters by 0.11 dB.
    assert np.max(np.abs(difference_db)) < 0.6
    assert np.mean(difference_db) == pytest.approx(0.0, abs=0.08)


def test_without_a_high_pass_the_floor_is_not_raised():
    radar = radar_with({"converter": ROUNDING["converter"]})
    assert build_sampled_noise(radar, receiver_of(radar).sweeps) is None


@pytest.mark.parametrize("keys", [FOLDING, RISING], ids=["folding", "rising"])
def test_a_raised_floor_hides_no_echo_behind_it(keys):
    """An echo 23 dB over thermal noise is found, and nothing nearer, where the floor is 60 dB higher."""
    radar = radar_with(keys, sampling="iq")
    receiver, beat = received(radar, 40, cell=170, power=200 * NOISE_W / 256)
    known = build_sampled_noise(radar, receiver.sweeps)
    found_m = {}
    for name, noise in (("known", known), ("unknown", None)):
        table = ProcessingTable(doppler_correction=False, volume_clutter="off", cfar={"guard": 16, "training": 24})
        detector = build_detector(table, receiver.chirp, high_pass=receiver.high_pass, noise=noise)
        echoes = detector.detect(beat, make_pulses(40).index, make_pulses(40).measured)
        found_m[name] = echoes.range_m
    truth_m = 170 * receiver.chirp.range_resolution_m
    assert len(found_m["known"]) == 40
    assert np.max(np.abs(found_m["known"] - truth_m)) < 1.0
    # Without that knowledge near noise passes in many pulses, but for what is the skirt of the least range.
    assert np.mean(np.abs(found_m["unknown"] - truth_m) > 5.0) > 0.25
