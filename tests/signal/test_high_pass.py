"""The IF high-pass: its response, what it does to an echo, to noise and to the converter, and its calibration."""

import numpy as np
import pytest

from beams import make_chirp
from flights import make_pulses
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.receiver import add_noise
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import Paths

CORNER_HZ = 30e3


def echoes_at(range_m, gain) -> Paths:
    count = len(range_m)
    return Paths(
        pulse=np.zeros(count, np.int64),
        delay_s=2 * np.array(range_m) / 299_792_458.0,
        gain=np.array(gain, dtype=complex),
        range_rate_mps=np.zeros(count),
        incidence_rad=np.zeros(count),
        hit_m=np.zeros((count, 3)),
        surface=np.zeros(count, np.int64),
    )


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
    paths = echoes_at([cell * chirp.range_resolution_m], [2e-3 * np.exp(0.4j)])
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
        leak = echoes_at([0.6] * len(pulses), [3e-5] * len(pulses))
        object.__setattr__(leak, "pulse", pulses.index)
        for name, seen in (("rain", paths), ("leakage", Paths.concatenate([leak, paths]))):
            beat = ready.receiver.beat(seen, pulses)
            spread[name, order] = np.max(np.abs(beat)) / np.sqrt(ready.receiver.noise_power_w)
            spectra[name, order] = ready.detector.analyser.power(beat)
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
