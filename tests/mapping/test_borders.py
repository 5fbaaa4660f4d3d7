"""Maps with steps: regions without ramps, planes of regions, and borders by the likelihood of whole profiles."""

import numpy as np
import pytest

from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.echo_model.model import mean_ranges
from sionna_radar.mapping.stepped.border_kernels import (
    NOTHING,
    CellColumns,
    approach,
    candidate,
    cast,
)
from sionna_radar.mapping.stepped.borders import (
    NEIGHBOUR_GAIN_NEPERS,
    StepMap,
    _Block,
    assign_border_cells,
    border_cells,
    contradicted_by_echoes,
    nearest_echo_off_level,
)
from sionna_radar.mapping.stepped.planes import plane_of_echoes
from sionna_radar.mapping.stepped.regions import distance_to_border_m, regions_of
from sionna_radar.mapping.stepped.uncertainty import sigma_after_reassignment

ROOF_M = 8.0


def columns_of(height: np.ndarray, spacing: float = 1.0) -> CellColumns:
    flat = np.zeros(height.shape)
    number, ceiling = np.arange(height.size).reshape(height.shape), np.full(height.shape, height.max() + 1.0)
    return CellColumns(height, flat, flat, number, ceiling, float(ceiling.max()), 0.0, 0.0, spacing)


def plainly(columns: CellColumns, origin: np.ndarray, ray: np.ndarray, farthest: float) -> tuple[float, int]:
    """Step along a ray until it is below the top of the column there."""
    for at in np.arange(0.0, farthest, 1e-3):
        x, y, z = origin + at * ray
        row, column = int(np.floor(y / columns.spacing)), int(np.floor(x / columns.spacing))
        inside = 0 <= row < columns.height.shape[0] and 0 <= column < columns.height.shape[1]
        if inside and z <= columns.height[row, column]:
            on_wall = columns.height[row, column] - z > 2e-3
            return float(at), 2 * int(columns.region[row, column]) + int(on_wall)
    return np.inf, NOTHING


def test_rays_meet_columns_where_a_plain_march_meets_them():
    rng = np.random.default_rng(3)
    columns = columns_of(rng.uniform(0.0, 6.0, (9, 12)))
    for _ in range(60):
        origin = np.array([*rng.uniform(-8.0, 16.0, 2), 20.0])
        toward = np.array([*rng.uniform(2.0, 8.0, 2), 0.0]) - origin
        ray = toward / np.linalg.norm(toward)
        far, what = cast(columns, *origin, *ray, 0.0, 60.0, NOTHING, 0, 0.0, 0.0, 0.0, 0)
        expected, on = plainly(columns, origin, ray, 60.0)
        assert far == pytest.approx(expected, abs=3e-3)
        assert what == on
        assert far - 30.0 < approach(columns, *origin, *ray, 60.0) <= far


def test_another_column_is_as_if_it_stood_in_the_map():
    height = np.random.default_rng(1).uniform(0.0, 3.0, (6, 6))
    changed = height.copy()
    changed[2, 3] = 9.0
    ray = np.array([0.55, 0.4, -0.4]) / np.linalg.norm([0.55, 0.4, -0.4])
    other = cast(columns_of(height), -8.0, -4.0, 12.0, *ray, 0.0, 60.0, 2, 3, 9.0, 0.0, 0.0, 15)
    assert other == cast(columns_of(changed), -8.0, -4.0, 12.0, *ray, 0.0, 60.0, NOTHING, 0, 0.0, 0.0, 0.0, 0)


def test_a_ramp_across_a_wall_does_not_join_roof_and_ground():
    height = np.zeros((30, 40))
    height[8:20, 10:28] = ROOF_M
    height[14, 7:10] = [2.0, 4.0, 6.0]  # as steep as a step of 2.5 m a cell
    region = regions_of(height, 2.5, 6)
    assert len(np.unique(region)) == 2
    assert region[10, 15] != region[2, 2]
    np.testing.assert_array_equal(region[8:20, 10:28], region[10, 15])


def test_gentle_ground_is_one_part():
    x, y = np.meshgrid(np.arange(50.0), np.arange(40.0))
    assert np.all(regions_of(0.3 * x + 2 * np.sin(y / 6), 1.0, 6) == 0)


def test_distances_to_borders_are_euclidean():
    region = np.zeros((21, 21), dtype=np.int64)
    region[:, 12:] = 1
    found = distance_to_border_m(region, 0.5)
    np.testing.assert_allclose(found[5], 0.5 * np.minimum(np.abs(np.arange(21) - 11), np.abs(np.arange(21) - 12)))
    assert np.all(np.isinf(distance_to_border_m(np.zeros((4, 4), dtype=np.int64), 1.0)))


WIDE = Grid(west_m=-20.0, south_m=-100.0, spacing_m=0.5, columns=400, rows=400)
MAP = Grid(west_m=50.0, south_m=-14.0, spacing_m=1.0, columns=41, rows=29)
WEST, EAST, SOUTH, NORTH, TOP = 62.3, 78.3, -7.7, 8.3, 6.0


