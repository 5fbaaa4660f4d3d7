"""What the tables say of their keys: the reference, the JSON Schema, and the scenario that `init` writes."""

import copy
import json
import re
import tomllib
from importlib import resources
from typing import Annotated

import jsonschema
import pytest
from pydantic import BaseModel, Field

from sionna_radar import Parameters, ScenarioError, parse_scenario, shipped_scenarios
from sionna_radar.scenario.recorded import DescribedRecording, RecordedRadar
from sionna_radar.scenario.reference import _WithMeanings, dotted_keys, meanings, reference, scenario_schema, sections
from sionna_radar.scenario.scenario import Scenario
from sionna_radar.scenario.table import unit_of

TEMPLATE = resources.files("sionna_radar.scenario").joinpath("template.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def validator():
    schema = scenario_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_every_key_of_every_table_says_what_it_means():
    for section in sections():
        assert section.about.rstrip().endswith("."), section
        silent = [key.name for key in section.keys if not key.meaning and key.name != "kind"]
        assert not silent, f"{section.place} {section.chosen}: {silent}"


PREPOSITIONS = {
    *("about", "above", "across", "after", "against", "along", "among", "as", "at", "before", "behind", "below"),
    *("beside", "besides", "between", "beyond", "by", "during", "for", "from", "in", "inside", "into", "like", "near"),
    *("of", "off", "on", "onto", "out", "over", "per", "since", "through", "to", "toward", "towards", "under", "until"),
    *("up", "upon", "via", "with", "within", "without", "instead", "which", "when", "where"),
}


def described_keys():
    """Yield every key of every table that editors see, of scenarios and of descriptions of recordings."""
    schemas = [scenario_schema()]
    schemas += [
        table.model_json_schema(schema_generator=_WithMeanings) for table in (DescribedRecording, RecordedRadar)
    ]
    waiting = [("scenario", schema) for schema in schemas]
    while waiting:
        name, node = waiting.pop()
        if isinstance(node, list):
            waiting += [(name, entry) for entry in node]
        if not isinstance(node, dict):
            continue
        waiting += node.items()
        if isinstance(node.get("properties"), dict):
            for key, entry in node["properties"].items():
                yield f"{node.get('title', name)}.{key}", entry.get("description", "")


def test_every_description_stands_alone_in_an_editors_hover():
    """An editor shows the description without its key: it needs its own noun, a capital letter and a full stop."""
    described = dict(described_keys())
    assert len(described) > 450
    broken = {
        key: text
        for key, text in described.items()
        if not text[:1].isupper()
        or text.split()[0].strip(",.:").lower() in PREPOSITIONS
        or not text.removesuffix(f" ({unit_of(key.rpartition('.')[2])})").endswith(".")
    }
    assert not broken


def test_every_meaning_is_a_sentence():
    """An entry that stands in the middle of another one takes its end away."""
    broken = {
        f"{section.place} {key.name}: {key.meaning}"
        for section in sections()
        for key in section.keys
        if key.meaning and (not key.meaning.rstrip().endswith(".") or key.meaning.count("(") != key.meaning.count(")"))
    }
    assert not broken


def test_every_number_has_a_unit_or_counts_something():
    """A number without a unit in its name is a ratio, an exponent, a count or a seed."""
    bare = {key.name for s in sections() for key in s.keys if re.match(r"(whole )?number", key.values) and not key.unit}
    counts = {"seed", "count", "samples_per_chirp", "guard", "training", "zero_padding", "beams", "paths_per_pulse"}
    counts |= {
        "high_pass_order",
        "anti_alias_order",
        "swerling",
        "levels",
        "element_exponent",
        "sinusoidal_periods",
        "bits",
        "blades",
        "points",
        "order",
        "bounces",
        "chirps",
        "receivers",
        "rounds",
        "wall_rounds",
        "estimation_rounds",
        "window_heights",
        "plant_types",
        "step_levels",
        "cells_before",
        "widths_before",
        "band",
        "wires",
        "strands",
        "sigmas",
        "rays",
        "max_returns",
        "frames",
        "full_well",
    }
    shares = {"hurst", "percentile", "scale", "rank", "false_alarm_probability", "least_reflectivity", "p1", "p2", "p3"}
    shares |= {"p4", "p5", "p6", "ground_reflectivity", "copolar_correlation", "scattering_coefficient"}
    shares |= {"xpd_coefficient", "water_fraction", "liquid_fraction", "specific_gravity", "side_lobe_share", "stagger"}
    shares |= {"reflectivity_ratio", "min_gain", "floor_share", "min_probability"}
    shares |= {"wall_slope", "wall_contrast", "wall_diagonal", "max_other_side"}
    shares |= {"height_spread", "missing", "water_content", "leaf_area_index"}
    shares |= {"efficiency", "excess_noise", "sun", "leaf_reflectivity"}
    assert bare <= counts | shares


@pytest.mark.parametrize(
    ("name", "unit"),
    [("speed_mps", "m/s"), ("max_gap_m", "m"), ("rcs_dbsm", "dB m²"), ("drift_ppm_per_k", "1e-6/K"), ("seed", "")],
)
def test_units_are_the_ends_of_names(name, unit):
    assert unit_of(name) == unit


def test_meanings_are_the_strings_under_fields():
    class Custom(Parameters):
        """A part.

        Examples
        --------
        None.
        """

        width_m: float = 1.0
        """Width of the window,
        all of it."""
        left: Annotated[int, Field(description="A side.")] = 0

    schema = Custom.model_json_schema(schema_generator=_WithMeanings)
    assert schema["description"] == "A part."
    about = {name: key["description"] for name, key in schema["properties"].items()}
    assert about == {"width_m": "Width of the window, all of it. (m)", "left": "A side."}


def test_the_reference_lists_every_field_with_its_default():
    text = reference()
    for key in dotted_keys():
        assert f"| `{key.rpartition('.')[2]}` |" in text
    assert "| `speed_mps` | number, more than 0 to 10000 | m/s | - | Ground speed. |" in text
    assert "| `carrier_hz` | number, 1e9 to 3e11 | Hz | `77000000000.0` |" in text

    def fields(table, prefix=""):
        for name, field in table.model_fields.items():
            yield prefix + name
            if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
                yield from fields(field.annotation, f"{prefix}{name}.")

    assert set(fields(Scenario)) <= {*dotted_keys(), *(k for k in fields(Scenario) if k.split(".")[0] == "materials")}


@pytest.mark.parametrize("name", shipped_scenarios())
def test_shipped_scenarios_fit_the_schema(name, validator):
    data = tomllib.loads(shipped_scenarios()[name].read_text(encoding="utf-8"))
    assert [error.message for error in validator.iter_errors(data)] == []


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("platform.altitude", 3.0),
        ("platform.altitude_m", -3.0),
        ("platform.altitude_m", "high"),
        ("radar.scan.mode", "wisk_broom"),
        ("terrain.kind", "hill"),
        ("processing.cfar.guard", 1.5),
        ("dem.shadow_incidence_deg", 91.0),
    ],
)
def test_the_schema_refuses_what_the_scenario_refuses(key, value, validator):
    data = tomllib.loads(shipped_scenarios()["hills"].read_text(encoding="utf-8"))
    table = data
    *places, last = key.split(".")
    for place in places:
        table = table.setdefault(place, {})
    table[last] = value
    assert not validator.is_valid(data)
    with pytest.raises(ScenarioError):
        parse_scenario(copy.deepcopy(data))


