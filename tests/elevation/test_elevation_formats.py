"""Elevation files: formats, cells without data, detail below their spacing, and heights in true metres."""

import logging
import math

import numpy as np
import pytest
from pyproj import CRS, Transformer
from rasterio import Affine

from elevation_files import NORTH, UTM, WEST, absolute, from_origin, in_crs, load, plane, write_heights, write_plane
from sionna_radar.elevation.file_heights import between_data, detail_on, treat_holes
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario.terrain import RasterTerrain
from worlds import load_ground


def assert_heights(raster, place, crs, surface):
    """The heights of filled cells are those of a surface in another CRS."""
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, surface(*in_crs(place, crs, x, y)), atol=1e-6)


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


def grid_of(rows: int, columns: int, spacing_m: float = 1.0, west_m: float = 0.0, south_m: float = 0.0) -> Grid:
    return Grid(west_m=west_m, south_m=south_m, spacing_m=spacing_m, columns=columns, rows=rows)


def slope_with(*holes: tuple[slice, slice]) -> Raster:
    grid = grid_of(40, 50)
    height = 0.5 * grid.centres_m[:, 0].reshape(grid.shape)
    for hole in holes:
        height[hole] = np.nan
    return Raster(grid=grid, height_m=height)


def test_what_lies_between_data_is_a_hole():
    lake, corner, bay = (slice(10, 15), slice(20, 26)), (slice(0, 8), slice(0, 8)), (slice(35, 40), slice(30, 33))
    filled = slope_with(lake, corner, bay).filled
    holes = between_data(filled)
    assert holes[lake].all()
    assert holes[bay].all()  # cut by the border, with land on both sides
    assert not holes[corner].any()
    assert holes.sum() == 5 * 6 + 5 * 3


def test_a_filled_hole_continues_what_is_around_it(caplog):
    lake = (slice(10, 15), slice(20, 26))
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster = treat_holes(slope_with(lake), "fill")
    assert "30 cells without data (1.50 %) are filled" in caplog.text
    truth = slope_with()
    np.testing.assert_allclose(raster.height_m[lake], truth.height_m[lake], atol=0.8)
    outside = slope_with(lake).filled
    np.testing.assert_array_equal(raster.height_m[outside], truth.height_m[outside])


def test_holes_are_kept_or_refused_as_asked():
    lake = (slice(10, 15), slice(20, 26))
    assert treat_holes(slope_with(lake), "keep").filled.sum() == 40 * 50 - 30
    with pytest.raises(ScenarioError, match=r"terrain.holes: 'refuse' finds 30 cells .* the first at \(20.0, 10.0\)"):
        treat_holes(slope_with(lake), "refuse")
    assert treat_holes(slope_with(), "refuse").filled.all()


@pytest.mark.parametrize("hurst", [0.3, 0.8])
def test_detail_has_its_spectrum(hurst):
    """RMS as asked, nothing above two posts of wavelength, and k^-(2 H + 2) below."""
    post = 10.0
    detail = detail_on(grid_of(512, 512, 0.5), post, hurst, 0.3, seed=4)
    assert detail.std() == pytest.approx(0.3, rel=0.1)
    power = np.abs(np.fft.fft2(detail * np.outer(np.hanning(512), np.hanning(512)))) ** 2
    wave = np.hypot(np.fft.fftfreq(512, 0.5)[:, None], np.fft.fftfreq(512, 0.5)[None])
    assert power[wave < 0.8 / (2 * post)].sum() < 0.02 * power.sum()
    bands = [(0.12, 0.15), (0.5, 0.6)]
    level = [power[(wave > low) & (wave < high)].mean() for low, high in bands]
    middle = [np.sqrt(low * high) for low, high in bands]
    slope = np.log(level[1] / level[0]) / np.log(middle[1] / middle[0])
    assert slope == pytest.approx(-(2 * hurst + 2), abs=0.35)


def test_detail_depends_on_the_place_alone():
    whole = detail_on(grid_of(300, 400, 0.5, west_m=-40.0, south_m=12.0), 5.0, 0.7, 1.0, seed=2)
    part = detail_on(grid_of(80, 60, 0.5, west_m=-40.0 + 35.0, south_m=12.0 + 20.0), 5.0, 0.7, 1.0, seed=2)
    np.testing.assert_allclose(part, whole[40:120, 70:130], atol=1e-9)
    other = detail_on(grid_of(80, 60, 0.5), 5.0, 0.7, 1.0, seed=3)
    assert abs(np.corrcoef(part.ravel(), other.ravel())[0, 1]) < 0.1


