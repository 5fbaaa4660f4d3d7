"""Surveys in a row over the same scene share it: nothing of their results depends on what was flown before."""

import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sionna_radar.foundation.kept_values import KeptValues, Same
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scene.build import build_ground
from sionna_radar.scene.landscape import TerrainInputs
from sionna_radar.scene.terrains.build import build_landscape
from sionna_radar.survey.chain import run
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.result import Survey

SHORT = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0}


def prepared(**changes: Any) -> Prepared:
    return prepare(load_scenario("hills", {**SHORT, **{key.replace("__", "."): v for key, v in changes.items()}}))


def products(survey: Survey) -> tuple[object, ...]:
    arrays = (survey.dem, survey.dem_sigma, survey.truth, survey.error)
    return (
        survey.points.sha256(),
        survey.lit.tobytes(),
        survey.warnings,
        *(None if raster is None else raster.height_m.tobytes() for raster in arrays),
    )


@pytest.mark.parametrize("speckle", ["persistent", "per_pulse"])
def test_products_are_the_same_bytes_over_a_shared_scene(speckle: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario = load_scenario("hills", {**SHORT, "tracing.speckle": speckle, "radar.snr_db": 20.0})
    # Another seed and another noise have flown over the scene before.
    run(load_scenario("hills", {**SHORT, "tracing.speckle": speckle, "seed": 7}))
    before = prepare(scenario).scene.caster
    shared = run(scenario)
    assert shared.prepared.scene.caster is before
    monkeypatch.setattr("sionna_radar.scene.build.shared_ground", build_ground)
    alone = run(scenario)
    assert shared.prepared.scene.caster is not alone.prepared.scene.caster
    assert products(shared) == products(alone)


def test_a_survey_changes_nothing_of_a_shared_scene() -> None:
    ready = prepared()
    surfaces = ready.scene.scene.surfaces
    before = [(s.vertices_m.tobytes(), s.faces.tobytes()) for s in surfaces]
    relief = [s.relief.height_m.tobytes() for s in surfaces if s.relief is not None]
    run(ready)
    assert before == [(s.vertices_m.tobytes(), s.faces.tobytes()) for s in surfaces]
    assert relief == [s.relief.height_m.tobytes() for s in surfaces if s.relief is not None]


def test_seed_radar_and_processing_share_the_scene_and_what_it_is_made_of_does_not() -> None:
    caster = prepared().scene.caster
    same = ({"seed": 5}, {"radar__snr_db": 9.0}, {"radar__bandwidth_hz": 4e8}, {"radar__carrier_hz": 76e9})
    for changes in (*same, {"processing__window": "taylor"}, {"radar__antenna__beamwidth_deg": 3.0}):
        assert prepared(**changes).scene.caster is caster
    building = {"position_m": [0.0, 30.0], "size_m": [5.0, 5.0, 5.0]}
    for changes in ({"terrain__seed": 5}, {"terrain__height_m": 7.5}, {"buildings": [building]}):
        assert prepared(**changes).scene.caster is not caster
        caster = prepared().scene.caster


def test_materials_are_those_of_the_scenario_over_a_shared_ground() -> None:
    at = np.array([0.5])
    levels = []
    for terrain_class in ("rolling_hills", "desert", "rolling_hills"):
        scene = prepared(materials__ground={"model": "constant_gamma", "terrain_class": terrain_class}).scene.scene
        levels.append(float(scene.materials["ground"].sigma0(at)[0]))
    assert levels[0] == levels[2] != levels[1]


def test_a_file_of_what_stands_that_is_written_anew_is_read_anew(tmp_path: Path) -> None:
    table = tmp_path / "rcs.csv"

    def level() -> float:
        target = {"position_m": [0.0, 0.0], "rcs_table": str(table)}
        found = prepared(targets=[target]).scene.scene.targets[0].rcs_table
        assert found is not None
        return float(found.rcs_m2[0, 0])

    table.write_text("azimuth_deg,rcs_dbsm\n0,10\n")
    assert level() == 10.0
    table.write_text("azimuth_deg,rcs_dbsm\n0,20\n")
    assert level() == 100.0


def test_custom_terrain_is_built_for_each_survey() -> None:
    asked = []
    scenario = load_scenario("hills", SHORT)

    def terrain(given: TerrainInputs) -> Any:
        asked.append(given.window_m)
        return build_landscape(scenario.terrain, given)

    casters = [prepare(scenario, CustomParts(terrain=terrain)).scene.caster for _ in range(2)]
    assert len(asked) == 2
    assert casters[0] is not casters[1]


def test_the_key_of_a_file_changes_with_its_content(tmp_path: Path) -> None:
    path = tmp_path / "ground.csv"
    path.write_text("one")
    key = content_key({"file": path})
    assert key == content_key({"file": path})
    stat = path.stat()
    path.write_text("two")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert content_key({"file": path}) != key, "size and time of change are the same, its record's is not"
    (tmp_path / "ground.csv.aux").write_text("beside")
    assert content_key({"file": path}) not in (key, None)


@pytest.mark.parametrize("value", [Path("nowhere.tif"), "https://example.org/a.tif", {"a": [Path("x.obj")]}])
def test_what_has_no_identity_has_no_key(value: Any) -> None:
    assert content_key({"given": value}) is None


def test_kept_values_are_few_and_say_again_what_was_logged(caplog: pytest.LogCaptureFixture) -> None:
    made = []

    def make() -> int:
        logging.getLogger("sionna_radar").warning("made %d", len(made))
        made.append(0)
        return len(made)

    kept = KeptValues(2)
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        found = [kept.once(key, make) for key in ("a", "a", "b", "c", "b", "a")]
    assert found == [1, 1, 2, 3, 2, 4]
    assert caplog.messages == ["made 0", "made 0", "made 1", "made 2", "made 1", "made 3"]
    assert len(kept) == 2


def test_same_is_of_one_object_only() -> None:
    first, second = [1], [1]
    assert Same(first) == Same(first)
    assert Same(first) != Same(second)