def on_box(grid: Grid, grown: float = 0.0) -> np.ndarray:
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    return (x > WEST - grown) & (x < EAST + grown) & (y > SOUTH - grown) & (y < NORTH + grown)


@pytest.fixture(scope="module")
def seen():
    """A box 18 dB brighter than the ground."""
    surface = Heightfield(grid=WIDE, height_m=np.where(on_box(WIDE), TOP, 0.0))
    return make_sightings(surface, 2.0, bright=lambda hit_m: np.where(hit_m[:, 2] > 0.5, 60.0, 1.0))


@pytest.fixture(scope="module")
def block(seen):
    """A map whose box is a cell too large on every side."""
    roof = on_box(MAP, 1.0)
    return _Block(seen, np.where(roof, TOP, 0.0), roof.astype(np.int64), MAP)


def test_cells_on_the_wrong_side_of_a_wall_go_over(seen):
    roof, true = on_box(MAP, 1.0), on_box(MAP)
    axis_m = seen.places(mean_ranges(seen).range_m)
    found = assign_border_cells(seen, axis_m, np.where(roof, TOP, 0.0), roof.astype(np.int64), ~roof, 1.0, MAP)
    in_view = found.expected > 0
    wrong_before, wrong_after = (in_view & (region != true) for region in (roof, found.region == 1))
    assert wrong_after.sum() < 0.65 * wrong_before.sum()
    np.testing.assert_array_equal(found.height_m[in_view], np.where(found.region == 1, TOP, 0.0)[in_view])
    kept = in_view & ~found.doubtful(*np.zeros((2, *MAP.shape), dtype=bool))
    assert (wrong_after & kept).sum() <= 0.3 * wrong_before.sum()


def test_profiles_changed_ray_by_ray_are_those_predicted_anew(block):
    wanted = np.flatnonzero(border_cells(block._columns.region))
    ground, height = np.full(MAP.rows * MAP.columns, NOTHING), np.zeros(MAP.rows * MAP.columns)
    changed, margin = np.zeros(MAP.shape, dtype=bool), np.full(MAP.shape, np.inf)
    block._update(5)
    block._sweep(wanted, block._crossing(), ground, height, changed, margin, 1.0)
    assert changed.any()
    kept, met = block._echoes.mean.copy(), block._views.meets.copy()
    block._cast(np.arange(len(met)))
    same = np.all(np.isclose(block._views.meets, met, rtol=1e-12), axis=1)
    assert same.mean() > 0.97  # a few rays over lowered cells meet others than they were known to cross
    block._update(0)
    rows = np.repeat(same, np.diff(block._echoes.start))
    np.testing.assert_allclose(block._echoes.mean[rows], kept[rows], rtol=1e-9)


def log_likelihood(block: _Block) -> float:
    """Return that of all profiles, with all rays cast and all profiles predicted anew."""
    block._cast(np.arange(len(block._echoes.first)))
    block._update(0)
    ratio = block._echoes.power / block._echoes.mean
    speckle_loss = np.where(ratio > MAX_SPECKLE, MAX_SPECKLE + np.log(ratio / MAX_SPECKLE), ratio)
    return float(-block._echoes.looks[0] * np.sum(speckle_loss + np.log(block._echoes.mean)))


def test_what_a_cell_gains_is_the_likelihood_of_whole_profiles_predicted_anew(seen):
    rng, roof = np.random.default_rng(4), on_box(MAP)
    cells = np.flatnonzero(border_cells(roof.astype(np.int64)))
    ground, height = np.full(MAP.rows * MAP.columns, NOTHING), np.zeros(MAP.rows * MAP.columns)
    for cell in rng.choice(cells, 12, replace=False):
        block = _Block(seen, np.where(roof, TOP, 0.0), roof.astype(np.int64), MAP)
        block._update(10)
        row, column = np.unravel_index(cell, MAP.shape)
        own, before = block._columns.region[row, column], log_likelihood(block)
        top, a, b, number = candidate(block._columns, row, column, 1 - own)
        beside = candidate(block._columns, row, column, own)[3]
        changed, margin = np.zeros(MAP.shape, dtype=bool), np.full(MAP.shape, np.inf)
        block._sweep(np.array([cell]), block._crossing(), ground, height, changed, margin, 1.0)
        block._columns.height[row, column], block._columns.region[row, column] = top, 1 - own
        block._columns.slope_x[row, column], block._columns.slope_y[row, column] = a, b
        gain = NEIGHBOUR_GAIN_NEPERS * (number - beside) + log_likelihood(block) - before
        assert margin[row, column] == pytest.approx(abs(gain), rel=1e-6, abs=1e-6)
        assert changed[row, column] == (gain > 0)


def test_a_bright_roof_is_found_as_bright_as_it_is(seen):
    true = on_box(MAP)
    block = _Block(seen, np.where(true, TOP, 0.0), true.astype(np.int64), MAP)
    block._update(40)
    ground, _, roof, roof_wall = 10 * np.log10(block._level)
    assert roof - ground == pytest.approx(10 * np.log10(60.0), abs=3.0)
    assert roof_wall - ground == pytest.approx(10 * np.log10(60.0), abs=3.0)


