"""Which cells the main beam lit."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from direct_receiver import points_at
from sionna_radar.accuracy.illumination import light, main_beam_hits
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.coverage import Illumination
from sionna_radar.radar.antenna import LIT, Antenna
from sionna_radar.radar.array_antenna import taylor_cut

GRID = Grid(west_m=-10.0, south_m=-10.0, spacing_m=1.0, columns=21, rows=21)
FLAT = Raster(grid=GRID, height_m=np.zeros(GRID.shape))


def lit(illumination: Illumination, gap_m: float = 0.0, visible: bool = True) -> set[tuple[float, float]]:
    mask = illumination.mask(gap_m, FLAT, lambda origin_m, point_m: np.full(len(point_m), visible))
    row, column = np.nonzero(mask)
    return set(zip(GRID.x_m[column].tolist(), GRID.y_m[row].tolist(), strict=True))


def add(illumination: Illumination, places) -> None:
    hit = np.array([(x, y, 0.0) for x, y in places]).reshape(-1, 3)
    illumination.add(hit, np.broadcast_to([0.0, 0.0, 50.0], hit.shape))


def test_a_hit_lights_its_cell_and_hits_outside_are_dropped():
    seen = Illumination(GRID)
    for places in [(2.4, -3.4), (-10.4, 10.4)], [(11.0, 0), (0, -10.6)], []:
        add(seen, places)
    assert lit(seen) == {(2.0, -3.0), (-10.0, 10.0)}


def test_lines_closer_than_the_gap_are_joined_unless_hidden():
    seen = Illumination(GRID)
    add(seen, [(x, y) for x in range(-10, 11) for y in (-8, -4, 4)])
    assert {y for _, y in lit(seen, gap_m=4.0)} == {-8.0, -7.0, -6.0, -5.0, -4.0, 4.0}
    assert {y for _, y in lit(seen, gap_m=4.0, visible=False)} == {-8.0, -4.0, 4.0}


def test_the_main_beam_ends_at_half_power_and_leaves_targets_out():
    cut = taylor_cut(np.deg2rad(4.0), -20.0)
    down = np.array([[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]])  # boresight straight down
    pose = Pose(position_m=np.array([[0.0, 0.0, 100.0]]), velocity_mps=np.zeros((1, 3)), R_world_antenna=down)
    pulses = Pulses(index=np.array([7]), time_s=np.zeros(1), scan_rad=np.zeros(1), true=pose, measured=pose)
    edge = 100.0 * np.tan(np.deg2rad(2.0))
    hit = np.array([(0, 0.98 * edge, 0), (0, 1.02 * edge, 0), (0.98 * edge, 0, 0), (0, 0, 0)], dtype=float)
    paths = points_at(np.zeros(4), pulse=7, hit_m=hit, surface=np.array([0, 0, 0, -1]))
    found, origin = main_beam_hits(paths, pulses, Antenna(cut, cut))
    np.testing.assert_array_equal(found, hit[[0, 2]])
    np.testing.assert_array_equal(origin, np.broadcast_to(pose.position_m, (2, 3)))


def test_hits_of_many_pulses_are_those_within_their_own_beams():
    rng, antenna = np.random.default_rng(1), Antenna(*2 * (taylor_cut(np.deg2rad(20.0), -20.0),))
    axes = Rotation.random(5, random_state=2).as_matrix()
    position = rng.uniform(-5, 5, (5, 3))
    pose = Pose(position_m=position, velocity_mps=np.zeros((5, 3)), R_world_antenna=axes)
    pulses = Pulses(index=np.arange(3, 8), time_s=np.zeros(5), scan_rad=np.zeros(5), true=pose, measured=pose)
    row = np.sort(rng.integers(0, 4, 2000))  # the last pulse has no path
    toward = np.einsum("nij,nj->ni", axes[row], rng.normal([1.0, 0.0, 0.0], 0.2, (2000, 3)))
    hit = position[row] + 50 * toward
    paths = points_at(np.zeros(2000), pulse=row + 3, hit_m=hit, surface=rng.integers(-1, 2, 2000))
    away = hit - position[row]
    direction = np.einsum("nij,ni->nj", axes[row], away / np.linalg.norm(away, axis=1, keepdims=True))
    lit = (antenna.gain(direction) ** 2 >= LIT * antenna.peak_gain**2) & (paths.surface >= 0)
    assert 0.1 < lit.mean() < 0.9
    found, origin = main_beam_hits(paths, pulses, antenna)
    np.testing.assert_array_equal(found, hit[lit])
    np.testing.assert_array_equal(origin, position[row[lit]])
    grid = Grid(west_m=-60.0, south_m=-60.0, spacing_m=1.0, columns=121, rows=121)
    for kind in (np.float32, np.float64):
        held = replace(paths, hit_m=hit.astype(kind))
        plain, fused = Illumination(grid), Illumination(grid)
        plain.add(*main_beam_hits(held, pulses, antenna))
        light(held, pulses, antenna, (), fused)
        assert plain.columns[1].sum() > 100
        for expected, found in zip((*plain.columns, *plain.taken()), (*fused.columns, *fused.taken()), strict=True):
            np.testing.assert_array_equal(found, expected)
        assert len(plain.taken()[0]) == len(fused.taken()[0]) == 0
