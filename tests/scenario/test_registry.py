"""Registries: names, parameters and where they come from."""

import inspect
from typing import Annotated

import pytest
from pydantic import BaseModel, Field

from sionna_radar.foundation.errors import PluginError, ScenarioError
from sionna_radar.scenario import ScanParameters, load_scenario, to_toml
from sionna_radar.scenario.parts import ALL, DEM_METHODS, RANGE_ESTIMATORS, SCANS
from sionna_radar.scenario.registry import Entry, Registry
from sionna_radar.scenario.table import Parameters


class Gate(Parameters):
    width_m: Annotated[float, Field(gt=0)] = 2.0


@pytest.fixture
def gated(monkeypatch):
    """A range estimator with a parameter, known for one test."""
    for name in RANGE_ESTIMATORS.origins():  # a module that registers itself in the copy would be lost with it
        RANGE_ESTIMATORS.entry(name)
    monkeypatch.setattr(RANGE_ESTIMATORS, "_entries", dict(RANGE_ESTIMATORS._entries))
    RANGE_ESTIMATORS.entry("centroid")

    @RANGE_ESTIMATORS.register("gated", Gate)
    def build(parameters):
        return parameters

    yield
    RANGE_ESTIMATORS._entries.pop("gated")


@pytest.mark.parametrize("registry", ALL, ids=lambda registry: registry.kind)
def test_our_own_parts_come_by_the_same_door(registry):
    for name, origin in registry.origins().items():
        entry = registry.entry(name)
        assert entry.name == name
        assert origin == entry.origin == "sionna_radar"
        assert callable(entry.build.function)
        assert entry.facts.frame is None or callable(entry.facts.frame.function)


def test_facts_of_a_dem_method_are_those_of_the_method():
    for name in DEM_METHODS.origins():
        entry = DEM_METHODS.entry(name)
        assert entry.facts.profiles == entry(entry.check(None)).profiles


def test_parameters_are_filled_in_and_written_back(gated):
    scenario = load_scenario("hills", {"processing.ranging": "gated"})
    assert scenario.processing.ranging_parameters == Gate(width_m=2.0)
    wider = load_scenario("hills", {"processing.ranging": "gated", "processing.ranging_parameters.width_m": 3.0})
    assert wider.processing.ranging_parameters == Gate(width_m=3.0)
    assert "width_m = 3.0" in to_toml(wider)


def test_parameters_are_checked(gated):
    with pytest.raises(ScenarioError) as error:
        load_scenario("hills", {"processing.ranging": "gated", "processing.ranging_parameters.width_m": -1.0})
    assert str(error.value.problems[0]) == "processing.ranging_parameters.width_m: must be greater than 0, not -1.0"


def test_an_unknown_name_lists_what_is_known_and_where_from(gated):
    with pytest.raises(ScenarioError, match=r"model_fit, gated \(from the module .*test_registry\)") as error:
        load_scenario("hills", {"processing.ranging": "gatted"})
    assert str(error.value).endswith("Did you mean gated?")


def test_a_name_is_registered_once(gated):
    with pytest.raises(PluginError, match="range estimator 'gated' is registered already, by the module"):

        @RANGE_ESTIMATORS.register("gated", Gate)
        def another(parameters):
            return parameters

    with pytest.raises(PluginError, match="DEM method 'linear' is registered already, by sionna_radar"):
        DEM_METHODS.register("linear")(dict)


def test_a_cell_of_a_notebook_may_run_twice():
    registry = Registry("toy", {})
    for _ in range(2):

        def toy():
            return None

        registry.register("toy")(toy)
    assert list(registry.origins()) == ["toy"]


def test_a_table_that_would_let_a_misspelt_key_pass_is_refused():
    class Loose(BaseModel):
        width_m: float = 1.0

    with pytest.raises(PluginError, match=r"parameters Loose are not a sionna_radar.scenario.table.Table"):
        Registry("toy", {}).register("loose", Loose)(dict)
    with pytest.raises(PluginError, match=r"Gate are not a sionna_radar.scenario.bases.ScanParameters"):
        SCANS.register("gate", Gate)(dict)


def test_a_custom_table_is_chosen_by_its_tag(monkeypatch):
    class Spiral(ScanParameters):
        turns: Annotated[int, Field(ge=1)] = 3

    registry = Registry("scan", {}, ScanParameters)
    registry.register("spiral", Spiral)(dict)
    assert registry.entry("spiral").check({"mode": "spiral", "turns": 2}) == Spiral(mode="spiral", turns=2)


@pytest.mark.parametrize("name", ["", "none", "two words", "a\nb", "x" * 65])
def test_a_name_that_no_scenario_can_give_is_refused(name):
    with pytest.raises(PluginError, match="not a name; give letters"):
        inspect.unwrap(Registry.register)(Registry("toy", {}), name)


def test_a_part_without_a_table_of_its_kind_is_refused():
    with pytest.raises(PluginError, match="scan 'bare': it needs parameters; derive them from ScanParameters"):
        SCANS.register("bare")


def test_two_nameless_builders_are_two():
    registry = Registry("toy", {})
    registry.register("toy")(lambda: 1)
    with pytest.raises(PluginError, match="registered already"):
        registry.register("toy")(lambda: 2)


def test_a_custom_part_that_cannot_be_built_says_which_it_is():
    registry = Registry("toy", {})

    @registry.register("broken")
    def broken():
        message = "out of order"
        raise RuntimeError(message)

    with pytest.raises(
        PluginError, match=r"toy 'broken' \(the module .*\) cannot be built: RuntimeError: out of order"
    ):
        registry.entry("broken")(None)


def test_the_users_overrides_stay_as_they_were():
    overrides = {"radar.scan": {}, "radar.scan.incidence_deg": 30.0}
    load_scenario("hills", overrides)
    assert overrides == {"radar.scan": {}, "radar.scan.incidence_deg": 30.0}


def test_a_shipped_scene_gives_way_to_a_custom_scan(monkeypatch):
    class Spiral(ScanParameters):
        turns: int = 3

    monkeypatch.setitem(
        SCANS._entries, "spiral", Entry(kind="scan", name="spiral", parameters=Spiral, build=dict, origin="here")
    )
    assert load_scenario("hills", {"radar.scan.mode": "spiral"}).radar.scan == Spiral(mode="spiral")


def test_a_table_of_its_own_kind_ends_no_search(monkeypatch):
    class Node(Parameters):
        children: tuple["Node", ...] = ()

    monkeypatch.setitem(
        DEM_METHODS._entries, "tree", Entry(kind="DEM method", name="tree", parameters=Node, build=dict, origin="here")
    )
    with pytest.raises(ScenarioError, match=r"radar.snrdb: unknown key; .* Did you mean snr_db\?"):
        load_scenario("hills", {"radar.snrdb": 3.0})
