import logging
import math
from pathlib import Path

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio import Affine

from sionna_radar.elevation import cutout
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario.terrain import RasterTerrain
from worlds import load_ground

UTM = "EPSG:32632"
WEST, NORTH = 450_000.0, 5_000_100.0
EVERYWHERE = (-1e5, -1e5, 1e5, 1e5)


def from_origin(west, north, dx, dy):
    return Affine(dx, 0.0, west, 0.0, -dy, north)


def plane(x, y):
    """A height every bilinear look-up reproduces exactly, in whatever coordinates it is a plane."""
    return 300.0 + 0.05 * (x - WEST) - 0.03 * (y - NORTH)


def cell_centres(transform, rows, columns):
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    a, b, c, d, e, f = tuple(transform)[:6]
    return a * column + b * row + c, d * column + e * row + f


def write(path, height, transform, crs=UTM, **profile):
    rows, columns = height.shape
    profile = {"driver": "GTiff", "dtype": height.dtype, "count": 1, **profile}
    scales, units = profile.pop("scale_offset", None), profile.pop("units", None)
    with rasterio.open(path, "w", height=rows, width=columns, transform=transform, crs=crs, **profile) as file:
        for band in range(1, profile["count"] + 1):
            file.write(height if band == 1 else np.zeros_like(height), band)
        if scales:
            file.scales, file.offsets = [scales[0]], [scales[1]]
        if units:
            file.units = [units]
    return path


def write_plane(path, *, transform=None, rows=100, columns=120, crs=UTM, surface=plane, **profile):
    transform = transform or from_origin(WEST, NORTH, 1.0, 1.0)
    height = surface(*cell_centres(transform, rows, columns))
    return write(path, np.asarray(height, np.float64), transform, crs=crs, **profile)


def load(path, window=EVERYWHERE, **fields):
    return load_ground(RasterTerrain(kind="raster", path=path, **fields), window)


def absolute(raster, georeference):
    """Coordinates and heights of all filled cells in the CRS of the georeference."""
    x, y = raster.grid.centres_m.T
    z = raster.height_m.ravel()
    keep = np.isfinite(z)
    origin = georeference.origin_m
    return x[keep] + origin[0], y[keep] + origin[1], z[keep] + origin[2]


def in_crs(georeference, crs, x, y):
    return Transformer.from_crs(CRS(georeference.crs_wkt), CRS(crs), always_xy=True).transform(x, y)


# ------------------------------------------------------------------------------- kept projection


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
    path = write(tmp_path / "a.tif", noise, from_origin(WEST, NORTH, 1.0, 1.0))
    raster, _ = load(path, spacing_m=10.0)
    # The mean of 100 cells; and a look-up between two such means lowers it further.
    assert raster.height_m.std() < 0.11


def test_cells_do_not_depend_on_the_window(tmp_path):
    noise = np.random.default_rng(3).standard_normal((200, 200)) + 100
    path = write(tmp_path / "a.tif", noise, from_origin(WEST, NORTH, 1.0, 1.0))
    whole, place = load(path, spacing_m=4.0)
    part, part_place = load(path, (-31.0, -20.0, 17.0, 45.0), spacing_m=4.0)
    points = np.random.default_rng(4).uniform(-15, 15, (50, 2))
    np.testing.assert_allclose(
        whole.at(points) + place.origin_m[2], part.at(points) + part_place.origin_m[2], atol=1e-9
    )


def test_too_many_cells_are_coarsened_with_a_message(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(cutout, "MAX_CELLS", 1000)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster, place = load(write_plane(tmp_path / "a.tif"))
    assert raster.height_m.size <= 1000
    assert raster.grid.spacing_m < 4
    assert "coarsened" in caplog.text
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, plane(x, y), atol=1e-9)


# --------------------------------------------------------------------------- other projections


def test_geographic_degrees_go_to_utm(tmp_path):
    def tilted(lon, lat):
        return 500 + 2000 * (lon - 7) + 1000 * (lat - 45)

    transform = from_origin(6.99, 45.01, 1 / 3600, 1 / 3600)
    path = write_plane(tmp_path / "a.tif", transform=transform, rows=80, columns=90, crs=4326, surface=tilted)
    raster, place = load(path)
    assert CRS(place.crs_wkt) == CRS("EPSG:32632")
    # One arc second of longitude at 45 degrees north, the shorter side of the cells.
    assert raster.grid.spacing_m == pytest.approx(math.radians(1 / 3600) * 6_378_137 * math.cos(0.7854), rel=5e-3)
    assert raster.filled.mean() > 0.95
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, tilted(*in_crs(place, 4326, x, y)), atol=1e-6)


def test_longitudes_beyond_180_are_followed(tmp_path):
    def tilted(lon, lat):
        return 500 + 1000 * (lon % 360 - 181) + 1000 * (lat + 17)

    transform = from_origin(180.99, -17.0, 1 / 3600, 1 / 3600)
    path = write_plane(tmp_path / "a.tif", transform=transform, rows=60, columns=60, crs=4326, surface=tilted)
    for fields in ({}, {"centre_lonlat_deg": (-179.0016, -17.0083)}):
        raster, place = load(path, (-300.0, -300.0, 300.0, 300.0), **fields)
        x, y, z = absolute(raster, place)
        np.testing.assert_allclose(z, tilted(*in_crs(place, 4326, x, y)), atol=1e-6)


