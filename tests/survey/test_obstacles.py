"""Wires, poles and targets that are flown over: identities, what hides them, reports, and the same bits everywhere."""

from pathlib import Path
from typing import Any

import numpy as np
import pyogrio
import pytest
from scipy.constants import speed_of_light
from scipy.special import gammaln
from scipy.stats import ncx2

from sionna_radar.accuracy.obstacles import SeenObstacle
from sionna_radar.execution.execution import Execution
from sionna_radar.report.survey.products import write_survey
from sionna_radar.report.survey.summary import summary
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.reprocessing import process
from sionna_radar.survey.result import Survey
from sionna_radar.tracing.paths import FIRST_OBSTACLE

pytestmark = pytest.mark.usefixtures("rough_errors")

AHEAD: dict[str, Any] = {
    "seed": 3,
    "terrain": {"kind": "hills", "size_m": [700.0, 300.0], "spacing_m": 2.0, "filter_sigma_m": 30.0, "height_m": 1.5},
    "platform": {"altitude_m": 20.0, "speed_mps": 10.0, "length_m": 170.0, "start_m": [-150.0, 0.0]},
    "radar": {
        "bandwidth_hz": 300e6,
        "chirp_rate_hz": 1390.0,
        "samples_per_chirp": 512,
        "transmit_power_dbm": 12.0,
        "noise_figure_db": 12.0,
        "antenna": {"beamwidth_deg": 3.0},
        "scan": {"mode": "conical", "incidence_deg": 75.0, "half_swath_deg": 12.0, "rotation_rpm": 1200.0},
    },
    "processing": {"echoes": "all"},
    "dem": {"method": "linear", "spacing_m": 2.0},
    "tracing": {"paths_per_pulse": 256},
    "wires": [{"points_m": [[30.0, -60.0, 13.0], [30.0, 61.0, 13.0]], "sag_m": 1.0, "diameter_mm": 10.0}],
    "poles": [{"position_m": [45.0, 4.0], "length_m": 16.0, "diameter_mm": 250.0}],
}


def ahead(**tables: object) -> Scenario:
    """A forward-looking radar that flies toward a wire and a pole."""
    return parse_scenario({**AHEAD, **tables})


@pytest.fixture(scope="module")
def survey() -> Survey:
    return run(ahead())


def test_wire_and_pole_are_seen_and_reported_seconds_ahead(survey: Survey) -> None:
    """Each by its name, from farther than 40 m, with nothing reported that is not there."""
    report = survey.obstacles
    assert report is not None
    assert report.reported is not None
    wire, pole = report.seen
    assert (wire.name, wire.kind, pole.name, pole.kind) == ("wires.0", "wires", "poles.0", "poles")
    for one in (wire, pole):
        assert one.seen
        assert one.hidden_by == ""
        assert one.first_range_m > 40
        assert one.looks >= one.visible > 10
        assert 0 < one.pd_look <= 1
        assert 3 < one.report_warning_s <= one.warning_s
        # Its first echo, at the speed of 10 m/s.
        assert one.warning_s == pytest.approx(one.first_range_m / 10, rel=0.1)
        assert abs(one.height_error_m) < 1.5
    assert sorted(report.of) == [0, 1]
    rates = report.rates()
    assert rates["pd_wire"] == rates["pd_obstacle"] == 1.0
    assert rates["false_alarms_per_km2"] == rates["false_alarms_per_minute"] == 0.0
    assert rates["warning_s"] == min(wire.report_warning_s, pole.report_warning_s)
    # The highest echo of a wire 14 to 15 m up.
    assert report.reported.above_m[list(report.of).index(0)] == pytest.approx(14, abs=4)


def test_map_is_made_without_what_hangs_over_it(survey: Survey) -> None:
    """As accurate as of the same ground without them; with their echoes it is not."""
    bare = run(ahead(wires=[], poles=[]))
    spoilt = run(ahead(processing={"echoes": "all", "obstacles": {"report": False}}))
    assert bare.obstacles is None
    assert spoilt.obstacles is not None
    assert spoilt.obstacles.reported is None
    assert survey.lit_error.rms_m < 1.5 * bare.lit_error.rms_m
    assert spoilt.lit_error.rms_m > 2 * survey.lit_error.rms_m


