"""Other radars in our receiver: the direct computation, powers and lengths of bursts, ghosts, and zeroing."""

import numpy as np
import pytest

from beams import make_antenna
from direct_receiver import points_at
from flights import make_pulses
from receivers import radar_with
from sionna_radar.detection.preprocessing import bursts, zeroed
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.build import build_sweeps
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.receiver import Interferer
from sionna_radar.signal.build import build_chain, build_interference
from sionna_radar.signal.receiver import Receiver
from sionna_radar.tracing.paths import Paths

C = 299_792_458.0
ANTENNA = make_antenna(4.0, 4.0)
SILENCE = points_at(20.0, 0.0)
# Sweeps of few megahertz, which the direct computation can sample whole.
NARROW = {"bandwidth_hz": 4e6, "transmit_power_dbm": 30.0, "noise_figure_db": 0.0}


def level_ground(places: np.ndarray) -> np.ndarray:
    return np.where(np.abs(places[:, 0]) < 1e3, 0.0, np.nan)


def receiver_with(*interferers: dict, **keys) -> Receiver:
    radar = radar_with(**{**NARROW, **keys})
    sweeps = build_sweeps(radar)
    others = build_interference([Interferer(**one) for one in interferers], level_ground, (ANTENNA,))
    return Receiver(
        sweeps=sweeps,
        transmit_power_w=1.0,
        noise_power_w=0.0,
        seed=5,
        chain=build_chain(radar, sweeps, None, others),
    )


OTHER = {"position_m": (0.0, 0.0), "power_dbm": 20.0, "antenna_gain_db": 10.0}
FAST = {**OTHER, "bandwidth_hz": 24e6, "chirp_rate_hz": 18e3, "offset_s": 1.1e-5, "carrier_hz": 77e9 - 2e6}
SWEPT = {**OTHER, "bandwidth_hz": 6e6, "chirp_rate_hz": 510.0, "offset_s": 2e-4, "carrier_hz": 77e9 + 3e5}


