"""The pulses that are transmitted until a time, in any grouping: those of a survey's schedule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.flight.pulses import in_bursts, schedule_pulses
from sionna_radar.flight.scan import RotatingScan
from sionna_radar.flight.trajectory import Phase, Trajectory
from sionna_radar.studies.live.clock import PulseClock

RATE_HZ, END_S = 200.0, 3.0
TRAJECTORY = Trajectory(
    position=lambda t: np.zeros((len(t), 3)),
    velocity=lambda t: np.zeros((len(t), 3)),
    euler=lambda t: np.zeros((len(t), 3)),
    phases=((Phase.TAKE_OFF, 0.0, 0.25), (Phase.CRUISE, 0.25, END_S)),
)


def scan_of(half_swath_deg):
    return RotatingScan(
        mode="whisk_broom",
        incidence_rad=0.5,
        half_swath_rad=np.deg2rad(half_swath_deg),
        rotation_rad_s=2 * np.pi * 3.3,
        start_rad=0.4,
        stabilised=True,
    )


@given(
    st.lists(st.floats(0.0, 0.3), min_size=1, max_size=20),
    st.sampled_from([0.0, 0.5]),
    st.sampled_from([1, 3]),
    st.sampled_from([5.0, 40.0, 180.0]),
)
def test_pulses_are_those_of_the_schedule(steps, stagger, averaged, half_swath_deg):
    scan = scan_of(half_swath_deg)
    chirps = schedule_pulses(TRAJECTORY, scan, RATE_HZ, stagger=stagger)
    bursts = in_bursts(chirps, averaged, RATE_HZ)
    expected = chirps.time_s if bursts is None else bursts.schedule.time_s
    clock = PulseClock(start_s=0.25, rate_hz=RATE_HZ, stagger=stagger, scan=scan, averaged=averaged, half_s=0.0)
    clock.begin(0.0)
    at_s = np.minimum.accumulate(np.minimum(np.cumsum([0.0, *steps, 10.0]), END_S)[::-1])[::-1]
    found = [clock.until(float(time_s)) for time_s in at_s]
    index, time_s = (np.concatenate(column) for column in zip(*found, strict=True))
    np.testing.assert_array_equal(index, np.arange(len(index)))
    # A schedule leaves out what ends after the cruise; a clock goes on.
    np.testing.assert_array_equal(time_s[: len(expected)], expected)
    assert np.all(time_s[len(expected) :] > expected.max(initial=0.0))
    assert len(time_s) <= len(expected) + 1


def test_a_frame_is_transmitted_when_it_has_ended():
    clock = PulseClock(start_s=0.0, rate_hz=10.0, stagger=0.0, scan=scan_of(180.0), averaged=1, half_s=0.02)
    clock.begin(0.0)
    assert clock.until(0.069)[1].tolist() == []
    assert clock.until(0.071)[1].tolist() == [0.05]
    clock.begin(0.5)
    index, time_s = clock.until(0.6)
    assert (index.tolist(), time_s.tolist()) == ([1], [0.55])


@pytest.mark.parametrize("half_swath_deg", [5.0, 180.0])
def test_the_next_pulse_is_known_beforehand(half_swath_deg):
    scan = scan_of(half_swath_deg)
    clock = PulseClock(start_s=0.0, rate_hz=RATE_HZ, stagger=0.0, scan=scan, averaged=1, half_s=0.0)
    clock.begin(0.0)
    for time_s in np.arange(0.0, 2.0, 0.013):
        clock.until(float(time_s))
        number, turn = clock.next_scan()
        index, at_s = PulseClockCopy(clock).until(float(time_s) + 1.0)
        assert (number, turn) == (index[0], scan.point(at_s[:1]).scan_number[0])


def PulseClockCopy(clock):
    copy = PulseClock(
        **{name: getattr(clock, name) for name in ("start_s", "rate_hz", "stagger", "scan", "averaged", "half_s")}
    )
    copy._chirp, copy._pulse = clock._chirp, clock._pulse
    return copy
