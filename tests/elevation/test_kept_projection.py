"""Files in a projection of metres: cells stay where they are, or are averaged to a coarser spacing."""

import logging
import math

import numpy as np
import pytest
from pyproj import CRS, Transformer
from rasterio import Affine

from elevation_files import NORTH, UTM, WEST, absolute, from_origin, load, plane, write_heights, write_plane
from sionna_radar.elevation import elevation_file


def test_a_utm_file_keeps_its_cells(tmp_path):
    raster, place = load(write_plane(tmp_path / "a.tif"))
    assert CRS(place.crs_wkt) == CRS(UTM)
    assert place.origin_m[:2] == (WEST + 60, NORTH - 50)
    assert raster.grid.shape == (100, 120)
    assert raster.grid.spacing_m == 1.0
    assert (raster.grid.west_m, raster.grid.south_m) == (-59.5, -49.5)
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


def test_local_heights_start_near_zero_and_add_up_to_the_file(tmp_path):
    raster, place = load(write_plane(tmp_path / "a.tif"))
    assert place.origin_m[2] == math.floor(300.0 + 0.05 * 0.5 + 0.03 * 0.5)
    assert 0 <= raster.height_m.min() < 1


def test_only_the_window_is_read_and_it_is_covered(tmp_path):
    path = write_plane(tmp_path / "a.tif")
    raster, place = load(path, (-10.2, 5.1, 3.3, 20.0))
    west, east = raster.grid.x_m[[0, -1]]
    south, north = raster.grid.y_m[[0, -1]]
    assert -12.5 <= west <= -10.2
    assert 3.3 <= east <= 5.5
    assert 3.0 <= south <= 5.1
    assert 20.0 <= north <= 22.0
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


def test_a_window_over_the_edge_is_clipped(tmp_path):
    raster, _ = load(write_plane(tmp_path / "a.tif"), (50.0, 40.0, 500.0, 500.0))
    assert raster.grid.x_m[-1] == 59.5
    assert raster.grid.y_m[-1] == 49.5
    assert raster.filled.all()


def test_the_centre_is_the_given_place(tmp_path):
    target = (WEST + 30.25, NORTH - 80.5)
    lonlat = Transformer.from_crs(UTM, 4326, always_xy=True).transform(*target)
    raster, place = load(write_plane(tmp_path / "a.tif"), (-10.0, -10.0, 10.0, 10.0), centre_lonlat_deg=lonlat)
    np.testing.assert_allclose(place.origin_m[:2], target, atol=1e-6)
    here = raster.at(np.zeros((1, 2)))[0] + place.origin_m[2]
    assert here == pytest.approx(plane(*target), abs=1e-6)


def test_rows_that_run_north_in_the_file_end_the_same(tmp_path):
    flipped = Affine(1, 0, WEST, 0, 1, NORTH - 100)
    raster, place = load(write_plane(tmp_path / "a.tif", transform=flipped))
    expected, expected_place = load(write_plane(tmp_path / "b.tif"))
    assert raster.grid == expected.grid
    assert place == expected_place
    np.testing.assert_allclose(raster.height_m, expected.height_m, atol=1e-9)


def test_cells_that_are_not_square_become_square_at_the_finer_spacing(tmp_path):
    oblong = from_origin(WEST, NORTH, 2.0, 1.0)
    raster, place = load(write_plane(tmp_path / "a.tif", transform=oblong, columns=60))
    assert raster.grid.spacing_m == 1.0
    assert raster.grid.shape == (100, 119)
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


@pytest.mark.parametrize("spacing", [0.3, 1.0, 2.0, 3.7, 8.0])
def test_any_spacing_keeps_a_plane(tmp_path, spacing):
    raster, place = load(write_plane(tmp_path / "a.tif"), spacing_m=spacing)
    assert raster.grid.spacing_m == spacing
    assert raster.filled.all()
    assert raster.grid.columns * spacing > 119 - 3 * spacing
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


def test_a_coarser_spacing_averages_the_cells_between(tmp_path):
    noise = np.random.default_rng(3).standard_normal((200, 200)) + 100
    path = write_heights(tmp_path / "a.tif", noise, from_origin(WEST, NORTH, 1.0, 1.0))
    raster, _ = load(path, spacing_m=10.0)
    # The mean of 100 cells; and a look-up between two such means lowers it further.
    assert raster.height_m.std() < 0.11


def test_cells_do_not_depend_on_the_window(tmp_path):
    noise = np.random.default_rng(3).standard_normal((200, 200)) + 100
    path = write_heights(tmp_path / "a.tif", noise, from_origin(WEST, NORTH, 1.0, 1.0))
    whole, place = load(path, spacing_m=4.0)
    part, part_place = load(path, (-31.0, -20.0, 17.0, 45.0), spacing_m=4.0)
    points = np.random.default_rng(4).uniform(-15, 15, (50, 2))
    np.testing.assert_allclose(
        whole.at(points) + place.origin_m[2], part.at(points) + part_place.origin_m[2], atol=1e-9
    )


def test_too_many_cells_are_coarsened_with_a_message(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(elevation_file, "MAX_CELLS", 1000)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster, place = load(write_plane(tmp_path / "a.tif"))
    assert raster.height_m.size <= 1000
    assert raster.grid.spacing_m < 4
    assert "coarsened" in caplog.text
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)
