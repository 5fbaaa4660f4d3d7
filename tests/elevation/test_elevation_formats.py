"""Formats of elevation files: ASCII grids, SRTM tiles, integers with a scale; and cells without data."""

import logging

import numpy as np
import pytest
from pyproj import CRS, Transformer

from elevation_files import NORTH, UTM, WEST, absolute, from_origin, load, plane, write_heights, write_plane
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.terrain import RasterTerrain
from worlds import load_ground


def test_an_ascii_grid_takes_its_crs_from_the_scenario(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(
        "ncols 3\nnrows 3\nxllcorner 450000\nyllcorner 5000000\ncellsize 10\nNODATA_value -99\n7 8 9\n4 5 6\n1 2 -99\n"
    )
    raster, place = load(path, crs=UTM)
    assert place.origin_m == (450_015.0, 5_000_015.0, 1.0)
    np.testing.assert_array_equal(raster.height_m, np.array([[1, 2, np.nan], [4, 5, 6], [7, 8, 9]]) - 1)
    with pytest.raises(ScenarioError, match=r"terrain\.crs: missing.*EPSG"):
        load(path)
    with pytest.raises(ScenarioError, match=r"terrain\.crs: 'EPSG:9' is no"):
        load(path, crs="EPSG:9")
    with pytest.raises(ScenarioError, match=r"terrain\.crs: .* does not contain"):
        load(path, crs="EPSG:4326")


def test_an_srtm_tile_has_its_posts_on_whole_arc_seconds(tmp_path):
    post = np.arange(1201)
    height = (post[None, :] % 50 + 2 * (post[:, None] % 40)).astype(">i2")
    height[600:603, 610] = -32768
    path = tmp_path / "N45E006.hgt"
    path.write_bytes(height.tobytes())
    centre = (6 + 600 / 1200, 46 - 600 / 1200)
    raster, place = load(path, (-1500.0, -1500.0, 1500.0, 1500.0), centre_lonlat_deg=centre)
    # Posts 580...599 either side are in the same sawtooth, so bilinear heights are linear.
    lon = 6 + (600 + np.array([3.0, 5.5, 7.25])) / 1200
    lat = 46 - (600 + np.array([5.0, 8.5, 6.75])) / 1200
    x, y = Transformer.from_crs(4326, CRS(place.crs_wkt), always_xy=True).transform(lon, lat)
    terrain = RasterTerrain(kind="raster", path=path, centre_lonlat_deg=centre, spacing_m=2.0)
    fine, fine_place = load_ground(terrain, (-100.0, -1500.0, 1500.0, 100.0))
    got = fine.at(np.column_stack([x, y]) - place.origin_m[:2]) + fine_place.origin_m[2]
    np.testing.assert_allclose(got, np.array([3, 5.5, 7.25]) + 2 * np.array([5, 8.5, 6.75]), atol=2e-4)
    assert not raster.filled.all()
    assert raster.height_m[raster.filled].min() + place.origin_m[2] >= 0


def test_scale_offset_integers_and_further_bands(tmp_path):
    stored = np.arange(100 * 120, dtype=np.int16).reshape(100, 120)
    path = write_heights(
        tmp_path / "a.tif",
        stored,
        from_origin(WEST, NORTH, 1.0, 1.0),
        count=1,
        scale_offset=(0.1, 50.0),
        compress="deflate",
        tiled=True,
        blockxsize=16,
        blockysize=16,
    )
    raster, place = load(path)
    np.testing.assert_allclose(raster.height_m + place.origin_m[2], np.flipud(stored) * 0.1 + 50, atol=1e-9)
    raster, place = load(write_plane(tmp_path / "b.tif", count=3))
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


@pytest.mark.parametrize(
    ("dtype", "empty", "declared"),
    [
        ("int16", -32768, -32768),
        ("int16", -32768, None),
        ("int16", -9999, None),
        ("float32", np.nan, None),
        ("float32", np.nan, np.nan),
        ("float32", np.float32(3.4e38), None),
        ("float32", -np.inf, None),
        ("float64", -3.0, -3.0),
    ],
)
def test_holes_are_the_cells_without_data(tmp_path, dtype, empty, declared, caplog):
    height = np.full((20, 20), 100, dtype)
    hole = np.zeros((20, 20), bool)
    hole[3:6, 4] = hole[10, 10:14] = True
    height[hole] = empty
    path = write_heights(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0), nodata=declared)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster, _ = load(path)
    np.testing.assert_array_equal(raster.filled, ~np.flipud(hole))
    assert (raster.height_m[raster.filled] == 0).all()
    assert ("nodata" in caplog.text) == (declared is None and not np.isnan(float(empty)))


def test_holes_never_bleed_into_heights(tmp_path):
    height = np.full((60, 60), 100.0)
    height[20:30, 20:30] = -9999
    path = write_heights(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0))
    for spacing in (0.7, 1.5, 3.0):
        raster, place = load(path, spacing_m=spacing)
        np.testing.assert_allclose(raster.height_m[raster.filled] + place.origin_m[2], 100, atol=1e-9)
        assert np.isnan(raster.at(np.array([[-5.0, 5.0]])))


def test_empty_borders_are_cut_off(tmp_path):
    height = np.full((30, 30), -9999.0)
    height[10:15, 5:25] = 40
    path = write_heights(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0), nodata=-9999.0)
    raster, _ = load(path)
    assert raster.grid.shape == (5, 20)
    assert (raster.grid.x_m[0], raster.grid.y_m[0]) == (-9.5, 0.5)
