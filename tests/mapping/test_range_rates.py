"""Range rates of ground in frames: pulse pairs, the direction that power comes from, and what errors change."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from plain_beats import mover_beats
from sionna_radar.detection.build import build_detector
from sionna_radar.flight.frames import conical_from_antenna
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, InstrumentErrors
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.navigation.range_rates import RangeRates, pulse_pair_rates
from sionna_radar.scenario.processing import CfarTable, ProcessingTable

CHIRP = make_chirp(bandwidth_hz=1e9, rate_hz=20e3, samples=256)


def beat(chirp, range_m, rate_mps, power, chirps=17):
    return mover_beats(chirp, np.arange(chirps) / chirp.rate_hz, range_m, rate_mps, power)


@pytest.mark.parametrize("sampling", ["real", "iq"])
@pytest.mark.parametrize("sweep", ["up", "down"])
def test_the_rate_of_a_frame_is_the_mean_by_power_and_repeats(sampling, sweep):
    chirp = replace(CHIRP, sampling=sampling, sweep=sweep)
    repeat_mps = chirp.wavelength_m * chirp.rate_hz / 2
    movers = [(6.0, -3.2, 1.0), (9.0, -2.6, 3.0)]
    slow = sum(beat(chirp, *mover) for mover in movers)
    fast = sum(beat(chirp, range_m, rate_mps - repeat_mps, power) for range_m, rate_mps, power in movers)
    # What leaks from the transmitter is strong, near and at rest.
    beats = np.concatenate([slow, fast]) + beat(chirp, 0.9, 0.0, 1e4, chirps=1)
    table = ProcessingTable(min_range_m=3.0, cfar=CfarTable(guard=2, training=8), zero_padding=2)
    detector = build_detector(table, chirp, make_antenna(2.0, 2.0))
    found = pulse_pair_rates(detector, lambda own: beats[own], np.arange(34).reshape(2, 17), 1 / chirp.rate_hz)
    np.testing.assert_allclose(found, -2.75, atol=3e-3)


def flown(count=600, heading_deg=(0.0, 90.0), incidence_deg=45.0, spread=(0.01, 0.012)):
    """Range rates as they are without errors, of a scan to and fro over level ground."""
    azimuth = np.deg2rad(50 * np.sin(np.arange(count) / 30))
    antenna = np.stack([conical_from_antenna(np.deg2rad(incidence_deg), azimuth[k : k + 1])[0] for k in range(count)])
    line = np.arange(count) * len(heading_deg) // count
    course = np.deg2rad(heading_deg)[line]
    nose = np.column_stack([np.sin(course), np.cos(course), np.zeros(count)])
    right = np.column_stack([np.cos(course), -np.sin(course), np.zeros(count)])
    mount = np.stack([nose, right, np.tile([0.0, 0.0, -1.0], (count, 1))], axis=2)
    motion = BelievedMotion(
        pose=Pose(
            position_m=np.zeros((count, 3)), velocity_mps=10 * nose + [0.0, 0.0, 0.3], R_world_antenna=mount @ antenna
        ),
        time_s=0.01 * np.arange(count) + 10.0 * line,
        R_mount_antenna=antenna,
        turn_rad_s=np.tile([0.1, -0.2, 0.3], (count, 1)),
        acceleration_mps2=np.tile([1.0, 2.0, -1.0], (count, 1)),
        line=line,
    )
    ones = np.ones(count)
    rates = RangeRates(rate_mps=0 * ones, sigma_mps=ones, spread=np.outer(ones, spread), motion=motion)
    return replace(rates, rate_mps=-rates.linearised(InstrumentErrors(), ())[1])


def predicted(rates, errors):
    return rates.rate_mps - rates.linearised(errors, ())[1]


@pytest.mark.parametrize("name", UNKNOWNS)
def test_the_change_of_the_rate_is_the_difference_of_predictions_at_both_sides(name):
    rates, step = flown(), 1e-4
    at = {"pitch": 0.003, "time_offset": 0.002, "backscatter_slope": 1.0}
    sides = [predicted(rates, InstrumentErrors.of({**at, name: at.get(name, 0.0) + sign * step})) for sign in (1, -1)]
    change = rates.linearised(InstrumentErrors.of(at), (name,))[0][:, 0]
    # That a turn changes the incidence, and with it the mean direction, is left out: v C 2 / cos^2 i.
    left_out = 10 * 0.012**2 * 2 / np.cos(np.deg2rad(50.0)) ** 2 if name in ("roll", "pitch") else 0.0
    atol = max(1e-6, left_out * 1.2, 3e-3 * np.abs(change).max())
    np.testing.assert_allclose(change, (sides[0] - sides[1]) / (2 * step), atol=atol)


@pytest.mark.parametrize("incidence_deg", [20.0, 45.0, 60.0])
@pytest.mark.parametrize("lambert", [0, 1])
def test_power_comes_from_the_direction_that_a_sum_over_the_beam_has(incidence_deg, lambert):
    """Over level ground of constant gamma, or where it falls with the cosine as by Lambert's law."""
    spread = (0.01, 0.012)
    rates = flown(incidence_deg=incidence_deg, spread=spread)
    pose = rates.motion.pose
    u, v = (grid.ravel() for grid in np.meshgrid(*(s * np.linspace(-4.5, 4.5, 91) for s in spread), indexing="ij"))
    beam = np.exp(-(u**2) / (2 * spread[0] ** 2) - v**2 / (2 * spread[1] ** 2))
    slope = lambert * np.tan(np.deg2rad(incidence_deg))
    for k in range(0, len(rates), 97):
        toward = np.column_stack([np.sqrt(1 - u**2 - v**2), u, v]) @ pose.R_world_antenna[k].T
        power = beam * np.abs(toward[:, 2]) ** (2 + lambert)
        mean = -(toward @ pose.velocity_mps[k]) @ power / power.sum()
        assert predicted(rates, InstrumentErrors(backscatter_slope=slope))[k] == pytest.approx(mean, abs=2e-5)
        # The axis alone would err by up to 2 mm/s.
        assert pose.boresight_range_rate_mps[k] != pytest.approx(mean, abs=2e-4)


