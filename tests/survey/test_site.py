"""A survey over a site of the user's own: a bridge whose underside nobody maps, and what is said of it."""

import json
import tomllib

import numpy as np
import pytest
import trimesh

from sionna_radar import load_scenario, run
from sionna_radar.report.survey.summary import summary, survey_table
from sionna_radar.scenario import parse_scenario
from sionna_radar.scenario.loading import to_toml
from vector_files import rectangle, write_geojson

SCENARIO = """
[terrain]
kind = "flat"
size_m = [200.0, 200.0]

[platform]
altitude_m = 40.0
speed_mps = 10.0
start_m = [-46.0, 0.0]
heading_deg = 90.0
length_m = 12.0

[radar]
snr_db = 30.0
scan.half_swath_deg = 30.0

[tracing]
paths_per_pulse = 64

[[objects]]
path = "bridge.glb"
up = "z"
position_m = [0.3, 0.2]

[[footprints]]
path = "town.json"
height_m = 3.0
"""


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    spans = [[(-4, -12, 5), (4, 12, 6)], [(-4, -12, 0), (4, -10, 5)], [(-4, 10, 0), (4, 12, 5)]]
    trimesh.util.concatenate([trimesh.creation.box(bounds=span) for span in spans]).export(folder / "bridge.glb")
    write_geojson(folder / "town.json", [([rectangle(-12, 14, -6, 20)], {})])
    (folder / "site.toml").write_text(SCENARIO)
    return run(load_scenario(folder / "site.toml"))


def test_the_truth_is_the_highest_surface_and_the_cells_below_another_are_counted(survey):
    """The deck is 8 x 24 m, of which 4 m stand on piers; every cell of 1 m under it counts."""
    grid = survey.truth.grid
    inside = survey.truth.height_m[(abs(grid.centres_m - [0.3, 0.2]) < [4.0, 12.0]).all(axis=1).reshape(grid.shape)]
    assert inside == pytest.approx(6.0, abs=1e-4)
    under = (abs(grid.centres_m - [0.3, 0.2]) < [4.0, 10.0]).all(axis=1)
    assert under.sum() > 100
    assert survey.overhang.cells == under.sum()
    document = json.loads(json.dumps(summary(survey)))
    told = document["overhang"]
    assert (told["cells"], told["share"]) == (survey.overhang.cells, pytest.approx(survey.overhang.share))
    west, south, east, north = told["places"][0]["extent_m"]
    assert (west, east) == pytest.approx((-3.7, 4.3), abs=1.01)  # the deck's width, about 0.3 m east
    assert south < 0 < north
    assert "highest" in document["meaning"]["overhang"]
    rows = dict(zip(*(list(column.cells) for column in survey_table(survey).columns), strict=True))
    assert rows["cells under an overhang"].startswith(f"{survey.overhang.cells} (")


def near_walls(place_m):
    """Return which places are within half a metre of an edge of the deck, at (0.3, 0.2), or of the footprint."""
    near = np.zeros(len(place_m), dtype=bool)
    for west, south, east, north in ((-3.7, -11.8, 4.3, 12.2), (-12.0, 14.0, -6.0, 20.0)):
        middle, half = np.array([west + east, south + north]) / 2, np.array([east - west, north - south]) / 2
        near |= np.abs((np.abs(place_m - middle) - half).max(axis=1)) < 0.5
    return near


def test_errors_off_walls_leave_out_those_of_objects_and_footprints(survey):
    assert 0 < survey.off_wall_error.count < survey.lit_error.count
    beside = near_walls(survey.truth.grid.centres_m).reshape(survey.truth.grid.shape)
    assert not (survey.lit & ~survey.beside_wall & beside).any()
    off_walls = survey.error.height_m[survey.lit & ~survey.beside_wall]
    assert survey.off_wall_error.rms_m == pytest.approx(np.sqrt(np.nanmean(off_walls**2)))


def test_paths_beside_the_scenario_are_found_and_written_whole(survey):
    scenario = survey.scenario
    assert scenario.objects[0].path.is_absolute()
    assert scenario.footprints[0].path.is_absolute()
    assert parse_scenario(tomllib.loads(to_toml(scenario))) == scenario
