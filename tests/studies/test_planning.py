"""Planned flights: their geometry, and whether they cover what was asked for when they are flown."""

import math

import numpy as np
import pytest
from scipy.spatial import KDTree

from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import load_scenario, parse_scenario
from sionna_radar.studies.planning.study import Wanted, check_plan, planned_scenario
from sionna_radar.studies.planning.study import plan as plan_flight
from sionna_radar.survey.observed_survey import observe_survey

LIDAR = {"sensor": "lidar"}


def flown_points(wanted: Wanted):
    plan = plan_flight(wanted)
    scenario = planned_scenario(plan).model_copy(update=LIDAR)
    return plan, observe_survey(scenario, execution=Execution(block_size=4096)).points(None).position_m


@pytest.mark.parametrize(
    "wanted",
    [
        Wanted(size_m=(60.0, 40.0), sampling_m=3.0),
        Wanted(size_m=(40.0, 150.0), sampling_m=4.0, altitude_m=30.0, half_swath_deg=35.0),
        Wanted(size_m=(50.0, 50.0), sampling_m=2.0, altitude_m=40.0, incidence_deg=20.0, most_rotation_rpm=120.0),
        Wanted(size_m=(30.0, 80.0), sampling_m=3.0, altitude_m=25.0, position_m=(120.0, -60.0), heading_deg=35.0),
    ],
    ids=["east", "north, lines", "slow antenna", "elsewhere, turned"],
)
def test_a_flown_plan_leaves_no_place_farther_than_the_sampling(wanted):
    plan, points = flown_points(wanted)
    east, north = wanted.size_m
    x, y = np.meshgrid(np.arange(-east / 2, east / 2 + 0.1, 0.5), np.arange(-north / 2, north / 2 + 0.1, 0.5))
    complex_place = (x + 1j * y) * np.exp(-1j * np.deg2rad(wanted.heading_deg)) + complex(*wanted.position_m)
    away, _ = KDTree(points[:, :2]).query(np.column_stack([complex_place.real.ravel(), complex_place.imag.ravel()]))
    # The middle of a square of echoes `sampling` apart is sampling / sqrt(2) from each.
    assert away.max() <= wanted.sampling_m / math.sqrt(2) + 1e-6
    assert plan.speed_mps <= wanted.speed_mps
    assert plan.rotation_rpm <= wanted.most_rotation_rpm + 1e-9


def test_the_radar_covers_what_it_planned():
    plan = plan_flight(Wanted(size_m=(40.0, 30.0), sampling_m=4.0))
    base = {"tracing": {"paths_per_pulse": 64}}
    scenario = planned_scenario(plan)
    scenario = parse_scenario(scenario.model_dump(mode="json", exclude_none=True) | base)
    survey = observe_survey(scenario)
    dem = survey.prepared.mapper.map(survey.points(None), None, survey.prepared.measured).dem
    x, y = dem.grid.centres_m.T
    inside = ((np.abs(x) < 20) & (np.abs(y) < 15)).reshape(dem.grid.shape)
    assert inside.sum() > 1000
    assert dem.filled[inside].all()
    assert np.sqrt(np.mean(dem.height_m[inside] ** 2)) < 0.3


@pytest.fixture(scope="module")
def level():
    plan = plan_flight(Wanted(size_m=(50.0, 30.0), sampling_m=3.0, position_m=(-40.0, 25.0), heading_deg=-20.0))
    return plan, check_plan(plan, planned_scenario(plan))


def test_a_plan_over_level_ground_holds_everywhere(level):
    plan, check = level
    assert check.coverage == 1.0
    # Lines of echoes lie nine tenths of the sampling apart; between two of them no place is better than this.
    assert 0.9 * 3.0 / math.sqrt(2) <= check.coarsest_m + 1e-6 <= 3.0
    assert check.sampling_of(0.5) < check.sampling_of(0.95) <= check.coarsest_m
    corners = check.place_m[[0, 0, -1, -1], [0, -1, 0, -1]]
    np.testing.assert_allclose(np.linalg.norm(corners - plan.wanted.position_m, axis=1), math.hypot(25.0, 15.0))
    np.testing.assert_allclose(np.linalg.norm(corners[1] - corners[0]), 50.0)


def test_what_the_terrain_takes_from_a_plan_is_told():
    """A wall 12 m high across the area: flown eastward, it throws a shadow of 12 m tan(tilt) / cos(scan angle)."""
    plan = plan_flight(Wanted(size_m=(50.0, 30.0), sampling_m=2.0, altitude_m=40.0))
    base = parse_scenario(
        {
            "terrain": {"kind": "flat"},
            "platform": {"altitude_m": 50.0, "speed_mps": 10.0},
            "radar": {"snr_db": 30.0},
            "buildings": [{"position_m": (0.0, 0.0), "size_m": (80.0, 1.0, 12.0)}],
        }
    )
    check = check_plan(plan, planned_scenario(plan, base))
    shadow = 12.0 * math.tan(plan.incidence_rad)
    # Places within sampling / sqrt(2) of the last and the first echo count as sampled; a line of echoes lies less
    # than a sample from each edge, and at the area's border the scan angle is 20.6 deg.
    least = (shadow - math.sqrt(2) * 2.0) / 50.0
    assert least < 1 - check.coverage < least + (2.0 + shadow * (1 / math.cos(math.radians(20.6)) - 1)) / 50.0
    x = check.place_m[..., 0]
    assert np.all((x[check.sampling_m > 2.0] > 0.5) & (x[check.sampling_m > 2.0] < 0.5 + 1.07 * shadow + 1.0))


