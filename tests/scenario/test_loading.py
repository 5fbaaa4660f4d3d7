"""Scenarios from files, and what is set beside them: overrides, assignments, files merged into a scenario."""

import tomllib
from pathlib import Path

import pytest

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import load_scenario, parse_scenario
from sionna_radar.scenario.loading import find_scenario, scenario_from, start_text, to_toml
from sionna_radar.scenario.overrides import parse_overrides, read_overrides
from sionna_radar.scenario.shipped import scenes_directory, shipped_scenarios


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
        ("targets.7.rcs_dbsm", "'7' is not an index of an entry"),
        ("targets.first.rcs_dbsm", "'first' is not an index of an entry"),
        ("targets.7", "'7' is not an index of an entry"),
        ("radar.snr_db.very.deep", "not an index of an entry"),
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


def test_a_misspelt_scenario_is_told_the_nearest():
    with pytest.raises(InputFileError, match=r"Did you mean san_francisco\?"):
        find_scenario("sanfrancisco")


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
    assert load_scenario("hills", overrides).terrain == parse_scenario(tomllib.loads(TEXT)).terrain
    assert load_scenario(write(tmp_path, TEXT), {"targets.0": None}).targets == ()
    with pytest.raises(ScenarioError, match=r"platform\.altitude_m: missing"):
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


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"seed": 7, "platform.length_m": None},
        {"radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 12.0},
        {"radar.antenna.pattern": "/of/an/antenna.csv"},
        {"terrain": {"kind": "flat"}},
        {"radar.scan.mode": "conical"},
        {"platform.log": "/of/a/flight.csv"},
    ],
)
def test_a_changed_copy_is_the_scenario_loaded_with_the_changes(changes):
    assert load_scenario("hills").replace(changes) == load_scenario("hills", changes)


def test_a_changed_copy_leaves_the_scenario_and_the_changes_alone():
    scenario, terrain = load_scenario("hills"), {"kind": "flat"}
    flat = scenario.replace({"terrain": terrain, "terrain.size_m": [300.0, 300.0]})
    assert flat.terrain.size_m == (300.0, 300.0)
    assert terrain == {"kind": "flat"}
    assert scenario == load_scenario("hills")


def test_a_change_that_does_not_fit_names_its_key():
    with pytest.raises(ScenarioError, match=r"hills: 1 problem\n  radar.snr_db: must be at least -100, not -1000"):
        load_scenario("hills").replace({"radar.snr_db": -1000})


def test_a_default_that_was_set_over_a_preset_stays_set():
    # 500 MHz is the default of the key, and not that of the preset.
    scenario = load_scenario("hills", {"radar": {"preset": "avtis2", "bandwidth_hz": 500e6}})
    assert parse_scenario(tomllib.loads(to_toml(scenario, defaults=False))) == scenario


def keys_of(table):
    """Return the number of keys of a table and those in it; a list, such as one of buildings, is one."""
    return sum(keys_of(value) if isinstance(value, dict) else 1 for value in table.values())


@pytest.mark.parametrize("name", sorted(shipped_scenarios()))
def test_a_scenario_without_its_defaults_loads_as_the_same(name):
    scenario = load_scenario(name)
    short = tomllib.loads(to_toml(scenario, defaults=False))
    assert parse_scenario(short) == scenario
    assert keys_of(short) < keys_of(tomllib.loads(to_toml(scenario))) / 2


def test_a_scenario_is_printed_by_what_differs_from_its_defaults_and_says_how_to_change_it():
    scenario = load_scenario("hills", {"radar.snr_db": 12.5})
    assert "snr_db = 12.5" in str(scenario)
    assert "carrier_hz" not in str(scenario)
    assert str(scenario.radar.antenna) == 'kind = "taylor"'
    with pytest.raises(
        AttributeError, match=r"RadarTable.snr_db cannot be set.*scenario.replace\(\{'...snr_db': 3.0\}\)"
    ):
        scenario.radar.snr_db = 3.0
    assert scenario.replace({"radar.snr_db": 3.0}).radar.snr_db == 3.0


def test_a_scenario_is_made_from_the_users_own_files(tmp_path):
    raster, log = tmp_path / "own.tif", tmp_path / "flight.gpx"
    for file in (raster, log):
        file.write_bytes(b"")
    (tmp_path / "surveys").mkdir()
    text = start_text(scenario_from([str(raster), "ti_awr1843", str(log)], tmp_path / "surveys"))
    given = tomllib.loads(text)
    assert given["terrain"] == {"kind": "raster", "path": "../own.tif"}
    assert given["platform"] == {"log": "../flight.gpx"}
    assert given["radar"] == {"preset": "ti_awr1843"}
    assert scenario_from([str(log)], tmp_path)["platform"]["log_shift"] == "to_terrain"


@pytest.mark.parametrize(
    ("sources", "words"),
    [
        (["none.tif"], "none.tif does not exist"),
        (["a.docx"], "neither a preset"),
        (["ti_awr1843", "avtis2"], "a second \\[radar\\]"),
    ],
)
def test_a_source_that_makes_no_scenario_is_refused(tmp_path, sources, words):
    with pytest.raises((ScenarioError, InputFileError), match=words):
        scenario_from(sources, tmp_path)


@pytest.mark.parametrize(
    ("version", "words"),
    [(2, "2 is newer than this program, which reads version 1"), (0, "must be 1, not 0"), ("1", "must be 1, not '1'")],
)
def test_a_scenario_of_another_format_is_refused(version, words):
    with pytest.raises(ScenarioError, match="version: ") as refused:
        load_scenario("hills", {"version": version})
    assert words in str(refused.value)
