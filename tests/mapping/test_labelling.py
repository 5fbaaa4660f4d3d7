"""Maps with steps: regions without ramps, planes of regions, and labels by the likelihood of whole profiles."""

import numpy as np
import pytest

from seen_points import seen_points
from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.numerics import MAX_SPECKLE
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.mapping.stepped.labelling import (
    DISCOUNT,
    Labelling,
    Start,
    labelled_map,
    nearest_echo_m,
)
from sionna_radar.mapping.stepped.labelling_kernels import (
    NOTHING,
    CellColumns,
    approach,
    candidate,
    cast,
)
from sionna_radar.mapping.stepped.planes import FilledBeams, Plane, plane_of_echoes
from sionna_radar.mapping.stepped.regions import border_cells, distance_to_border_m, regions_of
from sionna_radar.mapping.stepped.uncertainty import sigma_after_reassignment

ROOF_M = 8.0


def columns_of(height: np.ndarray, spacing: float = 1.0) -> CellColumns:
    flat = np.zeros(height.shape)
    number, ceiling = np.arange(height.size).reshape(height.shape), np.full(height.shape, height.max() + 1.0)
    return CellColumns(height, flat, flat, number, ceiling, float(ceiling.max()), 0.0, 0.0, spacing)


def plainly(columns: CellColumns, origin: np.ndarray, ray: np.ndarray, farthest: float) -> tuple[float, int]:
    """Step along a ray until it is below the top of the column there."""
    at = np.arange(0.0, farthest, 1e-3)
    x, y, z = origin[:, None] + at * ray[:, None]
    row, column = (np.floor(place / columns.spacing).astype(int) for place in (y, x))
    inside = (row >= 0) & (row < columns.height.shape[0]) & (column >= 0) & (column < columns.height.shape[1])
    top = np.full(len(at), -np.inf)
    top[inside] = columns.height[row[inside], column[inside]]
    if (z <= top).any():
        first = int(np.argmax(z <= top))
        on_wall = top[first] - z[first] > 2e-3
        return float(at[first]), 2 * int(columns.region[row[first], column[first]]) + int(on_wall)
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
    region = regions_of(height, 2.5)
    assert len(np.unique(region)) == 2
    assert region[10, 15] != region[2, 2]
    np.testing.assert_array_equal(region[8:20, 10:28], region[10, 15])


def test_gentle_ground_is_one_part():
    x, y = np.meshgrid(np.arange(50.0), np.arange(40.0))
    assert np.all(regions_of(0.3 * x + 2 * np.sin(y / 6), 1.0) == 0)


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


PAIR_NEPERS = 1.0


def labelling_of(seen, roof: np.ndarray) -> Labelling:
    height = np.where(roof, TOP, 0.0)
    return Labelling(seen, height, roof.astype(np.int64), MAP, np.full(MAP.shape, TOP), PAIR_NEPERS)


def beams_of(seen) -> FilledBeams:
    """Return the beams whose echoes refit planes: each echo on the axis, at its mean range."""
    pose, range_m = seen.pose, mean_ranges(seen).range_m
    position = pose.position_m + range_m[:, None] * pose.boresight
    return FilledBeams(seen_points(position, pose.position_m, range_m=range_m), seen, 4.0)


def labelled(seen, *roofs: np.ndarray, echo_m: np.ndarray | None = None):
    starts = [Start(np.where(roof, TOP, 0.0), roof.astype(np.int64)) for roof in roofs]
    axis_m = seen.places(mean_ranges(seen).range_m)
    echo_m = np.full(MAP.shape, np.nan) if echo_m is None else echo_m
    return labelled_map(seen, axis_m, starts, echo_m, 1.0, MAP, PAIR_NEPERS, beams_of(seen))


def plain_energy(labelling: Labelling) -> float:
    """Return the energy with all rays cast and all profiles predicted anew, cell by cell."""
    labelling._cast(np.arange(len(labelling._echoes.first)))
    labelling._update(0)
    echoes, region = labelling._echoes, labelling._columns.region
    ratio = echoes.power / echoes.mean
    loss = np.where(ratio > MAX_SPECKLE, MAX_SPECKLE + np.log(ratio / MAX_SPECKLE), ratio) + np.log(echoes.mean)
    pairs = 0
    for (i, j), one in np.ndenumerate(region):
        for u, v in ((i, j + 1), (i + 1, j - 1), (i + 1, j), (i + 1, j + 1)):
            if u < region.shape[0] and 0 <= v < region.shape[1]:
                pairs += one != region[u, v]
    return float(echoes.looks[0] * np.sum(loss)) + PAIR_NEPERS * pairs


@pytest.fixture(scope="module")
def grown(seen):
    """The map that is found from a box a cell too large on every side."""
    return labelled(seen, on_box(MAP, 1.0))


def in_view_of(seen) -> np.ndarray:
    """Return the cells that are no farther than the far wall: behind it is shadow."""
    x, _ = np.meshgrid(MAP.x_m, MAP.y_m)
    return x < EAST


