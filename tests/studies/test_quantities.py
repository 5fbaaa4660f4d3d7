"""Named quantities against closed forms and what is flown; expressions over them, and what they refuse."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sionna_radar.flight.build import build_scan
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.windows import taylor
from sionna_radar.radar.build import build_antenna
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.design.plan import RESULTS
from sionna_radar.studies.planning.study import Wanted, planned_scenario
from sionna_radar.studies.planning.study import plan as plan_flight
from sionna_radar.studies.sweep.costs import read_costs
from sionna_radar.studies.sweep.expressions import check_consistent, check_names, parse_expression, parse_requirement
from sionna_radar.studies.sweep.quantities import QUANTITIES, Area, quantities_of, taylor_aperture_m
from sionna_radar.survey.preparation import prepare

H, V = 50.0, 10.0


def hills(**keys):
    return load_scenario("hills", {key.replace("__", "."): value for key, value in keys.items()})


@pytest.mark.parametrize("side_lobe_db", [-20.0, -30.0])
@pytest.mark.parametrize("beam_deg", [1.0, 4.0])
def test_the_aperture_has_the_beam_it_is_sized_for(beam_deg, side_lobe_db):
    """The pattern of a Taylor line of that length, summed element by element, falls to half its power there."""
    wavelength, count = speed_of_light / 77e9, 801
    length = taylor_aperture_m(math.radians(beam_deg), side_lobe_db, wavelength)
    nbar = max(2, math.ceil(2 * (math.acosh(10 ** (-side_lobe_db / 20)) / math.pi) ** 2 + 0.5))
    weights = taylor(count, nbar, -side_lobe_db)
    place = (np.arange(count) - (count - 1) / 2) / count * length
    voltage = weights @ np.cos(2 * np.pi * place / wavelength * math.sin(math.radians(beam_deg / 2))) / weights.sum()
    assert voltage**2 == pytest.approx(0.5, rel=0.02)  # the closed form is that of many side lobes


def test_a_degree_at_77_ghz_takes_a_quarter_of_a_metre():
    assert quantities_of(hills(radar__antenna__beamwidth_deg=1.0))["aperture_m"] == pytest.approx(0.22, abs=0.04)


def test_quantities_of_a_whisk_broom_scan():
    found = quantities_of(hills(radar__snr_db=None, radar__transmit_power_dbm=30.0, radar__noise_figure_db=12.0))
    share, rpm, half = 50 / 180, 120.0, math.radians(50)
    assert found["pulses_per_s"] == pytest.approx(360 * share)
    assert found["data_rate_mbps"] == pytest.approx(360 * share * 1024 * 16 * 1e-6)
    assert found["transmit_power_w"] == pytest.approx(1.0 * share)
    assert found["swath_m"] == pytest.approx(2 * H * math.tan(half))
    assert found["area_per_hour_km2"] == pytest.approx(found["swath_m"] * V * 3600 / 1e6)
    assert found["line_gap_m"] == pytest.approx(V * 60 / rpm)
    assert found["flying_time_s"] == pytest.approx(100 / V)


@pytest.mark.parametrize("mode", ["whisk_broom", "conical"])
def test_swath_and_dwell_are_those_of_the_scan(mode):
    scenario = hills(radar__scan__mode=mode)
    scan = build_scan(scenario.radar.scan)
    time = np.arange(0.0, 0.5, 1e-4)
    pointing = scan.point(time)
    beam = pointing.R_mount_antenna[:, :, 0]
    active = pointing.active
    aside = np.abs(H * beam[active, 1] / np.abs(beam[active, 2]))
    found = quantities_of(scenario)
    assert found["swath_m"] == pytest.approx(2 * aside.max(), rel=3e-3)
    step = np.arccos(np.clip(np.sum(beam[1:] * beam[:-1], axis=1), -1, 1)).mean() / 1e-4
    assert found["dwell_s"] == pytest.approx(math.radians(2.0) / step, rel=0.01)


@pytest.mark.parametrize("look", ["forward", "left", "right"])
def test_the_swath_of_an_electronic_scan_is_where_its_beams_meet_the_ground(look):
    array = {"kind": "array", "elements": [32, 16]}
    scenario = hills(radar__antenna=array, radar__scan={"mode": "electronic", "look": look, "incidence_deg": 35.0})
    scan = build_scan(scenario.radar.scan)
    axes = scan.point(np.arange(scan.beams) / (scan.beams * scan.scans_per_s)).R_mount_antenna
    found = quantities_of(scenario)
    # Across the track the beams to a side are as wide as that in the middle; forward, their axes span the swath.
    edges = [0.0]
    if look != "forward":
        axes, half = axes[len(axes) // 2][None], build_antenna(scenario.radar.antenna).beamwidths_rad[1] / 2
        edges = [-half, half]
    beams = np.concatenate([np.cos(edge) * axes[:, :, 0] + np.sin(edge) * axes[:, :, 2] for edge in edges])
    aside = H * beams[:, 1] / beams[:, 2]
    assert found["swath_m"] == pytest.approx(np.ptp(aside), rel=1e-6)
    assert found["line_gap_m"] == pytest.approx(V / scan.scans_per_s)
    assert found["dwell_s"] == pytest.approx(1 / (scan.scans_per_s * scan.beams))
    assert found["aperture_m"] == pytest.approx(16 * speed_of_light / 77e9)


def test_lines_to_a_side_do_not_wait_for_a_beam_ahead():
    """A beam to the side meets the ground abeam: the lines are as long as the area, but for two gaps at each end."""
    found = quantities_of(hills(radar__scan__mode="side_looking"), Area(size_m=(300.0, 3.0), overlap=0.0))
    assert found["lines"] == 1
    assert found["flying_time_s"] * V == pytest.approx(300 + 4 * V / 360)


@pytest.mark.parametrize(("multiplexing", "at_once"), [("tdm", 1), ("ddm", 3)])
def test_quantities_of_a_module_are_those_of_its_frames(multiplexing, at_once):
    keys = {"preset": "ti_awr1843_array", "array": {"chirps": 32, "frame_rate_hz": 5.0, "multiplexing": multiplexing}}
    found = quantities_of(load_scenario("hills", {"sensor": "mimo", "radar": keys}))
    chirps, wavelength = 3 * 32, speed_of_light / 77e9
    assert found["pulses_per_s"] == chirps * 5
    assert found["samples_per_s"] == chirps * 5 * 256 * 2 * 4
    assert found["transmit_power_w"] == pytest.approx(10**-1.8 * at_once * chirps * 5 / 16e3)
    assert found["line_gap_m"] == V / 5
    assert found["dwell_s"] == pytest.approx(chirps / 16e3)
    assert found["swath_m"] == pytest.approx(2 * H * math.tan(math.radians(50)))
    assert found["aperture_m"] == pytest.approx(2 * wavelength)


def test_quantities_of_a_lidar_are_those_of_its_scan():
    found = quantities_of(hills(sensor="lidar"))
    defined = {"pulses_per_s", "swath_m", "area_per_hour_km2", "lines", "flying_time_s", "line_gap_m"}
    assert {name for name, value in found.items() if math.isfinite(value)} == defined
    assert all("lidar" in QUANTITIES[name].undefined for name in found.keys() - defined)


@pytest.mark.parametrize("keys", [{"platform__bank_deg": 20.0}, {}])
def test_the_time_of_several_lines_is_that_of_their_flight(keys):
    lines = {"count": 2, "spacing_m": 20.0, "length_m": 40.0, "crossing": True}
    scenario = hills(platform__lines=lines, platform__length_m=None, platform__start_m=None, **keys)
    found = quantities_of(scenario)
    start_s, end_s = prepare(scenario).flight.trajectory.cruise_s()
    assert found["lines"] == 4
    assert found["flying_time_s"] == pytest.approx(end_s - start_s)


def test_every_scan_has_every_quantity_or_says_when_not():
    """Of each sensor and scan: a number, or undefined in the words of the table."""
    array, electronic = {"kind": "array", "elements": [16, 8]}, {"mode": "electronic", "look": "left"}
    scans = [{"radar__scan__mode": mode} for mode in ("whisk_broom", "conical", "fixed", "side_looking")]
    scans.append({"radar__antenna": array, "radar__scan": electronic})
    power = {"radar__snr_db": None, "radar__transmit_power_dbm": 10.0, "radar__noise_figure_db": 12.0}
    for scan in scans:
        for area in (None, Area(size_m=(500.0, 300.0))):
            assert all(value > 0 for value in quantities_of(hills(**scan, **power), area).values())
    flat = quantities_of(hills(radar__scan__mode="conical", radar__scan__incidence_deg=0.0))
    assert math.isnan(flat["swath_m"])
    assert "incidence 0" in QUANTITIES["swath_m"].undefined


def test_the_page_lists_the_quantities(cli):
    page = (Path(__file__).parents[2] / "docs" / "design.md").read_text()
    rows = [f"| `{name}` | {entry.unit} | {entry.formula} |" for name, entry in QUANTITIES.items()]
    assert "\n".join(rows) in page
    shown = cli("design", "--help").stdout
    assert [name for name in (*QUANTITIES, *RESULTS) if name not in shown] == []


def test_what_a_scenario_leaves_open_is_undefined():
    assert math.isnan(quantities_of(hills())["transmit_power_w"])
    assert all(entry.formula and entry.unit for entry in QUANTITIES.values())


def test_flying_time_over_an_area_is_that_of_the_plan():
    wanted = Wanted(size_m=(400.0, 300.0), sampling_m=2.0, altitude_m=40.0, overlap=0.2)
    plan = plan_flight(wanted)
    found = quantities_of(planned_scenario(plan), Area(size_m=wanted.size_m, overlap=wanted.overlap))
    assert found["lines"] == plan.lines
    assert found["flying_time_s"] == pytest.approx(plan.flight_s, rel=0.01)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2 * rms_m + 1", 1.4),
        ("radar.antenna.beamwidth_deg ** 2 / -4", -1.0),
        ("max(rms_m, 1, 0.5) - min(3, 2)", -1.0),
        ("sqrt(abs(-4)) + log10(100) + log(exp(1))", 5.0),
    ],
)
def test_expressions_are_arithmetic(text, value):
    found = parse_expression(text, "--minimise").value({"rms_m": 0.2, "radar.antenna.beamwidth_deg": 2})
    assert found == pytest.approx(value)


def test_expressions_take_arrays_and_name_what_they_need():
    expression = parse_expression("a.b * rms_m + max(mass_kg, 1) - rms_m", "--minimise")
    assert expression.names == ("a.b", "rms_m", "mass_kg")
    values = {"a.b": np.array([1.0, 2.0]), "rms_m": 0.5, "mass_kg": np.array([0.0, 3.0])}
    assert expression.value(values) == pytest.approx([1.0, 3.5])


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "rms_m.__class__()",
        "[1, 2]",
        "'text'",
        "rms_m if 1 else 2",
        "lambda: 1",
        "open(1)",
        "sqrt(1, 2)",
        "max()",
        "1 <",
        "True + 1",
        "(" * 300 + ")" * 300,
        "1 +" * 400,
        "x := 3",
        "rms_m * " + "7" * 320,
        "rms_m + 3e400",
    ],
)
def test_whatever_else_is_refused(text):
    with pytest.raises(ScenarioError, match="--minimise"):
        parse_expression(text, "--minimise")


def test_no_number_is_too_large():
    assert np.isinf(parse_expression("9 ** 9 ** 9 ** 9", "--minimise").value({}))


@pytest.mark.parametrize(("text", "holds"), [("rms_m < 0.1", 0.02), ("coverage > 0.9", -0.1), ("0.9 < coverage", -0.1)])
def test_the_margin_of_a_condition_is_positive_where_it_holds(text, holds):
    requirement = parse_requirement(text)
    assert requirement.margin({"rms_m": 0.08, "coverage": 0.8}) == pytest.approx(holds)


def test_a_limit_relaxed_by_a_share_gives_way_by_it():
    values = {"rms_m": 0.1, "coverage": 0.8}
    assert parse_requirement("rms_m < 0.1").margin(values, 0.1) == pytest.approx(0.01)
    assert parse_requirement("coverage > 0.9").margin(values, 0.1) == pytest.approx(-0.01)


@pytest.mark.parametrize("text", ["rms_m", "rms_m == 1", "1 < rms_m < 2", "1 < 2", "rms_m <"])
def test_what_is_no_condition_is_refused(text):
    with pytest.raises(ScenarioError, match="--require"):
        parse_requirement(text)


def test_an_unknown_name_is_told_with_the_nearest():
    with pytest.raises(ScenarioError, match=r"rsm_m is no key.*Did you mean rms_m\?"):
        check_names(["rsm_m"], ["rms_m", "coverage"], "--require")


TOML = """
[antenna]  # an aluminium plate, 5 mm thick
mass_kg = "2700 * 0.005 * aperture_m ** 2"
price_eur = 100
[battery]
mass_kg = "flying_time_s / 3600"
"""
CSV = "component,mass_kg,price_eur\nantenna,2700 * 0.005 * aperture_m ** 2,100\nbattery,flying_time_s / 3600,\n"


@pytest.mark.parametrize(("name", "text"), [("costs.toml", TOML), ("costs.csv", CSV)])
def test_costs_are_summed_over_components(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    costs = read_costs(tmp_path / name)
    values = {"aperture_m": np.array([0.1, 0.2]), "flying_time_s": 1800.0}
    assert costs.names == ("mass_kg", "price_eur")
    assert set(costs.needs) == set(values)
    totals = costs.totals(values)
    assert totals["mass_kg"] == pytest.approx([0.635, 1.04])
    assert totals["price_eur"] == pytest.approx(100)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.toml", "mass_kg = 1"),
        ("a.toml", "[a]\nmass_kg = [1]"),
        ("a.toml", "[a]\n'mass kg' = 1"),
        ("a.toml", "[a"),
        ("a.toml", ""),
        ("a.toml", "[a]\nmass_kg = true"),
        ("a.csv", "component,mass_kg\na,1,2\n"),
        ("a.csv", "component,mass_kg\na,1\na,2\n"),
    ],
)
def test_what_is_no_table_of_costs_is_refused(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputFileError, match="--costs"):
        read_costs(tmp_path / name)


@pytest.mark.parametrize(
    "conditions",
    [
        ["le90_m < 0.3", "le90_m > 0.4"],
        ["0.5 < coverage", "coverage < 2 * 0.2"],
        ["rms_m < le90_m", "aperture_m < 1", "le90_m < std_m", "std_m < rms_m"],
        ["nmad_m < 0"],
        ["coverage_of_swath > 1"],
        ["rms_m / 2 > 1", "rms_m / 2 < 1"],
    ],
)
def test_requirements_that_contradict_each_other_are_refused(conditions):
    with pytest.raises(ScenarioError, match=r"contradict each other|can never hold"):
        check_consistent([parse_requirement(text) for text in conditions])


@pytest.mark.parametrize(
    "conditions",
    [
        ["le90_m > 0.3", "le90_m < 0.4"],
        ["mean_m > -0.1", "mean_m < 0"],
        ["rms_m < le90_m", "le90_m < 2 * rms_m", "rms_m < 0.1"],
        ["coverage > 0.99", "coverage_of_swath > 0.9"],
        ["log(0 * rms_m) < 1"],
        [],
    ],
)
def test_requirements_that_can_be_met_are_not(conditions):
    check_consistent([parse_requirement(text) for text in conditions])