def test_rates_are_unfolded_and_vary_as_means_of_stretches_do():
    rates, rng = flown(), np.random.default_rng(4)
    wrong = InstrumentErrors.of({"pitch": 0.01, "heading": -0.008})
    true_mps = predicted(rates, wrong)

    def found(repeated):
        noise = np.repeat(rng.standard_normal(len(rates) // repeated), repeated)
        seen = (true_mps + 0.02 * noise + 0.5) % 1.0 - 0.5
        return RangeRates.of_frames(seen, rates.motion, tuple(rates.spread[0]), 1.0)

    plain, alike = found(1), found(6)
    np.testing.assert_allclose(plain.rate_mps, true_mps, atol=0.1)
    assert plain.sigma_mps[0] == pytest.approx(0.02, rel=0.25)
    # Of frames that are alike in sixes, a sixth tells something.
    assert alike.sigma_mps[0] == pytest.approx(0.02 * np.sqrt(6), rel=0.25)
    few = rates.rows(slice(0, 60))
    assert np.isinf(RangeRates.of_frames(few.rate_mps, few.motion, (0.01, 0.012), 1.0).sigma_mps).all()


def test_heading_trades_off_with_a_crosswind_of_the_velocity_and_pitch_with_a_vertical_one():
    """Along one line an error of either is one of the other, at the ratio of the speed; opposite lines part heading."""
    rates = flown(heading_deg=(0.0,))
    rates = replace(rates, motion=replace(rates.motion, turn_rad_s=0 * rates.motion.turn_rad_s))
    names = ("heading", "velocity_east", "pitch", "velocity_up", "roll", "squint")
    change = dict(zip(names, rates.linearised(InstrumentErrors(), names)[0].T, strict=True))
    speed = 10.0
    largest = np.abs(change["velocity_up"]).max()
    # A nose that is believed too far right, or up, is a velocity that is believed too far left, or down.
    np.testing.assert_allclose(change["heading"], -speed * change["velocity_east"], atol=0.04 * speed * largest)
    np.testing.assert_allclose(change["pitch"], -speed * change["velocity_up"], atol=0.04 * speed * largest)
    # Roll about the course changes nothing but what climbing makes of it.
    assert np.abs(change["roll"]).max() < 0.04 * np.abs(change["heading"]).max()
    opposite = flown(heading_deg=(180.0,)).linearised(InstrumentErrors(), names)[0]
    np.testing.assert_allclose(opposite[:, 0], speed * opposite[:, 1], atol=0.04 * speed * largest)