def test_coarse_cells_have_no_detail():
    with pytest.raises(ScenarioError, match=r"terrain.roughen: cells of 4 m .* set terrain.spacing_m = 1.2 or less"):
        detail_on(grid_of(10, 10, 4.0), 5.0, 0.7, 1.0, seed=1)


SECOND = 1 / 3600
# Cells of a file in its CRS (west, north, size), its CRS, and the CRS and the cell size, m, that they become.
PLACES = {
    # One arc second of longitude at 45 degrees north, the shorter side of the cells.
    "degrees": ((6.99, 45.01, SECOND), 4326, "EPSG:32632", math.radians(SECOND) * 6_378_137 * math.cos(0.7854)),
    "US survey feet": ((990_000.0, 200_000.0, 3.0), 2263, None, 3 * 1200 / 3937),
    "Web Mercator": ((780_000.0, 5_620_000.0, 10.0), 3857, UTM, 10 * math.cos(math.radians(45))),
}


@pytest.mark.parametrize("name", PLACES)
def test_horizontal_units_become_metres(name, tmp_path):
    (west, north, size), crs, becomes, spacing_m = PLACES[name]

    def tilted(x, y):
        return 500 + 0.05 * (x - west) / size + 0.03 * (y - north) / size

    path = write_plane(tmp_path / "a.tif", transform=from_origin(west, north, size, size), crs=crs, surface=tilted)
    raster, place = load(path)
    assert becomes is None or CRS(place.crs_wkt) == CRS(becomes)
    assert raster.grid.spacing_m == pytest.approx(spacing_m, rel=0.01)
    assert raster.filled.mean() > 0.9
    assert_heights(raster, place, crs, tilted)


def test_longitudes_beyond_180_are_followed(tmp_path):
    def tilted(lon, lat):
        return 500 + 1000 * (lon % 360 - 181) + 1000 * (lat + 17)

    transform = from_origin(180.99, -17.0, 1 / 3600, 1 / 3600)
    path = write_plane(tmp_path / "a.tif", transform=transform, rows=60, columns=60, crs=4326, surface=tilted)
    for fields in ({}, {"centre_lonlat_deg": (-179.0016, -17.0083)}):
        raster, place = load(path, (-300.0, -300.0, 300.0, 300.0), **fields)
        assert_heights(raster, place, 4326, tilted)


def test_heights_in_feet_of_a_compound_crs_become_metres(tmp_path):
    path = write_plane(tmp_path / "a.tif", crs="EPSG:26911+6360")
    raster, place = load(path)
    # In feet in the file, in metres in the products.
    assert [part.to_epsg() for part in CRS(place.crs_wkt).sub_crs_list] == [26911, 5703]
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y) * 1200 / 3937, atol=1e-9)


def test_heights_in_feet_by_the_band_unit_become_metres(tmp_path):
    raster, place = load(write_plane(tmp_path / "a.tif", units="ft"))
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y) * 0.3048, atol=1e-9)


def test_feet_on_the_map_without_a_height_unit_are_said(tmp_path, caplog):
    transform = from_origin(990_000.0, 200_000.0, 3.0, 3.0)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        load(write_plane(tmp_path / "a.tif", transform=transform, crs="EPSG:2263", surface=lambda x, y: 0 * x))
    assert "taken as metres" in caplog.text


def test_a_rotated_raster_is_turned(tmp_path):
    cos, sin = math.cos(math.radians(30)), math.sin(math.radians(30))
    raster, place = load(write_plane(tmp_path / "a.tif", transform=Affine(cos, sin, WEST, sin, -cos, NORTH)))
    assert raster.grid.spacing_m == pytest.approx(1.0, rel=1e-3)
    x, y, z = absolute(raster, place)
    assert len(z) > 0.95 * 100 * 120
    assert not raster.filled.all()
    np.testing.assert_allclose(z, plane(*in_crs(place, UTM, x, y)), atol=1e-6)


@pytest.mark.parametrize(("crs", "x", "y"), [("EPSG:3031", 900_000.0, 100_000.0), ("EPSG:3413", 0.0, -400_000.0)])
def test_polar_maps_are_turned_north_up(tmp_path, crs, x, y):
    transform = from_origin(x, y, 5.0, 5.0)

    def tilted(east, north):
        return 100 + 0.1 * (east - x) - 0.05 * (north - y)

    raster, place = load(write_plane(tmp_path / "a.tif", transform=transform, crs=crs, surface=tilted))
    assert_heights(raster, place, crs, tilted)
    _, lats = in_crs(place, 4326, place.origin_m[0] + np.array([0, 0]), place.origin_m[1] + np.array([0, 50]))
    assert lats[1] - lats[0] == pytest.approx(50 / 111_650, rel=5e-3)