def test_wires_hide_nothing_and_do_not_change_the_ground(survey: Survey) -> None:
    """Paths of surfaces, and the true surface, are those without them."""
    bare = prepare(ahead(wires=[], poles=[]))
    pulses = [100, 700, 1100]
    with_wires = survey.prepared.paths(pulses)
    ground = with_wires.rows(with_wires.surface > FIRST_OBSTACLE)
    np.testing.assert_array_equal(ground.gain, bare.paths(pulses).gain)
    assert len(ground) < len(with_wires)
    np.testing.assert_array_equal(survey.truth.height_m, bare.truth.surface.height_m)


def test_range_rate_of_a_wire_is_that_of_its_places(survey: Survey) -> None:
    """Delays over a short time change by the range rate."""
    schedule = survey.prepared.flight
    index = np.arange(1000, 1060)
    block = schedule.pulses(index)
    paths = survey.prepared.paths(index)
    wire = paths.rows(paths.surface == FIRST_OBSTACLE)
    assert len(wire) > 20
    pose = block.true.rows(block.row_of(wire.pulse))
    away = wire.hit_m - pose.position_m
    range_m = np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(wire.delay_s * speed_of_light / 2, range_m, atol=0.07)  # steps of an eighth of a cell
    np.testing.assert_allclose(wire.range_rate_mps, -np.sum(away * pose.velocity_mps, axis=1) / range_m, rtol=1e-6)


def test_alike_obstacles_side_by_side_do_not_hide_each_other() -> None:
    """Eight wires of one table or of eight return the same echoes, which are of wires, not of the ground."""
    line = {"diameter_mm": 20.0, "points_m": [[30.0, -60.0, 13.0], [30.0, 61.0, 13.0]]}
    east = 30.0 + 0.15 * (np.arange(8) - 3.5)
    eight = [{**line, "points_m": [[x, -60.0, 13.0], [x, 61.0, 13.0]]} for x in east]
    start = {"platform": {**AHEAD["platform"], "start_m": [-30.0, 0.0], "length_m": 40.0}, "poles": []}
    of_one, of_eight = (
        run(ahead(**start, wires=wires)).obstacles for wires in ([{**line, "count": 8, "spacing_m": 0.15}], eight)
    )
    assert of_one is not None
    assert of_eight is not None
    assert of_one.seen[0].echoes > 10
    assert sum(one.echoes for one in of_eight.seen) == pytest.approx(of_one.seen[0].echoes, rel=0.05)
    assert of_eight.rates()["false_alarms_per_km2"] == of_one.rates()["false_alarms_per_km2"]
    # One report holds the echoes of them all.
    assert of_one.reported is not None
    assert of_eight.reported is not None
    assert len(of_eight.reported) == len(of_one.reported) == of_one.rates()["pd_wire"] == 1
    heard = [one.echoes > 0 for one in of_eight.seen]
    assert of_eight.rates()["pd_wire"] == np.mean(heard) > 0.5


@pytest.mark.parametrize("sweep", ["up", "down", "triangular"])
def test_echo_off_the_axis_of_a_slow_sweep_is_of_its_target(sweep: str) -> None:
    """In a side lobe, where range rates differ by many cells of a sweep of 3 ms from those on the axis."""
    scan = {**AHEAD["radar"]["scan"], "rotation_rpm": 300.0}
    report = run(
        ahead(
            wires=[],
            poles=[],
            targets=[{"position_m": [-100.0, 0.0], "height_m": 6.0, "rcs_dbsm": 25.0}],
            platform={**AHEAD["platform"], "speed_mps": 20.0, "start_m": [-135.0, 0.0], "length_m": 20.0},
            radar={**AHEAD["radar"], "chirp_rate_hz": 347.0, "sweep": sweep, "scan": scan},
            processing={"echoes": "strongest" if sweep == "triangular" else "all", "obstacles": {"report": True}},
        )
    ).obstacles
    assert report is not None
    assert report.seen[0].looks == 0
    assert report.seen[0].echoes > 0
    assert report.rates()["pd_obstacle"] == 1.0
    assert report.rates()["false_alarms_per_km2"] == 0.0