def test_a_plan_over_hills_holds_too():
    base = load_scenario("hills", {"terrain.spacing_m": 2.0})
    plan = plan_flight(Wanted(size_m=(60.0, 40.0), sampling_m=3.0, position_m=(20.0, 10.0), heading_deg=30.0), base)
    scenario = planned_scenario(plan, base)
    assert scenario.terrain == base.terrain
    assert check_plan(plan, scenario).coverage > 0.99


def test_lines_overlap_as_asked():
    plan = plan_flight(Wanted(size_m=(300.0, 100.0), sampling_m=3.0, altitude_m=20.0, half_swath_deg=45.0))
    assert plan.swath_m == pytest.approx(40.0)
    # Three lines of 32 m each would not do; four are 25 m apart, and reach 7.5 m beyond the border on each side.
    assert plan.lines == 4
    assert plan.line_spacing_m == pytest.approx(25.0)
    assert (plan.lines - 1) * plan.line_spacing_m + plan.swath_m == pytest.approx(115.0)
    lines = np.array(plan.waypoints_m).reshape(-1, 2, 2)
    headings = np.sign(lines[:, 1, 0] - lines[:, 0, 0])
    np.testing.assert_array_equal(headings, [1, -1, 1, -1])
    legs = np.linalg.norm(np.diff(np.array(plan.waypoints_m), axis=0), axis=1)
    assert plan.flight_s == pytest.approx(legs.sum() / 10)


def test_a_slow_antenna_slows_the_flight():
    plan = plan_flight(Wanted(size_m=(50.0, 50.0), sampling_m=2.0, most_rotation_rpm=60.0))
    assert plan.rotation_rpm == pytest.approx(60.0)
    assert plan.speed_mps == pytest.approx(1.8)  # a turn a second, nine tenths of two metres apart
    slow = plan_flight(Wanted(size_m=(50.0, 50.0), sampling_m=2.0, most_chirp_rate_hz=300.0))
    assert slow.chirp_rate_hz == pytest.approx(300.0)
    assert slow.speed_mps < 10.0


@pytest.mark.parametrize("slope_deg", [0.0, 20.0, 30.0, 50.0, 70.0])
def test_slopes_stay_out_of_the_shadow(slope_deg):
    plan = plan_flight(Wanted(size_m=(50.0, 50.0), sampling_m=2.0, greatest_slope_deg=slope_deg))
    edge = math.acos(math.cos(plan.incidence_rad) * math.cos(plan.half_swath_rad))
    assert math.degrees(edge) <= max(90 - slope_deg - 5, 0) + 1e-6
    assert plan.half_swath_rad > 0


def test_the_beam_is_no_wider_than_two_samples():
    plan = plan_flight(Wanted(size_m=(50.0, 50.0), sampling_m=2.0))
    slant = plan.altitude_m / math.cos(plan.incidence_rad)
    # The width of the array as built, which meets the 2 deg asked for to a millionth or two.
    width = build_antenna(planned_scenario(plan).radar.antenna).beamwidths_rad[1]
    assert width == pytest.approx(math.radians(2.0), rel=5e-6)
    assert slant * width <= 4.0 + 1e-9
    assert plan.altitude_m == pytest.approx(4.0 * math.cos(plan.incidence_rad) ** 2 / width)


def test_a_high_flight_gets_the_samples_it_needs():
    plan = plan_flight(Wanted(size_m=(50.0, 50.0), sampling_m=5.0, altitude_m=200.0))
    assert plan.samples_per_chirp >= 4096
    farthest = 200.0 / math.cos(plan.incidence_rad) / math.cos(plan.half_swath_rad)
    assert planned_scenario(plan).radar.max_range_m > farthest


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"size_m": (0.0, 5.0)}, "area, east"),
        ({"size_m": (50.0, 1e-6)}, "area, north"),
        ({"sampling_m": -1.0}, "sampling"),
        ({"overlap": 0.95}, "overlap"),
        ({"altitude_m": 0.0}, "altitude"),
        ({"most_rotation_rpm": 0.0}, "most-rpm"),
        ({"most_rotation_rpm": math.nan}, "most-rpm"),
        ({"most_chirp_rate_hz": -0.0}, "most-chirps"),
        ({"speed_mps": 5e-324}, "speed"),
        ({"heading_deg": math.inf}, "heading"),
    ],
)
def test_what_cannot_be_planned_is_refused_by_its_name(wrong, field):
    with pytest.raises(ScenarioError, match=f"{field}: .* must be at least"):
        plan_flight(Wanted(**({"size_m": (50.0, 50.0), "sampling_m": 2.0} | wrong)))
