"""The receiver: what its sweeps add up from paths, power and noise, and where the power of noise comes from."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from flights import make_pulses
from sionna_radar.radar.build import build_chirp, build_sweeps
from sionna_radar.scenario import StageParameters, load_scenario
from sionna_radar.scenario.parts import RECEIVER_STAGES
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import ReceiverTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.build import (
    build_chain,
    build_high_pass,
    noise_power,
    register_receiver_stage,
    transmit_power_w,
)
from sionna_radar.signal.receiver import Receiver, add_noise
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import Paths

PULSES = make_pulses(12, incidence_deg=30.0)
ROW = np.repeat(np.arange(12), 3)
PATHS = Paths.along_boresight(
    PULSES,
    ROW,
    np.tile([40.0, 60.0, 61.0], 12),
    gain=1e-5 * np.exp(1j * np.arange(36.0)),
    incidence_rad=np.full(36, 0.5),
    surface=np.zeros(36, dtype=int),
)
TRIANGLE = build_sweeps(RadarTable(snr_db=30.0, sweep="triangular"))
SILENCE = PATHS.rows(np.zeros(0, dtype=int))


def receiver(*sweeps, power_w: float = 0.25, noise_w: float = 1e-12, **options) -> Receiver:
    return Receiver(sweeps=sweeps, transmit_power_w=power_w, noise_power_w=noise_w, seed=3, **options)


def test_without_noise_a_beat_is_what_is_synthesised_times_the_sent_amplitude():
    quiet = receiver(*TRIANGLE, noise_w=0.0)
    for beat, sweep in zip(quiet.beats(PATHS, PULSES), TRIANGLE, strict=True):
        np.testing.assert_allclose(beat, 0.5 * synthesise(PATHS, PULSES, sweep), rtol=1e-12)


def test_one_sweep_alone_is_the_beat():
    single = receiver(make_chirp())
    (beat,) = single.beats(PATHS, PULSES)
    np.testing.assert_array_equal(single.beat(PATHS, PULSES), beat)
    assert beat.shape == (12, 1024)


def test_the_first_of_two_sweeps_reads_the_same_echoes_as_if_it_were_the_only_one():
    """The noise is drawn for both sweeps at once, the echoes are those of the sweep."""
    triangle = receiver(*TRIANGLE, noise_w=0.0)
    np.testing.assert_array_equal(triangle.beat(PATHS, PULSES), triangle.beats(PATHS, PULSES)[0])
    assert triangle.chirp == TRIANGLE[0]


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_silence_has_the_power_of_the_noise_in_every_sweep(sampling):
    sweeps = build_sweeps(RadarTable(snr_db=30.0, sweep="triangular", sampling=sampling))
    pulses = make_pulses(200)
    up, down = receiver(*sweeps, noise_w=4e-9).beats(SILENCE, pulses)
    for beat in (up, down):
        assert np.mean(np.abs(beat) ** 2) == pytest.approx(4e-9, rel=5 / np.sqrt(beat.size))
    # The two sweeps hold noise of their own.
    assert abs(np.vdot(up, down)) < 5 * 4e-9 * np.sqrt(up.size)


@pytest.mark.parametrize("corner_hz", [0.0, 20e3])
def test_a_pulse_is_the_same_in_any_block(corner_hz):
    radar = receiver(make_chirp(), high_pass=build_high_pass(ReceiverTable(high_pass_corner_hz=corner_hz)))
    whole = radar.beat(PATHS, PULSES)
    alone = radar.beat(PATHS.rows(PATHS.pulse == 5), make_pulses(1, incidence_deg=30.0, first=5))
    np.testing.assert_array_equal(alone[0], whole[5])


def test_another_seed_is_other_noise_on_the_same_echoes():
    radar = receiver(make_chirp())
    other = replace(radar, seed=4)
    assert np.any(radar.beat(PATHS, PULSES) != other.beat(PATHS, PULSES))
    echoes = radar.beat(PATHS, PULSES) - radar.beat(SILENCE, PULSES)
    np.testing.assert_allclose(echoes, other.beat(PATHS, PULSES) - other.beat(SILENCE, PULSES), atol=1e-16)


@pytest.mark.parametrize("corner_hz", [0.0, 20e3])
def test_what_is_not_asked_for_changes_no_bit(corner_hz):
    """A prepared survey has no chain unless a key asks for it, and its beats are sums, noise and high-pass alone."""
    keys = {"platform.length_m": 2.0, "tracing.paths_per_pulse": 16, "terrain.spacing_m": 2.0}
    ready = prepare(load_scenario("hills", {**keys, "radar.receiver.high_pass_corner_hz": corner_hz}))
    plain, pulses = ready.receiver, ready.flight.pulses(np.arange(4))
    assert plain.chain is None
    paths, sweep, high_pass = ready.sensor_inputs().tracer().trace(pulses), plain.chirp, plain.high_pass
    if high_pass is None:
        expected = add_noise(synthesise(paths, pulses, sweep), plain.noise_power_w, plain.seed, pulses.index)
    else:
        noise = add_noise(np.zeros((4, sweep.samples)), plain.noise_power_w, plain.seed, pulses.index)
        expected = synthesise(high_pass.filtered(paths, sweep), pulses, sweep)
        expected = expected + high_pass.shaped(noise, sweep.sampling_rate_hz)
    seen = plain.reception(paths, pulses)
    assert seen.beats[0].tobytes() == expected.tobytes()
    assert seen.saturated is None


def test_a_custom_stage_takes_the_place_of_one_of_ours():
    class Half(StageParameters):
        """A stage that weakens.

        scale: of amplitudes.
        """

        scale: float = 0.5

    @register_receiver_stage("weaker_for_this_test", Half)
    def weaker(parameters, given):
        assert given.sweeps[0].samples == 1024
        return lambda received: replace(received, samples=parameters.scale * received.samples)

    table = {"stages": {"converter": {"stage": "weaker_for_this_test", "scale": 0.25}}}
    radar = RadarTable(snr_db=30.0, receiver=table)
    custom = receiver(make_chirp(), noise_w=0.0, chain=build_chain(radar, (make_chirp(),), None))
    plain = receiver(make_chirp(), noise_w=0.0)
    np.testing.assert_allclose(custom.beat(PATHS, PULSES), 0.25 * plain.beat(PATHS, PULSES), atol=1e-16)
    RECEIVER_STAGES._entries.pop("weaker_for_this_test")


POWER = 3e-13


@pytest.mark.parametrize("kind", [float, complex])
def test_noise_has_the_wanted_power(kind):
    noise = add_noise(np.zeros((400, 1024), dtype=kind), POWER, 1, np.arange(400))
    count = noise.size * (2 if kind is complex else 1)
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(POWER, rel=4 * np.sqrt(2 / count))
    assert abs(noise.mean()) < 4 * np.sqrt(POWER / noise.size)
    if kind is complex:
        assert noise.real.var() == pytest.approx(noise.imag.var(), rel=0.02)
        assert abs(np.mean(noise**2)) < 4 * POWER / np.sqrt(noise.size)  # circular


@pytest.mark.parametrize("kind", [float, complex])
def test_noise_is_white(kind):
    noise = add_noise(np.zeros((500, 512), dtype=kind), 1.0, 1, np.arange(500))
    for lag in (1, 2, 7):
        assert abs(np.mean(noise[:, lag:] * np.conj(noise[:, :-lag]))) < 4 / np.sqrt(noise.size)
    assert abs(np.mean(noise[1:] * np.conj(noise[:-1]))) < 4 / np.sqrt(noise.size)


def test_noise_belongs_to_the_pulse_and_the_seed():
    silent = np.zeros((20, 64))
    whole = add_noise(silent, 1.0, 5, np.arange(100, 120))
    np.testing.assert_array_equal(add_noise(silent[:1], 1.0, 5, np.array([107]))[0], whole[7])
    assert not np.any(whole == add_noise(silent, 1.0, 6, np.arange(100, 120)))
    assert not np.any(silent)  # the input is left alone


def test_noise_is_added():
    signal = np.linspace(0, 5, 64)[None]
    quiet = add_noise(np.zeros((1, 64)), 1.0, 1, np.array([3]))
    np.testing.assert_allclose(add_noise(signal, 1.0, 1, np.array([3])), signal + quiet)


@pytest.mark.parametrize(("sampling", "bandwidth_hz"), [("real", 184_320), ("iq", 368_640)])
def test_a_noise_figure_gives_k_t_f_b(sampling, bandwidth_hz):
    # k T at 290 K is -173.975 dBm/Hz.
    radar = RadarTable(transmit_power_dbm=10.0, noise_figure_db=12.0, sampling=sampling)
    expected_dbm = -173.975 + 12.0 + 10 * np.log10(bandwidth_hz)
    measured = noise_power(radar, build_chirp(radar), reference_echo=1.0)
    assert 10 * np.log10(measured / 1e-3) == pytest.approx(expected_dbm, abs=1e-3)
    assert transmit_power_w(radar) == pytest.approx(0.01)


def test_twice_the_temperature_is_twice_the_noise():
    cold, hot = (RadarTable(transmit_power_dbm=0.0, noise_figure_db=3.0, temperature_k=t) for t in (150.0, 300.0))
    assert noise_power(hot, build_chirp(hot), 1.0) == pytest.approx(2 * noise_power(cold, build_chirp(cold), 1.0))


def test_a_signal_to_noise_ratio_is_counted_from_the_reference_echo():
    radar = RadarTable(snr_db=30.0)
    assert noise_power(radar, build_chirp(radar), reference_echo=4e-10) == pytest.approx(4e-13)
    assert transmit_power_w(radar) == 1.0
