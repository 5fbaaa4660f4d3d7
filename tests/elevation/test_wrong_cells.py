"""Elevation files with single wrong cells, without any data, and with holes where buildings were: each is told."""

import numpy as np
import pytest

from elevation_files import NORTH, WEST, from_origin, write_heights
from sionna_radar import load_scenario, prepare
from sionna_radar.elevation.wrong_cells import lone_cells
from sionna_radar.foundation.errors import InputFileError

NODATA = -32768.0


def ground(seed: int = 3, rows: int = 260, columns: int = 300) -> np.ndarray:
    """Gentle ground of some 200 m, with a little roughness."""
    rng = np.random.default_rng(seed)
    return 200.0 + 5.0 * np.sin(np.arange(columns) / 30.0) + rng.normal(0, 0.2, (rows, columns))


def prepared(path, **keys):
    return prepare(load_scenario("own_dem", {"terrain.path": str(path), "platform.length_m": 30.0, **keys}))


def filed(tmp_path, height, step_m=1.0, crs="EPSG:32632"):
    transform = from_origin(WEST, NORTH, step_m, step_m)
    return write_heights(tmp_path / "ground.tif", height, transform, crs=crs, nodata=NODATA)


@pytest.mark.parametrize(("row", "column", "height_m"), [(3, 7, 3200.0), (0, 0, -400.0), (99, 40, 500.0)])
def test_a_lone_cell_is_found_at_its_place(row, column, height_m):
    height = ground(rows=100, columns=80)
    height[row, column] = height_m
    height[row + 1 if row < 50 else row - 1, column] = np.nan
    np.testing.assert_array_equal(lone_cells(height, 2.0), [[row, column]])


def test_ground_cliffs_walls_and_masts_are_none():
    height = ground(rows=100, columns=80)
    height[:, 40:] += 900.0  # a cliff
    height[20:30, 10:15] += 150.0  # a tower block
    height[70, 10:70] += 200.0  # a dam, one cell wide
    height[60, 20] += 45.0  # a mast
    assert len(lone_cells(height, 1.0)) == 0
    peak = 200.0 + 80.0 * np.exp(-np.hypot(*np.mgrid[-20:21, -20:21]) / 2)
    assert len(lone_cells(peak, 30.0)) == 0
    assert len(lone_cells(np.full((2, 9), 5.0), 1.0)) == 0


def test_a_wrong_cell_is_named_with_place_and_height_and_kept(tmp_path):
    height = ground()
    height[20, 30] = 1850.0
    (only,) = prepared(filed(tmp_path, height)).warnings
    place = f"1850 m at ({WEST + 30.5:.10g}, {NORTH - 20.5:.10g}) (EPSG:32632)"
    assert place in only
    assert "kept as the file says" in only


def test_many_wrong_cells_are_counted_and_a_few_named(tmp_path):
    height = ground()
    height[20:200:20, 30] = -900.0
    (only,) = prepared(filed(tmp_path, height)).warnings
    assert "9 single cells lie far beyond all neighbours" in only
    assert "and 4 more" in only


@pytest.mark.parametrize("value", [NODATA, -9999.0, np.nan])
def test_a_file_without_any_data_says_so(tmp_path, value):
    path = filed(tmp_path, np.full((120, 90), value))
    with pytest.raises(InputFileError, match=r"holds no height: all of its 90 x 120 cells are without data"):
        prepared(path)


def test_beams_into_holes_are_counted(tmp_path):
    height = ground()
    height[110:150, 180:200] = NODATA
    path = filed(tmp_path, height)
    (only,) = prepared(path, **{"terrain.holes": "keep"}).warnings
    share = float(only.split("terrain: ")[1].split(" %")[0])
    assert 1.0 < share < 40.0
    assert "of the beams fall into its holes" in only
    assert not any("into its holes" in warning for warning in prepared(path, **{"terrain.holes": "fill"}).warnings)
