"""Leakage: a still path, what the oscillator leaves of it, and how the processing takes it out."""

from dataclasses import replace

import numpy as np
import pytest

from direct_receiver import direct_beat, points_at
from flights import make_pulses
from receivers import radar_with, receiver_of
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import prepare

TWO = [{"delay_ns": 0.9, "level_db": -30.0}, {"delay_ns": 3.4, "level_db": -42.0}]


@pytest.mark.parametrize("sweep", ["up", "down"])
def test_leakage_is_the_beat_of_its_delays_in_every_pulse(sweep):
    receiver = receiver_of(radar_with({"leakage": TWO}, sampling="iq", sweep=sweep))
    beat = receiver.beats(points_at(20.0, 0.0), make_pulses(4))[0]
    ways = points_at([0.9e-9 * 299_792_458.0 / 2, 3.4e-9 * 299_792_458.0 / 2], 10 ** (np.array([-30.0, -42.0]) / 20))
    chirp = receiver.chirp
    expected = direct_beat(ways, chirp, chirp.sample_time_s)
    np.testing.assert_allclose(beat, np.tile(expected, (4, 1)), atol=1e-8)


@pytest.mark.parametrize(("sampling", "power"), [("iq", 0.1), ("real", 0.2)])
def test_leakage_without_delay_is_a_constant(sampling, power):
    """-10 dB at no delay: a beat of zero, whose cosine has all of its power twice."""
    receiver = receiver_of(radar_with({"leakage": [{"delay_ns": 0.0, "level_db": -10.0}]}, sampling=sampling))
    beat = receiver.beats(points_at(20.0, 0.0), make_pulses(2))[0]
    np.testing.assert_allclose(np.abs(beat) ** 2, power, rtol=1e-6)


def test_phase_noise_of_leakage_is_that_of_its_short_delay():
    """The residual grows with the square of the delay: 20 dB for ten times of it."""
    noise = {"phase_noise_dbc_hz": [[1e3, -60.0], [1e6, -60.0]]}
    left = []
    for delay_ns in (2.0, 20.0):
        leak = [{"delay_ns": delay_ns, "level_db": 0.0}]
        pulses, silence = make_pulses(20), points_at(20.0, 0.0)
        clean = receiver_of(radar_with({"leakage": leak}, samples_per_chirp=1024)).beats(silence, pulses)[0]
        noisy = receiver_of(radar_with({"leakage": leak, "oscillator": noise}, samples_per_chirp=1024))
        changed = (noisy.beats(silence, pulses)[0] - clean)[:, 64:-64]
        left.append(np.mean(changed**2))
    # The carrier turns with the delay, but both stay less than a beat's period away from it on average.
    f = np.linspace(0, 184_320, 4001)[1:]
    expected = [np.mean(np.sin(np.pi * f * delay_ns * 1e-9) ** 2) for delay_ns in (2.0, 20.0)]
    assert 10 * np.log10(left[1] / left[0]) == pytest.approx(10 * np.log10(expected[1] / expected[0]), abs=4.0)
    assert expected[1] / expected[0] == pytest.approx(100, rel=0.01)


def test_what_is_still_is_subtracted():
    """A radome far over the ground: the mean of the survey's chirps takes it down to what the ground leaves."""
    keys = {"platform.length_m": 12.0, "tracing.paths_per_pulse": 16, "terrain.spacing_m": 2.0}
    keys |= {"radar.receiver.leakage": [{"delay_ns": 12.0, "level_db": -40.0}], "processing.leakage": "subtract"}
    ready = prepare(load_scenario("hills", keys))
    sensor, pulses = ready.build_sensor(), ready.flight.pulses(np.arange(0, len(ready), 3))
    paths = sensor.tracer.trace(pulses)
    power = ready.instrument.detector.analyser.power
    kept = power(ready.receiver.beat(paths, pulses)).mean(axis=0)
    clean = power(replace(ready.receiver, chain=None).beat(paths, pulses)).mean(axis=0)
    subtracted = np.mean([one.power for one in sensor.record_chirps(pulses)], axis=0)
    radome, ground = 12, np.flatnonzero(clean > 0.03 * clean.max())
    assert kept[radome] > 1e3 * clean.max()
    # Ground that many of the few chirps see alike goes with it: less than a tenth.
    assert subtracted[ground].sum() == pytest.approx(clean[ground].sum(), rel=0.1)
    assert subtracted[radome] < 1e-2 * clean.max()
