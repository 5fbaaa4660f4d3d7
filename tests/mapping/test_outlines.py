"""Outlines finer than the cells of a map: bodies against closed forms, and a box of any heading seen by brute force."""

import numpy as np
import pytest

from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.mean_ranges import mean_ranges
from sionna_radar.mapping.outlines import UNIT_M, EdgeLikelihood, rectangle, with_outlines

FINE = Grid(west_m=-20.0, south_m=-60.0, spacing_m=0.25, columns=600, rows=480)
MAP = Grid(west_m=50.0, south_m=-14.0, spacing_m=1.0, columns=41, rows=29)
TOP_M = 6.0
# A body that no other test has: 15.4 m by 9.6 m, turned by 23 deg, its walls on no cell's centre.
CENTRE, SIZE, TURN = np.array([70.3, 1.2]), np.array([15.4, 9.6]), np.deg2rad(23.0)


def corners(centre=CENTRE, size=SIZE, turn=TURN):
    along, across = np.array([np.cos(turn), np.sin(turn)]), np.array([-np.sin(turn), np.cos(turn)])
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return np.array([centre + a * size[0] / 2 * along + b * size[1] / 2 * across for a, b in signs])


def on_body(x, y):
    east, north = x - CENTRE[0], y - CENTRE[1]
    along, across = np.cos(TURN) * east + np.sin(TURN) * north, np.cos(TURN) * north - np.sin(TURN) * east
    return (np.abs(along) < SIZE[0] / 2) & (np.abs(across) < SIZE[1] / 2)


def body_over(grid: Grid) -> Heightfield:
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    return Heightfield(grid=grid, height_m=np.where(on_body(x, y), TOP_M, 0.0))


@pytest.fixture(scope="module")
def sightings():
    return make_sightings(body_over(FINE), beamwidth_deg=3.0)


def likelihood(sightings) -> EdgeLikelihood:
    ground = Heightfield(grid=MAP, height_m=np.zeros(MAP.shape))
    return EdgeLikelihood(sightings, ground, np.array([TOP_M, 0.0, 0.0]), np.arange(len(sightings)))


def test_a_body_takes_from_what_is_behind_it_what_it_sends_itself(sightings):
    """All of the beam meets the body or the ground, whose power falls with the square of the range."""
    found = likelihood(sightings)
    nothing = found.shapes(corners() + 1000.0).sum(axis=1)
    everything = found.shapes(corners(size=np.array([400.0, 400.0]))).sum(axis=1)
    assert nothing[1:] == pytest.approx(0.0)
    assert everything[[0, 2]] == pytest.approx(0.0)
    height = sightings.pose.position_m[0, 2]
    assert everything[1] / nothing[0] == pytest.approx((height / (height - TOP_M)) ** 2, rel=1e-3)
    share = found.shapes(corners()).sum(axis=1) / nothing[0]
    assert (share > 0.01).all()
    assert 1.0 < share.sum() < (height / (height - TOP_M)) ** 2
    assert nothing[0] < len(sightings) * (UNIT_M / height) ** 2


def test_a_wall_in_front_is_seen_between_its_top_and_its_foot(sightings):
    """A wall across the view sends from every range between those of its edges, and no farther."""
    found = likelihood(sightings)
    pulse = int(np.argmin(np.abs(sightings.pose.boresight[:, 1])))
    at = sightings.pose.position_m[pulse]
    wall_east = at[0] + 48.0
    front = np.array([[wall_east, -200.0], [wall_east + 3, -200.0], [wall_east + 3, 200.0], [wall_east, 200.0]])
    cells = slice(sightings.profiles.start[pulse], sightings.profiles.start[pulse + 1])
    wall = found.shapes(front)[2, cells]
    range_m = np.flatnonzero(wall > 1e-3 * wall.max()) * sightings.profiles.cell_m
    assert range_m.min() >= np.hypot(48.0, at[2] - TOP_M) - 0.7
    assert range_m.max() <= np.hypot(48.0, at[2]) / np.cos(np.deg2rad(4)) + 0.7


def test_edges_are_found_to_a_fraction_of_a_cell(sightings):
    wrong = corners(CENTRE + np.array([0.8, -0.7]), SIZE * 1.1, TURN + 0.06)
    found = likelihood(sightings)
    fit = found.fit(rectangle(wrong), np.zeros(5))
    error = np.linalg.norm(rectangle(wrong)(fit.parameters) - corners(), axis=1)
    assert fit.loss < found.loss(found.shapes(wrong)) - 10
    assert np.sqrt(np.mean(error**2)) < 0.45
    assert 0.01 < fit.sigma_m < 0.3


def test_cells_get_the_height_at_their_centre(sightings):
    """A part whose cells are wrong by one all around ends where the body does."""
    x, y = np.meshgrid(MAP.x_m, MAP.y_m)
    truth = on_body(x, y)
    ragged = on_body(x + 1.0, y - 1.0)
    pose = sightings.pose
    axis_m = pose.position_m + mean_ranges(sightings).range_m[:, None] * pose.boresight
    height = np.where(ragged, TOP_M, 0.0)
    found = with_outlines(
        sightings, axis_m, height, ragged.astype(int), np.ones(MAP.shape, dtype=bool), MAP, step_m=1.2, flat_m=0.2
    )
    assert np.minimum(np.abs(found), np.abs(found - TOP_M)).max() < 1e-9
    assert ((found > 1) != truth).sum() < 0.4 * (ragged != truth).sum()


def test_parts_without_a_plane_top_keep_their_cells(sightings):
    x, y = np.meshgrid(MAP.x_m, MAP.y_m)
    part = on_body(x, y)
    height = np.where(part, TOP_M + 2 * np.sin(x), 0.0)
    axis_m = sightings.pose.position_m + 70.0 * sightings.pose.boresight
    found = with_outlines(sightings, axis_m, height, part.astype(int), part, MAP, step_m=1.2, flat_m=0.2)
    np.testing.assert_array_equal(found, height)
