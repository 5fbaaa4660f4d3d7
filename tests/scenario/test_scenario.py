"""Scenarios: what is accepted, what is refused and how, and that what is written back reads the same."""

import tomllib
from pathlib import Path

import pytest
from pydantic import ValidationError

from scenario_keys import keys_of
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import Scenario, load_scenario, parse_scenario
from sionna_radar.scenario.loading import (
    find_scenario,
    parse_overrides,
    read_overrides,
    scenes_directory,
    shipped_scenarios,
    to_toml,
)

LEAST = {
    "terrain": {"kind": "flat"},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
    "radar": {"snr_db": 30.0},
}


def changed(**keys: object) -> dict:
    """The least scenario with dotted keys (written with __) set; None removes one."""
    data = {name: dict(table) for name, table in LEAST.items()}
    for key, value in keys.items():
        *tables, last = key.split("__")
        node = data
        for name in tables:
            node = node.setdefault(name, {})
        if value is None:
            del node[last]
        else:
            node[last] = value
    return data


def problems(data: dict) -> dict[str, str]:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(data)
    return {problem.field: problem.message for problem in caught.value.problems}


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_load_and_come_back_from_toml(name):
    path = shipped_scenarios()[name]
    overrides = {}
    if "path" in tomllib.loads(path.read_text(encoding="utf-8"))["terrain"]:
        overrides["terrain.path"] = "some.tif"  # the user's own file, which is not shipped
    scenario = load_scenario(name, overrides)
    assert scenario.description
    again = parse_scenario(tomllib.loads(to_toml(scenario)))
    assert again == scenario
    assert to_toml(again) == to_toml(scenario)


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_say_what_they_show(name):
    assert shipped_scenarios()[name].read_text(encoding="utf-8").startswith("# ")


def test_the_least_scenario_takes_the_papers_radar():
    scenario = parse_scenario(LEAST)
    radar = scenario.radar
    assert (radar.carrier_hz, radar.bandwidth_hz, radar.chirp_rate_hz) == (77e9, 500e6, 360.0)
    assert (radar.antenna.beamwidth_deg, radar.antenna.side_lobe_db) == (2.0, -20.0)
    assert (radar.scan.mode, radar.scan.rotation_rpm, radar.scan.incidence_deg) == ("whisk_broom", 120.0, 45.0)
    assert scenario.tracing.paths_per_pulse == 512


