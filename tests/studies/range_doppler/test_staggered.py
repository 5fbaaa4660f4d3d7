"""Two intervals in turn: range rates that even ones leave ambiguous, how often noise misleads, false alarms."""

import numpy as np
import pytest
from scipy.stats import norm

from beams import make_chirp
from plain_beats import mover_beats
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.studies.range_doppler.cfar import RingCfar
from sionna_radar.studies.range_doppler.frames import RangeDoppler
from sionna_radar.studies.range_doppler.movers import Movers, StaggeredRangeDoppler, find_movers

RATE_HZ = 20e3


def staggered(stagger, chirps=128, **changes) -> StaggeredRangeDoppler:
    values = {"bandwidth_hz": 300e6, "rate_hz": RATE_HZ, "samples": 128, "sampling": "iq"}
    half = RangeDoppler(
        chirp=make_chirp(**(values | changes)), chirps=chirps // 2, zero_padding=2, interval_s=(2 + stagger) / RATE_HZ
    )
    return StaggeredRangeDoppler(half=half, first_s=1 / RATE_HZ)


def chirp_times(found, stagger):
    number = np.arange(found.chirps)
    return (number + stagger * (number // 2) - found.chirps // 2 * (1 + stagger / 2)) / RATE_HZ


def frame(found, stagger, range_m, rate_mps):
    return mover_beats(found.chirp, chirp_times(found, stagger), range_m, rate_mps)


@pytest.mark.parametrize(("stagger", "foldings"), [(0.0, 2), (0.5, 5), (0.25, 9), (0.2, 2), (1.0, 3)])
def test_as_many_rates_are_told_apart_as_their_phases_allow(stagger, foldings):
    """Intervals of 1 and 1 + stagger: of 2 : 3 there are five in a span, of 4 : 5 nine, of 5 : 6 two lie too near."""
    found = staggered(stagger)
    assert found.foldings == foldings
    assert found.highest_rate_mps == pytest.approx(foldings * found.half.highest_rate_mps)


@pytest.mark.parametrize(("sampling", "sweep"), [("iq", "up"), ("real", "down")])
@pytest.mark.parametrize("rate_mps", [-37.9, -21.3, -4.2, 0.0, 9.96, 30.7])
def test_an_ambiguous_mover_has_its_range_rate_and_its_range(sampling, sweep, rate_mps):
    """Even intervals fold at 19.5 m/s, each half at 7.8; a span is 0.4 range cells."""
    found = staggered(0.5, sampling=sampling, sweep=sweep)
    beat = frame(found, 0.5, 21.37, rate_mps)
    made = found.map(beat)
    movers = find_movers(made, made.power > 0.5)
    assert len(movers) == 1
    (unfolded,) = found.unfolded(beat, movers).range_rate_mps
    assert unfolded == pytest.approx(rate_mps, abs=0.02 * found.rate_cell_mps)
    # What migrates by more than the folded rate does lies a little off the middle.
    assert found.unfolded(beat, movers).range_m[0] == pytest.approx(21.37, abs=0.1 * found.chirp.range_resolution_m)


def test_the_rate_is_that_of_the_plain_transform_of_all_chirps():
    """At their own times, over all rates that are told apart."""
    found, rate_mps = staggered(0.25), 51.4
    beat = frame(found, 0.25, 21.37, rate_mps)
    made = found.map(beat)
    movers = find_movers(made, made.power > 0.5)
    tone = beat[:, found.chirp.samples // 2]
    rates = np.linspace(-found.highest_rate_mps, found.highest_rate_mps, 40_001)
    turns = 2 / found.chirp.wavelength_m * np.outer(rates, chirp_times(found, 0.25))
    plain = rates[np.argmax(np.abs(np.exp(-2j * np.pi * turns) @ tone))]
    assert found.unfolded(beat, movers).range_rate_mps[0] == pytest.approx(plain, abs=0.02)
    assert plain == pytest.approx(rate_mps, abs=0.02)


def test_noise_misleads_as_often_as_its_phase_errs_by_half_a_turn_between_rates():
    """Nine rates 40 deg apart, at 13 dB in each half: the error has 1 / sqrt(SNR) = 12.8 deg, one in nine beyond 20."""
    found, stagger, rate_mps = staggered(0.25, chirps=32, samples=32), 0.25, 14.0
    beat, random = frame(found, stagger, 8.0, rate_mps), np.random.default_rng(4)
    made = found.map(beat)
    mover = find_movers(made, made.power > 0.5)
    assert len(mover) == 1
    weight = np.sum(np.outer(found.half.rate_weights, found.half.range_weights) ** 2)
    ratio, wrong, trials = 10**1.3, 0, 800
    noise_w = made.power.max() / ratio / weight
    one = Movers(range_m=mover.range_m, range_rate_mps=mover.range_rate_mps, power=mover.power)
    for _ in range(trials):
        parts = random.standard_normal((2, *beat.shape)) * np.sqrt(noise_w / 2)
        wrong += abs(found.unfolded(beat + parts[0] + 1j * parts[1], one).range_rate_mps[0] - rate_mps) > 1.0
    expected = 2 * norm.sf(np.deg2rad(20) * np.sqrt(ratio))
    assert wrong / trials == pytest.approx(expected, rel=0.3)


def test_noise_is_detected_at_the_specified_rate():
    found = staggered(0.5, chirps=64, samples=64)
    half = RangeDoppler(chirp=found.chirp, chirps=32, interval_s=found.half.interval_s)
    found = StaggeredRangeDoppler(half=half, first_s=found.first_s)
    cfar = RingCfar(
        guard=(2, 2), training=(3, 3), false_alarm_probability=1e-2, correlation=half.noise_correlation(6), looks=2
    )
    random, alarms, cells = np.random.default_rng(8), 0, 0
    for _ in range(60):
        parts = random.standard_normal((2, 64, 64))
        detected = cfar.detected(found.map(parts[0] + 1j * parts[1]).power)[:, 5:-5]
        alarms, cells = alarms + detected.sum(), cells + detected.size
    assert alarms / cells == pytest.approx(1e-2, rel=0.1)


def test_an_ordered_ring_knows_single_looks_alone():
    white = (np.array([1.0]), np.array([1.0]))
    with pytest.raises(ScenarioError, match=r"processing.cfar.kind: 'OS' has no false-alarm rate in closed form"):
        RingCfar(kind="OS", guard=(1, 1), training=(2, 2), false_alarm_probability=1e-3, correlation=white, looks=2)
