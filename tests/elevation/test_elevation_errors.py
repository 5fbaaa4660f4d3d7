"""Elevation files that cannot be used, and what is said of them."""

from pathlib import Path

import numpy as np
import pytest
import rasterio

from elevation_files import EVERYWHERE, NORTH, UTM, WEST, from_origin, load, write_heights, write_plane
from sionna_radar.foundation.errors import InputFileError, ScenarioError


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
    path = write_heights(
        tmp_path / "a.tif", np.random.default_rng(1).random((300, 300)), from_origin(WEST, NORTH, 1, 1)
    )
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
    complex_values = write_heights(tmp_path / "a.tif", np.zeros((9, 9), np.complex64), here)
    assert "complex64 values, not heights" in str(refusal(complex_values))
    row = write_heights(tmp_path / "b.tif", np.zeros((1, 9)), here)
    assert "1 x 9 cells" in str(refusal(row))
    empty = write_heights(tmp_path / "c.tif", np.full((9, 9), np.nan), here)
    assert "holds no height: all of its 9 x 9 cells" in str(refusal(empty))
    apart = write_heights(tmp_path / "d.tif", np.where(np.eye(9) > 0, 1.0, np.nan), here)
    assert "no 2 x 2 cells" in str(refusal(apart))


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_raster_without_a_place(tmp_path):
    path = write_heights(tmp_path / "a.tif", np.zeros((9, 9)), None, crs=None)
    assert "is not georeferenced" in str(refusal(path, crs=UTM))


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


def test_a_flight_given_in_eastings_and_northings(tmp_path):
    path = write_plane(tmp_path / "a.tif")
    east, north = WEST + 60.0, NORTH - 50.0
    said = str(refusal(path, (east - 50.0, north - 50.0, east + 50.0, north + 50.0)))
    assert f"set coordinates = '{UTM}'" in said
    assert "coordinates" not in str(refusal(path, (500.0, 0.0, 900.0, 100.0)))


def test_geographic_windows_outside(tmp_path):
    transform = from_origin(6.99, 45.01, 1 / 3600, 1 / 3600)
    path = write_heights(tmp_path / "a.tif", np.zeros((50, 50)), transform, crs=4326)
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
