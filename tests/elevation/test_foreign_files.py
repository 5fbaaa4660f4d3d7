"""Rasters that are turned or have several bands, clouds in feet or elsewhere: read as they are meant, or said."""

from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio.enums import ColorInterp
from rasterio.transform import Affine

from sionna_radar.accuracy.reference import read_reference
from sionna_radar.elevation.elevation_file import Cutout, cut, opened_file
from sionna_radar.elevation.local_frame import StatedFrame
from sionna_radar.elevation.point_cloud import open_cloud
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Georeference, Grid
from sionna_radar.scene.terrains.elevation import place_cloud

CELLS = 80
# NAD83(CSRS) in Canada and GDA94 in Australia: neither is of WGS 84.
FRAMES = {"EPSG:2958": (630_000.0, 4_830_000.0), "EPSG:28355": (320_000.0, 5_810_000.0)}


def plane(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 120.0 + 0.03 * x + 0.01 * y


def raster(path: Path, crs: str, turn_deg: float, bands: int = 1, dtype: str = "float64") -> Path:
    east, north = FRAMES[crs]
    cos, sin = 2 * np.cos(np.deg2rad(turn_deg)), 2 * np.sin(np.deg2rad(turn_deg))
    transform = Affine(cos, sin, east, sin, -cos, north)
    column, row = np.meshgrid(np.arange(CELLS) + 0.5, np.arange(CELLS) + 0.5)
    x = transform.a * column + transform.b * row
    y = transform.d * column + transform.e * row
    profile = {"driver": "GTiff", "width": CELLS, "height": CELLS, "count": bands, "dtype": dtype, "crs": crs}
    with rasterio.open(path, "w", **profile, transform=transform) as file:
        for band in range(1, bands + 1):
            file.write((plane(x, y) + 50.0 * (band - 1)).astype(dtype), band)
    return path


@pytest.mark.parametrize("crs", FRAMES)
@pytest.mark.parametrize("turn_deg", [0.0, 12.0, -35.0])
def test_a_turned_raster_keeps_its_own_crs(tmp_path, crs, turn_deg):
    with opened_file(raster(tmp_path / "a.tif", crs, turn_deg)) as file:
        found, place = cut(file, Cutout(window_m=(-25.0, -25.0, 25.0, 25.0), frame=StatedFrame()))
    assert CRS.from_wkt(place.crs_wkt) == CRS(crs)
    x, y = found.grid.centres_m.T + np.array(place.origin_m[:2])[:, None] - np.array(FRAMES[crs])[:, None]
    np.testing.assert_allclose(found.height_m.ravel() + place.origin_m[2], plane(x, y), atol=1e-6)
    # Cells of the file are those of the map only where they are not turned.
    assert (place.cells is None) == (turn_deg != 0)


def test_a_band_is_chosen_or_the_first_is_said(tmp_path, caplog):
    path, window = raster(tmp_path / "a.tif", "EPSG:2958", 0.0, bands=3), (-20.0, -20.0, 20.0, 20.0)
    with rasterio.open(path, "r+") as file:
        file.set_band_description(2, "surface")
    levels = []
    for band in (None, 1, 3):
        caplog.clear()
        with opened_file(path) as file:
            found, place = cut(file, Cutout(window_m=window, frame=StatedFrame(band=band)))
        levels.append(float(np.mean(found.height_m)) + place.origin_m[2])
        said = "band 1 of 3 is read (1 without a name, 2 surface, 3 without a name); set terrain.band" in caplog.text
        assert said == (band is None)
    np.testing.assert_allclose(np.diff(levels), [0.0, 100.0], atol=1e-6)
    with (
        opened_file(path) as file,
        pytest.raises(ScenarioError, match=r"terrain.band: 4 is not in the file, which has 3"),
    ):
        cut(file, Cutout(window_m=window, frame=StatedFrame(band=4)))


def test_opacity_is_no_band_of_heights(tmp_path, caplog):
    path = raster(tmp_path / "a.tif", "EPSG:2958", 0.0, bands=2, dtype="uint16")
    with rasterio.open(path, "r+") as file:
        file.colorinterp = [ColorInterp.gray, ColorInterp.alpha]
    with opened_file(path) as file:
        cut(file, Cutout(window_m=(-20.0, -20.0, 20.0, 20.0), frame=StatedFrame()))
    assert "terrain.band" not in caplog.text


def cloud(path: Path, crs: str, corner: tuple[float, float], size: float = 300.0, height: float = 1000.0) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [*corner, 0.0], [0.001] * 3
    header.add_crs(CRS.from_user_input(crs))
    points = laspy.LasData(header)
    place = np.random.default_rng(5).uniform(0, size, size=(2, 3000))
    points.x, points.y, points.z = corner[0] + place[0], corner[1] + place[1], np.full(3000, height)
    points.return_number[:] = 1
    points.write(path)
    return path


TEXAS = "EPSG:2277", (3_100_000.0, 10_080_000.0)  # State Plane, US survey feet
FOOT_M = 1200 / 3937


@pytest.mark.parametrize(("crs", "stated", "unit_m", "said"), [
    ("EPSG:2277", {}, FOOT_M, True),
    ("EPSG:2277", {"height_unit": "m"}, 1.0, False),
    ("EPSG:2277", {"vertical_crs": "EPSG:5703"}, 1.0, False),
    ("EPSG:2277+5703", {}, 1.0, False),
    ("EPSG:2277+6360", {}, FOOT_M, False),
    ("EPSG:26914", {}, 1.0, False),
])  # fmt: skip
def test_heights_of_a_cloud_have_the_unit_of_its_map_unless_another_is_stated(
    tmp_path, caplog, crs, stated, unit_m, said
):
    corner = TEXAS[1] if "2277" in crs else (620_000.0, 3_350_000.0)
    with open_cloud(cloud(tmp_path / "a.las", crs, corner)) as file:
        placed = place_cloud(file, StatedFrame(**stated))
    assert placed.heights.unit_m == pytest.approx(unit_m, rel=1e-9)
    assert ("they are taken in US survey foot, as its map is; set terrain.height_unit" in caplog.text) == said


def dem_grid(crs: str, origin_m: tuple[float, float, float]) -> Grid:
    place = Georeference(crs_wkt=CRS(crs).to_wkt(), origin_m=origin_m)
    return Grid(west_m=0.0, south_m=0.0, spacing_m=2.0, columns=30, rows=30, georeference=place)


def test_a_reference_cloud_in_feet_is_in_metres(tmp_path, caplog):
    path = cloud(tmp_path / "a.laz", *TEXAS)
    to_utm = Transformer.from_crs(CRS(TEXAS[0]), CRS(32614), always_xy=True)
    east, north = to_utm.transform(TEXAS[1][0] + 50.0, TEXAS[1][1] + 50.0)
    reference = read_reference(path, dem_grid("EPSG:32614", (east, north, 100.0)))
    heights = reference.height_m[np.isfinite(reference.height_m)]
    np.testing.assert_allclose(heights, 1000 * FOOT_M - 100.0, atol=1e-6)
    assert "reference: no unit is stated for the cloud's heights" in caplog.text


@pytest.mark.parametrize("name", ["far.las", "far.tif"])
def test_a_reference_elsewhere_is_refused_with_both_extents(tmp_path, name):
    path = tmp_path / name
    if name == "far.las":
        cloud(path, "EPSG:32632", (500_000.0, 5_400_000.0))
    else:
        profile = {"driver": "GTiff", "width": 150, "height": 150, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
        with rasterio.open(path, "w", **profile, transform=Affine(2, 0, 500_000, 0, -2, 5_400_300)) as file:
            file.write(np.zeros((150, 150), np.float32), 1)
    with pytest.raises(InputFileError) as refused:
        read_reference(path, dem_grid("EPSG:32632", (510_000.0, 5_410_000.0, 0.0)))
    assert "covers x = 500000 to 500300 m, y = 5400000 to 5400300 m" in str(refused.value)
    assert "the DEM x = 509999 to 510059 m, y = 5409999 to 5410059 m" in str(refused.value)
