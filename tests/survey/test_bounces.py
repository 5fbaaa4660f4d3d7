"""Second bounces in a survey: what they need, and that without them nothing changes."""

import pytest

from sionna_radar import ScenarioError, load_scenario, prepare

SHORT = {
    "platform.length_m": 10.0,
    "platform.start_m": [-40.0, 0.0],
    "tracing.paths_per_pulse": 64,
    "tracing.bounces": 2,
}
SMOOTH_WALLS = {
    "model": "constant_gamma",
    "terrain_class": "city",
    "specular": True,
    "permittivity": [5.0, 0.2],
    "rms_height_m": 1e-4,
}


@pytest.mark.parametrize(
    ("scenario", "changes", "expected"),
    [
        ("buildings", {}, "specular = true"),
        ("buildings", {"tracing.engine": "gamma"}, "single bounces only"),
        (
            "buildings",
            {
                "materials.building": SMOOTH_WALLS,
                "vegetation": [
                    {
                        "polygon_m": [[0, 0], [5, 0], [5, 5]],
                        "height_m": 3.0,
                        "extinction_db_per_m": 1.0,
                        "backscatter_db_per_m": -20.0,
                    }
                ],
            },
            "through [[vegetation]]",
        ),
    ],
)
def test_what_two_bounces_need(scenario, changes, expected):
    with pytest.raises(ScenarioError) as failed:
        prepare(load_scenario(scenario, {**SHORT, **changes}))
    (problem,) = failed.value.problems
    assert problem.field == "tracing.bounces"
    assert expected in problem.message


def test_walls_that_reflect_will_do():
    prepared = prepare(load_scenario("buildings", {**SHORT, "materials.building": SMOOTH_WALLS}))
    paths = prepared.sensor_inputs().tracer().trace(prepared.flight.sample(20))
    assert (paths.surface == -4).any()