def hidden_by(**tables: object) -> dict[str, str]:
    report = run(ahead(**tables)).obstacles
    assert report is not None
    return {one.name: one.hidden_by for one in report.seen}


def test_what_hid_an_obstacle_is_said() -> None:
    """Behind a wall, beyond the swath, too faint, and beneath the ground's own echo."""
    reasons = hidden_by(
        wires=[],
        buildings=[{"position_m": [20.0, 0.0], "size_m": [60.0, 4.0, 19.0]}],
        poles=[
            {"position_m": [26.0, 2.0], "length_m": 3.0, "diameter_mm": 100.0},
            {"position_m": [-20.0, 90.0], "length_m": 3.0, "diameter_mm": 100.0},
        ],
        targets=[
            {"position_m": [-40.0, 0.0], "height_m": 6.0, "rcs_dbsm": -60.0},
            {"position_m": [-45.0, 0.0], "height_m": 0.0, "rcs_dbsm": -34.0},
        ],
    )
    assert reasons == {
        "targets.0": "noise",
        "targets.1": "ground clutter",
        "poles.0": "shadow",
        "poles.1": "beam",
        "buildings.0": "",
    }


RAIN: dict[str, Any] = {"rain_rate_mm_per_h": 10.0}
# Before the wire is reached, 50 to 26 m away from it.
NEAR: dict[str, Any] = {"platform": {**AHEAD["platform"], "start_m": [-20.0, 0.0], "length_m": 24.0}}


@pytest.fixture(scope="module")
def in_rain(sketched_rain: None, tmp_path_factory: pytest.TempPathFactory) -> tuple[Survey, Path]:
    path = tmp_path_factory.mktemp("rain") / "signals.nc"
    return run(ahead(weather=RAIN, **NEAR), recordings={"signals": path}), path


@pytest.fixture(scope="module")
def rain_alone(sketched_rain: None) -> Survey:
    """The same flight without wire and pole."""
    return run(ahead(weather=RAIN, wires=[], poles=[], **NEAR))


def test_wire_is_reported_in_rain(in_rain: tuple[Survey, Path], rain_alone: Survey) -> None:
    """Where the beam meets it; the pole is 3 to 15 dB below the rain. The ground stays, a recording tells the same."""
    survey, path = in_rain
    report = survey.obstacles
    assert report is not None
    assert report.reported is not None
    rates = report.rates()
    assert rates["pd_wire"] == 1.0
    assert [one.hidden_by for one in report.seen] == ["", "rain"]
    assert rates["false_alarms_per_km2"] == 0.0
    assert rates["warning_s"] > 3
    assert survey.lit_error.rms_m < 1.3 * rain_alone.lit_error.rms_m
    read = process(path)
    assert read.obstacles is not None
    for name in ("position_m", "above_m", "probability", "report_pulse"):
        np.testing.assert_array_equal(getattr(read.obstacles, name), getattr(report.reported, name))


# Sweeps of 1.4 ms: the nearest drops fold at 3 m, and are spread by the window from there.
SLOW: dict[str, Any] = {
    "radar": {**AHEAD["radar"], "chirp_rate_hz": 695.0, "scan": {**AHEAD["radar"]["scan"], "rotation_rpm": 600.0}},
    "platform": {**AHEAD["platform"], "length_m": 20.0},
}


def check_rain_alone(scene: dict[str, Any], most: int, silent: Survey | None = None) -> None:
    """Nothing is reported, and all but a few echoes are those without a report.

    silent: the survey without a report; None to fly it.
    """
    reporting = run(ahead(**scene, processing={"echoes": "all", "obstacles": {"report": True}}))
    silent = silent or run(ahead(**scene))
    assert silent.scenario == ahead(**scene)
    assert reporting.obstacles is not None
    assert reporting.obstacles.reported is not None
    assert len(reporting.obstacles.reported) == 0
    last = np.append(np.diff(reporting.points.pulse) > 0, True)
    same = reporting.points.range_m[last] == silent.points.range_m
    assert same.mean() > 0.99
    assert np.count_nonzero(~last) <= most