def test_cells_on_the_wrong_side_of_a_wall_go_over(seen, grown):
    roof, true, in_view = on_box(MAP, 1.0), on_box(MAP), in_view_of(seen)
    wrong_before, wrong_after = (in_view & (region != true) for region in (roof, grown.region == 1))
    assert wrong_after.sum() < 0.4 * wrong_before.sum()
    np.testing.assert_array_equal(grown.height_m, np.where(grown.region == 1, TOP, 0.0))
    assert (wrong_after & (grown.other_side < 0.1)).sum() <= 0.1 * wrong_before.sum()


def test_a_border_says_which_cells_may_be_of_the_other_side(seen, grown):
    """Far from it none; what is stated is about what is wrong."""
    true, in_view = on_box(MAP), in_view_of(seen)
    far = ~border_cells(on_box(MAP, 2.0).astype(int)) & ~border_cells(on_box(MAP, -2.0).astype(int))
    far &= on_box(MAP, -2.0) | ~on_box(MAP, 3.0)
    assert grown.other_side[far & in_view].max() < 0.02
    wrong, stated = (in_view & ((grown.region == 1) != true)).sum(), grown.other_side[in_view].sum()
    assert 0.3 * wrong < stated < 4 * wrong + 5
    # All other heights of a cell are a box away.
    np.testing.assert_allclose(grown.other_side_m2, TOP**2 * grown.other_side, atol=1e-6)


def test_a_box_that_one_start_lacks_is_taken_from_another(seen):
    nothing, true = np.zeros(MAP.shape, dtype=bool), on_box(MAP)
    found = labelled(seen, nothing, true)
    assert np.mean((found.height_m > TOP / 2)[true]) > 0.9
    both = labelled(seen, true, nothing)
    assert np.mean((both.height_m > TOP / 2) == (found.height_m > TOP / 2)) > 0.98


def test_two_parts_of_a_roof_become_one(seen):
    x, _ = np.meshgrid(MAP.x_m, MAP.y_m)
    true = on_box(MAP)
    halves = np.where(true & (x > 70.0), 2, true.astype(np.int64))
    axis_m, nowhere = seen.places(mean_ranges(seen).range_m), np.full(MAP.shape, np.nan)
    height = np.where(true, TOP, 0.0)
    found = labelled_map(seen, axis_m, [Start(height, halves)], nowhere, 1.0, MAP, PAIR_NEPERS, beams_of(seen))
    assert len(np.unique(found.region[found.height_m > TOP / 2])) == 1


def test_a_roof_that_is_too_low_is_lifted_to_its_echoes(seen):
    true = on_box(MAP)
    level = Plane(np.array([70.0, 0.0]), np.array([TOP - 0.4, 0.0, 0.0]), np.eye(3))
    start = Start(np.where(true, TOP - 0.4, 0.0), true.astype(np.int64), {1: level})
    axis_m, nowhere = seen.places(mean_ranges(seen).range_m), np.full(MAP.shape, np.nan)
    found = labelled_map(seen, axis_m, [start], nowhere, 1.0, MAP, PAIR_NEPERS, beams_of(seen))
    roof = found.region == 1
    np.testing.assert_allclose(np.median(found.height_m[roof]), TOP, atol=0.1)
    assert np.isfinite(found.refitted_sigma_m[roof]).all()
    assert np.isnan(found.refitted_sigma_m[~roof]).all()


def test_an_echo_a_step_off_is_as_good_as_a_map(seen):
    """Alone it doubts a cell by the square of its share: of one rival that agrees, a quarter."""
    true = on_box(MAP)
    x, y = np.meshgrid(MAP.x_m, MAP.y_m)
    inside = (np.abs(x - 70.0) < 3) & (np.abs(y) < 3)
    found = labelled(seen, true, true, echo_m=np.where(inside, 0.0, np.where(true, TOP, 0.0)))
    np.testing.assert_allclose(found.other_side[inside], 0.25, atol=1e-9)
    np.testing.assert_allclose(found.other_side_m2[inside], 0.25 * TOP**2, rtol=1e-9)


def test_the_nearest_echo_gives_its_height():
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=12, rows=3)
    echoes = np.array([[0.0, 1.0, 0.5], [3.0, 1.0, 0.1], [7.0, 1.0, 0.0], [10.0, 1.0, 6.0]])
    np.testing.assert_array_equal(nearest_echo_m(echoes, grid)[:, [0, 4, 8, 11]], [[0.5, 0.1, 0.0, 6.0]] * 3)
    assert np.isnan(nearest_echo_m(np.zeros((0, 3)), grid)).all()


def test_profiles_changed_ray_by_ray_are_those_predicted_anew(seen):
    labelling = labelling_of(seen, on_box(MAP, 1.0))
    wanted, reference = border_cells(labelling._columns.region), labelling.height_m.copy()
    into = np.zeros((2, *MAP.shape))
    changed = labelling._sweep(wanted, labelling._crossing(), 1.0, np.empty((0, 0)), reference, 1.0, into)
    assert changed.any()
    kept, met = labelling._echoes.mean.copy(), labelling._views.meets.copy()
    labelling._cast(np.arange(len(met)))
    same = np.all(np.isclose(labelling._views.meets, met, rtol=1e-12), axis=1)
    assert same.mean() > 0.97  # a few rays over lowered cells meet others than they were known to cross
    labelling._update(0)
    rows = np.repeat(same, np.diff(labelling._echoes.start))
    np.testing.assert_allclose(labelling._echoes.mean[rows], kept[rows], rtol=1e-9)


