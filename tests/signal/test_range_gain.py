"""The gain over range: its slope, its calibration, the direct computation, the converter behind it, and its floors."""

import numpy as np
import pytest
import scipy.signal

from direct_receiver import direct_beat, points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.analog_filters import RangeGain, build_high_pass
from sionna_radar.signal.beat import SampleGrid
from sionna_radar.studies.link_spectra import floors_of

RISING = {"from_hz": 2e3, "to_hz": 30e3, "order": 2}


@pytest.mark.parametrize("order", [1, 2, 3])
def test_it_rises_by_six_decibels_an_octave_and_order_to_one(order):
    gain = RangeGain(from_hz=10.0, to_hz=1e5, order=order)
    frequency = np.array([1e-3, 1e3, 2e3, 1e9])
    power_db = 10 * np.log10(gain.power_response(frequency))
    np.testing.assert_allclose(np.abs(gain.response(frequency)) ** 2, gain.power_response(frequency), rtol=1e-9)
    assert power_db[0] == pytest.approx(-80.0 * order, abs=1e-6)
    assert power_db[2] - power_db[1] == pytest.approx(6.02 * order, abs=0.01)
    assert power_db[3] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(gain.response(-frequency), np.conj(gain.response(frequency)))


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("converter", [{}, {"full_scale_over_noise_db": 250.0}])
def test_echoes_are_weakened_by_it_and_calibrated_back(sampling, converter):
    """By the short way of an ideal receiver, and by that through all stages."""
    radar = radar_with({"range_gain": RISING, "converter": converter}, sampling=sampling)
    receiver = receiver_of(radar, noise_w=1e-20)
    chirp = receiver.chirp
    for cell in (10, 60):
        (beat,) = receiver.beats(points_at(cell * chirp.range_resolution_m), make_pulses(1))
        raw = SpectrumAnalyser(chirp, "hann", 1).power(beat)[0, cell]
        calibrated = SpectrumAnalyser(chirp, "hann", 1, receiver.high_pass).power(beat)[0, cell]
        expected = receiver.high_pass.power_response(np.array([cell * chirp.rate_hz]))[0]
        assert 10 * np.log10(raw / expected) == pytest.approx(0.0, abs=0.05)
        assert 10 * np.log10(calibrated) == pytest.approx(0.0, abs=0.2)


def test_it_does_what_it_does_in_time():
    """The direct beat at 64 points a sample, through digital filters that hardly differ from the analogue one."""
    fine, keys = 64, {"range_gain": RISING, "high_pass_corner_hz": 3e3, "high_pass_order": 1}
    receiver = receiver_of(radar_with({**keys, "converter": {"full_scale_over_noise_db": 250.0}}), noise_w=1e-20)
    paths = points_at([14.0, 33.0, 25.0], [1.0, 0.5j, 2.0])
    found = receiver.beats(paths, make_pulses(1))[0][0]
    grid = SampleGrid(receiver.chirp, fine, 256)
    wide = grid.wide
    beat = np.sqrt(2) * direct_beat(paths, wide, wide.sample_time_s).real
    zero, pole = (-2 * np.pi * RISING[key] for key in ("from_hz", "to_hz"))
    section = scipy.signal.bilinear([1.0, -zero], [1.0, -pole], wide.sampling_rate_hz)
    for _ in range(RISING["order"]):
        beat = scipy.signal.lfilter(*section, beat)
    beat = scipy.signal.sosfilt(scipy.signal.butter(1, 3e3, "highpass", fs=wide.sampling_rate_hz, output="sos"), beat)
    expected = grid.sampled(beat[None])[0]
    assert np.linalg.norm(found - expected) < 5e-3 * np.linalg.norm(expected)


def test_a_near_flash_no_longer_fills_the_converter():
    flash = points_at([6.0, 60.0], [1.0, 1e-3])
    for keys, clipped in (({}, True), ({"range_gain": RISING}, False)):
        converter = {"bits": 12, "full_scale_over_noise_db": 90.0}
        receiver = receiver_of(radar_with({**keys, "converter": converter}), noise_w=1e-10)
        saturated = receiver.reception(flash, make_pulses(1)).saturated
        assert bool(saturated[0]) == clipped


def test_rounding_weighs_where_the_gain_is_low():
    """Thermal noise stays even in calibrated spectra, rounding is raised at near ranges: closed form and chain."""
    converter = {"bits": 6, "full_scale_over_noise_db": 22.0}
    radar = radar_with({"range_gain": RISING, "converter": converter})
    receiver = receiver_of(radar, noise_w=1e-6)
    analyser = SpectrumAnalyser(receiver.chirp, "hann", 1, receiver.high_pass)
    silent = points_at(10.0, 0.0).rows(np.zeros(0, np.int64))
    (beat,) = receiver.beats(silent, make_pulses(3000))
    floors = floors_of(radar, receiver, analyser)
    cells = slice(4, -4)
    found = analyser.power(beat).mean(axis=0)[cells]
    expected = sum(floors.values())[cells]
    assert np.max(np.abs(10 * np.log10(found / expected))) < 0.35
    assert np.mean(10 * np.log10(found / expected)) == pytest.approx(0.0, abs=0.05)
    rounding = floors["rounding of the converter"][cells]
    assert 10 * np.log10(rounding[0] / rounding[-1]) > 20
    assert rounding[0] > floors["thermal noise"][4] / 2


@pytest.mark.parametrize(
    ("rising", "message"),
    [
        ({"from_hz": 3e4, "to_hz": 3e4}, "to_hz: 30000 is not beyond from_hz = 30000"),
        ({"from_hz": 1e6, "to_hz": 2e6}, "receiver.range_gain.from_hz: 1e\\+06 lies beyond the highest beat"),
    ],
)
def test_a_gain_that_does_not_rise_within_the_band_is_refused(rising, message):
    with pytest.raises(ValueError, match=message):
        radar_with({"range_gain": rising})


def test_without_it_nothing_is_built():
    assert build_high_pass(RadarTable(snr_db=20.0).receiver) is None
    assert build_high_pass(radar_with({"range_gain": RISING}).receiver).corner_hz == 0
