"""Point clouds and rasters with bytes changed or ends cut: each is one clear error or finite heights."""

import contextlib
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from elevation_files import from_origin, write_heights
from mutants import mutated
from sionna_radar.elevation.elevation_file import Cutout, cut, opened_file
from sionna_radar.elevation.local_frame import StatedFrame
from sionna_radar.foundation.errors import RadarError
from sionna_radar.foundation.raster import Raster
from sionna_radar.scenario.terrain import PointsTerrain
from worlds import load_ground

WINDOW = (-100.0, -100.0, 100.0, 100.0)
MUTATIONS_EACH = 40


def las(path: Path) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [690_000.0, 5_330_000.0, 0.0], [0.001, 0.001, 0.001]
    header.add_crs(CRS.from_epsg(32632))
    cloud = laspy.LasData(header)
    place = np.random.default_rng(1).uniform(0, 60, size=(2, 400))
    cloud.x, cloud.y, cloud.z = place[0] + 690_000, place[1] + 5_330_000, 0.1 * place[0]
    cloud.return_number[:] = 1
    cloud.write(path)
    return path


def raster(path: Path) -> Path:
    heights = np.random.default_rng(1).normal(50, 3, size=(20, 30)).astype(np.float32)
    corner = from_origin(690_000.0, 5_330_000.0, 5.0, 5.0)
    if path.suffix == ".asc":
        return write_heights(path, heights, corner, None, driver="AAIGrid")
    return write_heights(path, heights, corner, compress="deflate")


def read_points(path: Path) -> Raster:
    return load_ground(PointsTerrain(path=path, spacing_m=5.0), WINDOW)[0]


def read_raster(path: Path) -> Raster:
    with opened_file(path) as dataset:
        return cut(dataset, Cutout(window_m=WINDOW, frame=StatedFrame(crs="EPSG:32632")))[0]


KINDS = {
    "cloud.las": (las, read_points),
    "cloud.laz": (las, read_points),
    "dem.tif": (raster, read_raster),
    "dem.asc": (raster, read_raster),
}


@pytest.mark.parametrize("name", KINDS)
def test_mutations(name, tmp_path):
    write, read = KINDS[name]
    path = write(tmp_path / name)
    assert np.isfinite(read(path).height_m).any()
    whole = path.read_bytes()
    generator = np.random.default_rng(sum(map(ord, name)))
    for _ in range(MUTATIONS_EACH):
        path.write_bytes(mutated(whole, generator))
        with contextlib.suppress(RadarError):  # anything else fails the test
            heights = read(path).height_m
            assert np.isfinite(heights).any()
            assert np.nanmax(np.abs(heights)) < 1e12
