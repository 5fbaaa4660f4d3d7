"""Fluctuating targets: Swerling's distributions, how long a draw lasts, and the radar equation under them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, expon, kstest

from beams import make_chirp
from flights import make_pulses
from sionna_radar.flight.scan import RotatingScan
from sionna_radar.scenario import load_scenario
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.targets import cross_section, trace_targets
from worlds import make_surface

COUNT = 20_000
MEAN_M2 = 2.5


def drawn(case, pulses, number=0, seed=1):
    return cross_section(Target(position_m=(0.0, 0.0, 0.0), rcs_m2=MEAN_M2, swerling=case), number, pulses, seed)


def scanned(count, per_scan):
    pulses = make_pulses(count)
    return replace(pulses, scan_number=np.arange(count) // per_scan)


@pytest.mark.parametrize(
    ("case", "law", "relative_std"),
    [(1, expon, 1.0), (2, expon, 1.0), (3, chi2(4, scale=1 / 4), 0.5**0.5), (4, chi2(4, scale=1 / 4), 0.5**0.5)],
)
def test_mean_and_distribution(case, law, relative_std):
    sigma = drawn(case, scanned(COUNT, 1)) / MEAN_M2
    assert sigma.mean() == pytest.approx(1.0, abs=4 * relative_std / np.sqrt(COUNT))
    assert sigma.std() == pytest.approx(relative_std, rel=0.04)
    assert kstest(sigma, law.cdf).pvalue > 0.01
    assert abs(np.corrcoef(sigma[1:], sigma[:-1])[0, 1]) < 4 / np.sqrt(COUNT)


@pytest.mark.parametrize("case", [1, 3])
def test_slow_targets_hold_for_a_scan(case):
    sigma = drawn(case, scanned(600, 50)).reshape(12, 50)
    assert np.all(sigma == sigma[:, :1])
    assert len(np.unique(sigma)) == 12
    whole = drawn(case, make_pulses(600))  # a scan of one's own that counts none
    assert len(np.unique(whole)) == 1


@pytest.mark.parametrize("case", [1, 2, 3, 4])
def test_draws_belong_to_seed_target_and_pulse(case):
    pulses = scanned(100, 10)
    part = replace(make_pulses(30, first=40), scan_number=pulses.scan_number[40:70])
    np.testing.assert_array_equal(drawn(case, part), drawn(case, pulses)[40:70])
    for other in (drawn(case, pulses, number=1), drawn(case, pulses, seed=2)):
        assert not np.any(other == drawn(case, pulses))


def test_a_constant_target_is_constant():
    assert np.all(drawn(0, make_pulses(10)) == MEAN_M2)


@pytest.mark.parametrize(("mode", "half_swath_deg"), [("whisk_broom", 50.0), ("conical", 180.0), ("fixed", 180.0)])
def test_scans_are_counted_by_time_alone(mode, half_swath_deg):
    scan = RotatingScan(
        mode=mode,
        incidence_rad=0.5,
        half_swath_rad=np.deg2rad(half_swath_deg),
        rotation_rad_s=0.0 if mode == "fixed" else 4 * np.pi,
        start_rad=np.deg2rad(-800.0),
        stabilised=True,
    )
    time_s = (np.arange(1800) + 0.5) / 360
    pointing = scan.point(time_s)
    number = pointing.scan_number
    assert number[0] == 0
    assert set(np.unique(np.diff(number))) <= {0, 1}
    assert number[-1] == (0 if mode == "fixed" else 10)
    np.testing.assert_array_equal(scan.point(time_s[700:]).scan_number, number[700:])
    for k in np.unique(number):  # within a scan the angle only grows
        assert np.all(np.diff(pointing.scan_rad[number == k]) >= 0)


@pytest.mark.parametrize("scene", ["hills", "jacksboro"])
def test_constant_targets_on_terrain_are_seen_and_exact(scene):
    """On fine hills and on triangles 90 m wide, straight from the radar equation in this test's own geometry."""
    place = np.random.default_rng(4).uniform([-30, -25], [30, 25], (40, 2))
    start = {"platform.start_m": [-40.0, 0.0], "platform.length_m": 80.0}
    targets = [{"position_m": p.tolist(), "rcs_dbsm": 3.0} for p in place]
    ready = prepare(load_scenario(scene, {"targets": targets, "radar.antenna.beamwidth_deg": 40.0} | start))
    pulses = ready.flight.sample(30)
    scene_targets = ready.world.scene.targets
    top = float(ready.world.scene.bounds_m[1, 2]) + 10
    surface = ready.world.caster.from_above(place, top)
    np.testing.assert_allclose([t.position_m[2] for t in scene_targets], surface, atol=0.02)
    paths = trace_targets(scene_targets, pulses, ready.instrument.antenna, ready.receiver.chirp, ready.world.caster)
    assert len(paths) > 0.9 * 40 * 30  # but for those in true shadow or behind the antenna
    row = np.searchsorted(pulses.index, paths.pulse)
    away = paths.hit_m - pulses.true.position_m[row]
    distance = np.linalg.norm(away, axis=1)
    local = np.einsum("nji,nj->ni", pulses.true.R_world_antenna[row], away / distance[:, None])
    gain = ready.instrument.antenna.gain(local)
    expected = 10 * np.log10(gain**2 * (299_792_458.0 / 77e9) ** 2 * 10**0.3 / ((4 * np.pi) ** 3 * distance**4))
    np.testing.assert_allclose(20 * np.log10(np.abs(paths.gain)), expected, atol=0.05)
    np.testing.assert_allclose(paths.delay_s * 299_792_458.0 / 2, distance, atol=1e-6)


def test_targets_that_are_all_behind_the_antenna_leave_no_path(pencil):
    caster = RayCaster([make_surface(lambda x, y: 0 * x)])
    behind = [Target(position_m=(0.0, 0.0, 90.0), rcs_m2=1.0)]
    assert len(trace_targets(behind, make_pulses(3), pencil, make_chirp(), caster)) == 0
