"""Grids and rasters."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from pyproj import CRS

from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.raster import Georeference, Grid, Raster

GRID = Grid(west_m=10.0, south_m=-4.0, spacing_m=2.0, columns=3, rows=2)


def test_cell_centres_run_from_south_west_row_by_row():
    assert GRID.shape == (2, 3)
    np.testing.assert_array_equal(GRID.x_m, [10, 12, 14])
    np.testing.assert_array_equal(GRID.y_m, [-4, -2])
    np.testing.assert_array_equal(GRID.centres_m, [[10, -4], [12, -4], [14, -4], [10, -2], [12, -2], [14, -2]])
    assert GRID.extent_m == (9.0, 15.0, -5.0, -1.0)


@given(st.floats(-500, 500), st.floats(-500, 500), st.floats(0, 300), st.floats(0, 300), st.floats(0.1, 20))
def test_a_covering_grid_covers_on_whole_multiples(west, south, width, height, spacing):
    grid = Grid.covering(west, south, west + width, south + height, spacing)
    slack = 1e-9 * (1000 + spacing)
    assert grid.x_m[0] <= west + slack
    assert grid.x_m[-1] >= west + width - slack
    assert grid.y_m[0] <= south + slack
    assert grid.y_m[-1] >= south + height - slack
    assert grid.x_m[-1] - west - width < spacing + slack
    assert west - grid.x_m[0] < spacing + slack
    assert grid.west_m / spacing == pytest.approx(round(grid.west_m / spacing), abs=1e-6)


def test_heights_between_cells_are_bilinear():
    raster = Raster(grid=GRID, height_m=np.array([[0.0, 2.0, 4.0], [10.0, 12.0, 14.0]]))
    place = np.array([[10.0, -4.0], [11.0, -4.0], [10.0, -3.0], [13.5, -2.5], [14.0, -2.0]])
    np.testing.assert_allclose(raster.at(place), [0.0, 1.0, 5.0, 11.0, 14.0], atol=1e-12)


def test_outside_and_beside_empty_cells_there_is_no_height():
    raster = Raster(grid=GRID, height_m=np.array([[0.0, 2.0, np.nan], [10.0, 12.0, 14.0]]))
    assert np.isnan(raster.at(np.array([[9.0, -4.0], [15.0, -3.0], [13.0, -3.0], [12.0, 0.0]]))).all()
    np.testing.assert_array_equal(raster.filled, [[True, True, False], [True, True, True]])


def test_an_array_is_a_raster_about_the_origin_or_where_it_is_said_to_be():
    height_m = np.array([[1, 2, 3], [4, 5, 6]])
    about = Raster.from_array(height_m, 2.0)
    assert about.grid == Grid(west_m=-2.0, south_m=-1.0, spacing_m=2.0, columns=3, rows=2)
    assert about.at(np.array([[0.0, 0.0]]))[0] == pytest.approx(3.5)
    assert Raster.from_array(height_m, 2.0, west_m=10.0, south_m=-4.0).grid == GRID


@pytest.mark.parametrize("height_m", [np.zeros((0, 3)), np.array([["a"]]), np.array([[1j]])])
def test_what_is_no_table_of_heights_is_refused(height_m):
    with pytest.raises(ValueError, match=r"height_m = .*; give a table of heights"):
        Raster.from_array(height_m, 1.0)


@pytest.mark.parametrize("spacing_m", [0.0, -1.0, float("nan"), float("inf")])
def test_a_spacing_that_is_none_is_refused(spacing_m):
    with pytest.raises(ValueError, match=r"spacing_m = .*; give the distance"):
        Raster.from_array(np.zeros((2, 2)), spacing_m)


@pytest.mark.parametrize("georeference", [None, Georeference(crs_wkt="EPSG:32632", origin_m=(5e5, 5e6, 0.0))])
def test_a_written_raster_is_read_where_it_was(georeference, tmp_path):
    height_m = np.array([[0.0, 2.0, np.nan], [10.0, 12.0, 14.0]], dtype=np.float32)
    path = tmp_path / "dem.tif"
    Raster(grid=replace(GRID, georeference=georeference), height_m=height_m).to_geotiff(path)
    east_m, north_m, _ = georeference.origin_m if georeference else (0.0, 0.0, 0.0)
    copy = Raster.read(path)
    assert (copy.grid.west_m, copy.grid.south_m) == (GRID.west_m + east_m, GRID.south_m + north_m)
    assert (copy.grid.shape, copy.grid.spacing_m) == (GRID.shape, GRID.spacing_m)
    np.testing.assert_array_equal(copy.height_m, height_m)


@pytest.mark.parametrize(("crs", "unit"), [("EPSG:4326", "degree"), ("EPSG:2263", "US survey foot")])
def test_a_raster_that_does_not_count_in_metres_is_refused(crs, unit, tmp_path):
    place = Georeference(crs_wkt=crs, origin_m=(0.0, 0.0, 0.0))
    far = Raster(grid=replace(GRID, georeference=place), height_m=np.zeros(GRID.shape))
    far.to_geotiff(tmp_path / "far.tif")
    with pytest.raises(InputFileError, match=rf"counts in {unit}, not in metres; convert it"):
        Raster.read(tmp_path / "far.tif")


UTM = Georeference(crs_wkt=CRS.from_epsg(32614).to_wkt(), origin_m=(600_000.0, 4_000_000.0, 250.0))


@pytest.mark.parametrize("place", [None, UTM])
def test_a_raster_becomes_an_array_and_a_file_with_the_same_coordinates(place, tmp_path):
    grid = Grid(west_m=-10.0, south_m=20.0, spacing_m=2.0, columns=3, rows=2, georeference=place)
    raster = Raster(grid=grid, height_m=np.array([[1.0, 2.0, np.nan], [4.0, 5.0, 6.0]]))
    array = raster.to_xarray()
    east, north, up = place.origin_m if place else (0.0, 0.0, 0.0)
    assert float(array.sel(x=east - 8.0, y=north + 22.0)) == 5.0 + up
    assert ("spatial_ref" in array.coords) == (place is not None)
    raster.to_geotiff(tmp_path / "dem.tif")
    with rasterio.open(tmp_path / "dem.tif") as file:
        assert next(file.sample([(east - 8.0, north + 22.0)]))[0] == 5.0 + up
        assert (file.crs is None) == (place is None)
    with pytest.raises(OutputError, match=r"dem\.tif exists already; name another file"):
        raster.to_geotiff(tmp_path / "dem.tif")
    error = replace(raster, quantity="height error")
    assert float(error.to_xarray().sel(x=east - 8.0, y=north + 22.0)) == 5.0  # errors have no datum


def test_a_part_of_a_grid_keeps_its_place_and_places_make_no_other_grid():
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=4, rows=4, georeference=UTM)
    assert grid.cut(slice(1, 3), slice(0, 2)).georeference is UTM
    assert grid == replace(grid, georeference=None)


def test_a_plot_has_the_extent_of_the_cells():
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=2.0, columns=3, rows=2)
    axes = Raster(grid=grid, height_m=np.arange(6.0).reshape(2, 3), quantity="height error").plot(Figure().subplots())
    (image,) = axes.images
    assert image.get_extent() == [-1.0, 5.0, -1.0, 3.0]
    assert image.get_clim() == (-5.0, 5.0)
    assert image.origin == "lower"
