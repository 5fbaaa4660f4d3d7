"""Placing echoes on the beam axis of the measured pose."""

from dataclasses import replace

import numpy as np

from flights import make_pulses
from sionna_radar.detection.echoes import Echoes
from sionna_radar.mapping.points import Points, locate


def echoes_of(pulse, range_m) -> Echoes:
    pulse = np.array(pulse)
    count = len(pulse)
    return Echoes(
        pulse=pulse,
        number=np.arange(count) - np.searchsorted(pulse, pulse),
        range_m=np.array(range_m, dtype=float),
        range_sigma_m=np.full(len(range_m), 0.1),
        power=np.linspace(1, 2, count),
        echo_snr_db=np.linspace(10, 20, count),
    )


def test_points_lie_on_the_beam_axis():
    pulses = make_pulses(
        4, incidence_deg=30.0, scan_deg=np.array([0.0, 10.0, 20.0, 30.0]), first=7, position_m=(5.0, 6.0, 50.0)
    )
    points = locate(echoes_of([8, 8, 10], [40.0, 60.0, 50.0]), pulses.index, pulses.measured)
    a = np.deg2rad(30)
    for k, (scan_deg, range_m) in enumerate([(10, 40), (10, 60), (30, 50)]):
        b = np.deg2rad(scan_deg)  # flying north: ahead is y, right is x
        along = np.array([np.cos(a) * np.sin(b), np.sin(a), -np.cos(a) * np.cos(b)])
        np.testing.assert_allclose(points.position_m[k], [5, 6, 50] + range_m * along, atol=1e-9)
    np.testing.assert_array_equal(points.origin_m, np.tile([5.0, 6.0, 50.0], (3, 1)))
    np.testing.assert_array_equal(points.number, [0, 1, 0])


def test_no_echoes_no_points():
    pulses = make_pulses(4)
    nothing = echoes_of([0], [1.0]).rows(slice(0))
    assert len(locate(nothing, pulses.index, pulses.measured)) == 0


def test_the_digest_tells_every_change():
    pulses = make_pulses(2)
    points = locate(echoes_of([0, 1], [40.0, 41.0]), pulses.index, pulses.measured)
    assert points.sha256() == locate(echoes_of([0, 1], [40.0, 41.0]), pulses.index, pulses.measured).sha256()
    for name in ("position_m", "range_m", "power", "echo_snr_db"):
        nudged = getattr(points, name).copy()
        nudged.flat[-1] = np.nextafter(nudged.flat[-1], np.inf)
        assert replace(points, **{name: nudged}).sha256() != points.sha256()


def test_concatenation_keeps_the_order():
    pulses = make_pulses(4)
    parts = [locate(echoes_of([k], [40.0 + k]), pulses.index, pulses.measured) for k in (0, 2, 3)]
    np.testing.assert_array_equal(Points.concatenate(parts).pulse, [0, 2, 3])


def looking(position_m, toward, range_m, sigma_m=0.2) -> Points:
    """Points of beams from some positions, whose ranges are that far."""
    toward = toward / np.linalg.norm(toward, axis=1, keepdims=True)
    count = len(range_m)
    return Points(
        pulse=np.arange(count),
        number=np.zeros(count, dtype=np.int64),
        position_m=position_m + range_m[:, None] * toward,
        origin_m=position_m,
        range_m=range_m,
        range_sigma_m=np.full(count, sigma_m),
        power=np.ones(count),
        echo_snr_db=np.full(count, 20.0),
    )


def test_noise_spreads_the_line_of_a_beam_that_looks_aside():
    """Over ground that rises and falls by metres, along 30 m, to the side; the same beam there and back makes a map."""
    rng, count = np.random.default_rng(2), 500
    along = np.linspace(0.0, 30.0, count)
    for heading in (0.0, 0.3):
        ahead, side = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        position = np.column_stack([along[:, None] * ahead, np.full(count, 50.0)])
        toward = np.tile([*side, -1.0], (count, 1))
        range_m = 70.0 + 3 * np.sin(along / 5) + rng.normal(0, 0.2, count)
        assert looking(position, toward, range_m).spread_by_noise
        # Straight down ranges do not move places.
        assert not looking(position, np.tile([0.0, 0.0, -1.0], (count, 1)), range_m).spread_by_noise
        shaken = toward + rng.normal(0, [0.0, 0.0, 1e-4], (count, 3))
        assert looking(position, shaken, range_m).spread_by_noise
        back = position + [*(20.0 * side), 0.0] * (np.arange(count) % 2 == 0)[:, None]
        assert not looking(back, toward, range_m).spread_by_noise


def test_a_narrow_scan_draws_a_surface():
    """A degree to each side, and a flight of half a metre under a wide scan."""
    rng, count = np.random.default_rng(3), 400
    scan = np.deg2rad(np.sin(np.arange(count)))
    position = np.column_stack([np.linspace(0, 30, count), np.zeros(count), np.full(count, 50.0)])
    toward = np.column_stack([np.zeros(count), np.sin(scan), -np.cos(scan)])
    assert not looking(position, toward, 50.0 + rng.normal(0, 0.2, count)).spread_by_noise
    wide = np.column_stack([np.zeros(count), np.sin(30 * scan), -np.cos(30 * scan)])
    short = np.column_stack([np.linspace(0, 0.5, count), np.zeros(count), np.full(count, 50.0)])
    assert not looking(short, wide, 50.0 / np.cos(30 * scan), 0.02).spread_by_noise