def test_us_survey_feet_go_to_metres(tmp_path):
    feet = from_origin(990_000.0, 200_000.0, 3.0, 3.0)

    def tilted(x, y):
        return 30 + 0.02 * (x - 990_000) + 0.01 * (y - 200_000)

    path = write_plane(tmp_path / "a.tif", transform=feet, crs="EPSG:2263", surface=tilted, units="m")
    raster, place = load(path)
    assert raster.grid.spacing_m == pytest.approx(3 * 1200 / 3937, rel=1e-3)
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, tilted(*in_crs(place, "EPSG:2263", x, y)), atol=1e-6)


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
    transform = Affine(cos, sin, WEST, sin, -cos, NORTH)
    raster, place = load(write_plane(tmp_path / "a.tif", transform=transform))
    assert raster.grid.spacing_m == pytest.approx(1.0, rel=1e-3)
    x, y, z = absolute(raster, place)
    assert len(z) > 0.95 * 100 * 120
    assert not raster.filled.all()
    np.testing.assert_allclose(z, plane(*in_crs(place, UTM, x, y)), atol=1e-6)


def test_web_mercator_metres_are_not_believed(tmp_path):
    transform = from_origin(780_000.0, 5_620_000.0, 10.0, 10.0)

    def tilted(x, y):
        return 100 + 0.1 * (x - 780_000) + 0.05 * (y - 5_620_000)

    raster, place = load(write_plane(tmp_path / "a.tif", transform=transform, crs="EPSG:3857", surface=tilted))
    assert CRS(place.crs_wkt) == CRS(UTM)
    assert raster.grid.spacing_m == pytest.approx(10 * math.cos(math.radians(45)), rel=0.01)
    x, y, z = absolute(raster, place)
    np.testing.assert_allclose(z, tilted(*in_crs(place, 3857, x, y)), atol=1e-6)


@pytest.mark.parametrize(("crs", "x", "y"), [("EPSG:3031", 900_000.0, 100_000.0), ("EPSG:3413", 0.0, -400_000.0)])
def test_polar_maps_are_turned_north_up(tmp_path, crs, x, y):
    transform = from_origin(x, y, 5.0, 5.0)

    def tilted(east, north):
        return 100 + 0.1 * (east - x) - 0.05 * (north - y)

    raster, place = load(write_plane(tmp_path / "a.tif", transform=transform, crs=crs, surface=tilted))
    east, north, z = absolute(raster, place)
    np.testing.assert_allclose(z, tilted(*in_crs(place, crs, east, north)), atol=1e-6)
    _, lats = in_crs(place, 4326, place.origin_m[0] + np.array([0, 0]), place.origin_m[1] + np.array([0, 50]))
    assert lats[1] - lats[0] == pytest.approx(50 / 111_650, rel=5e-3)


# ------------------------------------------------------------------------------------ formats


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
    with pytest.raises(ScenarioError, match=r"terrain\.crs: .* has no place"):
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
    path = write(
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


# ------------------------------------------------------------------------------------- no data


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
    path = write(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0), nodata=declared)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster, _ = load(path)
    np.testing.assert_array_equal(raster.filled, ~np.flipud(hole))
    assert (raster.height_m[raster.filled] == 0).all()
    assert ("nodata" in caplog.text) == (declared is None and not np.isnan(float(empty)))


def test_holes_never_bleed_into_heights(tmp_path):
    height = np.full((60, 60), 100.0)
    height[20:30, 20:30] = -9999
    path = write(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0))
    for spacing in (0.7, 1.5, 3.0):
        raster, place = load(path, spacing_m=spacing)
        np.testing.assert_allclose(raster.height_m[raster.filled] + place.origin_m[2], 100, atol=1e-9)
        assert np.isnan(raster.at(np.array([[-5.0, 5.0]])))


def test_empty_borders_are_cut_off(tmp_path):
    height = np.full((30, 30), -9999.0)
    height[10:15, 5:25] = 40
    path = write(tmp_path / "a.tif", height, from_origin(WEST, NORTH, 1.0, 1.0), nodata=-9999.0)
    raster, _ = load(path)
    assert raster.grid.shape == (5, 20)
    assert (raster.grid.x_m[0], raster.grid.y_m[0]) == (-9.5, 0.5)


# -------------------------------------------------------------------------------------- errors


def refusal(path, window=EVERYWHERE, **fields):
    with pytest.raises((InputFileError, ScenarioError)) as caught:
        load(path, window, **fields)
    return caught.value


def test_files_that_are_not_there(tmp_path):
    assert "does not exist" in str(refusal(tmp_path / "missing.tif"))
    assert "is a directory" in str(refusal(tmp_path))


