"""Reported obstacles of points made by hand: ground of known noise, noise in the air at a known rate, and wires."""

import numpy as np
import pytest

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.obstacles import ObstacleRule, above_ground, ground_around, reported_obstacles
from sionna_radar.mapping.points import Points
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import AntennaTable

HEIGHT_M, CELL_M = 40.0, 0.3


@pytest.fixture(scope="module")
def antenna() -> Antenna:
    return build_antenna(AntennaTable(beamwidth_deg=2.0))


def rule(**keys: float) -> ObstacleRule:
    defaults = {
        "sigmas": 5.0, "min_probability": 0.9, "false_alarm_probability": 1e-6, "cell_m": CELL_M, "min_range_m": 3.0,
        "link_m": 3.0,
    }  # fmt: skip
    return ObstacleRule(**{**defaults, **keys})


def looking_down(place_m: np.ndarray, range_m: np.ndarray, sigma_m: float = 0.05) -> tuple[Points, Pose]:
    """Echoes straight below a radar at places 40 m up, one a pulse."""
    count = len(place_m)
    origin = np.column_stack([place_m, np.full(count, HEIGHT_M)])
    down = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]).T
    points = Points(
        pulse=np.arange(count),
        number=np.zeros(count, dtype=np.int64),
        position_m=origin - np.column_stack([np.zeros((count, 2)), range_m]),
        origin_m=origin,
        range_m=range_m,
        range_sigma_m=np.full(count, sigma_m),
        power=np.ones(count),
        echo_snr_db=np.full(count, 20.0),
    )
    return points, Pose(
        position_m=origin, velocity_mps=np.zeros((count, 3)), R_world_antenna=np.tile(down, (count, 1, 1))
    )


def ground(
    count: int, rng: np.random.Generator, slope: float = 0.0, sigma_m: float = 0.05
) -> tuple[np.ndarray, np.ndarray]:
    """Places over 60 by 60 m, and ranges to a plane through the middle at height 0."""
    place = rng.uniform(-30, 30, (count, 2))
    return place, HEIGHT_M - slope * place[:, 0] + rng.normal(0, sigma_m, count)


def flat_map(slope: float = 0.0) -> tuple[Raster, Raster]:
    grid = Grid(west_m=-30.0, south_m=-30.0, spacing_m=1.0, columns=61, rows=61)
    height = np.tile(slope * grid.x_m, (61, 1))
    return Raster(grid=grid, height_m=height), Raster(grid=grid, height_m=np.full(grid.shape, 0.02))


@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_ground_alone_is_no_obstacle(antenna: Antenna, slope: float) -> None:
    """Neither on the level nor on a slope, where the beam's width makes heights differ."""
    points, pose = looking_down(*ground(3000, np.random.default_rng(1), slope))
    assert not above_ground(points, pose, antenna, rule()).any()
    found, member = reported_obstacles(points, pose, antenna, *flat_map(slope), rule(), len(points))
    assert len(found) == 0
    assert np.all(member == -1)


def test_plane_of_the_ground_is_found_under_an_obstacle_that_returns_most_echoes(antenna: Antenna) -> None:
    """Twenty times as many echoes of one place as of the ground around it do not lift the ground."""
    rng = np.random.default_rng(2)
    place, range_m = ground(800, rng, 0.3)
    mast = np.column_stack([rng.uniform(-1, 1, 16_000), rng.uniform(-1, 1, 16_000)])
    points, pose = looking_down(np.vstack([place, mast]), np.concatenate([range_m, np.full(16_000, HEIGHT_M - 9.0)]))
    around = ground_around(points, 3.0)
    assert around is not None
    np.testing.assert_allclose(around.height_m, 0.3 * points.position_m[:, 0], atol=0.4)
    above = above_ground(points, pose, antenna, rule())
    assert np.all(above[800:])
    assert not above[:800].any()


