"""Files that lie about what they are: each ends in one error that names the key, and nothing is fetched or filled."""

import os
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
import rasterio
from rasterio import Affine

from sionna_radar import calibrate, compare
from sionna_radar.elevation.elevation_file import Cutout, cut, opened_file
from sionna_radar.elevation.local_frame import StatedFrame
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.foundation.input_file import is_file, is_folder, read_text, regular_file, shown
from sionna_radar.scenario import load_scenario
from sionna_radar.scene.ground_cover import ClassRaster, classes_at
from sionna_radar.studies.budget.study import load_grades
from sionna_radar.surfaces.backscatter import TableBackscatter

CUTOUT = Cutout(window_m=(-50.0, -50.0, 50.0, 50.0), frame=StatedFrame(crs="EPSG:32631"))
POINTS = np.array([[0.0, 0.0], [5.0, 5.0]])
ASC = "ncols {0}\nnrows {0}\nxllcorner -50\nyllcorner -50\ncellsize 10\n"


def asc(path: Path, cells: int = 10, claimed: int | None = None) -> Path:
    rows = "\n".join(" ".join("7" for _ in range(cells)) for _ in range(cells))
    path.write_text(ASC.format(claimed or cells) + rows + "\n")
    return path


def vrt_of(source: object) -> str:
    return (
        '<VRTDataset rasterXSize="10" rasterYSize="10"><GeoTransform>-50,10,0,50,0,-10</GeoTransform>'
        f'<VRTRasterBand dataType="Byte" band="1"><SimpleSource><SourceFilename>{source}</SourceFilename>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


def raw_vrt_of(source: object) -> str:
    return (
        '<VRTDataset rasterXSize="4" rasterYSize="4"><GeoTransform>-50,25,0,50,0,-25</GeoTransform>'
        '<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand">'
        f"<SourceFilename>{source}</SourceFilename></VRTRasterBand></VRTDataset>"
    )


WMS = (
    '<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:{port}/x</ServerUrl></Service><DataWindow>'
    "<UpperLeftX>-50</UpperLeftX><UpperLeftY>50</UpperLeftY><LowerRightX>50</LowerRightX><LowerRightY>-50</LowerRightY>"
    "<SizeX>10</SizeX><SizeY>10</SizeY></DataWindow><BandsCount>1</BandsCount></GDAL_WMS>"
)


def as_terrain(path: Path) -> object:
    with opened_file(path) as dataset:
        return cut(dataset, CUTOUT)


def as_cover(path: Path) -> object:
    return classes_at(ClassRaster(path=path, materials={7: "building"}), POINTS, None)


AS_RASTER = {"terrain.path": as_terrain, "terrain.cover_raster.path": as_cover}
AS_TEXT = {"table": TableBackscatter.from_csv, "grades": load_grades, "scenario": load_scenario}
READERS = AS_RASTER | AS_TEXT


@pytest.mark.parametrize("key", AS_RASTER)
def test_a_plain_grid_passes(key, tmp_path):
    assert AS_RASTER[key](asc(tmp_path / "plain.asc")) is not None


@pytest.mark.parametrize("key", AS_RASTER)
@pytest.mark.parametrize("name", ["a.tif", "a.asc", "a.hgt", "a.vrt"])
@pytest.mark.parametrize("text", [vrt_of, raw_vrt_of], ids=["vrt", "raw vrt"])
def test_a_file_that_points_to_another_is_refused_whatever_its_name(key, name, text, tmp_path):
    other = asc(tmp_path / "other.asc")
    path = tmp_path / name
    path.write_text(text(other))
    with pytest.raises(InputFileError, match=f"{key} = .*{name} cannot be read as a raster"):
        AS_RASTER[key](path)


@pytest.fixture
def server():
    """A server that takes connections and says nothing; yields its port and who came."""
    came = []
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(0.2)

        def wait() -> None:
            try:
                connection, peer = listener.accept()
            except OSError:
                return
            came.append(peer)
            connection.close()

        thread = threading.Thread(target=wait)
        thread.start()
        yield listener.getsockname()[1], came
        thread.join()


@pytest.mark.parametrize("key", AS_RASTER)
def test_no_server_is_asked(key, server, tmp_path):
    port, came = server
    wms = tmp_path / "map.tif"
    wms.write_text(WMS.format(port=port))
    for path in (wms, Path(f"/vsicurl/http://127.0.0.1:{port}/a.tif"), Path(f"http://127.0.0.1:{port}/a.tif")):
        with pytest.raises(InputFileError):
            AS_RASTER[key](path)
    assert not came


@pytest.mark.parametrize("key", AS_RASTER)
def test_text_in_place_of_a_path_is_no_raster(key, tmp_path):
    with pytest.raises(InputFileError, match=r"does not exist|too long"):
        AS_RASTER[key](Path(vrt_of(asc(tmp_path / "other.asc"))))


@pytest.mark.parametrize("key", AS_RASTER)
def test_a_small_file_that_claims_many_cells_is_refused_before_it_is_read(key, tmp_path):
    path = asc(tmp_path / "small.asc", cells=100, claimed=1_000_000)
    with pytest.raises(InputFileError, match=r"1,000,000 x 1,000,000 cells, more than|Too large raster dimension"):
        AS_RASTER[key](path)  # newer GDAL says so itself
    asc(path, cells=100, claimed=20_000)
    with pytest.raises(InputFileError, match=r"claims 20,000 x 20,000 cells but has only"):
        AS_RASTER[key](path)


@pytest.mark.parametrize("key", AS_RASTER)
def test_a_file_of_one_block_too_large_to_decode_is_refused(key, tmp_path):
    path = tmp_path / "block.tif"
    size = {"width": 16_384, "height": 16_384, "blockxsize": 16_384, "blockysize": 16_384, "tiled": True}
    with rasterio.open(
        path, "w", driver="GTiff", count=1, dtype="uint8", compress="deflate", sparse_ok=True,
        transform=Affine(10, 0, -50, 0, -10, 50), **size,
    ):  # fmt: skip
        pass
    with pytest.raises(InputFileError, match="stored in blocks of"):
        AS_RASTER[key](path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
@pytest.mark.parametrize("key", READERS)
def test_what_is_no_regular_file_is_refused(key, tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for path in (pipe, Path("/dev/zero"), tmp_path / "socket"):
            with pytest.raises(InputFileError, match="is a device, pipe or socket, not a regular file"):
                READERS[key](path)
    with pytest.raises(InputFileError, match="is a directory, not a regular file"):
        READERS[key](tmp_path)


@pytest.mark.skipif(os.name == "nt", reason="links need rights there")
@pytest.mark.parametrize("key", READERS)
def test_paths_that_lead_nowhere_end_in_one_error(key, tmp_path):
    loop = tmp_path / "loop"
    loop.symlink_to(tmp_path / "pool")
    (tmp_path / "pool").symlink_to(loop)
    for path, said in (
        (loop, "loop of symbolic links"),
        (tmp_path / ("x" * 3000), "too long for a path"),
        (Path("a\0b"), "characters that no path can"),
        (tmp_path / "not here", "does not exist|no such scenario"),
        (tmp_path / "\udcff\udcfe", "does not exist|no such scenario"),
    ):
        with pytest.raises(InputFileError, match=said) as caught:
            READERS[key](path)
        str(caught.value).encode("utf-8")  # can be printed
        assert len(str(caught.value)) < 1500


@pytest.mark.parametrize("letters", [256, 5000])
@pytest.mark.parametrize("read", [calibrate, compare])
def test_results_whose_name_is_too_long_end_in_one_error(read, letters):
    with pytest.raises(InputFileError, match=r"\(\d+ characters\) is too long for a path"):
        read(["x" * letters, "y"])


def test_a_path_that_no_file_system_takes_is_neither_file_nor_folder(tmp_path):
    for path in (Path("x" * 300), Path("a\0b"), tmp_path / "not here"):
        assert not is_file(path)
        assert not is_folder(path)
    assert is_folder(tmp_path)
    assert is_file(asc(tmp_path / "plain.asc"))


@pytest.mark.parametrize("key", ["terrain.path", "terrain.cover_raster.path", "materials.moss.path"])
@pytest.mark.parametrize("path", ["a\0b", "x" * 5000, "\udcff"])
def test_a_scenario_with_such_a_path_is_refused(key, path):
    tables = {
        "terrain.path": {"terrain": {"kind": "raster", "path": path}},
        "terrain.cover_raster.path": {"terrain.cover_raster": {"path": path, "classes": {"1": "building"}}},
        "materials.moss.path": {"materials.moss": {"model": "table", "path": path}},
    }
    with pytest.raises((ScenarioError, InputFileError)) as caught:
        load_scenario("hills", tables[key])
    assert key in str(caught.value)
    str(caught.value).encode("utf-8")


def test_a_file_larger_than_its_bound_is_not_read(tmp_path):
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate(20_000_000)
    with pytest.raises(InputFileError, match="20,000,000 bytes, more than"):
        read_text(path, "table", "give a smaller one")
    assert regular_file(path, "table", "", 30_000_000) == 20_000_000


@pytest.mark.parametrize("cells", ["9" * 200_000 + ",1", '"' + "x" * 200_000])
def test_a_field_of_a_table_that_is_too_long_is_refused(cells, tmp_path):
    path = tmp_path / "table.csv"
    path.write_text(f"incidence_deg,sigma0_db\n{cells}\n20,3\n")
    with pytest.raises(InputFileError, match="line 2"):
        TableBackscatter.from_csv(path)
    path.write_text(f"{cells}\n10,3\n20,3\n")
    with pytest.raises(InputFileError, match="line 1"):
        TableBackscatter.from_csv(path)


SYSTEMS = {
    "engineering": 'ENGCRS["site",EDATUM["site"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]',
    "vertical": "EPSG:5773",
    "lunar": 'GEOGCRS["Moon",DATUM["Moon",ELLIPSOID["Moon",1737400,0,LENGTHUNIT["metre",1]]],PRIMEM["0",0],'
    'CS[ellipsoidal,2],AXIS["latitude",north],AXIS["longitude",east],ANGLEUNIT["degree",0.0174532925199433]]',
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_cover_in_a_system_that_places_nothing_on_the_earth_is_refused(name, tmp_path):
    path = tmp_path / "cover.tif"
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, "width": 8, "height": 8}
    try:
        file = rasterio.open(path, "w", **profile, crs=SYSTEMS[name], transform=Affine(1, 0, -84.4, 0, -1, 36.5))
    except rasterio.errors.CRSError:
        pytest.skip("this GDAL cannot write such a system")
    with file:
        file.write(np.ones((8, 8), dtype=np.uint8), 1)
    from sionna_radar.survey.preparation import prepare

    cover = {"path": str(path), "classes": {"1": "building"}}
    with pytest.raises(RadarError, match="cover"):
        prepare(load_scenario("jacksboro", {"terrain.cover_raster": cover}))


def test_a_value_is_shown_on_one_line_and_short():
    assert shown("a\nb\0c") == r"'a\nb\x00c'"
    assert shown(Path("a\nb")) == r"a\nb"
    assert len(shown("9" * 5000)) < 160


@pytest.mark.parametrize("suffix", [".msk", ".OVR"])
def test_a_mask_beside_a_raster_may_not_point_elsewhere(tmp_path, suffix):
    path = asc(tmp_path / "ground.asc")
    beside = tmp_path / f"ground.asc{suffix}"
    beside.write_text(vrt_of("/etc/hostname"))
    with pytest.raises(InputFileError, match="next to it, which is not a TIFF; remove it"):
        as_terrain(path)
    with rasterio.open(beside, "w", driver="GTiff", width=10, height=10, count=1, dtype="uint8", crs="EPSG:32631",
                       transform=Affine(10, 0, -50, 0, -10, 50)) as mask:  # fmt: skip
        mask.write(np.full((1, 10, 10), 255, dtype=np.uint8))
    as_terrain(path)
