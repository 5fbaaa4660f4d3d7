"""Planes of roofs, from echoes of beams that the roof fills in part."""

import numpy as np
import pytest

from seen_points import seen_points
from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import Sightings
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.planes import FilledBeams, Plane

GROUND = Grid(west_m=-20.0, south_m=-100.0, spacing_m=0.5, columns=400, rows=400)
MAP = Grid(west_m=50.0, south_m=-14.0, spacing_m=0.5, columns=81, rows=57)
WEST, EAST, SOUTH, NORTH, TOP = 58.0, 70.0, -9.0, 9.0, 6.0
BEAM_DEG, NOISE_M = 2.0, 0.03


def on_roof(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (x > WEST) & (x < EAST) & (y > SOUTH) & (y < NORTH)


def seen_from_roof(sightings: Sightings, slope: float, least_share: float) -> Points:
    """Return the mean ranges over a roof that rises eastward, with some noise, each on the axis of its beam."""
    rng = np.random.default_rng(1)
    u, v = rng.uniform(-1.2, 1.2, (2, 40_000)) * np.deg2rad(BEAM_DEG)
    local = np.column_stack([np.sqrt(1 - u**2 - v**2), u, v])
    gain = sightings.beam.two_way(local)
    found = []
    for row in range(len(sightings)):
        origin, ray = sightings.pose.position_m[row], local @ sightings.pose.R_world_antenna[row].T
        range_m = (origin[2] - TOP - slope * (origin[0] - EAST)) / (slope * ray[:, 0] - ray[:, 2])
        power = gain / range_m**2
        own = power * on_roof(*(origin + range_m[:, None] * ray)[:, :2].T)
        if own.sum() > least_share * power.sum():
            found.append((row, np.sum(own * range_m) / own.sum()))
    pulse, mean_m = np.array([row for row, _ in found]), np.array([mean for _, mean in found])
    mean_m += rng.normal(0.0, NOISE_M, len(pulse))
    pose = sightings.pose.rows(pulse)
    position, sigma = pose.position_m + mean_m[:, None] * pose.boresight, np.full(len(pulse), NOISE_M)
    return seen_points(position, pose.position_m, pulse=pulse, range_m=mean_m, range_sigma_m=sigma)


@pytest.fixture(scope="module")
def sightings():
    return make_sightings(Heightfield(grid=GROUND, height_m=np.zeros(GROUND.shape)), BEAM_DEG)


@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_a_roof_is_where_its_echoes_come_from(sightings, slope):
    """Placed on their axes, the echoes of beams that a roof fills in part are off by decimetres."""
    points = seen_from_roof(sightings, slope, 0.2)
    inside = on_roof(*np.meshgrid(MAP.x_m, MAP.y_m))
    start = Plane(np.array([EAST, 0.0]), np.array([TOP + 0.3, slope, 0.0]), np.zeros((3, 3)))
    true = TOP + slope * (points.position_m[:, 0] - EAST)
    assert np.ptp(points.position_m[:, 2] - true) > 0.15
    found = FilledBeams(points, sightings, 4.0).refitted(start, inside, MAP, 2.0)
    place = np.array([[60.0, -5.0], [66.0, 5.0]])
    np.testing.assert_allclose(found.at(place), TOP + slope * (place[:, 0] - EAST), atol=0.05)


def test_a_roof_that_fills_no_beam_stays(sightings):
    points = seen_from_roof(sightings, 0.0, 0.2)
    x, y = np.meshgrid(MAP.x_m, MAP.y_m)
    start = Plane(np.array([EAST, 0.0]), np.array([TOP + 0.3, 0.0, 0.0]), np.zeros((3, 3)))
    narrow = on_roof(x, y) & (np.abs(y) < 0.6)
    assert FilledBeams(points, sightings, 4.0).refitted(start, narrow, MAP, 2.0) is start
    none = points.rows(np.arange(0))
    assert FilledBeams(none, sightings, 4.0).refitted(start, on_roof(x, y), MAP, 2.0) is start
