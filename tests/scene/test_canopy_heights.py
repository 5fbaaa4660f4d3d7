"""Plants from point clouds: their classes, over the ground that the same cloud gives."""

from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import parse_scenario
from sionna_radar.scene.canopy_heights import plant_heights
from sionna_radar.scene.vegetation import Stand
from sionna_radar.survey.preparation import prepare

EAST, NORTH = 690_000.0, 5_330_000.0


def write(path, epsg):
    """A slope with a point each metre; on its eastern half trees of 7 m, whose points are of class 5."""
    x, y = (k.ravel() for k in np.meshgrid(np.arange(-80.0, 80.5), np.arange(-80.0, 80.5)))
    ground = 500 + 0.1 * x
    wood = x > 0
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = [EAST, NORTH, 0.0], [0.001, 0.001, 0.001]
    if epsg:
        header.add_crs(CRS.from_epsg(epsg))
    las = laspy.LasData(header)
    las.x, las.y = np.concatenate([x, x[wood]]) + EAST, np.concatenate([y, y[wood]]) + NORTH
    las.z = np.concatenate([ground, ground[wood] + 7.0])
    las.classification = np.repeat([2, 5], [len(x), wood.sum()])
    las.write(path)
    return str(path)


def forest(cloud, **stand):
    return parse_scenario(
        {
            "terrain": {"kind": "points", "path": cloud, "points": "ground", "spacing_m": 2.0},
            "platform": {"altitude_m": 40.0, "speed_mps": 10.0, "length_m": 20.0},
            "radar": {"snr_db": 30.0, "samples_per_chirp": 1024, "scan": {"mode": "fixed", "incidence_deg": 20.0}},
            "vegetation": [{"path": cloud, "extinction_db_per_m": 1.0, "backscatter_db_per_m": -20.0} | stand],
        }
    )


@pytest.mark.parametrize("epsg", [32632, None])
def test_trees_stand_where_their_points_are(tmp_path, epsg):
    file = write(tmp_path / "wood.laz", epsg)
    vegetation = prepare(forest(file)).world.scene.vegetation
    plant, east = vegetation.plant_m, np.tile(vegetation.grid.x_m, (vegetation.grid.rows, 1))
    north = np.tile(vegetation.grid.y_m[:, None], (1, vegetation.grid.columns))
    inside = (np.abs(north) < 40) & (np.abs(east) < 40)
    assert np.all(np.isnan(plant[inside & (east < -1)]))
    np.testing.assert_allclose(plant[inside & (east > 1.5)], 7.0, atol=0.15)


def test_what_gives_no_trees_is_refused(tmp_path):
    file = write(tmp_path / "wood.las", 32632)
    with pytest.raises(InputFileError, match=r"no points of the classes 3, 4 in the stand, x = .* and covers x = "):
        prepare(forest(file, classes=[3, 4]))
    with pytest.raises(ScenarioError, match="no CRS; give both, or none"):
        prepare(forest(write(tmp_path / "bare.las", 32632), path=write(tmp_path / "local.las", None)))
    with pytest.raises(ScenarioError, match=r"vegetation\.0\.classes: has no effect"):
        forest(file, path=None, polygon_m=[[0, 0], [9, 0], [0, 9]], height_m=3.0, classes=[5])


def test_cells_of_a_cloud_that_are_too_many_are_refused(tmp_path):
    path = Path(write(tmp_path / "wood.laz", 32632))
    stand = Stand(path=path, of_cloud=True, cloud_spacing_m=0.05, extinction_db_per_m=1.0, backscatter_db_per_m=-20.0)
    corners = np.array([[-4e3, -4e3], [4e3, 4e3]])
    with pytest.raises(ScenarioError, match=r"cloud_spacing_m: 0\.05 makes .* cells of the stand, more than"):
        plant_heights(None, lambda place: np.zeros(len(place)), stand, "vegetation.0", corners)
