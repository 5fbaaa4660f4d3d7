"""Surveys in a row over the same scene share it: nothing of their results depends on what was flown before."""

import logging
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sionna_radar.foundation.build_cache import BuildCache
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scene.landscape import TerrainInputs
from sionna_radar.scene.terrains.build import build_landscape
from sionna_radar.survey.chain import run
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.result import Survey

SHORT = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0}


def prepared(cache: BuildCache, **changes: Any) -> Prepared:
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    return prepare(load_scenario("hills", {**SHORT, **changes}), cache=cache)


def products(survey: Survey) -> tuple[object, ...]:
    arrays = (survey.dem, survey.dem_sigma, survey.truth, survey.error)
    return (
        survey.points.sha256(),
        survey.lit.tobytes(),
        survey.warnings,
        *(None if raster is None else raster.height_m.tobytes() for raster in arrays),
    )


@pytest.mark.parametrize("speckle", ["persistent", "per_pulse"])
def test_products_are_the_same_bytes_over_a_shared_scene(speckle: str) -> None:
    scenario = load_scenario("hills", {**SHORT, "tracing.speckle": speckle, "radar.snr_db": 20.0})
    # Another seed and another noise have flown over the scene before.
    before = run(load_scenario("hills", {**SHORT, "tracing.speckle": speckle, "seed": 7}))
    shared = run(scenario)
    assert shared.prepared.world.caster is before.prepared.world.caster
    assert shared.prepared.instrument.antenna is before.prepared.instrument.antenna
    alone = run(prepare(scenario, cache=BuildCache()))
    assert shared.prepared.world.caster is not alone.prepared.world.caster
    assert products(shared) == products(alone)


def test_a_survey_changes_nothing_of_a_shared_scene() -> None:
    ready = prepared(BuildCache())
    surfaces = ready.world.scene.surfaces
    before = [(s.vertices_m.tobytes(), s.faces.tobytes()) for s in surfaces]
    relief = [s.relief.height_m.tobytes() for s in surfaces if s.relief is not None]
    run(ready)
    assert before == [(s.vertices_m.tobytes(), s.faces.tobytes()) for s in surfaces]
    assert relief == [s.relief.height_m.tobytes() for s in surfaces if s.relief is not None]


def test_seed_radar_and_processing_share_the_scene_and_what_it_is_made_of_does_not() -> None:
    cache = BuildCache()
    caster = prepared(cache).world.caster
    same = ({"seed": 5}, {"radar__snr_db": 9.0}, {"radar__bandwidth_hz": 4e8}, {"radar__carrier_hz": 76e9})
    for changes in (*same, {"processing__window": "taylor"}, {"radar__antenna__beamwidth_deg": 3.0}):
        assert prepared(cache, **changes).world.caster is caster
    building = {"position_m": [0.0, 30.0], "size_m": [5.0, 5.0, 5.0]}
    for changes in ({"terrain__seed": 5}, {"terrain__height_m": 7.5}, {"buildings": [building]}):
        assert prepared(cache, **changes).world.caster is not caster
        caster = prepared(cache).world.caster


def test_materials_are_those_of_the_scenario_over_a_shared_ground() -> None:
    at = np.array([0.5])
    levels, cache = [], BuildCache()
    for terrain_class in ("rolling_hills", "desert", "rolling_hills"):
        scene = prepared(
            cache, materials__ground={"model": "constant_gamma", "terrain_class": terrain_class}
        ).world.scene
        levels.append(float(scene.materials["ground"].sigma0(at)[0]))
    assert levels[0] == levels[2] != levels[1]


def test_a_file_of_what_stands_that_is_written_anew_is_read_anew(tmp_path: Path) -> None:
    table, cache = tmp_path / "rcs.csv", BuildCache()

    def level() -> float:
        target = {"position_m": [0.0, 0.0], "rcs_table": str(table)}
        found = prepared(cache, targets=[target]).world.scene.targets[0].rcs_table
        assert found is not None
        return float(found.rcs_m2[0, 0])

    table.write_text("azimuth_deg,rcs_dbsm\n0,10\n")
    assert level() == 10.0
    table.write_text("azimuth_deg,rcs_dbsm\n0,20\n")
    assert level() == 100.0


def test_custom_terrain_is_built_for_each_survey() -> None:
    asked = []
    scenario = load_scenario("hills", SHORT)

    def terrain(inputs: TerrainInputs) -> Any:
        asked.append(inputs.window_m)
        return build_landscape(scenario.terrain, inputs)

    cache = BuildCache()
    casters = [prepare(scenario, CustomParts(terrain=terrain), cache=cache).world.caster for _ in range(2)]
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


def test_a_cache_holds_the_latest_of_each_and_says_again_what_was_logged(caplog: pytest.LogCaptureFixture) -> None:
    made = []

    def build() -> int:
        logging.getLogger("sionna_radar").warning("made %d", len(made))
        made.append(0)
        return len(made)

    cache = BuildCache()
    with caplog.at_level(logging.WARNING, "sionna_radar"):
        found = [cache.once("ground", key, build) for key in ("a", "a", "b", None, None, "b", "a")]
        other = cache.once("antenna", "a", build)
    assert found == [1, 1, 2, 3, 4, 2, 5]
    assert other == 6
    assert caplog.messages == [f"made {number}" for number in (0, 0, 1, 2, 3, 1, 4, 5)]


def test_what_cannot_be_built_is_not_kept() -> None:
    cache = BuildCache()
    cache.once("ground", "a", lambda: 1)
    with pytest.raises(ZeroDivisionError):
        cache.once("ground", "b", lambda: 1 // 0)
    assert cache.once("ground", "b", lambda: 2) == 2
