"""Point clouds, written by laspy: gridded as a plain loop over all points does it, in pieces and on the map."""

import logging

import laspy
import numpy as np
import pytest
from pyproj import CRS

from sionna_radar.elevation import point_cloud
from sionna_radar.elevation.point_cloud import gridded, open_cloud
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Grid
from sionna_radar.scenario.terrain import PointsTerrain
from sionna_radar.scene.terrains.build import map_frame
from worlds import load_ground

WINDOW = (-1000.0, -1000.0, 1000.0, 1000.0)
POINTS = 40_000


def ground(x, y):
    return 100.0 + 0.1 * x + 2.0 * np.sin(y / 10)


@pytest.fixture(scope="module")
def cloud():
    """Points over 200 by 120 m: ground, and canopy 5 m above it in the north as first of two returns."""
    generator = np.random.default_rng(1)
    x, y = generator.uniform(0, 200, POINTS), generator.uniform(0, 120, POINTS)
    z = ground(x, y) + generator.normal(0, 0.05, POINTS)
    tree = (y > 60) & (generator.random(POINTS) < 0.5)
    return x, y, np.where(tree, z + 5, z), tree


def moved(east, north):
    return east - 690_000, north - 5_330_000


def write(path, cloud, *, epsg=32632, east=690_000.0, north=5_330_000.0, unit=1.0, **extra):
    x, y, z, tree = cloud
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [east, north, 0.0], [0.001, 0.001, 0.001]
    if epsg:
        header.add_crs(CRS.from_epsg(epsg))
    las = laspy.LasData(header)
    las.x, las.y, las.z = x + east, y + north, z / unit
    las.classification = np.where(tree, 5, 2)
    las.return_number, las.number_of_returns = np.where(tree, 1, 1 + (y > 60)), np.where(y > 60, 2, 1)
    for name, values in extra.items():
        setattr(las, name, values)
    las.write(path)
    return path


@pytest.fixture(scope="module", params=["las", "laz"])
def file(request, cloud, tmp_path_factory):
    return write(tmp_path_factory.mktemp("clouds") / f"cloud.{request.param}", cloud)