def test_odds_of_a_cell_are_those_of_the_energies_of_both_maps(seen):
    rng, roof = np.random.default_rng(4), on_box(MAP)
    cells = np.flatnonzero(border_cells(roof.astype(np.int64)))
    for cell in rng.choice(cells, 12, replace=False):
        labelling = labelling_of(seen, roof)
        row, column = np.unravel_index(cell, MAP.shape)
        own, before = labelling._columns.region[row, column], plain_energy(labelling)
        top, a, b, _ = candidate(labelling._columns, row, column, 1 - own)
        wanted, into = np.zeros(MAP.shape, dtype=bool), np.zeros((2, *MAP.shape))
        wanted[row, column] = True
        reference, crossing = labelling.height_m.copy(), labelling._crossing()
        changed = labelling._sweep(wanted, crossing, 1.0, np.empty((0, 0)), reference, 1.0, into)
        labelling._columns.height[row, column], labelling._columns.region[row, column] = top, 1 - own
        labelling._columns.slope_x[row, column], labelling._columns.slope_y[row, column] = a, b
        fall = before - plain_energy(labelling)
        assert changed[row, column] == (fall > 0)
        assert into[0][row, column] == pytest.approx(1 / (1 + np.exp(-fall)), rel=1e-5, abs=1e-9)
        assert into[1][row, column] == pytest.approx(TOP**2 * into[0][row, column])


def test_labels_are_drawn_as_often_as_is_likely(seen):
    roof, wanted = on_box(MAP), np.zeros(MAP.shape, dtype=bool)
    odds, drawn = [], []
    rng = np.random.default_rng(6)
    for cell in np.flatnonzero(border_cells(roof.astype(np.int64)))[::2]:
        wanted[:] = False
        wanted.ravel()[cell] = True
        labelling = labelling_of(seen, roof)
        crossing, reference, into = labelling._crossing(), labelling.height_m.copy(), np.zeros((2, *MAP.shape))
        uniform = rng.random(MAP.shape)
        labelling._sweep(wanted, crossing, DISCOUNT, uniform, reference, 1.0, into)
        odds.append(into[0].ravel()[cell])
        drawn.append(labelling.height_m.ravel()[cell] != reference.ravel()[cell])
        # The current label comes first.
        assert drawn[-1] == (uniform.ravel()[cell] > 1 - odds[-1])
    assert 0 < sum(drawn) < len(drawn)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_regions_change_where_and_only_where_that_lowers_the_energy(seen, seed):
    rng = np.random.default_rng(seed)
    accepted = []
    for _ in range(6):
        labelling = labelling_of(seen, on_box(MAP, float(rng.choice([0.0, 1.0]))))
        before, crossing = plain_energy(labelling), labelling._crossing()
        row, column = rng.integers(2, 20), rng.integers(4, 28)
        rows, columns = (at.ravel() for at in np.mgrid[row : row + rng.integers(1, 8), column : column + 5])
        region = int(rng.integers(0, 2))
        flat = np.zeros(len(rows))
        tops = np.full(len(rows), TOP * region), flat, flat, np.full(len(rows), region)
        accepted.append(labelling._propose(rows, columns, tops, crossing))
        kept = labelling.energy()
        assert plain_energy(labelling) == pytest.approx(kept, abs=1e-3)
        if accepted[-1]:
            assert kept < before
            continue
        assert kept == pytest.approx(before, abs=1e-6)
        for array, values in zip((labelling._columns.height, labelling._columns.region), tops[::3], strict=True):
            array[rows, columns] = values
        assert plain_energy(labelling) >= before
    assert not all(accepted)


def test_a_bright_roof_is_found_as_bright_as_it_is(seen):
    labelling = labelling_of(seen, on_box(MAP))
    labelling._update(40)
    ground, _, roof, roof_wall = 10 * np.log10(labelling._level)
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
    axis_m, nowhere = seen.places(mean_ranges(seen).range_m), np.full(MAP.shape, np.nan)
    start = Start(np.full(MAP.shape, 1.5), np.zeros(MAP.shape, dtype=np.int64))
    found = labelled_map(seen, axis_m, [start], nowhere, 1.0, MAP, PAIR_NEPERS, beams_of(seen))
    np.testing.assert_array_equal(found.height_m, start.height_m)
    assert not found.other_side.any()


def test_a_cell_that_changes_its_part_is_known_as_well_as_its_new_neighbours():
    before, after = np.array([[0, 0, 0, 1, 1]]), np.array([[0, 0, 1, 1, 1]])
    sigma = sigma_after_reassignment(np.array([[0.1, 0.1, 0.1, 0.4, 0.5]]), before, after)
    np.testing.assert_array_equal(sigma, [[0.1, 0.1, 0.4, 0.4, 0.5]])
