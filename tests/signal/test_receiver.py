"""The receiver: what its sweeps add up from paths, power and noise."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from flights import make_pulses
from sionna_radar.radar.chirp import build_sweeps
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.scenario.receiver import ReceiverTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.high_pass import build_high_pass
from sionna_radar.signal.receiver import Receiver
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
    high_pass = build_high_pass(ReceiverTable(high_pass_corner_hz=corner_hz))
    radar = receiver(make_chirp(), high_pass=high_pass)
    whole = radar.beat(PATHS, PULSES)
    alone = radar.beat(PATHS.rows(PATHS.pulse == 5), make_pulses(1, incidence_deg=30.0, first=5))
    np.testing.assert_array_equal(alone[0], whole[5])


def test_another_seed_is_other_noise_on_the_same_echoes():
    radar = receiver(make_chirp())
    other = replace(radar, seed=4)
    assert np.any(radar.beat(PATHS, PULSES) != other.beat(PATHS, PULSES))
    echoes = radar.beat(PATHS, PULSES) - radar.beat(SILENCE, PULSES)
    np.testing.assert_allclose(echoes, other.beat(PATHS, PULSES) - other.beat(SILENCE, PULSES), atol=1e-16)
