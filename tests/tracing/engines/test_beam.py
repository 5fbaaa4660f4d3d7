"""The beam engine against the radar equation, and its path table against geometry."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beams import make_antenna, make_chirp, plane_power
from flights import make_pulses
from sionna_radar.radar.antenna import Antenna, measured_cut
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from worlds import make_scene, make_surface

C = 299_792_458.0


def power_per_pulse(paths, pulses) -> np.ndarray:
    row = paths.pulse - pulses.index[0]
    return np.bincount(row, weights=np.abs(paths.gain.astype(complex)) ** 2, minlength=len(pulses))


def engine(scene, antenna, chirp, rays=512, seed=1, side_lobe_share=0.05):
    return BeamEngine(scene, antenna, chirp, seed, rays, side_lobe_share)


@pytest.fixture(scope="module", params=["V", "H"])
def polarized(request, plane):
    antenna = make_antenna(2.0, 2.0, request.param)
    return antenna, engine(plane, antenna, make_chirp())


@pytest.mark.parametrize("incidence_deg", [0, 15, 30, 45, 60, 70])
def test_mean_power_over_a_plane_is_the_radar_equation(polarized, incidence_deg):
    antenna, beam = polarized
    pulses = make_pulses(400, incidence_deg=incidence_deg)
    mean = power_per_pulse(beam.trace(pulses), pulses).mean()
    expected = plane_power(antenna, 50.0, incidence_deg)
    assert 10 * np.log10(mean / expected) == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize("heading_deg", [0.0, 75.0])
@pytest.mark.parametrize(("incidence_deg", "scan_deg"), [(45.0, 40.0), (20.0, -50.0), (0.0, 60.0)])
def test_an_uneven_beam_is_turned_as_it_should(plane, incidence_deg, scan_deg, heading_deg):
    antenna = make_antenna(3.0, 12.0)
    pulses = make_pulses(400, incidence_deg=incidence_deg, scan_deg=scan_deg, heading_deg=heading_deg)
    mean = power_per_pulse(engine(plane, antenna, make_chirp()).trace(pulses), pulses).mean()
    expected = plane_power(antenna, 50.0, incidence_deg, scan_deg)
    assert 10 * np.log10(mean / expected) == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("side_lobe_share", [0.01, 0.5])
def test_the_share_of_side_lobe_rays_changes_the_noise_and_not_the_mean(plane, pencil, side_lobe_share):
    pulses = make_pulses(600, incidence_deg=30.0)
    beam = engine(plane, pencil, make_chirp(), side_lobe_share=side_lobe_share)
    mean = power_per_pulse(beam.trace(pulses), pulses).mean()
    assert 10 * np.log10(mean / plane_power(pencil, 50.0, 30.0)) == pytest.approx(0.0, abs=0.01)


def test_a_high_side_lobe_brings_its_own_echo(plane):
    """A lobe at -10 dB, 25 deg below a beam that looks out flat, carries a large part of the echo."""
    angle_deg = np.arange(-60.0, 60.01, 0.05)
    beam_db, lobe_db = (level - 3.0103 * ((angle_deg - at) / 1.5) ** 2 for level, at in ((0.0, 0.0), (-5.0, -25.0)))
    elevation = measured_cut(np.deg2rad(angle_deg), 10 * np.log10(10 ** (beam_db / 10) + 10 ** (lobe_db / 10) + 1e-6))
    azimuth = measured_cut(np.deg2rad(angle_deg), np.maximum(-3.0103 * (angle_deg / 1.5) ** 2, -60.0))
    antenna = Antenna(azimuth, elevation)
    pulses = make_pulses(400, incidence_deg=65.0)
    mean = power_per_pulse(engine(plane, antenna, make_chirp()).trace(pulses), pulses).mean()
    assert 10 * np.log10(mean / plane_power(antenna, 50.0, 65.0)) == pytest.approx(0.0, abs=0.05)


def test_the_table_holds_the_geometry(plane, pencil):
    velocity = np.array([3.0, 10.0, -2.0])
    pulses = make_pulses(5, incidence_deg=40.0, scan_deg=20.0, velocity_mps=tuple(velocity), first=7)
    paths = engine(plane, pencil, make_chirp()).trace(pulses)
    away = paths.hit_m - pulses.true.position_m[paths.pulse - 7]
    range_m = np.linalg.norm(away, axis=1)
    assert np.all(np.diff(paths.pulse) >= 0)
    assert set(paths.pulse) == set(range(7, 12))
    near = range_m < 500
    np.testing.assert_allclose(paths.hit_m[near, 2], 0.0, atol=1e-4)
    np.testing.assert_allclose(paths.delay_s, 2 * range_m / C, rtol=3e-6)
    np.testing.assert_allclose(paths.range_rate_mps, -(away / range_m[:, None]) @ velocity, atol=1e-4)
    np.testing.assert_allclose(np.cos(paths.incidence_rad[near]), 50 / range_m[near], atol=1e-4)
    np.testing.assert_array_equal(paths.surface, 0)


def test_most_paths_lie_in_the_beam(plane, pencil):
    pulses = make_pulses(20, incidence_deg=30.0)
    paths = engine(plane, pencil, make_chirp()).trace(pulses)
    away = paths.hit_m - [0, 0, 50]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    off_deg = np.rad2deg(np.arccos(np.clip(away @ pulses.true.boresight[0], -1, 1)))
    assert np.mean(off_deg < 1.5) > 0.8
    power = np.abs(paths.gain) ** 2
    assert power.sum() ** 2 / np.sum(power**2) > 0.6 * len(power)  # effective paths


def test_phases_are_spread_evenly_and_differ_from_pulse_to_pulse(plane, pencil):
    paths = engine(plane, pencil, make_chirp()).trace(make_pulses(100, incidence_deg=0.0))
    rotor = paths.gain / np.abs(paths.gain)
    for turns in (1, 2):
        assert np.abs(np.mean(rotor**turns)) < 4 / np.sqrt(len(rotor))
    power = np.abs([paths.gain[paths.pulse == k].sum() for k in range(100)]) ** 2
    assert power.std() / power.mean() == pytest.approx(1.0, abs=0.3)  # speckle: exponential power


def test_a_pulse_is_the_same_in_any_block(plane, pencil):
    beam = engine(plane, pencil, make_chirp())
    scan = np.linspace(-40, 40, 12)
    whole = beam.trace(make_pulses(12, incidence_deg=45.0, scan_deg=scan))
    again = engine(plane, pencil, make_chirp()).trace(make_pulses(12, incidence_deg=45.0, scan_deg=scan))
    for field in fields(whole):
        np.testing.assert_array_equal(getattr(whole, field.name), getattr(again, field.name))
    for k in (0, 5, 11):
        alone = beam.trace(make_pulses(1, incidence_deg=45.0, scan_deg=scan[k], first=k))
        for field in fields(whole):
            mine = getattr(whole, field.name)[whole.pulse == k]
            np.testing.assert_array_equal(mine, getattr(alone, field.name), err_msg=field.name)


def test_another_seed_draws_other_paths(plane, pencil):
    one, other = (engine(plane, pencil, make_chirp(), seed=seed).trace(make_pulses(1)) for seed in (1, 2))
    assert not np.array_equal(one.hit_m, other.hit_m)


def test_rays_that_miss_leave_no_path(pencil):
    small = make_scene(make_surface(lambda x, y: 0 * x, size_m=20.0))
    paths = engine(small, pencil, make_chirp()).trace(make_pulses(3, incidence_deg=60.0))
    assert np.all(np.abs(paths.hit_m[:, :2]) <= 10.001)
    up = make_pulses(2, incidence_deg=0.0)
    mirror = np.diag([1.0, -1.0, -1.0])
    up = replace(up, true=replace(up.true, R_world_antenna=mirror @ up.true.R_world_antenna))
    assert len(engine(small, pencil, make_chirp()).trace(up)) == 0


def test_surfaces_are_named_by_their_place_in_the_scene():
    west = make_surface(lambda x, y: 0 * x, size_m=200.0, centre_m=(-100.0, 0.0), name="west")
    east = make_surface(lambda x, y: 0 * x, size_m=200.0, centre_m=(100.0, 0.0), name="east")
    paths = engine(make_scene(west, east), make_antenna(20.0, 20.0), make_chirp()).trace(make_pulses(4))
    np.testing.assert_array_equal(paths.surface, (paths.hit_m[:, 0] > 0).astype(int))
    assert set(paths.surface) == {0, 1}


def hill(x, y):
    return 6 * np.exp(-((x - 10) ** 2 + (y - 40) ** 2) / 400)


@settings(max_examples=5)
@given(st.floats(-300, 300), st.floats(-300, 300), st.floats(-100, 100))
def test_moving_scene_and_radar_together_changes_nothing(east, north, up):
    antenna, chirp = make_antenna(4.0, 4.0), make_chirp()
    still = make_surface(hill, size_m=200.0)
    moved = replace(still, vertices_m=still.vertices_m + np.array([east, north, up]))
    here = make_pulses(8, incidence_deg=40.0, scan_deg=10.0)
    there = make_pulses(8, incidence_deg=40.0, scan_deg=10.0, position_m=(east, north, 50.0 + up))
    one = engine(make_scene(still), antenna, chirp, side_lobe_share=0.01).trace(here)
    two = engine(make_scene(moved), antenna, chirp, side_lobe_share=0.01).trace(there)
    np.testing.assert_allclose(power_per_pulse(two, there), power_per_pulse(one, here), rtol=2e-3)
    if len(one) == len(two):  # a ray that grazes the mesh's edge may change sides
        np.testing.assert_allclose(two.hit_m - [east, north, up], one.hit_m, atol=5e-3)
        np.testing.assert_allclose(two.delay_s, one.delay_s, atol=2 * 2e-3 / C)


@settings(max_examples=5)
@given(st.floats(-180, 180))
def test_turning_scene_and_radar_together_changes_nothing(heading):
    antenna, chirp = make_antenna(4.0, 4.0, "H"), make_chirp()
    c, s = np.cos(np.deg2rad(-heading)), np.sin(np.deg2rad(-heading))  # headings turn clockwise
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    still = make_surface(hill, size_m=200.0)
    moved = replace(still, vertices_m=still.vertices_m @ turn.T)
    here, there = (make_pulses(8, incidence_deg=40.0, scan_deg=10.0, heading_deg=h) for h in (0.0, heading))
    one = engine(make_scene(still), antenna, chirp, side_lobe_share=0.01).trace(here)
    two = engine(make_scene(moved), antenna, chirp, side_lobe_share=0.01).trace(there)
    np.testing.assert_allclose(power_per_pulse(two, there), power_per_pulse(one, here), rtol=2e-3)
