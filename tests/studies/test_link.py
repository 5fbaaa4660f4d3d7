"""A link budget: closed form against the chain, and against the radar equation by hand."""

import json

import numpy as np
import pytest
from scipy.constants import Boltzmann, speed_of_light

from sionna_radar.foundation.decibels import from_db
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.build import build_antenna
from sionna_radar.radar.equation import two_way_beam_sr
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.link import study as link_study
from sionna_radar.studies.link.document import DOCUMENT
from sionna_radar.studies.link.study import _survey_reach_m
from sionna_radar.studies.link.study import link_budget as run_link_budget
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from surveys import WEAK

pytestmark = pytest.mark.usefixtures("rough_errors", "sketched_rain")

# Whose probability of detection is no integral.
PLAIN = WEAK | {"processing.cfar.kind": "CA"}


@pytest.fixture(scope="module")
def budget():
    """A weak radar over hills' ground, in clear air and in rain; pulses of the survey's detector, which takes long."""
    scenario = load_scenario("hills", WEAK)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(link_study, "SURVEY_PULSES", 30)
        return run_link_budget(scenario, incidences_deg=[40.0], rains_mm_per_h=[0.0, 20.0], pulses=800)


def test_simulation_and_closed_form_agree(budget):
    clear, rain = budget.links
    assert budget.agrees
    assert budget.largest_difference_db < 0.3
    assert all(one.compared and not one.reason for link in budget.links for one in link.simulated)
    # Near and far, certain and doubtful: a share of pulses, and three of its standard deviations.
    assert clear.simulated[1].ground.passing < 0.9 < clear.simulated[0].ground.passing
    for one in (*clear.simulated, *rain.simulated):
        passing = one.ground.passing
        assert abs(one.passed - passing) < 3 * np.sqrt(passing * (1 - passing) / 800) + 0.02
        assert one.echo_passed >= one.passed


def test_signal_to_noise_is_the_radar_equation(budget):
    """A pencil beam's whole echo, spread as a Gaussian over range, and the share of it in a range cell."""
    clear, antenna, tilt = budget.links[0], build_antenna(budget.scenario.radar.antenna), np.deg2rad(40.0)
    noise_w = Boltzmann * 290.0 * from_db(15.0) * 512 * 360.0 / 2
    assert budget.noise_w == pytest.approx(noise_w)
    window = np.hanning(513)[:-1]
    widening = 512 * np.sum(window**2) / np.sum(window) ** 2
    cell_m, range_m = speed_of_light / 500e6, clear.range_m[-1]
    sigma0 = budget.scenario.all_materials["ground"].gamma * np.cos(tilt)
    area_m2 = range_m**2 * two_way_beam_sr(antenna) / np.cos(tilt)
    whole = 1e-3 * from_db(-12.0) * antenna.peak_gain**2 * (speed_of_light / 77e9) ** 2 / (4 * np.pi) ** 3
    whole *= sigma0 * area_m2 / range_m**4
    # Half-power widths: of the two-way beam across the plane, and of the window's response.
    width_m = np.hypot(range_m * np.tan(tilt) * np.deg2rad(2.0) / np.sqrt(2), 1.44 * cell_m) / 2.355
    in_cell = whole * widening * cell_m / (np.sqrt(2 * np.pi) * width_m)
    assert 10 * np.log10(clear.ground[-1].snr / (in_cell / (noise_w * 2 * widening / 512))) == pytest.approx(
        0.0, abs=0.4
    )


def test_rain_takes_and_adds(budget):
    clear, rain = budget.links
    assert np.all(clear.of_ground("clutter") == 0)
    assert np.all(rain.of_ground("clutter") > 0)
    loss_db = 10 * np.log10(clear.of_ground("snr") / rain.of_ground("snr"))
    # Twice the path at the specific attenuation of 20 mm/h at 77 GHz (ITU-R P.838: 10.5 dB/km).
    np.testing.assert_allclose(loss_db, 2 * 10.5e-3 * clear.range_m, rtol=0.1, atol=0.02)
    assert rain.cell_reach_m < clear.range_m[-1]
    assert budget.dynamic_range_db > 10


