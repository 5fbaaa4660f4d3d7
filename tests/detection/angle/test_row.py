"""A row of receivers: a plane, two surfaces in one range cell, and beam formers against the bound."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from receivers import echoes_of_all
from sionna_radar import load_scenario
from sionna_radar.detection.angle.row import (
    cosine_variance,
    forward_backward,
    lowest,
    noise_projection,
    scanned,
    source_powers,
)
from sionna_radar.detection.build import build_angle_estimator, build_detector
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.mapping.points import locate
from sionna_radar.radar.build import build_receivers
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.survey.observation import observe
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.warnings import direction_warnings
from sionna_radar.tracing.paths import Paths

ANTENNA, HEIGHT_M, MIDDLE_M = make_antenna(8.0, 8.0), 50.0, 71.0
PULSES = make_pulses(24, incidence_deg=45.0, position_m=(0.0, 0.0, HEIGHT_M))
UPPER, LOWER = 0.05, -0.045


def estimator(angle, sweep="up", **receiver):
    radar = RadarTable(snr_db=30.0, sweep=sweep, second_receiver={"axis": "elevation", **receiver})
    table = ProcessingTable(angle=angle)
    chirp = make_chirp(sweep=sweep)
    detector = build_detector(table, chirp, ANTENNA)
    array = build_receivers(radar.second_receiver, ANTENNA, chirp, 1 / radar.chirp_rate_hz)
    return build_angle_estimator(table, detector, ANTENNA, array)


def row_of(receivers, spacing, **keys):
    return estimator("row", kind="row", receivers=receivers, baseline_wavelengths=spacing, **keys)


def echo_of(range_m, cosine_up, gain, left=(-0.05, 0.05), pulses=PULSES):
    """Scatterers in each pulse at ranges and directions, spread across the beam as well."""
    rng, shape = np.random.default_rng(7), (len(pulses), len(range_m))
    left = rng.uniform(*left, shape)
    direction = np.stack(np.broadcast_arrays(np.sqrt(1 - left**2 - cosine_up**2), left, cosine_up), axis=2)
    away = np.einsum("pij,pkj->pki", pulses.true.R_world_antenna, direction)
    place = pulses.true.position_m[:, None] + np.broadcast_to(range_m, shape)[..., None] * away
    phase = np.exp(2j * np.pi * rng.random(shape))
    return Paths.to_points(
        pulses,
        np.repeat(np.arange(len(pulses)), len(range_m)),
        place.reshape(-1, 3),
        gain=(gain * phase).ravel(),
        incidence_rad=np.full(phase.size, 0.5),
        surface=np.zeros(phase.size, dtype=int),
    )


def surfaces(*cosines, count=400):
    """Level surfaces that cross the same ranges in some directions: over each the range grows with the direction."""
    range_m = np.random.default_rng(3).uniform(MIDDLE_M - 1.5, MIDDLE_M + 1.5, (len(cosines), count))
    up = np.array(cosines)[:, None] + (range_m - MIDDLE_M) / MIDDLE_M
    return echo_of(range_m.ravel(), up.ravel(), 1e-6)


def found_by(found, paths, noise_w=1e-13, pulses=PULSES):
    return echoes_of_all(found, paths, pulses, noise_w)


def near(echoes):
    """Direction cosines of the points where both surfaces are."""
    own = np.abs(echoes.range_m - MIDDLE_M) < 1.0
    # What the range adds to the direction of a level surface.
    return echoes.direction[own, 2] - (echoes.range_m[own] - MIDDLE_M) / MIDDLE_M, echoes.across_sigma_rad[own]


@pytest.mark.parametrize(("receivers", "spacing", "sweep"), [(4, 2.5, "up"), (8, 1.0, "down"), (16, 1.0, "up")])
def test_points_of_a_plane_lie_on_it(receivers, spacing, sweep):
    """One surface is taken for one, and its points scatter as they state."""
    across = np.linspace(-0.12, 0.12, 900)
    height = 0.5**0.5 * (np.sqrt(1 - across**2) - across)
    gain = 1e-8 * ANTENNA.gain(np.column_stack([np.sqrt(1 - across**2), 0 * across, across]))
    found = row_of(receivers, spacing, sweep=sweep)
    echoes = found_by(found, echo_of(HEIGHT_M / height, across, gain))
    points = locate(echoes, PULSES.index, PULSES.measured)
    assert 2.5 * len(PULSES) < len(points) < 4 * len(PULSES)
    assert np.abs(np.mean(points.position_m[:, 2])) < 0.1
    assert np.std(points.position_m[:, 2]) < 0.15


@pytest.mark.parametrize(("receivers", "spacing"), [(8, 1.0), (4, 2.5)])
def test_two_surfaces_in_the_same_cells_are_told_apart(receivers, spacing):
    """5.4 deg from each other, to 0.1 m at 71 m and as they state; a pair's coherence is too low for any point."""
    up, sigma = near(found_by(row_of(receivers, spacing), surfaces(UPPER, LOWER)))
    high = up > 0
    assert min(high.sum(), (~high).sum()) > 0.8 * len(PULSES)
    for own, expected in ((high, UPPER), (~high, LOWER)):
        error = up[own] - expected
        assert np.sqrt(np.mean(error**2)) < 0.1 / MIDDLE_M
        assert 0.5 < np.sqrt(np.mean((error / sigma[own]) ** 2)) < 1.5
    assert len(found_by(estimator("interferometric"), surfaces(UPPER, LOWER))) < 0.1 * len(PULSES)