@pytest.mark.parametrize(
    ("keys", "field", "said"),
    [
        ({"radar__snr": 3.0}, "radar.snr", "unknown key"),
        ({"colour": "red"}, "colour", "unknown key"),
        ({"radar__scan__tilt": 3.0}, "radar.scan.tilt", "unknown key"),
        ({"terrain__width": 3.0}, "terrain.width", "unknown key"),
        ({"platform__altitude_m": None}, "platform.altitude_m", "required"),
        ({"radar": None}, "radar", "required"),
        ({"terrain__kind": None}, "terrain.kind", "required"),
        ({"terrain__kind": "moon"}, "terrain.kind", "flat, hills, fractal, jacksboro, raster, sionna:san_francisco"),
        ({"terrain__kind": "sionna:atlantis"}, "terrain.kind", "'sionna:atlantis' is unknown"),
        ({"terrain__kind": 3}, "terrain.kind", "flat"),
        ({"terrain__kind": "raster"}, "terrain.path", "required"),
        ({"platform__altitude_m": "high"}, "platform.altitude_m", "'high' is refused"),
        ({"platform__altitude_m": "50"}, "platform.altitude_m", "'50' is refused"),
        ({"platform__altitude_m": True}, "platform.altitude_m", "True is refused"),
        ({"platform__altitude_m": float("nan")}, "platform.altitude_m", "nan is refused"),
        ({"platform__altitude_m": float("inf")}, "platform.altitude_m", "inf is refused"),
        ({"platform__altitude_m": -5.0}, "platform.altitude_m", "-5.0 is refused: it must be greater than 0"),
        ({"platform__speed_mps": 0.0}, "platform.speed_mps", "0.0 is refused"),
        ({"platform__start_m": [1.0]}, "platform.start_m.1", "required"),
        ({"platform__waypoints_m": [[0.0, 0.0]]}, "platform.waypoints_m", "at least two"),
        ({"platform__waypoints_m": [[0.0, 0.0], [0.0, 0.0]]}, "platform.waypoints_m", "follows itself"),
        (
            {"platform__waypoints_m": [[0.0, 0.0], [9.0, 0.0]], "platform__length_m": 50.0},
            "platform.waypoints_m",
            "contradicts length_m",
        ),
        ({"platform__profile": "full", "platform__takeoff_height_m": 60.0}, "platform.takeoff_height_m", "not below"),
        ({"radar__samples_per_chirp": 1024.0}, "radar.samples_per_chirp", "1024.0 is refused"),
        ({"radar__samples_per_chirp": 8}, "radar.samples_per_chirp", "8 is refused"),
        ({"radar__bandwidth_hz": 60e9}, "radar.bandwidth_hz", "not small against carrier_hz"),
        ({"radar__sweep": "sideways"}, "radar.sweep", "'sideways' is refused"),
        ({"radar__snr_db": None}, "radar.snr_db", "missing"),
        ({"radar__noise_figure_db": 10.0}, "radar.snr_db", "contradicts"),
        ({"radar__snr_db": None, "radar__noise_figure_db": 10.0}, "radar.snr_db", "missing"),
        ({"radar__snr_db": None, "radar__transmit_power_dbm": 1.0}, "radar.noise_figure_db", "missing beside"),
        ({"radar__antenna__beamwidth_deg": 0.0}, "radar.antenna.beamwidth_deg", "0.0 is refused"),
        ({"radar__antenna__beamwidth_deg": [2.0, 90.0]}, "radar.antenna.beamwidth_deg.1", "90.0 is refused"),
        ({"radar__antenna__side_lobe_db": -5.0}, "radar.antenna.side_lobe_db", "-5.0 is refused"),
        ({"radar__scan__incidence_deg": 90.0}, "radar.scan.incidence_deg", "90.0 is refused"),
        ({"radar__scan__half_swath_deg": 95.0}, "radar.scan.half_swath_deg", "stays below 90"),
        ({"radar__scan__stabilised": 1}, "radar.scan.stabilised", "1 is refused"),
        ({"radar__scan__side": "left"}, "radar.scan.side", "set mode = 'side_looking'"),
        ({"radar__scan__side": "up"}, "radar.scan.side", "'up' is refused"),
        ({"tracing__engine": "magic"}, "tracing.engine", "'magic' is unknown; give one of sionna, gamma, path_solver"),
        ({"tracing__paths_per_pulse": 1}, "tracing.paths_per_pulse", "1 is refused"),
        ({"processing__window": "haan"}, "processing.window", "not a window of scipy"),
        ({"processing__cfar__kind": "XY"}, "processing.cfar.kind", "'XY' is refused"),
        ({"processing__cfar__guard": 300}, "processing.cfar.guard", "do not fit 512 range cells"),
        (
            {"processing__cfar__false_alarm_probability": 1.0},
            "processing.cfar.false_alarm_probability",
            "1.0 is refused",
        ),
        ({"dem__spacing_m": 0.0}, "dem.spacing_m", "0.0 is refused"),
        ({"seed": -1}, "seed", "-1 is refused"),
        ({"seed": 2**63}, "seed", "is refused"),
        ({"terrain__material": "moss"}, "terrain.material", "add [materials.moss]"),
        ({"buildings": [{"position_m": [0.0, 0.0], "size_m": [1.0, 1.0]}]}, "buildings.0.size_m.2", "required"),
        (
            {"buildings": [{"position_m": [0.0, 0.0], "size_m": [1.0, 1.0, 1.0], "material": "gold"}]},
            "buildings.0.material",
            "'gold' is not defined",
        ),
        ({"targets": [{"position_m": [0.0, 0.0], "rcs_dbsm": 500.0}]}, "targets.0.rcs_dbsm", "500.0 is refused"),
        ({"materials": {"moss": {"model": "magic"}}}, "materials.moss.model", "'magic' is unknown; give one"),
        ({"materials": {"moss": {"model": "constant_gamma"}}}, "materials.moss.gamma_db", "not neither"),
        (
            {"materials": {"moss": {"model": "constant_gamma", "gamma_db": -20.0, "terrain_class": "city"}}},
            "materials.moss.gamma_db",
            "not both",
        ),
        (
            {"materials": {"moss": {"model": "lambertian", "nadir_sigma0_db": "x"}}},
            "materials.moss.nadir_sigma0_db",
            "'x'",
        ),
    ],
)
def test_bad_input_is_refused_with_its_key_and_a_remedy(keys, field, said):
    found = problems(changed(**keys))
    assert field in found, found
    assert said in found[field]