@pytest.mark.parametrize(("sweep", "sampling"), [("up", "real"), ("up", "iq"), ("down", "real"), ("down", "iq")])
@pytest.mark.parametrize("kind", ["fmcw", "falling", "fast", "fast, falling", "cw"])
def test_a_burst_is_the_difference_of_two_waves_behind_an_ideal_filter(kind, sweep, sampling):
    """Both waves densely sampled, mixed, and all frequencies beyond the band taken away.

    A fast one crosses the band of four sampling rates in 0.3 of its points, 50 times a sweep.
    """
    swept = FAST if "fast" in kind else SWEPT
    table = {**OTHER, "kind": "cw"} if kind == "cw" else {**swept, "sweep": "down" if "falling" in kind else "up"}
    receiver = receiver_with(table, sweep=sweep, sampling=sampling)
    # Level flight beside it, so that its range stays 50 m but for what a sweep changes of it.
    pulses = make_pulses(2, velocity_mps=(0.0, 0.0, 0.0), first=3)
    found = receiver.beats(SILENCE, pulses)[0]
    chirp, grid = receiver.chirp, receiver.chain.grid(receiver.chirp)
    fine = 512 if "fast" in kind else 64
    points = fine * (chirp.samples + 2 * grid.guard)
    t = (np.arange(points) - points // 2) / (fine * chirp.sampling_rate_hz)
    power_w = 1.0 * ANTENNA.peak_gain * (chirp.wavelength_m / (4 * np.pi * 50.0)) ** 2
    expected = np.empty_like(found)
    for row, moment in enumerate(pulses.time_s):
        at = moment + t - 50.0 / C
        if kind == "cw":
            theirs = 77e9 * at
        else:
            rate_hz, slope = swept["chirp_rate_hz"], swept["bandwidth_hz"] * swept["chirp_rate_hz"]
            u = np.mod(at - swept["offset_s"], 1 / rate_hz) - 0.5 / rate_hz
            theirs = swept["carrier_hz"] * u + slope * u**2 / 2 * (-1 if "falling" in kind else 1)
        ours = chirp.carrier_hz * t + chirp.slope_hz_s * t**2 / 2
        beat = np.sqrt(power_w) * np.exp(2j * np.pi * chirp.direction * np.mod(ours - theirs, 1.0))
        f = np.fft.fftfreq(points, 1 / (fine * chirp.sampling_rate_hz))
        if sampling == "real":
            passed = np.fft.ifft(np.fft.fft(np.sqrt(2) * beat.real) * (np.abs(f) <= chirp.sampling_rate_hz / 2)).real
        else:
            passed = np.fft.ifft(np.fft.fft(beat) * ((f >= 0) & (f < chirp.sampling_rate_hz)))
        middle = points // 2 - fine * (chirp.samples // 2)
        expected[row] = passed[middle : middle + fine * chirp.samples : fine]
    level = np.linalg.norm(expected)
    assert level > (0.01 if "fast" in kind else 0.1) * np.sqrt(power_w)
    # What is left is where a sweep of the other begins anew, at all frequencies, and at the ends of the grids.
    if kind == "cw":  # its phase counts from another time
        turn = np.sum(found * np.conj(expected), axis=1, keepdims=True)
        if sampling == "iq":
            expected = expected * turn / np.abs(turn)
        else:
            expected, found = np.abs(np.fft.rfft(expected)), np.abs(np.fft.rfft(found))
            level = np.linalg.norm(expected)
    assert np.linalg.norm(found - expected) < 0.05 * level


def test_a_burst_lasts_as_long_as_the_sweeps_take_to_cross_the_band():
    """Of a real receiver twice half the sampling rate over the difference of the slopes, at the power of one way."""
    receiver = receiver_with(SWEPT)
    chirp = receiver.chirp
    pulses = make_pulses(400, velocity_mps=(0.0, 0.0, 0.0))
    beat = receiver.beats(SILENCE, pulses)[0]
    power_w = 1.0 * ANTENNA.peak_gain * (chirp.wavelength_m / (4 * np.pi * 50.0)) ** 2
    seconds = chirp.sampling_rate_hz / abs(6e6 * 510 - chirp.slope_hz_s)
    # How often frequencies meet: sweeps of different lengths pass each other at all offsets.
    t = np.linspace(-0.5, 0.5, 4001) / 360
    ours = chirp.slope_hz_s * t
    theirs = (3e5 + 6e6 * 510 * (np.mod(at + t - 2e-4, 1 / 510) - 0.5 / 510) for at in pulses.time_s)
    between = [np.mean(np.abs(ours - other) < chirp.sampling_rate_hz / 2) for other in theirs]
    # A burst has few oscillations, so that its ends are not sharp.
    assert np.mean(np.abs(beat) ** 2) == pytest.approx(power_w * np.mean(between), rel=0.08)
    assert max(between) >= 0.9 * min(1.0, seconds * 360)


def test_the_same_sweep_is_a_ghost():
    """A radar of the same slope that starts late by the delay of 60 m, half of it on its way, stands still there."""
    receiver = receiver_with(
        {**OTHER, "bandwidth_hz": 500e6, "chirp_rate_hz": 360.0, "offset_s": -0.5 / 360 + 3e-7 - 50 / C},
        bandwidth_hz=500e6,
        samples_per_chirp=1024,
    )
    pulses = make_pulses(1, velocity_mps=(0.0, 0.0, 0.0))
    power = SpectrumAnalyser(receiver.chirp, "hann", 1).power(receiver.beat(SILENCE, pulses))[0]
    assert power.argmax() == round(3e-7 * 500e6)


def test_what_is_received_follows_the_beam_and_the_range():
    receiver = receiver_with({**OTHER, "kind": "cw"})
    stage = receiver.chain.stages[2]
    pulses = make_pulses(3, scan_deg=np.array([0.0, 2.0, 60.0]))
    power_w, range_m, rate_mps = stage.arriving(stage.radars[0], pulses, 0.004)
    np.testing.assert_allclose(range_m, 50.0)
    np.testing.assert_allclose(rate_mps, 0.0, atol=1e-9)
    assert 10 * np.log10(power_w[1] / power_w[0]) == pytest.approx(-3.0, abs=0.1)  # half of the beam off its axis
    assert power_w[2] < 1e-2 * power_w[0]
    expected = 1.0 * ANTENNA.peak_gain * (0.004 / (4 * np.pi * 50.0)) ** 2
    assert power_w[0] == pytest.approx(expected, rel=1e-3)


def test_a_pulse_has_the_same_bursts_in_any_block():
    receiver = receiver_with(SWEPT, {**OTHER, "kind": "cw"})
    whole = receiver.beat(SILENCE, make_pulses(6))
    alone = receiver.beat(SILENCE.rows(np.zeros(0, dtype=int)), make_pulses(1, first=4))
    np.testing.assert_allclose(alone[0], whole[4], atol=1e-15)


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_zeroing_takes_bursts_and_leaves_echoes(sampling):
    random = np.random.default_rng(1)
    shape = (200, 1024)
    beat = random.normal(size=shape) + (1j * random.normal(size=shape) if sampling == "iq" else 0)
    assert bursts(beat).mean() < 5 * 10e-6 * 2
    t = np.arange(1024) / 1024
    tone = np.tile(np.exp(2j * np.pi * 100.3 * t), (1, 1))
    tone = tone if sampling == "iq" else tone.real
    np.testing.assert_array_equal(zeroed(tone), tone)
    hit = beat.copy()
    hit[:, 300:360] += 200 * np.exp(2j * np.pi * 3000 * t[300:360] ** 2).real
    clean = zeroed(hit)
    inside = np.abs(clean[:, 300:360])
    assert np.mean(inside**2) < 10 * np.mean(np.abs(beat) ** 2)
    outside = np.r_[0:290, 370:1024]
    np.testing.assert_allclose(clean[:, outside] / beat[:, outside], 1024 / (1024 - 60), rtol=0.02)
    coarse = np.where(np.arange(1024) % 20 == 0, tone, 0)
    np.testing.assert_array_equal(zeroed(coarse), coarse)


def test_interferers_need_powers_and_a_place_on_the_ground():
    with pytest.raises(ScenarioError, match=r"interferers: their powers are absolute"):
        load_scenario("hills", {"interferers": [{**OTHER, "kind": "cw"}]})
    with pytest.raises(ScenarioError, match=r"interferers.0.position_m: .* lies beyond the terrain"):
        receiver_with({**OTHER, "kind": "cw", "position_m": (2e3, 0.0)})
    with pytest.raises(ScenarioError, match=r"bandwidth_hz: missing"):
        Interferer(position_m=(0.0, 0.0), power_dbm=0.0)
    steep = receiver_with({**OTHER, "bandwidth_hz": 1e11, "chirp_rate_hz": 1e7})
    with pytest.raises(ScenarioError, match=r"interferers: a slope of 1e\+18 Hz/s takes over 8,388,608 points"):
        steep.beats(SILENCE, make_pulses(1))
    assert isinstance(SILENCE, Paths)