def test_rain_alone_is_no_obstacle_and_ground_behind_it_stays(rain_alone: Survey) -> None:
    check_rain_alone({"wires": [], "poles": [], "weather": RAIN, **NEAR}, 1, rain_alone)


def test_near_drops_that_fold_are_not_taken_for_the_ground() -> None:
    """In sweeps of 2.9 ms, whose shift of 8 m folds the nearest drops, 30 dB above the ground, in front of it."""
    scan = {"mode": "conical", "incidence_deg": 40.0, "half_swath_deg": 30.0, "rotation_rpm": 300.0}
    radar = {"bandwidth_hz": 200e6, "chirp_rate_hz": 347.0, "antenna": {"beamwidth_deg": 6.0}, "scan": scan}
    survey = run(
        ahead(
            wires=[],
            poles=[],
            seed=1,
            weather={"rain_rate_mm_per_h": 3.0},
            platform={**AHEAD["platform"], "altitude_m": 25.0, "length_m": 20.0},
            radar={**AHEAD["radar"], **radar, "transmit_power_dbm": 0.0},
        )
    )
    assert len(survey.points) > 100
    assert survey.points.position_m[:, 2].max() < 5.0
    assert survey.lit_error.rms_m < 1.0


@pytest.mark.usefixtures("sketched_rain")
def test_rain_that_folds_is_no_obstacle_and_ground_behind_it_stays() -> None:
    rain = {"rain_rate_mm_per_h": 5.0}
    check_rain_alone({"wires": [], "poles": [], "seed": 2, "weather": rain, **SLOW}, 1)