def test_all_problems_are_told_at_once():
    data = changed(
        platform__altitude_m=-1.0, radar__antenna__beamwidth_deg="wide", dem__spacing=2.0, targets=[{"rcs_dbsm": 0.0}]
    )
    assert set(problems(data)) == {
        "platform.altitude_m",
        "radar.antenna.beamwidth_deg",
        "dem.spacing",
        "targets.0.position_m",
    }
    with pytest.raises(ScenarioError, match=r"(?s)4 problems\n.*platform\.altitude_m: -1\.0 is refused"):
        parse_scenario(data)


def test_whole_numbers_are_numbers():
    assert parse_scenario(changed(platform__altitude_m=50)).platform.altitude_m == 50.0


def test_a_scenario_is_frozen():
    scenario = parse_scenario(LEAST)
    with pytest.raises(ValidationError):
        scenario.seed = 3
    with pytest.raises(ValidationError):
        scenario.radar.snr_db = 3.0


def write(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(text, encoding="utf-8")
    return path


TEXT = """
[terrain]
kind = "flat"
[platform]
altitude_m = 50.0
speed_mps = 10.0
[radar]
snr_db = 30.0
[[targets]]
position_m = [1.0, 2.0]
rcs_dbsm = 3.0
"""


def test_overrides_replace_dotted_keys(tmp_path):
    path = write(tmp_path, TEXT)
    overrides = {
        "radar.antenna.beamwidth_deg": [4.0, 3.0],
        "seed": 9,
        "targets.0.rcs_dbsm": -7.0,
        "radar.scan.mode": "conical",
        "platform.altitude_m": 30,
    }
    scenario = load_scenario(path, overrides)
    assert scenario.radar.antenna.beamwidth_deg == (4.0, 3.0)
    assert scenario.seed == 9
    assert scenario.targets[0].rcs_dbsm == -7.0
    assert scenario.radar.scan.mode == "conical"
    assert scenario.platform.altitude_m == 30.0
    assert load_scenario(path) == load_scenario(str(path), {})


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("radar.snr_db.deep", "leads through a value that is not a table"),
        ("targets.7.rcs_dbsm", "'7' is not an entry"),
        ("targets.first.rcs_dbsm", "'first' is not an entry"),
        ("targets.7", "'7' is not an entry"),
        ("radar.snr_db.very.deep", "not an entry"),
    ],
)
def test_overrides_that_lead_nowhere_are_refused(tmp_path, key, said):
    with pytest.raises(ScenarioError, match=said):
        load_scenario(write(tmp_path, TEXT), {key: 1.0})


def test_an_override_that_is_wrong_is_refused_like_the_file(tmp_path):
    with pytest.raises(ScenarioError, match=r"radar\.snr: unknown key"):
        load_scenario(write(tmp_path, TEXT), {"radar.snr": 1.0})


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("4", 4),
        ("4.5", 4.5),
        ("[2.0, 3.0]", [2.0, 3.0]),
        ("true", True),
        ("conical", "conical"),
        ('"a b"', "a b"),
        ("1e3", 1e3),
    ],
)
def test_assignments_hold_toml_or_a_bare_word(text, value):
    (parsed,) = parse_overrides([f"a.b = {text}" if text == "4" else f"a.b={text}"]).values()
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize("assignment", ["a.b", "=4", "  =4"])
def test_what_is_no_assignment_is_refused(assignment):
    with pytest.raises(ScenarioError, match="is not KEY=VALUE"):
        parse_overrides([assignment])


