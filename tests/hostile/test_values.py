"""Values that no survey has: each class once, and a fuzzer over all keys. All end in a result or in one clear error."""

import math
import random
import warnings

import numpy as np
import pytest
from scipy.ndimage import binary_closing

from scenario_keys import keys_of, with_keys
from sionna_radar.foundation.errors import InputFileError, RadarError, ScenarioError
from sionna_radar.mapping.coverage import closed
from sionna_radar.scenario import Scenario, load_scenario, parse_scenario
from sionna_radar.scenario.overrides import parse_overrides
from sionna_radar.scene.build import build_world
from sionna_radar.studies.planning.study import Wanted
from sionna_radar.studies.planning.study import plan as plan_flight
from sionna_radar.survey import limits
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare

BASE = {
    "terrain": {"kind": "flat", "size_m": [300.0, 300.0], "spacing_m": 10.0},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 5.0, "start_m": [-60.0, 0.0]},
    "radar": {"snr_db": 30.0},
}


def said_of(keys: dict[str, object]) -> str:
    """What is said of a scenario up to its first pulse; nothing if it can be flown."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            prepare(parse_scenario(with_keys(BASE, keys)))
        except RadarError as error:
            str(error).encode("utf-8")
            return str(error)
    return ""


FOLLOWING = {"platform.height": "terrain_following"}
PERSISTENT = {"tracing.speckle": "persistent"}
ROUGH = {"model": "integral_equation", "permittivity": [4.0, 1.0], "rms_height_m": 0.001, "correlation_length_m": 0.01}


@pytest.mark.parametrize(
    ("keys", "field"),
    [
        ({"platform.speed_mps": 1e-9}, "platform.speed_mps"),
        ({"radar.chirp_rate_hz": 1e18}, "radar.chirp_rate_hz"),
        ({"radar.chirp_rate_hz": 1e7, "platform.length_m": 90.0, "platform.speed_mps": 5.0}, "platform.speed_mps"),
        ({"radar.chirp_rate_hz": 0.01}, "radar.chirp_rate_hz"),
        (FOLLOWING | {"platform.follow_length_m": 1e-9}, "platform.follow_length_m"),
        ({"terrain.spacing_m": 1e300}, "terrain.spacing_m"),
        ({"terrain.spacing_m": 1e9}, "terrain.spacing_m"),
        ({"terrain.spacing_m": 1e-9}, "terrain.spacing_m"),
        ({"terrain.size_m": [1e9, 1e9]}, "terrain.spacing_m"),
        (PERSISTENT | {"tracing.scatterers_per_m2": 1000.0, "radar.antenna.beamwidth_deg": 60.0}, "scatterers_per_m2"),
        (PERSISTENT | {"tracing.scatterers_per_m2": 9000.0}, "tracing.scatterers_per_m2"),
        ({"radar.samples_per_chirp": 2**18, "processing.zero_padding": 16}, "processing.zero_padding"),
        ({"radar.samples_per_chirp": 2**20, "processing.zero_padding": 16}, "radar.samples_per_chirp"),
        ({"radar.samples_per_chirp": 10**6, "processing.cfar.training": 200_000}, "processing.cfar.training"),
        (
            {"radar.samples_per_chirp": 2**17, "processing.cfar.training": 512, "processing.cfar.kind": "OS"},
            "processing.cfar.training",
        ),
        ({"processing.cfar.kind": "OS", "processing.cfar.rank": 1e-300}, "processing.cfar.rank"),
        ({"processing.dynamic_range_db": 4000.0}, "processing.dynamic_range_db"),
        ({"platform.navigation.position_constant_m": 1e6}, "platform.navigation.position_constant_m"),
        ({"materials.ground": ROUGH | {"rms_height_m": 1e300}}, "materials.ground.rms_height_m"),
        ({"materials.ground": ROUGH | {"correlation_length_m": 1e300}}, "materials.ground.correlation_length_m"),
        (
            {"materials.ground": {"model": "sionna_itu", "itu_type": "vacuum", "scattering_coefficient": 0.3}},
            "materials.ground.itu_type",
        ),
        ({"tracing.paths_per_pulse": 10_000_000}, "tracing.paths_per_pulse"),
        ({"dem.max_gap_m": 1e9}, "dem.max_gap_m"),
        ({"dem.spacing_m": 1e-9}, "dem.spacing_m"),
        ({"radar.bandwidth_hz": 1e5}, "radar.bandwidth_hz"),
        ({"processing.min_range_m": 3e6}, "processing.min_range_m"),
        ({"buildings": [{"position_m": [0.0, 40.0], "size_m": [9.0, 9.0, 3e7]}]}, "building-0"),
        ({"sensor": "lidar", "dem.method": "refined"}, "dem.method"),
        ({"radar.sweep": "triangular", "dem.method": "refined"}, "dem.method"),
        ({"radar.antenna.beamwidth_deg": 40.0, "processing.ranging": "model_fit"}, "processing.ranging"),
    ],
)
def test_what_would_cost_too_much_or_overflow_is_refused_before(keys, field):
    assert field in said_of(keys)


def test_gaps_that_the_scan_leaves_are_said_to_be_its_own():
    assert "without the key: as wide as the beams lie apart" in said_of({"radar.scan.rotation_rpm": 1e6})


@pytest.mark.parametrize("keys", [{}, PERSISTENT, {"radar.samples_per_chirp": 2**15}, {"dem.max_gap_m": 300.0}])
def test_what_a_survey_may_cost_passes(keys):
    assert said_of(keys) == ""


def test_a_remedys_value_works(monkeypatch):
    monkeypatch.setattr(limits, "MAX_CHIRPS", 100_000)  # a flight of 100 million is scheduled in 15 s
    said = said_of({"platform.speed_mps": 1e-6})
    value = float(said.partition("raise it to ")[2].partition(",")[0])
    assert "chirps" not in said_of({"platform.speed_mps": value})
    said = said_of(PERSISTENT | {"tracing.scatterers_per_m2": 9000.0})
    value = float(said.partition("lower it to ")[2].partition(",")[0])
    assert said_of(PERSISTENT | {"tracing.scatterers_per_m2": value}) == ""


def test_a_plan_of_too_many_chirps_is_refused_before_it_is_built():
    with pytest.raises(ScenarioError, match=r"sampling: 0\.05 m over 200 x 150 m takes .* chirps, more than"):
        plan_flight(Wanted(size_m=(200.0, 150.0), sampling_m=0.05))
    with pytest.raises(ScenarioError, match="sampling"):
        plan_flight(Wanted(size_m=(9e4, 9e4), sampling_m=1e-9))


@pytest.mark.parametrize("text", ["[" * 1000, "[" * 1000 + "]" * 1000, "{a=" * 1000 + "1" + "}" * 1000, "9" * 5000])
def test_deep_and_endless_values_are_refused(text, tmp_path):
    with pytest.raises(ScenarioError, match=r"radar\.snr_db") as caught:
        parse_overrides([f"radar.snr_db={text}"])
    assert len(str(caught.value)) < 500
    path = tmp_path / "deep.toml"
    path.write_text(f"a = {text}")
    with pytest.raises(InputFileError, match=r"deep\.toml: not valid TOML") as caught:
        load_scenario(path)
    assert len(str(caught.value)) < 500
    with pytest.raises((ScenarioError, InputFileError)):
        load_scenario("hills", {"a." * 1000 + "b": 1})


@pytest.mark.parametrize("name", ["surface-0", "surface-1", "a.b", "[/x]", "material-0", ""])
def test_any_name_of_a_material_is_flown(name):

    keys = {"materials": {name: {"model": "constant_gamma", "gamma_db": -20.0}}, "terrain.material": name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ready = prepare(parse_scenario(with_keys(BASE, keys)))
        paths = ready.sensor_inputs().tracer().trace(ready.flight.pulses(np.arange(2)))
    assert len(paths) > 100


@pytest.mark.parametrize("radius", [0, 1, 3, 10, 40])
def test_a_closing_is_that_by_a_disk(radius):
    cells = np.random.default_rng(radius).random((37, 51)) < 0.02
    offset = np.arange(-radius, radius + 1)
    disk = offset[:, None] ** 2 + offset[None] ** 2 <= radius**2
    plain = binary_closing(np.pad(cells, radius), disk)[radius : radius + 37, radius : radius + 51]
    np.testing.assert_array_equal(closed(cells, 2.0 * radius, 1.0), plain)
    assert not closed(np.zeros((3, 4), dtype=bool), 2.0 * radius, 1.0).any()


def test_polygons_take_no_more_than_their_own_vertices():
    square = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])
    cover = [
        {"polygon_m": (square + np.array([x, y])).tolist(), "material": "building"}
        for x in range(-100, 101, 20)
        for y in range(-100, 101, 20)
    ]
    terrain = {"terrain.spacing_m": 2.0, "terrain.cover": cover}
    scene = build_world(parse_scenario(with_keys(BASE, terrain)), (-150.0, -150.0, 150.0, 150.0)).scene
    assert len(scene.surfaces) == 1 + len(cover)
    vertices = sum(len(surface.vertices_m) for surface in scene.surfaces)
    assert vertices < 2 * 151**2


# ------------------------------------------------------------------------------------------------ fuzzer

WORDS = ("", "x", "none", "\0", "[/x]", "ä" * 200, "flat", "all", "refined", "triangular", "9" * 50)
NUMBERS = (
    0, 1, -1, 2, 7, 0.5, -0.0, 1e-300, 1e-15, 1e-9, 1e-3, 30.0, 89.9, 360.0, 1e3, 1e5, 1e9, 1e15, 1e30, 1e300,
    2**20, 2**31, 2**63 - 1, 10**30, math.nan, math.inf, -math.inf,
)  # fmt: skip


KEYS = [".".join(key) for key in keys_of(Scenario) if key not in (("terrain",), ("platform",), ("radar",))]


def any_value(chance: random.Random, depth: int = 0) -> object:
    kind = chance.random()
    if kind < 0.6:
        number = chance.choice(NUMBERS)
        return number * chance.choice((1, 1, 1, -1, 1.5)) if isinstance(number, float) else number
    if kind < 0.75:
        return chance.choice(WORDS)
    if kind < 0.8:
        return chance.choice((True, False, None))
    if depth > 3:
        return []
    if kind < 0.93:
        return [any_value(chance, depth + 1) for _ in range(chance.randrange(4))]
    return {chance.choice(("a", "kind", "model", "path")): any_value(chance, depth + 1)}


def scaled(chance: random.Random, value: object) -> object:
    """A default moved by some orders of magnitude, which comes farther than what is refused at once."""
    factor = 10.0 ** chance.choice((-6, -3, -1, 1, 3, 6))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    return int(value * factor) if isinstance(value, int) else value * factor


def default_of(key: str) -> object:
    node: object = parse_scenario(BASE)
    for name in key.split("."):
        node = getattr(node, name, None)
    return node


def fuzzed(seed: int) -> str:
    chance = random.Random(seed)
    keys = chance.sample(KEYS, chance.choice((1, 1, 2, 3)))
    # A table is replaced, or a key in it: not both.
    keys = [key for key in keys if not any(key.startswith(f"{other}.") for other in keys)]
    values = (scaled(chance, default_of(key)) if chance.random() < 0.5 else any_value(chance) for key in keys)
    return said_of(dict(zip(keys, values, strict=True)))


def is_a_result_or_one_clear_error(said: str) -> bool:
    """Nothing said of what can be flown; else short lines without a word of pydantic's or Python's."""
    return len(said) < 5000 and not any(word in said for word in ("Traceback", "pydantic", "validation error"))


@pytest.mark.parametrize("sensor", ["radar", "lidar"])
@pytest.mark.parametrize("key", ["rain_rate_mm_per_h", "snowfall_mm_per_h", "liquid_water_g_per_m3"])
def test_weather_is_none_or_enough_to_compute_with(key, sensor):
    flown = {"platform.length_m": 1.0, "sensor": sensor}
    for vanishing in (5e-324, 1e-300, 1e-16):
        with pytest.raises(ScenarioError, match=rf"weather.{key}: must be at least 1e-15, not .*"):
            load_scenario("hills", {**flown, f"weather.{key}": vanishing})
    run(load_scenario("hills", {**flown, f"weather.{key}": 1e-15}))


@pytest.mark.parametrize("tens", range(20))
def test_no_value_ends_in_anything_but_a_result_or_an_error(tens):
    assert all(is_a_result_or_one_clear_error(fuzzed(seed)) for seed in range(10 * tens, 10 * tens + 10))


@pytest.mark.study
@pytest.mark.parametrize("hundreds", range(50))
def test_no_value_of_many_ends_in_anything_but_a_result_or_an_error(hundreds):
    first = 1000 + 100 * hundreds
    assert all(is_a_result_or_one_clear_error(fuzzed(seed)) for seed in range(first, first + 100))