@pytest.mark.parametrize("slope", [0.0, 0.1])
def test_a_plane_through_whole_echoes_is_known_as_well_as_it_says(slope):
    x, _ = np.meshgrid(WIDE.x_m, WIDE.y_m)
    sightings = make_sightings(Heightfield(grid=WIDE, height_m=1.0 + slope * (x - 60.0)), 2.0)
    found = plane_of_echoes(sightings, mean_ranges(sightings), MAP)
    assert found is not None
    place = np.array([[60.0, 0.0], [80.0, 10.0]])
    error = found.at(place) - (1.0 + slope * (place[:, 0] - 60.0))
    assert np.all(np.abs(error) < 4 * found.sigma_m(place))
    assert np.all(found.sigma_m(place) < 0.15)
    assert (found.coefficients[1] == 0) == (slope == 0)


def test_a_hill_is_no_plane():
    x, y = np.meshgrid(WIDE.x_m, WIDE.y_m)
    hill = Heightfield(grid=WIDE, height_m=3 * np.exp(-((x - 65) ** 2 + y**2) / 2 / 15**2))
    sightings = make_sightings(hill, 2.0)
    assert plane_of_echoes(sightings, mean_ranges(sightings), MAP) is None


def test_a_map_without_borders_stays_as_it_is(seen):
    axis_m = seen.places(mean_ranges(seen).range_m)
    height, region = np.full(MAP.shape, 1.5), np.zeros(MAP.shape, dtype=np.int64)
    found = assign_border_cells(seen, axis_m, height, region, np.ones(MAP.shape, dtype=bool), 1.0, MAP)
    np.testing.assert_array_equal(found.height_m, height)
    assert not found.doubtful(*np.zeros((2, *MAP.shape), dtype=bool)).any()


def test_cells_whose_nearest_echo_is_a_step_away_are_doubtful_unless_profiles_are_sure():
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=12, rows=3)
    x, _ = np.meshgrid(grid.x_m, grid.y_m)
    roof = x > 5.5
    # The ground is heard up to x = 7, the roof from x = 10 on.
    echoes = np.array([[0.0, 1.0, 0.0], [3.0, 1.0, 0.1], [7.0, 1.0, 0.0], [10.0, 1.0, 6.0]])
    elsewhere = nearest_echo_off_level(np.where(roof, 6.0, 0.0), echoes, 1.0, grid)
    np.testing.assert_array_equal(elsewhere, (x > 5.5) & (x < 8.5))
    margin = np.where(x == 7.0, 100.0, np.inf)
    found = StepMap(np.where(roof, 6.0, 0.0), roof.astype(int), np.ones(grid.shape), np.ones(grid.shape), margin)
    nowhere = np.zeros(grid.shape, dtype=bool)
    np.testing.assert_array_equal(found.doubtful(elsewhere, nowhere), (x == 6.0) | (x == 8.0))
    assert not nearest_echo_off_level(np.zeros(grid.shape), np.zeros((0, 3)), 1.0, grid).any()


def test_echoes_of_a_roof_that_is_no_part_of_the_map_leave_it_empty_and_a_stray_one_or_a_slope_does_not():
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=24, rows=9)
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    rng = np.random.default_rng(4)
    place = rng.uniform(0, [23, 8], (200, 2))
    height = 1.5 * x  # of a slope so steep that the nearest echo is a step off the cell's height, not off the map
    echoes = np.column_stack([place, 1.5 * np.round(place[:, 0])])
    assert nearest_echo_off_level(height, echoes, 0.5, grid).any()
    assert not contradicted_by_echoes(height, echoes, 0.5, grid).any()
    stray, tip = np.array([[5.0, 4.0, 30.0]]), np.hypot(place[:, 0] - 17, place[:, 1] - 4) < 3
    assert not contradicted_by_echoes(height, np.vstack([echoes, stray]), 0.5, grid).any()
    echoes[tip, 2] += 12.0
    empty = contradicted_by_echoes(height, echoes, 0.5, grid)
    assert empty[np.hypot(x - 17, y - 4) < 1.5].all()
    assert not empty[np.hypot(x - 17, y - 4) > 5].any()
    one_part, nowhere = np.zeros(grid.shape, dtype=int), np.zeros(grid.shape, dtype=bool)
    found = StepMap(height, one_part, np.ones(grid.shape), np.ones(grid.shape), np.full(grid.shape, np.inf))
    np.testing.assert_array_equal(found.doubtful(nowhere, empty), empty)
    assert not contradicted_by_echoes(height, echoes[:2], 0.5, grid).any()


def test_a_cell_that_changes_its_part_is_known_as_well_as_its_new_neighbours():
    before, after = np.array([[0, 0, 0, 1, 1]]), np.array([[0, 0, 1, 1, 1]])
    sigma = sigma_after_reassignment(np.array([[0.1, 0.1, 0.1, 0.4, 0.5]]), before, after)
    np.testing.assert_array_equal(sigma, [[0.1, 0.1, 0.4, 0.4, 0.5]])
