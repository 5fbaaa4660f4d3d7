"""Points along the echoes of a plane, how far off they are, and the phase between receivers against its bound."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from receivers import echoes_of_all
from sionna_radar.detection.angle.arrival import coherence, phase_covariance, ratio_covariance
from sionna_radar.detection.angle.segments import range_strips, stretches_of
from sionna_radar.detection.build import build_angle_estimator, build_detector
from sionna_radar.mapping.points import locate
from sionna_radar.radar.build import build_receivers
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.tracing.paths import Paths

ANTENNA, CHIRP, HEIGHT_M = make_antenna(8.0, 8.0), make_chirp(), 50.0
PULSES = make_pulses(24, incidence_deg=45.0, scan_deg=np.linspace(-45, 45, 24), position_m=(0.0, 0.0, HEIGHT_M))


def estimator(angle: str, kind: str, **processing):
    radar = RadarTable(snr_db=30.0, second_receiver={"kind": kind})
    table = ProcessingTable(angle=angle, **processing)
    detector = build_detector(table, CHIRP, ANTENNA)
    array = build_receivers(radar.second_receiver, ANTENNA, CHIRP, 1 / radar.chirp_rate_hz)
    return build_angle_estimator(table, detector, ANTENNA, array)


def plane_echo(slope: float, seed: int = 1, count: int = 700, pulses=PULSES, antenna=ANTENNA, widest=0.14) -> Paths:
    """Scatterers on a plane that rises toward east, as many in each beam, weighted with the two-way pattern."""
    rng = np.random.default_rng(seed)
    across = rng.uniform(-widest, widest, (len(pulses), count, 2))
    direction = np.dstack([np.sqrt(1 - np.sum(across**2, axis=2)), across])
    gain = antenna.gain(direction.reshape(-1, 3)).reshape(len(pulses), count)
    away = np.einsum("pij,pkj->pki", pulses.true.R_world_antenna, direction)
    range_m = -HEIGHT_M / (away[..., 2] - slope * away[..., 0])
    phase = np.exp(2j * np.pi * rng.random((len(pulses), count)))
    return Paths.to_points(
        pulses,
        np.repeat(np.arange(len(pulses)), count),
        (pulses.true.position_m[:, None] + range_m[..., None] * away).reshape(-1, 3),
        gain=(1e-8 * gain * phase / range_m).ravel(),
        incidence_rad=np.full(len(pulses) * count, 0.5),
        surface=np.zeros(len(pulses) * count, dtype=int),
    )


def points_of(found, paths: Paths, noise_w: float = 1e-13):
    return locate(echoes_of_all(found, paths, PULSES, noise_w), PULSES.index, PULSES.measured)


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


def test_points_on_the_flanks_of_a_narrow_beam_are_not_drawn_to_its_middle():
    """Cells on a flank hear more of the ranges nearer to the middle: 0.03 m of height at 71 m, 3 deg wide."""
    antenna, pulses = make_antenna(3.0, 3.0), make_pulses(300, incidence_deg=45.0, position_m=(0.0, 0.0, HEIGHT_M))
    radar = RadarTable(snr_db=60.0, second_receiver={"kind": "interferometer", "baseline_wavelengths": 4.0})
    table = ProcessingTable(angle="interferometric")
    found = build_angle_estimator(
        table, build_detector(table, CHIRP, antenna), antenna,
        build_receivers(radar.second_receiver, antenna, CHIRP, 1 / radar.chirp_rate_hz),
    )  # fmt: skip
    echoes = echoes_of_all(found, plane_echo(0.0, pulses=pulses, antenna=antenna, widest=0.06), pulses, 1e-17)
    points = locate(echoes, pulses.index, pulses.measured)
    nearer = np.linalg.norm(points.position_m[:, :2], axis=1) < HEIGHT_M
    for flank in (nearer, ~nearer):
        error = points.position_m[flank, 2]
        assert abs(error.mean()) < 0.008
        assert error.std() < 0.05


def test_the_ratio_of_the_halves_finds_the_plane_too():
    points = points_of(estimator("monopulse", "monopulse"), plane_echo(0.0))
    error = points.position_m[:, 2]
    assert np.median(np.abs(error)) < 0.25
    assert len(points) > 2.5 * len(PULSES)


@pytest.mark.parametrize(("kind", "angle"), [("monopulse", "monopulse"), ("interferometer", "interferometric")])
def test_points_far_off_the_boresight_are_not_drawn_outward(kind, angle):
    """The ratio of the halves bends upward: by its mean over a stretch points stood 0.05 m too low and too high."""
    pulses = make_pulses(400, incidence_deg=45.0, position_m=(0.0, 0.0, HEIGHT_M))
    echoes = echoes_of_all(estimator(angle, kind), plane_echo(0.0, pulses=pulses, seed=3), pulses, 1e-15)
    points = locate(echoes, pulses.index, pulses.measured)
    near_m, far_m = (HEIGHT_M * np.tan(np.deg2rad(45.0 + off)) for off in (-1.5, 1.5))
    ground_m = np.linalg.norm(points.position_m[:, :2], axis=1)
    for flank in (ground_m < near_m, ground_m > far_m):
        assert flank.sum() > 100
        assert abs(points.position_m[flank, 2].mean()) < 0.025


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


TRIALS, SCATTERERS = 2000, 24


def signals(rng, looks: int, along: tuple[float, ...], snr: float, factor=lambda x: np.exp(1j * x)):
    """Return the signals of a first receiver and of some beside it, over strips of Gaussian scatterers."""

    def normal(*shape):
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    place = rng.standard_normal((TRIALS, looks, SCATTERERS))
    field = normal(TRIALS, looks, SCATTERERS) / np.sqrt(SCATTERERS)
    first = field.sum(axis=2) + normal(TRIALS, looks) / np.sqrt(snr)
    sides = [(field * factor(a * place)).sum(axis=2) + normal(TRIALS, looks) / np.sqrt(snr) for a in along]
    return first, sides


@pytest.mark.parametrize("along", [0.0, 0.5], ids=["a point", "a strip"])
@pytest.mark.parametrize("snr", [10.0, 300.0])
def test_the_phase_reaches_its_bound(along, snr):
    looks = 16.0
    first, (side,) = signals(np.random.default_rng(1), int(looks), (along,), snr)
    phase = np.angle(np.sum(side * first.conj(), axis=1))
    coherent = coherence(np.array([along]), np.array([snr]))[0]
    bound = (1 - coherent**2) / (2 * looks * coherent**2)  # Cramer and Rao's, of a cross-spectrum
    # 2000 trials know a variance to 3.2 %; with 16 looks the phase is a little above its bound.
    assert 0.9 < np.var(phase) / bound < 1.25
    stated = phase_covariance(np.array([[along]]), np.array([snr]), np.array([float(looks)]))[0, 0, 0]
    assert bound < stated * (1 + 1e-12)
    assert stated < bound * looks / (looks - 1)


@pytest.mark.parametrize("looks", [3, 4, 5])
def test_few_looks_of_speckle_scatter_more_than_their_bound(looks):
    """By L / (L - 1), as the mean of the inverse of their power does."""
    first, (side,) = signals(np.random.default_rng(6), looks, (0.2,), 1e6)
    phase = np.angle(np.sum(side * first.conj(), axis=1))
    stated = phase_covariance(np.array([[0.2]]), np.array([1e6]), np.array([float(looks)]))[0, 0, 0]
    # The mean place of a few scatterers in each look varies as well.
    assert np.var(phase) == pytest.approx(stated + 0.2**2 / (SCATTERERS * looks), rel=0.12)
    assert stated == pytest.approx((np.exp(0.04) - 1) / (2 * (looks - 1)), rel=1e-3)


def test_two_receivers_err_together_along_the_strip_and_little_across_it():
    along, snr, looks = (0.4, -0.3), 1000.0, 48
    first, sides = signals(np.random.default_rng(2), looks, along, snr)
    phase = np.stack([np.angle(np.sum(side * first.conj(), axis=1)) for side in sides])
    stated = phase_covariance(np.array([along]), np.array([snr]), np.array([float(looks)]))[0]
    np.testing.assert_allclose(np.cov(phase), stated, rtol=0.2)
    across = np.array([0.3, 0.4])
    measured = np.var(across @ phase)
    assert measured == pytest.approx(across @ stated @ across, rel=0.25)
    assert measured < 0.03 * np.var(phase[0])


def test_ratios_of_difference_and_sum_scatter_as_stated():
    snr, looks, along = 200.0, 48, 0.2
    rng = np.random.default_rng(3)
    first, (side,) = signals(rng, looks, (along,), snr, factor=lambda x: np.tan(x + 0.1))
    ratio = np.sum((side * first.conj()).real, axis=1) / (np.sum(np.abs(first) ** 2, axis=1) - looks / snr)
    place, share = np.polynomial.hermite_e.hermegauss(7)
    of_place = np.tan(0.1 + along * place)[None, None]
    stated = ratio_covariance(of_place, share / share.sum(), np.array([snr]), np.array([float(looks)]))[0, 0, 0]
    # Fewer looks than infinitely many scatter the ratio a little more than its first order.
    assert np.var(ratio) == pytest.approx(stated, rel=0.25)