@pytest.mark.study
@pytest.mark.parametrize("rate", [5.0, 20.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rain_over_a_whole_flight_is_no_obstacle(rate: float, seed: int) -> None:
    """`pytest -m study -k over_a_whole_flight`, over another seed and other rain each."""
    check_rain_alone({"wires": [], "poles": [], "seed": seed, "weather": {"rain_rate_mm_per_h": rate}}, 3)


def test_recording_and_workers_and_blocks_report_the_same(survey: Survey, tmp_path: Path) -> None:
    """Echoes, map and obstacles bit for bit, of a recording without the scene, too."""
    again = run(ahead(), recordings={"signals": tmp_path / "signals.nc"}, execution=Execution(block_size=256))
    read = process(tmp_path / "signals.nc")
    for other in (again.obstacles.reported if again.obstacles else None, read.obstacles):
        assert other is not None
        assert survey.obstacles is not None
        assert survey.obstacles.reported is not None
        for name in ("position_m", "above_m", "probability", "report_pulse"):
            np.testing.assert_array_equal(getattr(other, name), getattr(survey.obstacles.reported, name))
    assert again.points.sha256() == survey.points.sha256()
    assert again.obstacles is not None
    assert survey.obstacles is not None
    assert repr(again.obstacles.seen) == repr(survey.obstacles.seen)
    assert read.dem is not None
    np.testing.assert_array_equal(read.dem.height_m, survey.dem.height_m)


def test_files_hold_what_was_seen_and_reported(survey: Survey, tmp_path: Path) -> None:
    """A table of all obstacles, a GeoPackage of those reported that is the same when written again, and the numbers."""
    report = survey.obstacles
    assert report is not None
    assert report.reported is not None
    for folder in ("one", "two"):
        files = {path.name for path in write_survey(survey, tmp_path / folder)}
        assert {"objects.csv", "obstacles.gpkg"} <= files
    one, two = (tmp_path / folder / "obstacles.gpkg" for folder in ("one", "two"))
    assert one.read_bytes() == two.read_bytes()
    info, _, _, columns = pyogrio.raw.read(one)
    values = dict(zip(info["fields"], columns, strict=True))
    np.testing.assert_allclose(values["top_m"], report.reported.position_m[:, 2])
    np.testing.assert_allclose(values["probability"], report.reported.probability)
    rows = (tmp_path / "one" / "objects.csv").read_text().splitlines()
    assert rows[0].startswith("name,kind,seen,hidden_by,looks")
    assert [row.split(",")[0] for row in rows[1:]] == ["wires.0", "poles.0"]
    numbers = summary(survey)["obstacles"]
    assert numbers["pd_wire"] == 1.0
    assert numbers["seen"][0]["echoes"] == report.seen[0].echoes
    page = (tmp_path / "one" / "report.html").read_text()
    assert "Obstacles" in page
    assert "wires.0" in page


CELLS_AWAY = 67


def staring(rcs_dbsm: float, swerling: int) -> Scenario:
    """A radar that hardly moves and looks at a target in the air, in the middle of a range cell, over faint ground."""
    range_m = CELLS_AWAY * speed_of_light / (2 * 250e6)
    return parse_scenario(
        {
            "seed": 5,
            "terrain": {"kind": "flat", "size_m": [500.0, 400.0], "spacing_m": 10.0},
            "materials": {"ground": {"model": "constant_gamma", "gamma_db": -70.0}},
            "platform": {"altitude_m": 60.0, "speed_mps": 0.001, "length_m": 0.004, "start_m": [0.0, 0.0]},
            "radar": {
                "transmit_power_dbm": 10.0, "noise_figure_db": 12.0, "chirp_rate_hz": 500.0, "bandwidth_hz": 250e6,
                "samples_per_chirp": 512, "antenna": {"beamwidth_deg": 3.0},
                "scan": {"mode": "fixed", "incidence_deg": 60.0},
            },
            "processing": {
                "echoes": "all", "window": "boxcar", "zero_padding": 1, "dynamic_range_db": 60.0,
                "cfar": {"kind": "CA", "guard": 2, "training": 16, "false_alarm_probability": 1e-4},
            },
            "tracing": {"paths_per_pulse": 32},
            "targets": [
                {
                    "position_m": [range_m * np.sin(np.pi / 3), 0.0], "height_m": 60.0 - range_m / 2,
                    "rcs_dbsm": rcs_dbsm, "swerling": swerling,
                }
            ],
        }
    )  # fmt: skip


@pytest.mark.parametrize("swerling", [0, 2])
def test_pd_of_a_look_is_that_of_the_closed_form(swerling: int) -> None:
    """Of 2,000 looks at 12 dB, within four standard deviations of the count.

    Fluctuating: that of the package's CFAR (Gandhi and Kassam 1988). Steady: the non-central chi-squared tail over the
    gamma-distributed mean of 32 training cells.
    """
    snr = 10**1.2
    trial = prepare(staring(-30.0, 0))
    paths = trial.paths([0])
    power = float(np.abs(paths.gain[paths.surface == FIRST_OBSTACLE][0]) ** 2) * trial.receiver.transmit_power_w
    noise = 2 * trial.receiver.noise_power_w * float(np.sum(trial.mapper.analyser.window**2))
    survey = run(staring(-30.0 + 10 * np.log10(snr * noise / power), swerling))
    cfar = survey.prepared.instrument.detector.cfar
    if swerling:
        expected = float(cfar.detection_probability(np.array([snr]))[0])
    else:
        level, weight = np.polynomial.laguerre.laggauss(60)
        cells = 32
        density = np.exp((cells - 1) * np.log(level) - gammaln(cells))
        passed = ncx2.sf(2 * cfar.both_sides_factor * level / cells, 2, 2 * snr)
        expected = float(np.sum(weight * density * passed))
    report = survey.obstacles
    assert report is not None
    seen = report.seen[0]
    assert seen.visible == survey.pulses == 2000
    assert 0.3 < expected < 0.95
    assert seen.pd_look == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / 2000))