def test_a_missing_file_is_told_with_the_shipped_names():
    with pytest.raises(InputFileError, match=r"nowhere\.toml: no such scenario file.*hills"):
        load_scenario("nowhere.toml")


def test_a_folder_is_no_scenario(tmp_path):
    with pytest.raises(InputFileError, match="is a directory, not a regular file"):
        load_scenario(tmp_path)


@pytest.mark.parametrize("content", [b"[terrain\nkind = 3", b"seed = 1\nseed = 2"])
def test_a_file_that_is_no_toml_is_refused(tmp_path, content):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(InputFileError, match=r"bad\.toml: not valid TOML: .*correct the file"):
        load_scenario(path)


def test_a_file_goes_before_a_shipped_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("hills").write_text(TEXT, encoding="utf-8")
    assert find_scenario("hills") == Path("hills")
    assert load_scenario("hills").terrain.kind == "flat"
    Path("hills").unlink()
    assert find_scenario("hills") == scenes_directory() / "hills.toml"


def test_a_relative_terrain_is_looked_for_beside_the_scenario(tmp_path, monkeypatch):
    text = TEXT.replace('kind = "flat"', 'kind = "raster"\npath = "dem.tif"')
    (tmp_path / "survey").mkdir()
    (tmp_path / "work").mkdir()
    path = write(tmp_path / "survey", text)
    monkeypatch.chdir(tmp_path / "work")
    assert load_scenario(path).terrain.path == tmp_path / "work" / "dem.tif"
    (tmp_path / "survey" / "dem.tif").touch()
    assert load_scenario(path).terrain.path == tmp_path / "survey" / "dem.tif"


def test_the_resolved_scenario_holds_the_defaults():
    written = tomllib.loads(to_toml(parse_scenario(LEAST)))
    assert written["radar"]["antenna"]["beamwidth_deg"] == 2.0
    assert written["processing"]["cfar"]["kind"] == parse_scenario(LEAST).processing.cfar.kind
    assert Scenario.model_validate(written) == parse_scenario(LEAST)


@pytest.mark.parametrize(
    ("keys", "field", "near"),
    [
        ({"radar__carier_hz": 77e9}, "radar.carier_hz", "Did you mean carrier_hz?"),
        ({"platfrom": {}}, "platfrom", "Did you mean platform?"),
        ({"radar__beamwidth_deg": 2.0}, "radar.beamwidth_deg", "Did you mean radar.antenna.beamwidth_deg?"),
        ({"terrain__sise_m": [1.0, 1.0]}, "terrain.sise_m", "Did you mean size_m?"),
        ({"terrain__kind": "hils"}, "terrain.kind", "Did you mean hills?"),
        ({"terrain__material": "biulding"}, "terrain.material", "Did you mean building?"),
        ({"processing__ranging": "centriod"}, "processing.ranging", "Did you mean centroid?"),
        ({"materials": {"moss": {"model": "lambertain"}}}, "materials.moss.model", "Did you mean lambertian?"),
        (
            {"materials": {"moss": {"model": "lambertian", "nadir_sigma_db": 1.0}}},
            "materials.moss.nadir_sigma_db",
            "Did you mean nadir_sigma0_db?",
        ),
    ],
)
def test_a_misspelt_word_is_told_the_nearest(keys, field, near):
    found = problems(changed(**keys))
    assert near in found.get(field, ""), found


def test_a_misspelt_scenario_is_told_the_nearest():
    with pytest.raises(InputFileError, match=r"Did you mean san_francisco\?"):
        find_scenario("sanfrancisco")


