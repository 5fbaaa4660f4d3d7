"""Scenarios: what is accepted, what is refused and how, and that what is written back reads the same."""

import tomllib

import numpy as np
import pytest

from scenario_keys import keys_of, with_keys
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import Scenario, load_scenario, parse_scenario
from sionna_radar.scenario.loading import to_toml
from sionna_radar.scenario.recorded import recorded_settings
from sionna_radar.scenario.shipped import shipped_scenarios

MIN = {
    "terrain": {"kind": "flat"},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
    "radar": {"snr_db": 30.0},
}


def changed(**keys: object) -> dict:
    """The least scenario with dotted keys (written with __) set; None removes one."""
    return with_keys(MIN, keys)


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
    scenario = parse_scenario(MIN)
    radar = scenario.radar
    assert (radar.carrier_hz, radar.bandwidth_hz, radar.chirp_rate_hz) == (77e9, 500e6, 360.0)
    assert (radar.antenna.beamwidth_deg, radar.antenna.side_lobe_db) == (2.0, -20.0)
    assert (radar.scan.mode, radar.scan.rotation_rpm, radar.scan.incidence_deg) == ("whisk_broom", 120.0, 45.0)
    assert scenario.tracing.paths == 512


@pytest.mark.parametrize(
    ("keys", "field", "said"),
    [
        ({"radar__snr": 3.0}, "radar.snr", "unknown key"),
        ({"colour": "red"}, "colour", "unknown key"),
        ({"radar__scan__tilt": 3.0}, "radar.scan.tilt", "unknown key"),
        ({"terrain__width": 3.0}, "terrain.width", "unknown key"),
        ({"platform__altitude_m": None}, "platform.altitude_m", "missing; add it, or platform.log"),
        ({"radar": None}, "radar", "missing; add it"),
        ({"terrain__kind": None}, "terrain.kind", "missing; give one of flat, hills, fractal"),
        ({"terrain__kind": "moon"}, "terrain.kind", "flat, hills, fractal, jacksboro, raster, points, mesh, sionna:"),
        ({"terrain__kind": "sionna:atlantis"}, "terrain.kind", "'sionna:atlantis' is unknown"),
        ({"terrain__kind": 3}, "terrain.kind", "flat"),
        ({"terrain__kind": "raster"}, "terrain.path", "missing"),
        ({"platform__altitude_m": "high"}, "platform.altitude_m", "not 'high'"),
        ({"platform__altitude_m": "50"}, "platform.altitude_m", "not '50'"),
        ({"platform__altitude_m": True}, "platform.altitude_m", "not True"),
        ({"platform__altitude_m": float("nan")}, "platform.altitude_m", "not nan"),
        ({"platform__altitude_m": float("inf")}, "platform.altitude_m", "not inf"),
        ({"platform__altitude_m": -5.0}, "platform.altitude_m", "must be greater than 0, not -5.0"),
        ({"platform__speed_mps": 0.0}, "platform.speed_mps", "not 0.0"),
        ({"platform__start_m": [1.0]}, "platform.start_m.1", "missing"),
        ({"platform__waypoints_m": [[0.0, 0.0]]}, "platform.waypoints_m", "at least two"),
        ({"platform__waypoints_m": [[0.0, 0.0], [0.0, 0.0]]}, "platform.waypoints_m", "follows itself"),
        (
            {"platform__waypoints_m": [[0.0, 0.0], [9.0, 0.0]], "platform__length_m": 50.0},
            "platform.waypoints_m",
            "contradicts length_m",
        ),
        ({"platform__profile": "full", "platform__takeoff_height_m": 60.0}, "platform.takeoff_height_m", "not below"),
        ({"radar__samples_per_chirp": 1024.0}, "radar.samples_per_chirp", "not 1024.0"),
        ({"radar__samples_per_chirp": 8}, "radar.samples_per_chirp", "not 8"),
        ({"radar__bandwidth_hz": 60e9}, "radar.bandwidth_hz", "not small against carrier_hz"),
        ({"radar__sweep": "sideways"}, "radar.sweep", "not 'sideways'"),
        ({"radar__snr_db": None}, "radar.snr_db", "missing"),
        ({"radar__noise_figure_db": 10.0}, "radar.snr_db", "contradicts"),
        ({"radar__snr_db": None, "radar__noise_figure_db": 10.0}, "radar.snr_db", "missing"),
        (
            {"radar__snr_db": None, "radar__transmit_power_dbm": 1.0},
            "radar.noise_figure_db",
            "missing, but required with transmit_power_dbm",
        ),
        ({"radar__antenna__beamwidth_deg": 0.0}, "radar.antenna.beamwidth_deg", "not 0.0"),
        ({"radar__antenna__beamwidth_deg": [2.0, 90.0]}, "radar.antenna.beamwidth_deg.1", "not 90.0"),
        ({"radar__antenna__side_lobe_db": -5.0}, "radar.antenna.side_lobe_db", "not -5.0"),
        ({"radar__scan__incidence_deg": 90.0}, "radar.scan.incidence_deg", "not 90.0"),
        ({"radar__scan__half_swath_deg": 95.0}, "radar.scan.half_swath_deg", "must stay below 90"),
        ({"radar__scan__stabilised": 1}, "radar.scan.stabilised", "not 1"),
        ({"radar__scan__side": "left"}, "radar.scan.side", "set mode = 'side_looking'"),
        ({"radar__scan__side": "up"}, "radar.scan.side", "not 'up'"),
        ({"tracing__engine": "magic"}, "tracing.engine", "'magic' is unknown; give one of sionna, gamma, path_solver"),
        ({"tracing__paths_per_pulse": 1}, "tracing.paths_per_pulse", "not 1"),
        ({"processing__window": "haan"}, "processing.window", "not a window of scipy"),
        ({"processing__cfar__kind": "XY"}, "processing.cfar.kind", "not 'XY'"),
        ({"processing__cfar__guard": 300}, "processing.cfar.guard", "do not fit 512 range cells"),
        (
            {"processing__cfar__false_alarm_probability": 1.0},
            "processing.cfar.false_alarm_probability",
            "not 1.0",
        ),
        ({"dem__spacing_m": 0.0}, "dem.spacing_m", "not 0.0"),
        ({"seed": -1}, "seed", "not -1"),
        ({"seed": 2**63}, "seed", "must be less than"),
        ({"terrain__material": "moss"}, "terrain.material", "add [materials.moss]"),
        ({"buildings": [{"position_m": [0.0, 0.0], "size_m": [1.0, 1.0]}]}, "buildings.0.size_m.2", "missing"),
        (
            {"buildings": [{"position_m": [0.0, 0.0], "size_m": [1.0, 1.0, 1.0], "material": "gold"}]},
            "buildings.0.material",
            "'gold' is not defined",
        ),
        ({"targets": [{"position_m": [0.0, 0.0], "rcs_dbsm": 500.0}]}, "targets.0.rcs_dbsm", "not 500.0"),
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
    with pytest.raises(ScenarioError, match=r"(?s)4 problems\n.*altitude_m: must be greater than 0, not -1\.0"):
        parse_scenario(data)


def test_a_wrong_entry_of_a_list_is_told_once():
    stand = {"polygon_m": [["x", 0.0], [1.0, 2.0], [3.0, 4.0]], "height_m": 1.0}
    found = problems(changed(vegetation=[stand | {"extinction_db_per_m": 1.0, "backscatter_db_per_m": 1.0}]))
    assert list(found) == ["vegetation.0.polygon_m.0.0"]


@pytest.mark.parametrize(
    ("widths", "field", "said"),
    [
        ([2.0, 90.0], "radar.antenna.beamwidth_deg.1", "must be at most 60"),
        ([2.0, 3.0, 4.0], "radar.antenna.beamwidth_deg", "must have at most 2 entries"),
        ("2 deg", "radar.antenna.beamwidth_deg", "must be a number without quotes"),
    ],
)
def test_a_list_where_a_number_may_stand_too_is_told_what_is_wrong_with_it_alone(widths, field, said):
    found = problems(changed(radar__antenna__beamwidth_deg=widths))
    assert list(found) == [field]
    assert said in found[field]


def test_a_key_of_another_model_is_not_its_own_remedy():
    slab = {"model": "sionna_itu", "itu_type": "concrete", "scattering_coefficient": 0.3, "motion": "water"}
    found = problems(changed(materials={"slab": slab}))
    assert found["materials.slab.motion"] == "unknown key; remove it or correct its spelling."


def test_whole_numbers_are_numbers():
    assert parse_scenario(changed(platform__altitude_m=50)).platform.altitude_m == 50.0


def test_a_scenario_is_frozen():
    scenario = parse_scenario(MIN)
    with pytest.raises(AttributeError, match=r"Scenario\.seed cannot be set"):
        scenario.seed = 3
    with pytest.raises(AttributeError, match="returns a changed copy"):
        scenario.radar.snr_db = 3.0


def test_the_resolved_scenario_holds_the_defaults():
    written = tomllib.loads(to_toml(parse_scenario(MIN)))
    assert written["radar"]["antenna"]["beamwidth_deg"] == 2.0
    assert written["processing"]["cfar"]["kind"] == parse_scenario(MIN).processing.cfar.kind
    assert Scenario.model_validate(written) == parse_scenario(MIN)


@pytest.mark.parametrize(
    ("keys", "field", "near"),
    [
        ({"radar__carier_hz": 77e9}, "radar.carier_hz", "Did you mean carrier_hz?"),
        ({"platfrom": {}}, "platfrom", "Did you mean platform?"),
        ({"radar__beamwidth_deg": 2.0}, "radar.beamwidth_deg", "Did you mean radar.antenna.beamwidth_deg?"),
        ({"radar__motion": "water"}, "radar.motion", "Did you mean materials.NAME.motion?"),
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


def test_a_recording_has_its_receiver_behind_it_but_for_the_high_pass():
    kept = recorded_settings({"radar.receiver.high_pass_corner_hz": 1e3}, "recording.nc")
    assert kept.radar.receiver.high_pass_corner_hz == 1e3
    with pytest.raises(ScenarioError, match=r"radar.receiver.oscillator: has no effect on recorded samples"):
        recorded_settings({"radar.receiver.oscillator.cubic_hz": 1e3}, "recording.nc")


@pytest.mark.parametrize(("quality", "paths"), [("fast", 256), ("normal", 512), ("fine", 1024)])
def test_quality_sets_the_number_of_rays_unless_it_is_given(quality, paths):
    scenario = load_scenario("hills", {"tracing.quality": quality})
    assert scenario.tracing.paths == paths
    again = parse_scenario(tomllib.loads(to_toml(scenario)))
    assert again.tracing.paths == paths
    assert load_scenario("hills", {"tracing.quality": quality, "tracing.paths_per_pulse": 99}).tracing.paths == 99


def star(points, step):
    """Return a star: each corner joined with the one `step` further on, crossing unless the step is one."""
    angle = 2 * np.pi * step * np.arange(points) / points
    return np.column_stack([40 * np.cos(angle), 30 * np.sin(angle)]).round(3).tolist()


COMB = [[0, 0], [0, 9], [1, 9], [1, 1], [2, 1], [2, 9], [3, 9], [3, 0]]
# A hole, joined to the outline by an edge to and fro.
KEYHOLE = [[0, 0], [9, 0], [9, 9], [0, 9], [0, 0], [3, 3], [3, 6], [6, 6], [6, 3], [3, 3]]
OUTLINES = {
    "stand": lambda corners: {"vegetation": [PLANTS | {"polygon_m": corners}]},
    "cover": lambda corners: {"terrain.cover": [{"polygon_m": corners, "material": "ground"}]},
}
PLANTS = {"height_m": 3.0, "extinction_db_per_m": 1.0, "backscatter_db_per_m": -10.0}


@pytest.mark.parametrize("table", OUTLINES)
@pytest.mark.parametrize("moved_m", [0.0, 5e6])
@pytest.mark.parametrize(
    "corners",
    [[[0, 0], [9, 0], [0, 9]], star(7, 1), star(7, 1)[::-1], COMB, KEYHOLE, [[0, 0], [9, 0], [9, 9], [0, 9], [0, 0]]],
)
def test_outlines_that_do_not_cross_are_taken(table, moved_m, corners):
    outline = [(x + moved_m, y + moved_m) for x, y in corners]
    scenario = load_scenario("hills", OUTLINES[table](outline))
    (taken,) = scenario.vegetation or scenario.terrain.cover
    assert list(taken.polygon_m) == outline


@pytest.mark.parametrize("table", OUTLINES)
@pytest.mark.parametrize("moved_m", [0.0, 5e6])
@pytest.mark.parametrize(
    ("corners", "words"),
    [
        ([[0, 0], [10, 10], [10, 0], [0, 10]], "the edges after corners 1 and 3 cross"),
        ([[0, 0], [10, 0], [0, 10], [10, 10]], "the edges after corners 2 and 4 cross"),
        (star(5, 2), "the edges after corners 1 and 3 cross"),
        (star(9, 4), "cross; give the corners in their order around the outline"),
        ([*COMB[:-1], [3, 5], [-1, 4]], "cross"),
        ([[0, 0], [1, 1], [2, 2]], "encloses no area"),
        ([[5, 5], [5, 5], [5, 5]], "encloses no area"),
    ],
)
def test_outlines_that_cross_or_enclose_nothing_are_refused(table, moved_m, corners, words):
    with pytest.raises(ScenarioError, match=words) as caught:
        load_scenario("hills", OUTLINES[table]([[x + moved_m, y + moved_m] for x, y in corners]))
    assert caught.value.problems[0].field in ("vegetation.0.polygon_m", "terrain.cover.0.polygon_m")


@pytest.mark.parametrize("key", ["attitude_constant_deg", "attitude_white_deg", "attitude_markov_deg"])
@pytest.mark.parametrize("value", [31.0, 80.0, [0.0, 0.0, 90.0]])
def test_errors_of_attitude_are_small_angles(key, value):
    load_scenario("hills", {f"platform.navigation.{key}": 30.0})
    with pytest.raises(ScenarioError, match=rf"{key}.*must be at most 30"):
        load_scenario("hills", {f"platform.navigation.{key}": value})


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"platform.navigation.boresight_error_deg": [0.0, -45.0, 0.0]}, "must be at least -30"),
        (
            {"processing.navigation": "refined", "processing.refined_navigation.attitude_deg": 80.0},
            "attitude_deg.*must be at most 30",
        ),
        ({"targets": [{"position_m": [0, 0], "height_m": 1e9, "rcs_dbsm": 0}]}, "height_m: must be at most 100000"),
    ],
)
def test_values_beyond_what_flies_are_refused(keys, words):
    with pytest.raises(ScenarioError, match=words):
        load_scenario("hills", keys)