@pytest.mark.parametrize("statistic", ["mean", "max", "percentile"])
def test_cells_are_those_of_a_plain_loop(cloud, file, statistic, monkeypatch):
    monkeypatch.setattr(point_cloud, "POINTS_AT_ONCE", 7_001)  # pieces that share cells
    x, y, z, _ = cloud
    grid = Grid(west_m=5.0, south_m=5.0, spacing_m=10.0, columns=20, rows=12)
    with open_cloud(file) as opened:
        raster = gridded(
            lambda: opened.pieces("all", lambda a, b: (a - 690_000, b - 5_330_000), 1.0), grid, statistic, 0.3
        )
    for row, column in [(0, 0), (3, 7), (11, 19), (6, 2)]:
        own = z[(x // 10 == column) & (y // 10 == row)]
        value = {"mean": own.mean(), "max": own.max(), "percentile": np.quantile(own, 0.3, method="lower")}[statistic]
        assert raster.height_m[row, column] == pytest.approx(value, abs=2e-3 + (statistic == "percentile") * 0.02)


def test_ground_and_first_returns_are_two_surfaces(file):
    table = {"path": file, "spacing_m": 2.0}
    bare, place = load_ground(PointsTerrain(points="ground", **table), WINDOW)
    canopy, _ = load_ground(PointsTerrain(points="first", statistic="max", **table), WINDOW)
    assert CRS.from_wkt(place.crs_wkt).to_epsg() == 32632
    x, y = bare.grid.centres_m.T
    truth = ground(x + 100, y + 60) - place.origin_m[2]
    np.testing.assert_allclose(bare.height_m.ravel(), truth, atol=0.4)
    above = (canopy.height_m - bare.height_m)[bare.grid.y_m > 5]
    assert np.median(above) == pytest.approx(5.0, abs=0.5)
    assert place.origin_m[:2] == pytest.approx((690_100.0, 5_330_060.0), abs=1.0)


def test_a_cloud_in_feet_and_one_in_degrees(cloud, tmp_path):
    """The State Plane of Massachusetts is in US feet; the heights of a compound CRS may be, too."""
    feet = 1200 / 3937
    x, y, z, tree = cloud
    path = write(
        tmp_path / "ft.las", (x / feet, y / feet, z, tree), epsg=2249, east=750_000.0, north=2_950_000.0, unit=feet
    )
    raster, place = load_ground(PointsTerrain(path=path, points="all", height_unit="ftUS", spacing_m=4.0), WINDOW)
    west, east, south, north = raster.grid.extent_m
    assert (east - west, north - south) == pytest.approx((200.0, 120.0), rel=0.06)
    assert CRS.from_wkt(place.crs_wkt).to_epsg() == 32619
    assert raster.height_m[raster.filled].mean() + place.origin_m[2] == pytest.approx(z.mean(), abs=0.1)


def test_a_cloud_without_a_crs_is_local(cloud, tmp_path):
    path = write(tmp_path / "local.las", cloud, epsg=None, east=0.0, north=0.0)
    raster, place = load_ground(PointsTerrain(path=path), WINDOW)
    assert place is None
    assert map_frame(PointsTerrain(path=path)) is None
    assert raster.grid.spacing_m == pytest.approx(np.sqrt(4 * 200 * 120 / POINTS), rel=0.06)
    with pytest.raises(ScenarioError, match="the file has no CRS"):
        map_frame(PointsTerrain(path=path, centre_lonlat_deg=(11.0, 47.0)))


def test_noise_and_withheld_points_do_not_count(cloud, tmp_path):
    x, y, z, tree = cloud
    high, withheld = np.zeros(POINTS, dtype=bool), np.zeros(POINTS, dtype=bool)
    high[::50], withheld[25::50] = True, True
    path = write(
        tmp_path / "noise.laz",
        (x, y, np.where(high | withheld, 900.0, z), tree),
        classification=np.where(high, 7, 1),
        withheld=withheld.astype(np.uint8),
    )
    raster, place = load_ground(PointsTerrain(path=path, statistic="max", spacing_m=4.0), WINDOW)
    assert np.nanmax(raster.height_m) + place.origin_m[2] < 140


@pytest.mark.parametrize("height_m", [62_909.7, -13_000.0])
def test_points_higher_than_any_land_are_left_out_and_said_once(cloud, tmp_path, caplog, height_m):
    x, y, z, tree = cloud
    wrong = np.arange(POINTS) < 40
    kept = write(tmp_path / "kept.las", tuple(column[~wrong] for column in cloud))
    spoilt = write(tmp_path / "spoilt.las", (x, y, np.where(wrong, height_m, z), tree))
    plain, found = (load_ground(PointsTerrain(path=path, points="first"), WINDOW) for path in (kept, spoilt))
    np.testing.assert_array_equal(found[0].height_m, plain[0].height_m)
    said = [record.getMessage() for record in caplog.records if "impossible heights" in record.getMessage()]
    assert len(said) == 1
    assert f"such as {height_m:g} m" in said[0]


def test_gaps_are_filled_and_said(cloud, tmp_path, caplog):
    x, y, z, tree = cloud
    kept = (np.abs(x - 100) > 8) | (np.abs(y - 60) > 8)
    path = write(tmp_path / "gap.las", tuple(c[kept] for c in (x, y, z, tree)))
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        raster, _ = load_ground(PointsTerrain(path=path, spacing_m=2.0), WINDOW)
    assert raster.filled.all()
    assert "are filled from around them" in caplog.text


def test_points_too_far_apart_make_no_surface(cloud, tmp_path):
    few = [100, 2000, 30_000]
    path = write(tmp_path / "few.las", tuple(c[few] for c in cloud))
    with pytest.raises(ScenarioError, match=r"terrain.spacing_m: 1 m leaves no 2 x 2 cells with points"):
        load_ground(PointsTerrain(path=path, points="all", spacing_m=1.0, holes="keep"), WINDOW)


def test_bad_clouds(cloud, file, tmp_path):
    with pytest.raises(ScenarioError, match=r"terrain.crs: 'WGS 84' does not contain the cloud's middle"):
        map_frame(PointsTerrain(path=file, crs="EPSG:4326"))
    unclassified = write(tmp_path / "one.las", cloud, classification=np.ones(POINTS, dtype=np.uint8))
    with pytest.raises(ScenarioError, match=r"terrain.points: no point chosen .* set points = 'first'"):
        load_ground(PointsTerrain(path=unclassified, points="ground"), WINDOW)
    with pytest.raises(ScenarioError, match="but the cloud covers x = -100 to 100 m"):
        load_ground(PointsTerrain(path=file), (500.0, 500.0, 600.0, 600.0))
    whole = file.read_bytes()
    lying = bytearray(whole)
    lying[247:255] = (10**12).to_bytes(8, "little")
    for number, content in enumerate([b"", b"hello", whole[:300], whole[: len(whole) // 2], bytes(lying)]):
        path = tmp_path / f"{number}.{file.suffix}"
        path.write_bytes(content)
        refused = r"terrain.path = .*(cannot be read as a point cloud|claims|damaged)"
        with pytest.raises(InputFileError, match=refused) as caught:
            load_ground(PointsTerrain(path=path), WINDOW)
        assert "Error: " not in str(caught.value)


@pytest.mark.parametrize(("place", "width"), [(100, 4), (96, 4), (235, 8), (243, 4)])
@pytest.mark.parametrize("value", [0x01, 0x7F, 0xFF])
def test_a_header_that_claims_records_without_room_is_refused_at_once(file, tmp_path, place, width, value):
    """The reader makes as many records as a header claims: four thousand million from one byte."""
    content = bytearray(file.read_bytes())
    content[place + width - 1] = value
    if place == 235:
        content[243:247] = (5).to_bytes(4, "little")
    path = tmp_path / f"lying.{file.suffix}"
    path.write_bytes(content)
    with pytest.raises(InputFileError, match=r"terrain.path = .*(cannot be read as a point cloud|claims|damaged)"):
        load_ground(PointsTerrain(path=path), WINDOW)


def test_extended_records_behind_the_points_are_none_of_the_scenes(file, cloud, tmp_path):
    content = bytearray(file.read_bytes())
    content[235:243], content[243:247] = len(content).to_bytes(8, "little"), (2).to_bytes(4, "little")
    path = tmp_path / f"more.{file.suffix}"
    path.write_bytes(bytes(content) + 2 * bytes(60))
    if file.suffix == ".las":
        read, plain = (load_ground(PointsTerrain(path=each), WINDOW)[0] for each in (path, file))
        np.testing.assert_array_equal(read.height_m, plain.height_m)
