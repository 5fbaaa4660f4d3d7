"""Points along the echoes of a plane: where they lie, and how far off they are against what is stated."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.detection.angle.build import build_angle_estimator
from sionna_radar.detection.angle.segments import range_strips, stretches_of
from sionna_radar.detection.detector import build_detector
from sionna_radar.mapping.points import locate
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.signal.leakage import side_paths
from sionna_radar.signal.receiver import Receiver
from sionna_radar.tracing.paths import Paths

ANTENNA, CHIRP, HEIGHT_M = make_antenna(8.0, 8.0), make_chirp(), 50.0
PULSES = make_pulses(24, incidence_deg=45.0, scan_deg=np.linspace(-45, 45, 24), position_m=(0.0, 0.0, HEIGHT_M))


def estimator(angle: str, kind: str, **processing):
    radar = RadarTable(snr_db=30.0, second_receiver={"kind": kind})
    table = ProcessingTable(angle=angle, **processing)
    return build_angle_estimator(radar, build_detector(table, CHIRP, ANTENNA), ANTENNA)


def plane_echo(slope: float, seed: int = 1, count: int = 700) -> Paths:
    """Scatterers on a plane that rises toward east, as many in each beam, weighted with the two-way pattern."""
    rng = np.random.default_rng(seed)
    across = rng.uniform(-0.14, 0.14, (len(PULSES), count, 2))
    direction = np.dstack([np.sqrt(1 - np.sum(across**2, axis=2)), across])
    gain = ANTENNA.gain(direction.reshape(-1, 3)).reshape(len(PULSES), count)
    away = np.einsum("pij,pkj->pki", PULSES.true.R_world_antenna, direction)
    range_m = -HEIGHT_M / (away[..., 2] - slope * away[..., 0])
    phase = np.exp(2j * np.pi * rng.random((len(PULSES), count)))
    return Paths.to_points(
        PULSES,
        np.repeat(np.arange(len(PULSES)), count),
        (PULSES.true.position_m[:, None] + range_m[..., None] * away).reshape(-1, 3),
        gain=(1e-8 * gain * phase / range_m).ravel(),
        incidence_rad=np.full(len(PULSES) * count, 0.5),
        surface=np.zeros(len(PULSES) * count, dtype=int),
    )


def points_of(found, paths: Paths, noise_w: float = 1e-13):
    receiver = Receiver(sweeps=(CHIRP,), transmit_power_w=1.0, noise_power_w=noise_w, seed=4)
    sides = [
        receiver.beat(side_paths(paths, PULSES, side), PULSES, channel)
        for channel, side in enumerate(found.receivers, start=1)
    ]
    echoes = found.find([receiver.beat(paths, PULSES), *sides], PULSES.index, PULSES.measured)
    return locate(found.detector.correct(echoes, PULSES.index, PULSES.measured), PULSES.index, PULSES.measured)


@pytest.mark.parametrize("slope", [0.0, 0.15])
def test_points_lie_on_the_plane_whatever_its_slope(slope):
    """Each echo becomes points along the beam; with the errors that they state, and without a bias."""
    found = estimator("interferometric", "interferometer")
    points = points_of(found, plane_echo(slope))
    assert len(points) > 2.5 * len(PULSES)
    error = points.position_m[:, 2] - slope * points.position_m[:, 0]
    away = points.position_m - points.origin_m
    level = np.linalg.norm(away[:, :2], axis=1) / np.linalg.norm(away, axis=1)
    stated = points.across_sigma_m * level
    assert 0.7 < np.sqrt(np.mean((error / stated) ** 2)) < 1.4
    assert abs(np.average(error, weights=stated**-2)) < 3 / np.sqrt(np.sum(stated**-2))


def test_the_ratio_of_the_halves_finds_the_plane_too():
    points = points_of(estimator("monopulse", "monopulse"), plane_echo(0.0))
    error = points.position_m[:, 2]
    assert np.median(np.abs(error)) < 0.25
    assert len(points) > 2.5 * len(PULSES)


def test_a_point_target_has_its_direction():
    found = replace(estimator("interferometric", "interferometer"), spread=(0.01, 0.01), half_power=(0.1, 0.1))
    direction = np.array([np.sqrt(1 - 0.02**2 - 0.01**2), 0.02, -0.01])
    away = 70.0 * PULSES.true.R_world_antenna @ direction
    paths = Paths.to_points(
        PULSES,
        np.arange(len(PULSES)),
        PULSES.true.position_m + away,
        gain=np.full(len(PULSES), 1e-4 + 0j),
        incidence_rad=np.full(len(PULSES), 0.5),
        surface=np.zeros(len(PULSES), dtype=int),
    )
    points = points_of(found, paths, noise_w=1e-16)
    away = points.position_m - points.origin_m
    toward = np.einsum("pij,pi->pj", PULSES.true.R_world_antenna[points.pulse], away)
    # All of its response shows one direction; the ways to phase centres a wavelength apart are not quite parallel.
    cosines = toward[:, 1:] / np.linalg.norm(toward, axis=1)[:, None]
    np.testing.assert_allclose(cosines, np.tile(direction[1:], (len(points), 1)), atol=1e-3)
    assert set(points.pulse) == set(range(len(PULSES)))
    np.testing.assert_allclose(np.average(points.range_m, weights=points.power), 70.0, atol=0.15)


def test_a_known_length_of_points():
    long, short = (
        points_of(estimator("interferometric", "interferometer", angle_length_m=m), plane_echo(0.0)) for m in (4.0, 2.0)
    )
    assert len(short) > 1.4 * len(long)


def test_no_echo_is_no_point():
    found = estimator("interferometric", "interferometer")
    points = points_of(found, plane_echo(0.0).rows(slice(0)))
    assert len(points) == 0
    assert points.across_sigma_m.shape == (0,)


def test_range_grows_across_the_strip():
    """Over level ground, by r tan(incidence) a radian toward where the antenna sees up."""
    strips = range_strips(PULSES.measured, (0.04, 0.04))
    R = PULSES.measured.R_world_antenna
    for row in (0, 11, 23):
        ranges = []
        for step in (-1e-4, 1e-4):
            cosines = strips.climb[row] * step
            ranges.append(-HEIGHT_M / (R[row] @ np.array([np.sqrt(1 - cosines @ cosines), *cosines]))[2])
            level = strips.strip[row] * step
            along = -HEIGHT_M / (R[row] @ np.array([np.sqrt(1 - level @ level), *level]))[2]
            assert along == pytest.approx(-HEIGHT_M / R[row, 2, 0], rel=1e-7)
        grown = (ranges[1] - ranges[0]) / 2e-4
        assert grown == pytest.approx(np.mean(ranges) * np.tan(strips.incidence_rad[row]), rel=1e-5)
    # In a round beam a strip has its mean nearest to the boresight; in a wide one it is drawn to the wide axis.
    np.testing.assert_allclose(strips.mean, strips.climb)
    np.testing.assert_allclose(strips.along, 0.04)


def test_stretches_share_an_echo_evenly():
    echo, first = stretches_of(np.array([10, 3, 1]), np.array([4.0, 4.0, 4.0]))
    np.testing.assert_array_equal(echo, [0, 0, 1, 2])
    np.testing.assert_array_equal(first, [0, 5, 0, 0])
