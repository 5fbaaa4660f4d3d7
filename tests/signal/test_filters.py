"""Filters: anti-aliasing, high-pass and the gain over range; what folds, what noise and echoes become, calibration."""

import numpy as np
import pytest
import scipy.signal

from beams import make_chirp
from direct_receiver import direct_beat, points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.signal.analog_filters import HighPass, RangeGain
from sionna_radar.signal.beat import SampleGrid, synthesise
from sionna_radar.signal.receiver import add_noise
from sionna_radar.studies.link.spectra import floors_of
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import Paths


def line(beat, cell):
    return np.abs(np.sum(beat * np.exp(-2j * np.pi * cell * np.arange(len(beat)) / len(beat)))) ** 2 / len(beat) ** 2


@pytest.mark.parametrize("order", [2, 4, 6])
@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_what_lies_beyond_the_band_folds_into_it_weakened(sampling, order):
    band_cells = 256 if sampling == "iq" else 128
    corner_hz = 100 * 360.0
    receiver = receiver_of(
        radar_with({"anti_alias_corner_hz": corner_hz, "anti_alias_order": order}, sampling=sampling)
    )
    chirp = receiver.chirp
    for cell in (band_cells // 4, band_cells + 40):
        (beat,) = receiver.beats(points_at(cell * chirp.range_resolution_m), make_pulses(1))
        folded = cell if cell < band_cells else cell - 256 if sampling == "iq" else 256 - cell
        counted_hz = 360.0 * abs(cell - (128 if sampling == "iq" else 0))
        expected = 1 / (1 + (counted_hz / corner_hz) ** (2 * order))
        found = line(beat[0], folded) * (2 if sampling == "real" else 1)
        assert found == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(("cell", "folded"), [(-20, 236), (360, 104), (480, None)])
def test_complex_samples_see_a_band_around_their_middle(cell, folded):
    """Twice as many points as samples hold beats from -128 to 384 cells; what lies beyond them does not fold twice."""
    corner_hz, order = 40 * 360.0, 4
    radar = radar_with({"anti_alias_corner_hz": corner_hz, "anti_alias_order": order}, sampling="iq")
    receiver = receiver_of(radar)
    assert receiver.chain.oversampling == 2
    chirp = receiver.chirp
    # Negative beats are those of what comes nearer, fast.
    rate_mps = min(cell, 0) * 360.0 * chirp.wavelength_m / 2
    paths = points_at(max(cell, 0) * chirp.range_resolution_m + 1e-9, 1.0, rate_mps)
    (beat,) = receiver.beats(paths, make_pulses(1))
    expected = 0.0 if folded is None else 1 / (1 + (360.0 * (cell - 128) / corner_hz) ** (2 * order))
    found = np.mean(np.abs(beat) ** 2) if folded is None else line(beat[0], folded)
    assert found == pytest.approx(expected, rel=2e-2, abs=1e-12)


@pytest.mark.parametrize("bent", [{}, {"sinusoidal_hz": 1e5, "sinusoidal_periods": 9.0}])
def test_filters_do_what_they_do_in_time(bent):
    """The direct beat at 64 points a sample, through digital filters that hardly differ from the analogue ones."""
    corner_hz, order, fine = 30e3, 3, 64
    keys = {"anti_alias_corner_hz": corner_hz, "anti_alias_order": order, "oscillator": bent}
    radar = radar_with({**keys, "high_pass_corner_hz": 3e3, "high_pass_order": 1})
    receiver = receiver_of(radar)
    paths = points_at([14.0, 33.0, 48.0], [1.0, 0.5j, 2.0])
    found = receiver.beats(paths, make_pulses(1))[0][0]
    grid = SampleGrid(receiver.chirp, fine, 128)
    wide, error = grid.wide, receiver.chain.stages[1].oscillator.error
    given = {} if error is None else {"error_rad": error.phase}
    beat = np.sqrt(2) * direct_beat(paths, wide, wide.sample_time_s, **given).real
    for kind, at, degree in (("lowpass", corner_hz, order), ("highpass", 3e3, 1)):
        sections = scipy.signal.butter(degree, at, kind, fs=wide.sampling_rate_hz, output="sos")
        beat = scipy.signal.sosfilt(sections, beat)
    expected = grid.sampled(beat[None])[0]
    assert np.linalg.norm(found - expected) < 3e-3 * np.linalg.norm(expected)


def test_an_ideal_filter_lets_nothing_fold():
    receiver = receiver_of(radar_with({"oscillator": {"cubic_hz": 1e-6}}))
    far = 160 * receiver.chirp.range_resolution_m
    beat = receiver.beats(points_at(far), make_pulses(1))[0]
    assert np.abs(beat).max() < 2e-3


CORNER_HZ = 30e3


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_response_is_butterworths(order):
    high_pass = HighPass(corner_hz=CORNER_HZ, order=order)
    frequency = np.array([300.0, 3e3, CORNER_HZ, 1e6])
    response = high_pass.response(frequency)
    np.testing.assert_allclose(np.abs(response) ** 2, high_pass.power_response(frequency), rtol=1e-9)
    assert np.abs(response[2]) ** 2 == pytest.approx(0.5)
    assert np.abs(response[1] / response[0]) == pytest.approx(10**order, rel=6e-3)
    # Far below its corner it leads by a quarter of a turn for each order.
    assert np.exp(1j * (np.angle(response[0]) - order * np.pi / 2)) == pytest.approx(1.0, abs=0.03)
    np.testing.assert_allclose(high_pass.response(-frequency), np.conj(response))


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("sweep", ["up", "down"])
def test_an_echo_is_weakened_and_turned_and_calibrated_back(sampling, sweep):
    chirp, high_pass = make_chirp(sampling=sampling, sweep=sweep), HighPass(corner_hz=CORNER_HZ, order=2)
    cell = 60
    paths = points_at(cell * chirp.range_resolution_m, 2e-3 * np.exp(0.4j))
    plain = SpectrumAnalyser(chirp, "hann", 1)
    before = plain.amplitude(synthesise(paths, make_pulses(1), chirp))[0, cell]
    beat = synthesise(high_pass.filtered(paths, chirp), make_pulses(1), chirp)
    raw = plain.amplitude(beat)[0, cell]
    expected = high_pass.response(np.array([cell * chirp.rate_hz]))[0]
    assert raw / before == pytest.approx(expected, abs=2e-4)
    calibrated = SpectrumAnalyser(chirp, "hann", 1, high_pass)
    assert calibrated.amplitude(beat)[0, cell] / before == pytest.approx(1.0, abs=3e-3)
    assert calibrated.power(beat)[0, cell] == pytest.approx(4e-6, rel=4e-3)


def test_noise_before_the_filter_is_shaped_and_calibrated_to_one_level():
    chirp, high_pass = make_chirp(), HighPass(corner_hz=CORNER_HZ, order=2)
    noise = add_noise(np.zeros((2000, 1024)), 1.0, 1, np.arange(2000))
    shaped = high_pass.shaped(noise, chirp.sampling_rate_hz)
    plain, calibrated = SpectrumAnalyser(chirp, "hann", 1), SpectrumAnalyser(chirp, "hann", 1, high_pass)
    white = plain.power(noise)[:, 2:-2].mean()
    raw = plain.power(shaped).mean(axis=0)
    at = high_pass.power_response(np.array([20, 83, 400]) * chirp.rate_hz)
    np.testing.assert_allclose(raw[[20, 83, 400]] / white, at, rtol=0.1)
    level = calibrated.power(shaped)[:, 1:-2].mean(axis=0) / white
    np.testing.assert_allclose(level, 1.0, atol=5 / np.sqrt(2000))
    assert level.mean() == pytest.approx(1.0, abs=0.01)
    whole = add_noise(np.zeros((1000, 1024), dtype=complex), 1.0, 1, np.arange(1000))
    analyser = SpectrumAnalyser(make_chirp(sampling="iq"), "hann", 1, high_pass)
    level = analyser.power(high_pass.shaped(whole, chirp.sampling_rate_hz))[:, 1:-3].mean(axis=0)
    np.testing.assert_allclose(level / np.mean(level), 1.0, atol=6 / np.sqrt(1000))


def survey(**changes):
    return load_scenario(
        "rain", {"platform.length_m": 2.0, "weather.rain_rate_mm_per_h": 25.0, "tracing.paths_per_pulse": 64, **changes}
    )


def test_it_spares_the_converter_and_changes_no_calibrated_spectrum():
    """Rain of 25 mm/h, and a strong echo at 0.6 m such as a radome's.

    Peak of the beat over the thermal noise, which a converter must span: 26 dB (rain) and 47 dB (radome) without.
    """
    spread, spectra = {}, {}
    for order in (0, 2):
        filtered = {"radar.receiver": {"high_pass_corner_hz": 60e3, "high_pass_order": order}} if order else {}
        ready = prepare(survey(**filtered))
        pulses = ready.flight.pulses(np.arange(20))
        paths = ready.sensor_inputs().tracer().trace(pulses)
        leak = points_at([0.6] * len(pulses), 3e-5)
        object.__setattr__(leak, "pulse", pulses.index)
        for name, seen in (("rain", paths), ("leakage", Paths.concatenate([leak, paths]))):
            beat = ready.receiver.beat(seen, pulses)
            spread[name, order] = np.max(np.abs(beat)) / np.sqrt(ready.receiver.noise_power_w)
            spectra[name, order] = ready.instrument.detector.analyser.power(beat)
    gained_db = {name: 20 * np.log10(spread[name, 0] / spread[name, 2]) for name in ("rain", "leakage")}
    assert gained_db["rain"] > 10
    assert gained_db["leakage"] > 20
    ground = slice(450, None)
    np.testing.assert_allclose(
        np.log(spectra["rain", 2][:, ground].mean()), np.log(spectra["rain", 0][:, ground].mean()), atol=0.02
    )


def test_a_corner_beyond_the_samples_and_an_order_without_a_corner_are_refused():
    with pytest.raises(ScenarioError, match=r"radar.receiver.high_pass_corner_hz: 1e\+06 lies beyond"):
        survey(**{"radar.receiver.high_pass_corner_hz": 1e6})
    with pytest.raises(ScenarioError, match=r"radar.receiver.high_pass_order: 3 has no effect"):
        survey(**{"radar.receiver.high_pass_order": 3})


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