def test_rain_never_helps_to_detect_the_ground(budget):
    """Its own echo passes the CFAR, which reads less behind it; the ground is held against noise and rain in its cell.

    There a cell of speckle passes with the probability of a Swerling 1 target, 1 / (1 + signal / noise) of what noise
    alone takes, at the ratio of the ground to both.
    """
    clear, rain = budget.links
    assert np.all(rain.of_ground("detection") <= clear.of_ground("detection") + 1e-9)
    assert np.all(rain.of_ground("passing") >= rain.of_ground("false_alarm"))
    # At the farthest ranges rain alone passes more often than a false alarm of noise.
    assert rain.ground[-1].false_alarm > 100 * clear.ground[-1].false_alarm
    cfar = load_scenario("hills", WEAK).processing.cfar
    for one in rain.ground:
        ratio = one.snr / (1 + one.clutter)
        # Of a level known exactly; the CFAR's own scatter takes a few hundredths.
        assert one.detection <= cfar.false_alarm_probability ** (1 / (1 + ratio)) + 0.01


def test_a_reach_beyond_the_sampled_ranges_is_told(capsys):
    strong = PLAIN | {"radar.transmit_power_dbm": 40.0}
    budget = run_link_budget(load_scenario("hills", strong), incidences_deg=[20.0], rains_mm_per_h=[0.0], pulses=40)
    (link,) = budget.links
    assert link.reaches_the_end
    DOCUMENT.show(budget)
    said = capsys.readouterr().out
    assert f"{link.range_m[-1]:.0f}+" in said
    assert "the sampled ranges end there, not the reach" in said


@pytest.mark.parametrize(
    ("changes", "arguments", "says"),
    [
        ({"radar.antenna.polarization": "RHCP"}, {}, "radar.antenna.polarization"),
        ({"sensor": "lidar"}, {}, "sensor"),
        ({"tracing.engine": "path_solver"}, {}, "tracing.engine: 'path_solver' sends too few"),
        ({}, {"incidences_deg": [90.0]}, "incidence"),
        ({}, {"rains_mm_per_h": []}, "rain"),
        ({}, {"rains_mm_per_h": [1e-300]}, "rain: 1e-300 given; give 0, or rates from 1e-15"),
    ],
)
def test_what_has_no_link_budget_is_refused(changes, arguments, says):
    with pytest.raises(ScenarioError, match=says):
        run_link_budget(load_scenario("hills", WEAK | changes), **arguments)


def test_the_command_writes_numbers_table_and_figure(cli, small, tmp_path):
    # So few pulses compare with nothing: it may end with 1.
    done = cli("link", small, "--incidence", "45", "--rain", "0", "--pulses", "100", "-o", tmp_path / "link", code=None)
    names = {path.relative_to(tmp_path / "link").as_posix() for path in (tmp_path / "link").rglob("*.*")}
    assert names == {"link.json", "link.csv", "manifest.json", "figures/link.png", "figures/floors.png"}
    document = json.loads((tmp_path / "link" / "link.json").read_text())
    assert len(document["links"][0]["range_m"]) == 60
    assert "reach" in done.stdout
    columns = (tmp_path / "link" / "link.csv").read_text().splitlines()[0].split(",")[4:]
    assert columns == [*document["links"][0]["simulated"][0]][1:6]
    assert set(columns) < set(document["links"][0])
    cli("link", small, "--rain", "much", "-o", tmp_path / "none", code=2)


BUILT = {
    "radar.chirp_rate_hz": 4000.0,
    "platform.length_m": 1.0,
    "radar.transmit_power_dbm": 5.0,
    "radar.receiver.high_pass_corner_hz": 200e3,
    "radar.receiver.leakage": [{"delay_ns": 1.003, "level_db": -25.0}],
    "radar.receiver.converter.bits": 14,
    "radar.receiver.converter.full_scale_dbm": -12.0,
    "radar.receiver.oscillator.phase_noise_dbc_hz": [[1e3, -95.0], [1e6, -95.0]],
}


def test_floors_are_those_of_the_chain(monkeypatch):
    """Leakage, its phase noise, rounding, thermal noise and the phase noise of ground and rain, under the echo."""
    # The survey's detector takes longer than all else, and has tests of its own.
    monkeypatch.setattr(link_study, "_survey_detection", lambda *_: 1.0)
    budget = run_link_budget(
        load_scenario("hills", PLAIN | BUILT), incidences_deg=[60.0], rains_mm_per_h=[4.0], pulses=300
    )
    found = budget.floors
    assert set(found.terms) == {
        "thermal noise",
        "rounding of the converter",
        "leakage",
        "phase noise of the leakage",
        "phase noise of the echo",
    }
    every = found.ground + found.clutter + np.sum(list(found.terms.values()), axis=0)
    for low_m, high_m in ((0.1, 0.5), (1.0, 2.0), (5.0, 40.0), (85.0, 140.0)):
        band = (found.range_m > low_m) & (found.range_m < high_m)
        assert 10 * np.log10(found.found[band].sum() / every[band].sum()) == pytest.approx(0.0, abs=0.3)
    rulers = [name for name, *_ in found.rulers()]
    assert rulers[:2] == ["rounding of the converter", "leakage"]
    assert "phase noise of the leakage" in rulers
    assert budget.agrees


