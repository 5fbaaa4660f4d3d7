"""Which cells the main beam lit."""

import numpy as np

from sionna_radar.mapping.coverage import Illumination
from sionna_radar.raster import Grid
from sionna_radar.tracing.paths import Paths

GRID = Grid(west_m=-10.0, south_m=-10.0, spacing_m=1.0, columns=21, rows=21)


def paths_at(hit_m, power, pulse=None, surface=0) -> Paths:
    hit = np.array([(x, y, 0.0) for x, y in hit_m])
    count = len(hit)
    return Paths(
        pulse=np.zeros(count, dtype=int) if pulse is None else np.array(pulse),
        delay_s=np.zeros(count),
        gain=np.sqrt(power).astype(complex),
        range_rate_mps=np.zeros(count),
        incidence_rad=np.zeros(count),
        hit_m=hit,
        surface=np.full(count, surface),
    )


def lit(illumination: Illumination, gap_m: float = 0.0) -> set[tuple[float, float]]:
    row, column = np.nonzero(illumination.mask(gap_m))
    return set(zip(GRID.x_m[column].tolist(), GRID.y_m[row].tolist(), strict=True))


def test_a_path_lights_the_cell_it_hits():
    seen = Illumination(GRID)
    seen.add(paths_at([(2.4, -3.4), (-10.4, 10.4)], [1.0, 0.9]))
    assert lit(seen) == {(2.0, -3.0), (-10.0, 10.0)}


def test_side_lobes_light_nothing():
    seen = Illumination(GRID)
    # A quarter of its own pulse's strongest path is the limit, pulse by pulse.
    seen.add(paths_at([(0, 0), (1, 0), (2, 0), (5, 5), (6, 5)], [1.0, 0.3, 0.2, 1e-6, 1e-7], pulse=[0, 0, 0, 1, 1]))
    assert lit(seen) == {(0.0, 0.0), (1.0, 0.0), (5.0, 5.0)}


def test_blocks_add_up_and_hits_outside_are_dropped():
    seen = Illumination(GRID)
    for place in [(0, 0), (4, 0), (11.0, 0), (0, -10.6)]:
        seen.add(paths_at([place], [1.0]))
    seen.add(Paths(**{name: column[:0] for name, column in vars(paths_at([(0, 0)], [1.0])).items()}))
    assert lit(seen) == {(0.0, 0.0), (4.0, 0.0)}


def test_a_point_target_lights_no_ground():
    seen = Illumination(GRID)
    seen.add(paths_at([(0, 0)], [1.0], surface=-1))
    assert lit(seen) == set()


def test_lines_closer_than_the_gap_are_joined():
    seen = Illumination(GRID)
    line = [(x, y) for x in range(-10, 11) for y in (-8, -4, 4)]
    seen.add(paths_at(line, np.ones(len(line))))
    rows = {y for _, y in lit(seen, gap_m=4.0)}
    assert rows == {-8.0, -7.0, -6.0, -5.0, -4.0, 4.0}