def over_ground(**tables: object) -> Scenario:
    """A radar that looks at a wire whose echo lies in range cells of the ground."""
    whole = staring(0.0, 0).model_dump(exclude_none=True)
    whole |= {"targets": [], "materials": {"ground": {"model": "constant_gamma", "gamma_db": -28.0}}}
    whole["platform"] |= {"altitude_m": 20.0}
    whole["radar"]["scan"]["incidence_deg"] = 62.0
    whole["radar"]["antenna"]["beamwidth_deg"] = 6.0
    whole["tracing"] |= {"paths_per_pulse": 512, "speckle": "per_pulse"}
    return parse_scenario({**whole, **tables})


def test_pd_of_a_wire_over_ground_is_that_of_a_monte_carlo() -> None:
    """A steady field and Gaussian ground and noise in each cell, held against the same threshold, 1,000 looks."""
    # In the middle of a cell, beside the axis, 1 m above the ground.
    range_m, height_m = 69 * speed_of_light / (2 * 250e6), 1.0
    x = float(np.sqrt(range_m**2 - (20.0 - height_m) ** 2))
    wire = {"points_m": [[x, -20.0, height_m], [x, 20.0, height_m]], "diameter_mm": 0.45}
    index = np.arange(0, 2000, 2)
    records = prepare(over_ground(wires=[wire])).spectra(index)
    bare = np.mean([record.power for record in prepare(over_ground(seed=77)).spectra(index)], axis=0)
    flown = prepare(over_ground(wires=[wire]))
    paths = flown.paths([0])
    own = paths.rows(paths.surface == FIRST_OBSTACLE)
    field = np.sum(own.gain * np.exp(-2j * np.pi * flown.receiver.chirp.carrier_hz * own.delay_s))
    level = flown.receiver.transmit_power_w * float(abs(field) ** 2)
    cell, cfar = 69, flown.instrument.detector.cfar
    assert 3 < level / bare[cell] < 60
    assert bare[cell] > 2 * np.median(bare)  # ground, not noise
    rng = np.random.default_rng(6)
    reach = cfar.guard + cfar.training
    around = bare[cell - reach : cell + reach + 1]
    drawn = np.sqrt(around / 2) * (rng.normal(size=(40_000, len(around))) + 1j * rng.normal(size=(40_000, len(around))))
    drawn[:, reach] += np.sqrt(level)
    power = np.abs(drawn) ** 2
    sides = np.concatenate([power[:, : cfar.training], power[:, -cfar.training :]], axis=1)
    expected = float(np.mean(power[:, reach] > cfar.both_sides_factor * sides.mean(axis=1)))
    passed = np.mean([record.power[cell] > record.threshold[cell] for record in records])
    assert 0.1 < expected < 0.95
    assert passed == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / len(index)))


def test_a_moving_target_behind_a_wall_is_looked_at_as_often_as_in_the_open() -> None:
    """The beam meets it in the same pulses, of which the wall hides those until the target has passed its end."""
    passing = {
        "position_m": [25.0, -4.0],
        "waypoints_m": [[25.0, 16.0]],
        "speed_mps": 3.0,
        "rcs_dbsm": 20.0,
        "height_m": 3,
    }
    wall = {"position_m": [-5.0, -20.0], "size_m": [50.0, 2.0, 30.0], "material": "ground"}
    tables = {
        "wires": [],
        "poles": [],
        "terrain": {"kind": "flat", "size_m": [700.0, 300.0]},
        "platform": {"altitude_m": 20.0, "speed_mps": 10.0, "length_m": 50.0, "start_m": [-65.0, 0.0]},
        "processing": {"echoes": "all", "obstacles": {"report": True}},
    }

    def seen(target: dict[str, Any], **more: object) -> SeenObstacle:
        report = run(ahead(**tables, targets=[target], **more)).obstacles
        assert report is not None
        return next(one for one in report.seen if one.kind == "targets")

    alone, behind = seen(passing), seen(passing, buildings=[wall])
    assert alone.looks == alone.visible > 10
    assert behind.looks == alone.looks
    assert 0 <= behind.visible < alone.visible
    slow = seen(passing | {"speed_mps": 0.2}, buildings=[wall])
    assert (slow.visible, slow.hidden_by) == (0, "shadow")