def test_echoes_below_a_step_of_the_converter_are_told(capsys):
    """A step of 2 A / 2^10, A of 10 dBm, over noise of -111 dBm: every sample is rounded to zero."""
    coarse = {"radar.receiver.converter.bits": 10, "radar.receiver.converter.full_scale_dbm": 10.0}
    budget = run_link_budget(
        load_scenario("hills", PLAIN | coarse), incidences_deg=[40.0], rains_mm_per_h=[0.0], pulses=100
    )
    DOCUMENT.show(budget)
    said = capsys.readouterr().out
    assert "rounding is no noise" in said
    assert "were not compared" in said
    assert "agree" not in said


@pytest.mark.parametrize("keys", [{"radar.stagger": 1.0}, {"radar.snr_db": 200.0, "radar.transmit_power_dbm": None}])
def test_uneven_intervals_and_no_noise_at_all_have_a_budget(keys):
    quiet = {"radar.noise_figure_db": None} if "radar.snr_db" in keys else {}
    scenario = load_scenario("hills", {**PLAIN, **keys, **quiet})
    budget = run_link_budget(scenario, incidences_deg=[40.0], rains_mm_per_h=[0.0], pulses=40)
    (link,) = budget.links
    assert not any(one.reason for one in link.simulated)
    assert np.all(np.isfinite(link.of_ground("snr")))
    assert np.all(np.isfinite(link.of_ground("detection")))


def test_behind_rain_the_survey_finds_what_link_says_it_does(capsys, monkeypatch):
    """A threshold in one cell tells ground from heavy rain seldom; the survey's detector nearly always, as flown."""
    monkeypatch.setattr(link_study, "SURVEY_PULSES", 60)
    still = {"terrain": {"kind": "flat", "size_m": [260.0, 160.0]}, "weather.rain_rate_mm_per_h": 20.0}
    still |= {"radar.samples_per_chirp": 512, "radar.scan": {"mode": "fixed", "incidence_deg": 30.0}}
    budget = run_link_budget(load_scenario("hills", still), incidences_deg=[30.0], rains_mm_per_h=[20.0], pulses=200)
    (link,) = budget.links
    for one in link.simulated:
        height_m = float(one.range_m) * np.cos(np.deg2rad(30.0))
        platform = {"altitude_m": height_m, "speed_mps": 8.0, "length_m": 2.0}
        flight = load_scenario("hills", still | {"platform": platform, "dem.method": "linear"})
        flown = run(flight)
        found = np.abs(flown.points.position_m[:, 2]) < 3 * flown.points.range_sigma_m + 0.3  # and a range cell
        share = np.unique(flown.points.pulse[found]).size / len(prepare(flight))
        assert one.ground.detection < 0.1
        assert share > 0.9
        assert one.survey_detection == pytest.approx(share, abs=0.1)
    assert link.cell_reach_m == 0.0
    assert link.survey_reach_m > 50.0
    DOCUMENT.show(budget)
    assert "survey: the survey's detector, simulated" in capsys.readouterr().out


def test_the_reach_is_up_to_where_the_probability_of_its_own_column_holds(budget):
    for link in budget.links:
        detection = link.of_ground("detection")
        assert np.all(detection[link.range_m <= link.cell_reach_m] >= 0.9)
        assert link.cell_reach_m == link.range_m[-1] or detection[link.range_m > link.cell_reach_m][0] < 0.9
        for one in link.simulated:
            assert (one.ground.detection >= 0.9) == (one.range_m <= link.cell_reach_m)
            assert (one.survey_detection >= 0.9) == (one.range_m <= link.survey_reach_m)


@pytest.mark.parametrize(("end_m", "reach_m"), [(0.5, 0.0), (7.2, 7.0), (13.0, 13.0), (29.0, 29.0), (99.0, 30.0)])
def test_the_reach_of_the_survey_is_found_by_bisection(end_m, reach_m):
    range_m = np.arange(1.0, 31.0)

    def detection(distance_m):
        return 0.95 if distance_m <= end_m + 1e-9 else 0.3

    known = {index: detection(range_m[index]) for index in (9, 20)}
    assert _survey_reach_m(range_m, known, detection) == reach_m
    assert np.isnan(_survey_reach_m(range_m, {9: np.nan, 20: 1.0}, detection))