EVERY_SHAPE = (None, True, 3, 3.5, "x", [], [1.0], [[1.0]], {}, {"a": 1}, [{}], 10**18, -1.0)


def told(data: dict) -> str:
    try:
        parse_scenario(data)
    except ScenarioError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("key", keys_of(Scenario), ids=".".join)
def test_no_message_speaks_of_pydantic(key):
    for value in EVERY_SHAPE:
        data = changed()
        node = data
        for name in key[:-1]:
            node = node.setdefault(name, {})
        node[key[-1]] = value
        message = told(data)
        for word in ("Table", "instance", "pydantic", "input should", "valid dictionary", "tuple", "NoneType"):
            assert word not in message, value


def test_a_shipped_value_gives_way_to_the_users():
    power = load_scenario("hills", {"radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 12.0}).radar
    assert (power.snr_db, power.transmit_power_dbm) == (None, 10.0)
    track = load_scenario("hills", {"platform.waypoints_m": [[0.0, 0.0], [9.0, 0.0]]}).platform
    assert (track.start_m, len(track.waypoints_m)) == (None, 2)
    flat = load_scenario("hills", {"terrain.kind": "flat"}).terrain
    assert (flat.kind, flat.size_m) == ("flat", (340.0, 340.0))
    assert load_scenario("hills", {"terrain.kind": "sionna:munich"}).terrain.city == "munich"
    moved = load_scenario("hills", {"materials.ground.gamma_db": -20.0}).materials["ground"]
    assert (moved.gamma_db, moved.terrain_class) == (-20.0, None)
    lambert = load_scenario("hills", {"materials.ground.model": "lambertian", "materials.ground.nadir_sigma0_db": 0.0})
    assert lambert.materials["ground"].model == "lambertian"
    assert load_scenario("slar", {"radar.scan.mode": "conical", "radar.scan.half_swath_deg": 20.0})


def test_what_the_user_wrote_never_gives_way(tmp_path):
    path = write(tmp_path, TEXT)
    with pytest.raises(ScenarioError, match=r"radar\.snr_db: contradicts"):
        load_scenario(path, {"radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 12.0})
    with pytest.raises(ScenarioError, match=r"radar\.snr_db: contradicts"):
        load_scenario("hills", {"radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 12.0, "radar.snr_db": 3.0})


def test_a_value_can_be_taken_out_and_a_table_replaced(tmp_path):
    overrides = parse_overrides(
        ["radar.snr_db=none", "radar.transmit_power_dbm=10", "radar.noise_figure_db=12", 'terrain={kind="flat"}']
    )
    assert overrides["radar.snr_db"] is None
    scenario = load_scenario(write(tmp_path, TEXT), overrides)
    assert scenario.radar.snr_db is None
    assert load_scenario("hills", overrides).terrain == parse_scenario(LEAST).terrain
    assert load_scenario(write(tmp_path, TEXT), {"targets.0": None}).targets == ()
    with pytest.raises(ScenarioError, match=r"platform\.altitude_m: required"):
        load_scenario("hills", parse_overrides(["platform.altitude_m=none"]))


def test_a_file_is_merged_into_a_scenario(tmp_path):
    (tmp_path / "grid.tif").touch()
    path = tmp_path / "more.toml"
    path.write_text(
        '[radar]\ntransmit_power_dbm = 10.0\nnoise_figure_db = 12.0\n[terrain]\nkind = "raster"\npath = "grid.tif"\n'
    )
    scenario = load_scenario("hills", read_overrides(path))
    assert scenario.radar.transmit_power_dbm == 10.0
    assert scenario.radar.bandwidth_hz == 500e6
    assert scenario.terrain.path == tmp_path / "grid.tif"
    path.write_text('[materials."a.b"]\nmodel = "lambertian"\n')
    with pytest.raises(InputFileError, match="dot in its name"):
        read_overrides(path)
    path.write_text("[radar\n")
    with pytest.raises(InputFileError, match=r"more\.toml: not valid TOML"):
        read_overrides(path)