def test_resolved_scenarios_fit_the_schema(validator):
    data = parse_scenario(tomllib.loads(TEMPLATE)).model_dump(mode="json", exclude_none=True)
    assert [error.message for error in validator.iter_errors(json.loads(json.dumps(data)))] == []


def test_the_template_is_a_scenario_with_all_its_examples_too(validator):
    data = tomllib.loads(TEMPLATE)
    validator.validate(data)
    parse_scenario(data)
    # What contradicts something else in it stands behind two signs, or is tried alone.
    lines = [re.sub(r"^# (?=\[|[a-z_]+ = )", "", line) for line in TEMPLATE.splitlines()]
    alone = ("coordinates", "lines", "transmit_power_dbm", "noise_figure_db", "height =")
    together = tomllib.loads("\n".join(line for line in lines if not line.startswith(alone)))
    assert {"materials", "buildings", "targets", "weather"} <= set(together)
    parse_scenario(together)


def test_keys_complete():
    keys = dotted_keys()
    assert "radar.antenna.beamwidth_deg" in keys
    assert "dem.method" in keys
    assert not any("[" in key or "NAME" in key for key in keys)


class _Part(Parameters):
    width_m: float = 2.0
    """How wide
    it is."""
    height_m: float = Field(1.0, description="How high it is.")
    """Not this."""
    depth_m: float = 1.0


class _Wider(_Part):
    width_m: float = 3.0


def test_a_meaning_is_the_string_under_a_key_or_its_description():
    told = {
        name: entry.get("description")
        for name, entry in _Wider.model_json_schema(schema_generator=_WithMeanings)["properties"].items()
    }
    assert told == {"width_m": "How wide it is. (m)", "height_m": "How high it is. (m)", "depth_m": None}


def test_a_table_without_source_has_no_meanings():
    named: dict[str, type[Parameters]] = {}
    exec("class Sourceless(Parameters):\n    width_m: float = 2.0\n    'How wide.'", {"Parameters": Parameters}, named)
    assert meanings(named["Sourceless"]) == {}
