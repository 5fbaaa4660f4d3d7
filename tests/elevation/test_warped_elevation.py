"""Files in degrees, feet, turned or with distorted metres: heights come out in true metres."""

import logging
import math

import numpy as np
import pytest
from pyproj import CRS
from rasterio import Affine

from elevation_files import NORTH, UTM, WEST, absolute, from_origin, in_crs, load, plane, write_plane


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