@pytest.mark.parametrize("content", [b"", b"hello", b"II*\x00\x08\x00\x00\x00" + bytes(100)])
def test_files_that_are_no_raster(tmp_path, content):
    path = tmp_path / "a.tif"
    path.write_bytes(content)
    error = refusal(path)
    assert isinstance(error, InputFileError)
    assert f"terrain.path = {path} cannot be read" in str(error)


def test_a_file_cut_short(tmp_path, capfd):
    path = write(tmp_path / "a.tif", np.random.default_rng(1).random((300, 300)), from_origin(WEST, NORTH, 1, 1))
    path.write_bytes(path.read_bytes()[:5000])
    error = refusal(path)
    assert isinstance(error, InputFileError)
    assert "cannot be read" in str(error)
    assert capfd.readouterr() == ("", "")


def test_an_hgt_of_the_wrong_size(tmp_path):
    path = tmp_path / "N45E006.hgt"
    path.write_bytes(bytes(1000))
    assert "cannot be read" in str(refusal(path))


def test_rasters_that_are_no_terrain(tmp_path):
    here = from_origin(WEST, NORTH, 1.0, 1.0)
    complex_values = write(tmp_path / "a.tif", np.zeros((9, 9), np.complex64), here)
    assert "complex64 values, not heights" in str(refusal(complex_values))
    row = write(tmp_path / "b.tif", np.zeros((1, 9)), here)
    assert "1 x 9 cells" in str(refusal(row))
    empty = write(tmp_path / "c.tif", np.full((9, 9), np.nan), here)
    assert "no 2 x 2 cells" in str(refusal(empty))
    apart = write(tmp_path / "d.tif", np.where(np.eye(9) > 0, 1.0, np.nan), here)
    assert "no 2 x 2 cells" in str(refusal(apart))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_raster_without_a_place(tmp_path):
    path = write(tmp_path / "a.tif", np.zeros((9, 9)), None, crs=None)
    assert "does not say where on the Earth" in str(refusal(path, crs=UTM))


def test_a_crs_that_is_no_map(tmp_path):
    path = write_plane(tmp_path / "a.tif")
    assert "neither projected nor geographic" in str(refusal(path, crs="EPSG:4978"))


def test_windows_outside(tmp_path):
    path = write_plane(tmp_path / "a.tif")
    error = refusal(path, (500.0, 0.0, 900.0, 100.0))
    assert isinstance(error, ScenarioError)
    assert error.problems[0].field == "terrain"
    assert "sees x = 500 to 900 m" in str(error)
    for centre in ((8.4, 45.3), (45.3, 8.4), (0.0, -89.0), (-172.0, -45.0)):
        error = refusal(path, (-100.0, -100.0, 100.0, 100.0), centre_lonlat_deg=centre)
        assert error.problems[0].field == "terrain.centre_lonlat_deg"
    assert "longitude and latitude" in str(refusal(path, centre_lonlat_deg=(8.0, 95.0)))


def test_geographic_windows_outside(tmp_path):
    transform = from_origin(6.99, 45.01, 1 / 3600, 1 / 3600)
    path = write(tmp_path / "a.tif", np.zeros((50, 50)), transform, crs=4326)
    for centre in ((8.4, 45.3), (6.995, 47.0), (-173.0, -45.0), (0.0, 90.0), (6.9, 45.0)):
        error = refusal(path, (-100.0, -100.0, 100.0, 100.0), centre_lonlat_deg=centre)
        assert error.problems[0].field == "terrain.centre_lonlat_deg"


@pytest.mark.parametrize("cell", ["1e-9", "1e-300", "1e12"])
def test_absurd_cell_sizes(tmp_path, cell):
    path = tmp_path / "a.asc"
    path.write_text(f"ncols 2\nnrows 2\nxllcorner 450000\nyllcorner 5000000\ncellsize {cell}\n1 2\n3 4\n")
    said = str(refusal(path, (-10.0, -10.0, 10.0, 10.0), crs=UTM, spacing_m=1.0))
    assert "a.asc" in said or "terrain." in said


def test_a_spacing_coarser_than_the_terrain(tmp_path):
    error = refusal(write_plane(tmp_path / "a.tif"), spacing_m=500.0)
    assert error.problems[0].field == "terrain.spacing_m"


def test_a_huge_file_is_read_by_its_window_alone(tmp_path):
    path = Path(tmp_path / "a.tif")
    with rasterio.open(
        path, "w", driver="GTiff", width=60_000, height=60_000, count=1, dtype="float32", crs=UTM,
        transform=from_origin(WEST, NORTH, 1.0, 1.0), tiled=True, sparse_ok=True, nodata=-1.0,
    ) as file:  # fmt: skip
        file.write(np.full((200, 200), 7.0, np.float32), 1, window=((30_000, 30_200), (30_000, 30_200)))
    raster, place = load(path, (10.0, -100.0, 90.0, -20.0))
    assert raster.filled.all()
    assert raster.grid.shape[0] < 90
    assert place.origin_m[2] == 7