def test_a_receiver_beside_the_row_tells_where_across_each_surface_is():
    """One 2.3 deg to the left, one to the right, in the same range cells, by the phase of each."""
    range_m = np.random.default_rng(3).uniform(MIDDLE_M - 1.5, MIDDLE_M + 1.5, (2, 400))
    up = np.array([[UPPER], [LOWER]]) + (range_m - MIDDLE_M) / MIDDLE_M
    narrow = [(0.04, 0.041), (-0.041, -0.04)]
    paths = Paths.concatenate([echo_of(range_m[k], up[k], 1e-6, narrow[k]) for k in range(2)])
    found = row_of(8, 1.0, axis="both")
    assert found.axes == (0, *7 * [1])
    echoes = found_by(found, paths)
    own = np.abs(echoes.range_m - MIDDLE_M) < 1.0
    left, up = echoes.direction[own, 1:].T
    assert min(np.sum(up > 0), np.sum(up < 0)) > 0.8 * len(PULSES)
    error = left - np.where(up > 0, 0.0405, -0.0405)
    assert np.sqrt(np.mean(error**2)) < 0.003


def test_a_single_surface_there_gives_single_points():
    up, _ = near(found_by(row_of(8, 1.0), surfaces(UPPER)))
    np.testing.assert_allclose(up, UPPER, atol=0.004)
    assert 0.8 * len(PULSES) < len(up) < 1.5 * len(PULSES)


def test_neither_the_block_size_nor_its_neighbours_change_a_bit():
    keys = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 128}
    keys |= {"radar.scan.mode": "conical", "radar.antenna.beamwidth_deg": 8.0, "processing.angle": "row"}
    keys |= {
        f"radar.second_receiver.{key}": v for key, v in {"kind": "row", "axis": "elevation", "receivers": 5}.items()
    }
    prepared = prepare(load_scenario("hills", keys))
    first, second = (observe(prepared, Execution(block_size=size))[1].echoes for size in (256, 7))
    np.testing.assert_array_equal(first.direction, second.direction)
    np.testing.assert_array_equal(first.across_sigma_rad, second.across_sigma_rad)
    assert len(first) > 2 * len(prepared)
    assert list(direction_warnings(prepared.angle, prepared.flight.sample(50).measured, 1)) == []
    turned = prepare(load_scenario("hills", keys | {"radar.scan.mode": "whisk_broom"}))
    (warning,) = direction_warnings(turned.angle, turned.flight.sample(50).measured, 1)
    assert warning.endswith("their spread is interpreted as a second surface; set radar.scan.mode = 'conical'")


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"kind": "row", "axis": "elevation"}, "receivers: missing"),
        ({"receivers": 8}, "receivers: 8 has no effect on kind = 'interferometer'"),
    ],
)
def test_what_is_no_row_is_refused(keys, message):
    with pytest.raises(ValueError, match=message):
        RadarTable(snr_db=30.0, second_receiver=keys)


def test_neighbours_so_far_apart_that_the_phase_wraps_are_refused():
    with pytest.raises(ScenarioError, match="wraps the phase inside the main lobe"):
        row_of(4, 8.0)


@pytest.mark.parametrize(("range_m", "speed_mps"), [(40.0, 10.0), (90.0, 10.0), (40.0, 40.0)])
@pytest.mark.parametrize(
    ("keys", "sweep", "within"),
    [
        ({"kind": "row", "receivers": 9, "baseline_wavelengths": 2.5}, "up", 4e-4),
        ({"kind": "row", "receivers": 5, "baseline_wavelengths": 3.0}, "down", 4e-4),
        ({"baseline_wavelengths": 4.5}, "up", 1.5e-4),
    ],
)
def test_a_point_is_seen_from_the_first_receiver_at_any_range(keys, sweep, within, range_m, speed_mps):
    """Wavefronts are spheres: the middle of a row of 0.08 m sees it 1e-3 off at 40 m, and 3e-3 to the side.

    At 40 m/s the Doppler shift moves its range by 12 m, a third of that.
    """
    pulses = make_pulses(24, incidence_deg=45.0, position_m=(0.0, 0.0, HEIGHT_M), velocity_mps=(0.0, speed_mps, 0.0))
    left, up, angle = 0.021, -0.033, "row" if "kind" in keys else "interferometric"
    found = estimator(angle, sweep, axis="both", **keys)
    echoes = found_by(found, echo_of(np.array([range_m]), up, 1e-6, (left, left), pulses), 1e-19, pulses)
    strongest = echoes.power > 0.5 * echoes.power.max()
    assert strongest.sum() >= len(pulses)
    np.testing.assert_allclose(echoes.direction[strongest, 1:], [[left, up]] * strongest.sum(), atol=within)