def test_a_wire_is_one_obstacle_with_its_height_and_extent(antenna: Antenna) -> None:
    """Echoes along 40 m of a wire, 6 m up, beside ground: one cluster, reported with its first two echoes."""
    rng = np.random.default_rng(3)
    place, range_m = ground(3000, rng)
    wire = np.column_stack([np.linspace(-20, 20, 30), np.full(30, 5.0)])
    points, pose = looking_down(np.vstack([place, wire]), np.concatenate([range_m, np.full(30, HEIGHT_M - 6.0)]))
    found, member = reported_obstacles(points, pose, antenna, *flat_map(), rule(), len(points))
    assert len(found) == 1
    assert found.echoes[0] == np.count_nonzero(member == 0) == 30
    assert found.above_m[0] == pytest.approx(6.0, abs=0.1)
    assert found.radius_m[0] == pytest.approx(20.0, abs=1.5)
    assert found.probability[0] > 0.999
    assert 3000 <= found.report_pulse[0] <= 3001
    assert found.first_range_m[0] == pytest.approx(34.0)


def test_noise_makes_the_clusters_that_are_expected(antenna: Antenna) -> None:
    """Alone and in pairs, at their closed-form rates: counts of 60 surveys within four standard deviations.

    A pair lies within the linking distance of each other on the ground and in range.
    """
    pfa, surveys, count = 3e-5, 60, 2000
    rng, flat = np.random.default_rng(4), flat_map()
    single = pairs = 0
    for _ in range(surveys):
        place, range_m = ground(count, rng)
        # A false alarm takes the place of the ground's echo in its pulse, at any of the cells of the air.
        cells = int((HEIGHT_M - 5.0 - 3.0) / CELL_M)
        false = rng.random(count) < pfa * cells
        range_m[false] = rng.uniform(3.0, HEIGHT_M - 5.0, int(false.sum()))
        points, pose = looking_down(place, range_m)
        one = rule(false_alarm_probability=pfa, min_probability=1e-9)
        found, _ = reported_obstacles(points, pose, antenna, *flat, one, count)
        single += int(np.count_nonzero(found.echoes == 1))
        pairs += int(np.count_nonzero(found.echoes == 2))
    expected = surveys * count * pfa * cells
    beside = count / 61**2 * np.pi * 3.0**2 * pfa * 2 * 3.0 / CELL_M
    assert single == pytest.approx(expected, abs=4 * np.sqrt(expected))
    # Of a ball the linked volume is two thirds of the cylinder of the closed form.
    assert pairs <= expected * beside + 4 * np.sqrt(expected * beside)
    assert pairs >= expected * beside / 4 - 4 * np.sqrt(expected * beside)


def test_probability_is_that_of_no_such_cluster_of_noise(antenna: Antenna) -> None:
    """exp(-expected) for one echo far above the ground, and certainty for three together."""
    place, range_m = ground(2000, np.random.default_rng(5))
    high = np.array([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]])
    for echoes, pfa in ((1, 1e-6), (1, 1e-5), (3, 1e-6)):
        points, pose = looking_down(np.vstack([place, high[:echoes]]), np.append(range_m, np.full(echoes, 20.0)))
        one = rule(false_alarm_probability=pfa, min_probability=0.01)
        found, _ = reported_obstacles(points, pose, antenna, *flat_map(), one, len(points))
        expected = pfa * (points.range_m - 3.0).mean() / CELL_M * len(points)
        if echoes == 1:
            assert found.probability[0] == pytest.approx(np.exp(-expected), rel=1e-6)
        else:
            assert found.probability[0] == pytest.approx(1.0, abs=1e-6)
    # Less probable ones are not reported.
    found, _ = reported_obstacles(
        points, pose, antenna, *flat_map(), rule(false_alarm_probability=1e-2, min_probability=0.99), len(points)
    )
    assert len(found) == 0 or found.echoes[0] == 3


def test_too_few_points_and_an_empty_map_report_nothing(antenna: Antenna) -> None:
    """No plane and no map are no error."""
    points, pose = looking_down(np.zeros((3, 2)), np.array([40.0, 20.0, 40.0]))
    empty = Raster(grid=flat_map()[0].grid, height_m=np.full((61, 61), np.nan))
    assert not above_ground(points, pose, antenna, rule()).any()
    for some in (points, points.rows(slice(0))):
        found, _ = reported_obstacles(some, pose, antenna, empty, None, rule(), 3)
        assert len(found) == 0
