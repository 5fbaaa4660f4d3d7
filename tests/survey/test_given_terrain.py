"""Ground that a caller gives as it is: an array, a raster, or the path of a file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from elevation_files import from_origin, write_heights
from sionna_radar import Raster, load_scenario, prepare, run
from sionna_radar.foundation.errors import InputFileError, PluginError, ScenarioError
from sionna_radar.mapping.mapper import MICRORELIEF_M
from sionna_radar.survey.custom_parts import CustomParts

SPACING_M = 4.0
SCENARIO = load_scenario("hills", {"platform.length_m": 8.0})
# A slope that rises to the north by 1 m in 20, 400 m across: rows from south to north.
NORTHWARD_M = SPACING_M * (np.arange(101) - 50)
HEIGHT_M = np.repeat(NORTHWARD_M[:, None] / 20, 101, axis=1)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    half_m = SPACING_M * 101 / 2
    corner = from_origin(690_000 - half_m, 5_330_000 + half_m, SPACING_M, SPACING_M)
    return write_heights(tmp_path / "slope.tif", np.flipud(HEIGHT_M), corner)


def slope_of(terrain: Any) -> np.ndarray:
    """Return the heights of the ground that was built, 60 m south, at, and 60 m north of the local origin."""
    ground_m = prepare(SCENARIO, CustomParts(terrain=terrain)).world.ground_m
    return ground_m(np.array([[0.0, -60.0], [0.0, 0.0], [0.0, 60.0]]))


def test_an_array_and_a_raster_are_ground_with_rows_to_the_north() -> None:
    for terrain in ((HEIGHT_M, SPACING_M), Raster.from_array(HEIGHT_M, SPACING_M)):
        np.testing.assert_allclose(slope_of(terrain), [-3.0, 0.0, 3.0], atol=1e-9)
    moved = Raster.from_array(HEIGHT_M, SPACING_M, west_m=-200.0, south_m=-180.0)
    np.testing.assert_allclose(slope_of(moved), [-4.0, -1.0, 2.0], atol=1e-9)
    whole = np.arange(101 * 101).reshape(101, 101) // 101
    np.testing.assert_allclose(slope_of((whole, SPACING_M)), [35, 50, 65], atol=1e-9)


def test_a_path_is_that_of_the_scenario(file: Path) -> None:
    by_key = run(load_scenario("hills", {"platform.length_m": 8.0, "terrain": {"kind": "raster", "path": str(file)}}))
    for path in (file, str(file)):
        survey = run(SCENARIO, parts=CustomParts(terrain=path))
        assert survey.points.sha256() == by_key.points.sha256()
        assert survey.prepared.scenario.terrain == by_key.prepared.scenario.terrain
        assert survey.prepared.scenario.source == SCENARIO.source
        assert not survey.replaced
        assert survey.prepared.mapper.microrelief_m == by_key.prepared.mapper.microrelief_m == MICRORELIEF_M


def test_measured_ground_has_relief_below_the_footprint_and_synthetic_ground_none(file: Path) -> None:
    def microrelief_m(terrain: Any, **dem: float) -> float:
        given = SCENARIO.replace({f"dem.{key}": value for key, value in dem.items()})
        return prepare(given, CustomParts(terrain=terrain)).mapper.microrelief_m

    assert microrelief_m(None) == 0.0
    assert microrelief_m(None, microrelief_m=0.01) == 0.01
    for terrain in (file, (HEIGHT_M, SPACING_M)):
        assert microrelief_m(terrain) == MICRORELIEF_M
        assert microrelief_m(terrain, microrelief_m=0.0) == 0.0


def test_a_survey_over_an_array_maps_it_and_says_what_it_flew_over() -> None:
    survey = run(SCENARIO, parts=CustomParts(terrain=(HEIGHT_M, SPACING_M)))
    assert survey.lit_error.rms_m < 0.2
    assert survey.replaced == {"terrain": "sionna_radar.foundation.raster.Raster"}
    assert any("its heights are 4 m apart" in warning for warning in survey.warnings)
    with_void = HEIGHT_M.copy()
    with_void[:3] = np.nan
    assert len(run(SCENARIO, parts=CustomParts(terrain=(with_void, SPACING_M))).points) == len(survey.points)


def test_material_and_covers_stay_those_of_the_scenario(file: Path) -> None:
    square = [(-90.0, -90.0), (90.0, -90.0), (90.0, 90.0), (-90.0, 90.0)]
    covered = SCENARIO.replace({"terrain.cover": [{"polygon_m": square, "material": "building"}]})
    for terrain in ((HEIGHT_M, SPACING_M), file):
        built = prepare(covered, CustomParts(terrain=terrain)).world.scene
        assert {surface.material for surface in built.surfaces} == {"ground", "building"}


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("terrain", "words"),
    [
        ((HEIGHT_M, -1.0), "spacing_m = -1 must be greater than 0"),
        ((HEIGHT_M[0], 1.0), r"shape \(101,\); give a table of heights"),
        ((HEIGHT_M,), r"a tuple is \(heights, spacing_m\)"),
        ((HEIGHT_M, "wide"), r"a tuple is \(heights, spacing_m\)"),
    ],
)
def test_what_is_no_array_of_heights_is_refused(terrain: Any, words: str) -> None:
    with pytest.raises(ScenarioError, match=f"terrain: .*{words}"):
        run(SCENARIO, parts=CustomParts(terrain=terrain))


@pytest.mark.usefixtures("unchecked")
def test_what_is_no_ground_is_refused_with_the_remedy(file: Path, tmp_path: Path) -> None:
    with pytest.raises(PluginError, match=r"terrain is of the type ndarray; give \(heights, spacing_m\)"):
        run(SCENARIO, parts=CustomParts(terrain=HEIGHT_M))  # type: ignore[arg-type]
    with pytest.raises(ScenarioError, match=r"spans 689798 to 690202 m east .* give the path of its file"):
        run(SCENARIO, parts=CustomParts(terrain=Raster.read(file)))
    with pytest.raises(ScenarioError, match="terrain: it has no surface"):
        run(SCENARIO, parts=CustomParts(terrain=(np.full((101, 101), np.nan), SPACING_M)))
    with pytest.raises((InputFileError, ScenarioError), match=r"terrain\.path.*nowhere"):
        run(SCENARIO, parts=CustomParts(terrain=tmp_path / "nowhere.tif"))


@pytest.mark.parametrize("along", [True, False])
def test_a_map_between_scan_lines_along_walls_is_stated_wider_with_a_warning(along):
    """Scan lines 5 m apart run north, walls of 2.4 m 12 m apart along them or across: misfits of 2.4 and 1."""
    fields_m = np.tile(2.4 * np.floor((np.arange(400) / 2 - 100) / 12), (400, 1))
    flight = {"platform.altitude_m": 40.0, "platform.length_m": 60.0, "platform.start_m": [-30.0, 0.0]}
    scenario = load_scenario("own_dem", flight | {"platform.height": "level", "dem.method": "linear"})
    survey = run(scenario, parts=CustomParts(terrain=(fields_m if along else fields_m.T, 0.5)))
    cells = survey.lit & survey.error.filled
    z = survey.error.height_m[cells] / survey.dem_sigma.height_m[cells]
    assert np.mean(np.abs(z) < 1.96) > 0.9
    assert any("farther from what the other lines predict" in warning for warning in survey.warnings) == along
    assert (survey.uncertainty.misfit > 2) == along