PLACE = np.arange(8) * 1.0


def steering(place_wavelengths, cosine):
    """Steering vectors of a row, one per direction cosine."""
    return np.exp(2j * np.pi * np.outer(cosine, place_wavelengths))


APART = np.array([-0.045, 0.05])
SCANNED = scanned(PLACE, 0.2)


def covariances(cosine, power, looks, trials, seed=1, noise_w=1.0):
    """Sample covariances of uncorrelated sources in noise."""
    random = np.random.default_rng(seed)

    def drawn(*shape):
        return (random.standard_normal(shape) + 1j * random.standard_normal(shape)) / np.sqrt(2)

    source = drawn(trials, looks, len(cosine)) * np.sqrt(power)
    x = source @ steering(PLACE, np.asarray(cosine)) + np.sqrt(noise_w) * drawn(trials, looks, len(PLACE))
    return np.einsum("tle,tlf->tef", x, x.conj()) / looks


def exact(cosine, power, noise_w=1.0):
    vectors = steering(PLACE, np.asarray(cosine))
    return np.einsum("s,se,sf->ef", np.asarray(power), vectors, vectors.conj()) + noise_w * np.eye(len(PLACE))


def test_two_nearer_than_the_beam_are_told_apart():
    """0.095 apart, in a beam of 1 / 8: one hump of the conventional one."""
    vectors, covariance = steering(PLACE, SCANNED), exact(APART, [100.0, 100.0])
    found = np.sort(lowest(noise_projection(covariance[None], vectors, 2), SCANNED, 2)[0])
    np.testing.assert_allclose(found, APART, atol=2e-4)


def test_coherent_ones_are_parted_by_the_row_turned_around():
    """Two ways of one wave: the covariance has one source alone, until the row is turned around."""
    vectors = steering(PLACE, APART)
    wave = 10.0 * (vectors[0] + 1j * vectors[1])
    covariance = np.outer(wave, wave.conj()) + np.eye(8)
    assert np.sum(np.linalg.eigvalsh(covariance) > 10) == 1
    parted = forward_backward(covariance)
    assert np.sum(np.linalg.eigvalsh(parted) > 10) == 2
    found = np.sort(lowest(noise_projection(parted[None], steering(PLACE, SCANNED), 2), SCANNED, 2)[0])
    np.testing.assert_allclose(found, APART, atol=2e-4)


@pytest.mark.parametrize(("cosine", "power"), [([0.021], [30.0]), (APART, [300.0, 100.0])])
def test_the_variance_is_that_of_the_bound(cosine, power):
    looks, trials = 32, 600
    covariance = covariances(cosine, power, looks, trials)
    found = np.sort(
        lowest(noise_projection(covariance, steering(PLACE, SCANNED), len(power)), SCANNED, len(power)), axis=1
    )
    error = found - np.sort(cosine)
    vectors = steering(PLACE, np.asarray(cosine))[None]
    bound = cosine_variance(vectors, 2j * np.pi * PLACE * vectors, np.array([power]), np.array([float(looks)]))[0]
    assert np.isfinite(found).all()
    np.testing.assert_array_less(np.abs(error.mean(axis=0)), 5 * np.sqrt(bound / trials))
    ratio = error.var(axis=0) / bound
    # MUSIC reaches the bound of strong sources; weaker ones add a share of 1 / N R.
    assert np.all((ratio > 0.85) & (ratio < 1.25))
    if len(power) == 1:
        # Of one source in a row of N spaced d: 6 / (L R (k d)^2 N (N^2 - 1)).
        assert bound[0] == pytest.approx(6 / (looks * power[0] * (2 * np.pi) ** 2 * 8 * 63), rel=1e-9)


def test_powers_of_sources_are_known_where_they_stand():
    covariance = exact(APART, [40.0, 7.0])[None]
    found = source_powers(covariance, steering(PLACE, APART)[None], np.array([1.0]))
    np.testing.assert_allclose(found[0], [40.0, 7.0], rtol=1e-9)


def test_a_source_that_is_not_there_is_not_a_number():
    """A share that falls all the way has no minimum."""
    assert np.isnan(lowest(np.linspace(1.0, 0.0, 9)[None], np.linspace(-1.0, 1.0, 9), 2)).all()
