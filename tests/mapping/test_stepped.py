"""Maps with steps: evidence against closed forms, levels against a plain search, and a box seen by brute force."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plain_evidence import evidence
from seen_points import seen_points
from sightings import make_sightings
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.mapping.options import STEPPED
from sionna_radar.mapping.points import Points
from sionna_radar.mapping.stepped.coarse_map import CoarseMap, choose_levels, path_costs
from sionna_radar.mapping.stepped.evidence import (
    _reflectivities,
    columns_between,
    evidence_against,
    levels_between,
    planes_around,
)
from sionna_radar.mapping.stepped.surface import SteppedTiles, _Surfaces, step_surface

WIDE = Grid(west_m=-20.0, south_m=-100.0, spacing_m=0.5, columns=400, rows=400)
MAP = Grid(west_m=50.0, south_m=-14.0, spacing_m=1.0, columns=41, rows=29)
BOX = (62.0, 78.0, -8.0, 8.0, 6.0)


def levels_of(cost: np.ndarray) -> np.ndarray:
    return choose_levels(path_costs(cost))


def on_box(x, y):
    west, east, south, north, _ = BOX
    return (x > west) & (x < east) & (y > south) & (y < north)


def box_over(grid: Grid) -> Heightfield:
    x, y = np.meshgrid(grid.x_m, grid.y_m)
    return Heightfield(grid=grid, height_m=np.where(on_box(x, y), BOX[4], 0.0))


def flat(grid: Grid) -> Heightfield:
    return Heightfield(grid=grid, height_m=np.zeros(grid.shape))


@pytest.fixture(scope="module")
def level():
    return make_sightings(flat(WIDE))


def located(sightings) -> Points:
    """Place the mean ranges of all echoes on the axis."""
    pose, range_m = sightings.pose, mean_ranges(sightings).range_m
    position = pose.position_m + range_m[:, None] * pose.boresight
    return seen_points(position, pose.position_m, range_m=range_m, range_sigma_m=np.full(len(range_m), 0.2))


def cost_of_row(cost, levels) -> float:
    step = np.abs(np.diff(levels))
    return (
        cost[np.arange(len(levels)), levels].sum()
        + STEPPED.jump_nepers / 3 * (step == 1).sum()
        + STEPPED.jump_nepers * (step > 1).sum()
    )


def test_levels_of_a_row_are_those_of_a_plain_search():
    rng = np.random.default_rng(3)
    for _ in range(20):
        cost = rng.uniform(0, 12, (5, 4))
        # The other six directions see single cells, which weigh a row of heights as much as it weighs itself.
        chosen = levels_of(cost[None].astype(np.float32))[0]
        ends = [
            min(cost_of_row(cost, np.array(row)) for row in product(range(4), repeat=5) if row[2] == level)
            for level in range(4)
        ]
        total = np.array(ends) + 7 * cost[2]
        assert chosen[2] == np.flatnonzero(total <= total.min() + 8 * STEPPED.tie_nepers).max()


def test_a_step_stays_and_noise_goes():
    rng = np.random.default_rng(1)
    truth = np.where(np.arange(30) < 15, 3, 12) * np.ones((20, 1), dtype=int)
    level = np.arange(18)
    cost = np.minimum(1.5 * np.abs(level - truth[..., None]), 6.0) + rng.uniform(0, 2, (20, 30, 18))
    deaf = rng.random((20, 30)) < 0.3
    cost[deaf] = 0.0
    chosen = levels_of(cost.astype(np.float32))
    beside = np.isin(np.arange(30), (14, 15)) & np.ones((20, 1), dtype=bool)
    assert np.abs(chosen - truth)[~beside].max() <= 2
    assert np.mean(chosen[~beside] == truth[~beside]) > 0.6
    assert np.mean(np.abs(chosen - truth)[beside] < 3) > 0.85


def test_of_equal_levels_the_highest_is_chosen():
    cost = np.full((6, 6, 9), 5.0, dtype=np.float32)
    cost[..., 2:5] = 0.0
    assert np.all(levels_of(cost) == 4)


def test_air_speaks_against_itself_and_ground_for_itself(level):
    """Over level ground nothing comes from above it, and the echoes are what its patches bring."""
    sightings = level
    level_m = np.arange(-4.0, 10.0, 0.5)
    against = evidence_against(sightings, MAP, np.zeros(MAP.shape), level_m)
    ground = against[..., np.argmin(np.abs(level_m))]
    air = against[..., level_m > 4.0]
    assert np.mean(ground < 0) > 0.9
    assert np.mean(air > 3) > 0.9
    assert np.median(air) > 10


def test_evidence_of_empty_air_is_the_likelihood_ratio(level):
    """Far above the ground all cells hold the noise n, where the weakest patch would bring m."""
    sightings = level
    spot = Grid(west_m=50.0, south_m=0.0, spacing_m=1.0, columns=2, rows=2)
    against = evidence_against(sightings, spot, np.zeros(spot.shape), np.array([12.0]))[0, 0, 0]
    profiles = sightings.profiles
    whole = []
    for pulse in range(len(sightings)):
        above = np.maximum(profiles.values(pulse) - 30 * profiles.noise[pulse], 0.0)
        whole.append(above @ above / above.sum() / 2)
    weakest = np.percentile(whole, 5)
    expected = 0.0
    away = np.array([50.0, 0.0, 12.0]) - sightings.pose.position_m
    range_m = np.linalg.norm(away, axis=1)
    for pulse in range(len(sightings)):
        local = sightings.pose.R_world_antenna[pulse].T @ away[pulse] / range_m[pulse]
        gain = sightings.beam.two_way(local[None])[0]
        noise = profiles.noise[pulse]
        cell = round(range_m[pulse] / profiles.cell_m)
        power = max(profiles.values(pulse)[cell - 1 : cell + 2].max(), noise)
        ratio = min(power / (noise + weakest * gain), 1.0)
        expected -= np.log(ratio) - ratio + 1
    assert expected > 5
    assert against == pytest.approx(expected, rel=0.02)


def test_evidence_is_that_of_the_plain_formulas(level):
    some = level.rows(np.arange(len(level)) % 5 == 0)
    moving = replace(some.pose, velocity_mps=some.pose.boresight * 9.0)
    window = np.array([0.02, 0.3, 1.0, 0.3, 0.02])
    some = replace(some, pose=moving, response=window, doppler=1.0)
    grid = Grid(west_m=55.0, south_m=-6.0, spacing_m=2.0, columns=12, rows=7)
    base, levels = np.full(grid.shape, -0.3), np.arange(-2.0, 9.0, 0.7)
    expected = evidence(some, grid, base, levels, _reflectivities(some))
    assert (expected < -1).any()
    assert (expected > 1).any()
    np.testing.assert_allclose(evidence_against(some, grid, base, levels), expected, rtol=1e-4, atol=1e-4)


def test_levels_do_not_depend_on_which_way_is_north():
    cost = np.random.default_rng(4).uniform(0, 12, (9, 7, 6)).astype(np.float32)
    chosen = levels_of(cost)
    np.testing.assert_array_equal(levels_of(cost.transpose(1, 0, 2)), chosen.T)
    np.testing.assert_array_equal(levels_of(cost[::-1]), chosen[::-1])


@pytest.fixture(scope="module")
def box():
    """Walls and roof are 18 dB brighter than the ground, and heard well beside the axis."""
    return make_sightings(box_over(WIDE), 2.0, bright=lambda hit_m: np.where(hit_m[:, 2] > 0.5, 60.0, 1.0))


def test_a_box_keeps_its_walls_and_its_levels(box):
    found = step_surface(box, located(box), MAP, 5.0)
    surface, heard = found.surface, found.supported
    x, y = np.meshgrid(MAP.x_m, MAP.y_m)
    west, east, south, north, height = BOX
    roof = (x > west + 2) & (x < east - 2) & (y > south + 2) & (y < north - 2)
    ahead = x < west - 2.5
    assert np.mean(heard[roof]) > 0.98
    assert np.median(np.abs(surface.height_m[roof] - height)) < 0.15
    assert np.mean(heard[ahead]) > 0.98
    assert np.sqrt(np.mean((surface.height_m[ahead & heard] - 0.0) ** 2)) < 0.1
    # The wall that faces the radar stands where it is to a cell, at its ends to a footprint.
    rows = np.abs(MAP.y_m) < 5
    first = np.array([MAP.x_m[np.argmax(row > height / 2)] for row in surface.height_m[rows]])
    assert np.median(np.abs(first - west)) <= 1.0
    assert np.all(np.abs(first - west) <= 3.5)


def test_a_map_in_tiles_is_that_of_all_echoes_but_beside_seams(box):
    """A seam crosses the roof; where there are no echoes nothing is mapped."""
    options = STEPPED.model_copy(update={"tile_m": 21.0})
    wide = replace(MAP, columns=135)
    tiles = SteppedTiles(box, located(box), wide, 5.0, options)
    times = np.zeros(wide.shape, dtype=int)
    for window in tiles.windows:
        times[window] += 1
    assert (times == 1).all()
    assert {(rows.start, columns.start) for rows, columns in tiles.windows} == {
        *product((0, 14), (0, 19, 38, 57, 77, 96, 115))
    }
    pieces = [tiles.piece(number) for number in range(len(tiles))]
    for piece in pieces[:3]:
        again = tiles.unpacked(piece.packed()).layers
        assert all(np.array_equal(layer, again[name]) for name, layer in piece.layers.items())
    found, whole = tiles.mapped(lambda _: pieces), step_surface(box, located(box), wide, 5.0, options)
    assert pieces[-1] is None
    assert not found.supported[:, 115:].any()
    assert found.surface.height_m[:, 115:].max() == min(piece.layers["height_m"].min() for piece in pieces if piece)
    seen = np.s_[:, : MAP.columns]
    both = found.supported[seen] & whole.supported[seen]
    assert both.sum() > 0.94 * whole.supported[seen].sum()
    apart = np.abs(found.surface.height_m - whole.surface.height_m)[seen]
    assert np.mean(apart[both] > 0.1) < 0.05
    assert np.mean(apart[both] > 1.0) < 0.01
    seam = both & on_box(*np.meshgrid(MAP.x_m, MAP.y_m)) & (np.abs(np.arange(MAP.columns) - 18.5) < 2)
    assert seam.sum() > 40
    assert np.mean(apart[seam] < 0.1) > 0.97
    assert apart[seam].max() < 1.0


def test_a_map_of_one_tile_is_made_at_once(box):
    (window,) = SteppedTiles(box, located(box), MAP, 5.0).windows
    assert MAP.cut(*window) == MAP
    found, whole = SteppedTiles(box, located(box), MAP, 5.0).mapped(), step_surface(box, located(box), MAP, 5.0)
    assert all(np.array_equal(layer, whole.layers[name]) for name, layer in found.layers.items())


def test_an_echo_a_step_above_the_coarse_map_is_of_no_part(level):
    """As of a wall beside it: such echoes made the ground of streets rough, and its map wrong by 0.5 m."""
    coarse = CoarseMap(np.zeros(MAP.shape), np.ones(MAP.shape, dtype=bool), np.zeros((0, *MAP.shape)), level_m=0.3)
    echoes = mean_ranges(level)
    near = replace(echoes, range_m=np.where(np.arange(len(level)) % 5 == 2, 0.9, 1.0) * echoes.range_m)
    surfaces = _Surfaces(level, near, located(level), MAP, coarse, 1.2, STEPPED)
    region = surfaces.whole_region(np.zeros(MAP.shape, dtype=int))
    inside = MAP.cell_of(level.places(near.range_m))[2]
    assert region[inside].tolist() == np.where(near.range_m < echoes.range_m, -1, 0)[inside].tolist()
    assert set(region[inside]) == {-1, 0}


def test_nothing_heard_makes_no_map(level):
    sightings = level
    silent = Grid(west_m=500.0, south_m=500.0, spacing_m=1.0, columns=8, rows=8)
    assert step_surface(sightings, located(sightings), silent, 5.0) is None


@pytest.mark.parametrize("half_width", [0.01, 0.3, 0.9])
def test_no_level_in_the_beam_is_left_out(half_width):
    rng = np.random.default_rng(5)
    level, planes, kept = np.arange(-30.0, 30.0, 0.7), np.empty((5, 3)), 0
    for R in Rotation.random(40, rng=rng).as_matrix():
        low, high = -half_width * rng.uniform(-0.5, 1.0, 2), half_width * rng.uniform(0.6, 1.0, 2)
        axes = np.array([low[0], 0.01, low[1], 0.01, *high])
        planes_around(R, axes, planes)
        for east, north in rng.uniform(-60.0, 60.0, (60, 2)):
            away = np.column_stack([np.full_like(level, east), np.full_like(level, north), level + 3.0])
            ahead, u, v = ((away / np.linalg.norm(away, axis=1)[:, None]) @ R).T
            seen = (ahead > 0) & (u >= low[0]) & (u <= high[0]) & (v >= low[1]) & (v <= high[1])
            first, last = levels_between(planes, east, north, 3.0, level)
            assert not seen[:first].any()
            assert not seen[last:].any()
            # The place in a row of columns 0.5 m apart.
            column = rng.integers(0, 40)
            span, west = (level[0] + 3.0, level[-1] + 3.0), east - 0.5 * column
            begin, end = columns_between(planes, north, span, west, 0.5, (0, 40))
            assert begin <= column < end or not seen.any()
            kept += max(last - first, 0)
    assert kept < (40 * 60 * len(level) if half_width > 0.7 else 0.4 * 40 * 60 * len(level))
