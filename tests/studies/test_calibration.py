"""Calibration: what was put into a survey is found within what is stated, and what cannot be told is not invented.

The slow studies: `pytest -m study -n 0 -s tests/studies/test_calibration.py`; `SIONNA_RADAR_STUDY=folder` keeps what
was found, so that a study that was cut goes on. A quarter of an hour each on one core.
"""

import itertools
import json
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from calibration_surveys import (
    SPREAD,
    echoes_of,
    flight,
    ground_of,
    prepared_with,
    solved,
    solved_over_unknown_ground,
    straight,
    trial,
)
from sionna_radar import Raster, load_scenario, process, run
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.beam import beam_nodes
from sionna_radar.studies.calibration.document import DOCUMENT, calibration_page, calibration_toml
from sionna_radar.studies.calibration.estimation import Posterior, solve
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes, Readings
from sionna_radar.studies.calibration.recorded_echoes import DOPPLER_ERRORS, _range_rates
from sionna_radar.studies.calibration.study import PRIORS, USUAL, parse_deviations, parse_errors
from sionna_radar.studies.calibration.study import calibrate as run_calibration
from sionna_radar.studies.planning.study import calibration_flights
from sionna_radar.survey.recording_source import open_recording

ERRORS = {"roll": 0.4, "pitch": -0.5, "heading": 0.3, "time_offset": 5.0}


def recorded(folder: Path, overrides: dict, errors: dict = ERRORS) -> tuple[Path, Path, float]:
    """Record a survey with errors: its signals, the true ground, and the RMS of its DEM without errors."""
    changes = {**overrides, "dem.method": "linear"}
    survey = run(prepared_with(errors, changes), recordings={"signals": folder / "lines.nc"})
    survey.truth.to_geotiff(folder / "ground.tif")
    return folder / "lines.nc", folder / "ground.tif", run(load_scenario("hills", changes)).lit_error.rms_m


@pytest.fixture(scope="module")
def lines(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lines")
    return (*recorded(folder, flight(30.0, 3, 4, **{"radar.chirp_rate_hz": 200.0})), folder)


@pytest.fixture(scope="module")
def calibrated(lines):
    recording, ground, error_free_m, folder = lines
    return run_calibration([recording], ground), error_free_m, folder


def test_errors_are_found_within_what_is_stated(calibrated):
    result, _, _ = calibrated
    assert set(result.errors) == set(USUAL)
    for name, (value, sigma) in result.errors.items():
        assert abs(value - ERRORS.get(name, 0.0)) < 4 * sigma, name
    assert result.errors["roll"][1] < 0.02
    assert result.solution.model_holds
    assert not result.displaced
    assert result.warnings == ()
    # A beam that turns by its width from pulse to pulse sees other ground.
    assert "Doppler is not used" in result.doppler[0]


def test_the_map_is_nearly_that_of_a_survey_without_errors(calibrated):
    result, error_free_m, _ = calibrated
    before, after = result.recordings[0].error
    assert before.rms_m > 2 * error_free_m
    assert after.rms_m < 1.1 * error_free_m


@pytest.mark.usefixtures("undrawn")
def test_what_is_written_processes_the_recording_without_the_errors(calibrated, tmp_path):
    result, _, folder = calibrated
    files = DOCUMENT.write(result, tmp_path / "out")
    assert {"calibration.json", "errors.csv", "calibration.toml", "report.html"} <= {file.name for file in files}
    table = tomllib.loads((tmp_path / "out" / "calibration.toml").read_text())["processing"]["calibration"]
    roll, sigma = result.errors["roll"]
    # Written to a thousandth of the standard deviation, not with all digits of a double.
    assert abs(table["mounting_deg"][0] - roll) <= 0.5e-3 * sigma
    assert len(str(table["mounting_deg"][0])) < 12
    keys = {f"processing.calibration.{key}": value for key, value in table.items()}
    again = process(folder / "lines.nc", keys)
    np.testing.assert_allclose(again.dem.height_m, result.recordings[0].dem[1].height_m, atol=1e-3, equal_nan=True)
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert document["model_holds"]
    assert [row["name"] for row in document["errors"]] == list(USUAL)
    assert "boresight_error_deg" in (tmp_path / "out" / "calibration.toml").read_text()
    assert "Calibration of lines.nc" in calibration_page(result)


def test_a_displaced_reference_is_said_and_estimated(lines, tmp_path):
    recording, ground, _, _ = lines
    truth = Raster.read(ground)
    grid = truth.grid
    moved = Raster.from_array(
        truth.height_m, grid.spacing_m, west_m=float(grid.x_m[0]) + 2.0, south_m=float(grid.y_m[0])
    )
    moved.to_geotiff(tmp_path / "moved.tif")
    result = run_calibration([recording], tmp_path / "moved.tif", names=("roll", "pitch", "range_bias"))
    assert result.displaced
    assert "displaced" in result.warnings[0]
    value, sigma = result.errors["datum_east"]
    assert abs(value + 2.0) < 4 * max(sigma, 0.1)


def test_a_level_plane_and_a_single_line_tell_neither_heading_nor_time(tmp_path):
    overrides = {
        "terrain": {"kind": "flat", "size_m": [400.0, 400.0]},
        "platform.lines": None,
        "platform.length_m": 40.0,
        "platform.start_m": [-60.0, 0.0],
        "platform.wind": None,
        "dem.method": "linear",
    }
    base = {key: value for key, value in flight(30.0, 3, 4).items() if not key.startswith("terrain")} | overrides
    survey = run(load_scenario("hills", base), recordings={"signals": tmp_path / "line.nc"})
    survey.truth.to_geotiff(tmp_path / "plane.tif")
    result = run_calibration([tmp_path / "line.nc"], tmp_path / "plane.tif")
    assert {"heading", "time_offset"}.isdisjoint(result.errors)
    document = DOCUMENT.content(result)
    assert {"heading"} in [set(direction) for direction in document["trade_offs"]]
    held = next(row for row in document["errors"] if row["name"] == "heading")
    assert held["estimate"] is None
    assert held["sigma"] == pytest.approx(held["prior"])


def coherent_line(velocity_error_mps: list[float], length_m: float, rotation_rpm: float, **changes: object) -> dict:
    """A line whose successive chirps share their speckle, over level ground."""
    scan = {"mode": "whisk_broom", "incidence_deg": 45.0, "rotation_rpm": rotation_rpm, "stabilised": False}
    return {
        "terrain": {"kind": "flat", "size_m": [420.0, 420.0]},
        "platform.length_m": length_m,
        "platform.start_m": [-length_m / 2 - 30.0, 0.0],
        "platform.navigation.velocity_constant_mps": velocity_error_mps,
        "radar.sampling": "iq",
        "radar.samples_per_chirp": 256,
        "radar.bandwidth_hz": 300e6,
        "radar.chirp_rate_hz": 2000.0,
        "radar.scan": scan,
        "dem.method": "linear",
        "dem.spacing_m": 4.0,
        **changes,
    }


def test_doppler_tells_heading_and_pitch_of_one_line_over_level_ground_that_is_not_known(tmp_path):
    """As well as the velocity is known: the range bias, and roll about the course, are not told."""
    truth = {"pitch": 0.4, "heading": -0.5}
    flown = coherent_line([0.01, -0.02, 0.01], 34.0, 60.0, **{"dem.spacing_m": 8.0, "tracing.paths_per_pulse": 128})
    run(prepared_with(truth, flown), recordings={"signals": tmp_path / "line.nc"})
    result = run_calibration([tmp_path / "line.nc"], names=("roll", "pitch", "heading", "range_bias"))
    assert "Doppler is used" in result.doppler[0]
    assert set(result.errors) == set(truth)
    for name, (value, sigma) in result.errors.items():
        assert abs(value - truth[name]) < 4 * sigma, name
        # 0.02 m/s of 10 m/s, which the flight does not tell.
        assert 0.11 < sigma < 0.25
    document = DOCUMENT.content(result)
    assert document["doppler"] == list(result.doppler)
    assert {"velocity_up"} in [set(direction) for direction in document["trade_offs"]]
    assert "backscatter" not in tomllib.loads(calibration_toml(result))["processing"]["calibration"]


@pytest.mark.study
def test_under_trees_no_estimate_is_stated(tmp_path):
    wood = {
        "polygon_m": [[-20.0, -150.0], [150.0, -150.0], [150.0, 150.0], [-20.0, 150.0]],
        "height_m": 8.0,
        "extinction_db_per_m": 1.0,
        "backscatter_db_per_m": -20.0,
    }
    recording, _, _ = recorded(tmp_path, flight(20.0, 3, 4, vegetation=[wood]), {})
    bare = run(load_scenario("hills", flight(20.0, 3, 4) | {"dem.method": "linear"}))
    bare.truth.to_geotiff(tmp_path / "bare.tif")
    result = run_calibration([recording], tmp_path / "bare.tif")
    assert result.solution.reduced_chi2 > 1.2
    assert result.errors == {}
    assert "No estimate is stated" in result.warnings[-1]
    first, second = result.recordings[0].dem
    np.testing.assert_array_equal(first.height_m, second.height_m)


def test_a_flight_that_calibrates_has_two_heights():
    base = load_scenario("hills", {"terrain.size_m": [800.0, 800.0]})
    low, high = calibration_flights(base)
    assert high.platform.altitude_m == 1.5 * low.platform.altitude_m == 75.0
    for flown in (low, high):
        assert flown.platform.lines.crossing
        assert flown.platform.lines.count == 2
        # The beam looks 50 m ahead: opposite lines meet the same ground over what is left.
        assert flown.platform.lines.length_m >= 200.0
    with pytest.raises(ScenarioError, match="leave the terrain"):
        calibration_flights(load_scenario("hills"))


@pytest.mark.parametrize(
    ("names", "priors", "words"),
    [
        (["yaw"], [], "yaw"),
        ([], ["roll"], "NAME=VALUE"),
        ([], ["roll=-1"], "NAME=VALUE"),
        ([], ["datum_up=1"], "NAME=VALUE"),
        (["datum_up"], [], "datum_up"),
    ],
)
def test_names_and_priors_that_are_none_are_refused(names, priors, words):
    with pytest.raises(ScenarioError, match=words):
        (parse_errors(names), parse_deviations("--prior", priors, PRIORS))


def test_commands_say_what_is_missing(cli, tmp_path, lines):
    recording, ground, _, _ = lines
    assert "signals.nc" in cli("calibrate", tmp_path, "--reference", ground, code=2).stderr
    done = cli("calibrate", recording, "--reference", tmp_path / "none.tif", code=2)
    assert "none.tif" in done.stderr
    done = cli("plan", "--calibration", code=2)
    assert "--base" in done.stderr
    done = cli("plan", "--area", "100x100", code=2)
    assert "--sampling" in done.stderr
    done = cli("run", "hills", "--set", "processing.calibration.range_bias_m=0.1", code=2)
    assert "processing.calibration" in done.stderr


def test_a_recording_without_ground_is_refused(lines, tmp_path):
    recording, ground, _, _ = lines
    truth = Raster.read(ground)
    away = Raster.from_array(truth.height_m, truth.grid.spacing_m, west_m=5000.0, south_m=5000.0)
    away.to_geotiff(tmp_path / "away.tif")
    with pytest.raises(InputFileError, match="away"):
        run_calibration([recording], tmp_path / "away.tif")


# ------------------------------------------------------------------------------------------------ a flown altimeter
HERE = Path(__file__).parents[2]
TREES = HERE / "examples" / "data" / "altimeter_trees.npz"
BARE = Path(os.environ.get("SIONNA_RADAR_RECORDINGS") or HERE.parent / "shared" / "data") / "radar_altimeter_bare.npz"


def altimeter(file: Path, rows: slice | np.ndarray) -> tuple[Readings, Heightfield]:
    """Readings of an altimeter along a line, over the ground that the laser beside it saw.

    Its beam is so wide that it reads the nearest ground, whatever the attitude.
    """
    line = np.load(file)
    time_s, radar_m, laser_m = (line[name] for name in ("utc_s", "radar_m", "laser_m"))
    known = np.isfinite(radar_m) & np.isfinite(laser_m)
    along_m = 60.0 * (time_s - time_s[0])
    chosen = np.zeros(len(known), dtype=bool)
    chosen[rows] = True
    chosen &= known
    count = int(chosen.sum())
    down = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    position = np.column_stack([along_m[chosen], np.zeros(count), laser_m[chosen]])
    motion = straight(position, 60.0, down, time_s[chosen].astype(float))
    grid = Grid.covering(-20.0, -20.0, float(along_m[-1]) + 20.0, 20.0, 20.0)
    readings = Readings(
        range_m=radar_m[chosen].astype(float), sigma_m=np.full(count, 0.5), motion=motion, reach_m=400.0
    )
    return readings, Heightfield(grid=grid, height_m=np.zeros(grid.shape))


def bias_of(file: Path, rows: slice | np.ndarray):
    readings, ground = altimeter(file, rows)
    return solve(CombinedEchoes(parts=(readings,)), ground, ["range_bias"], {"range_bias": 5.0})


@pytest.mark.skipif(not BARE.is_file(), reason="the recording may not be committed")
def test_the_bias_of_a_flown_altimeter_over_open_country_holds_on_the_other_half():
    """Halves in turns of 40 readings: the bias wanders by 0.2 m along the line, so that its two ends differ."""
    count = len(np.load(BARE)["radar_m"])
    turn = np.arange(count) // 40 % 2 == 0
    one, other = bias_of(BARE, turn), bias_of(BARE, ~turn)
    assert one.value[0] == pytest.approx(1.8, abs=0.15)
    assert abs(one.value[0] - other.value[0]) < 2.5 * np.hypot(one.sigma[0], other.sigma[0])
    assert one.sigma[0] < 0.1
    # A constant is no model of what wanders, and it is said; it is still one of most of the bias.
    whole = bias_of(BARE, slice(None))
    assert not whole.model_holds
    assert not whole.rejected_by_chi2


@pytest.mark.skipif(not BARE.is_file(), reason="the recording may not be committed")
def test_what_one_part_of_the_flown_line_says_of_the_next_holds():
    """The bias as a random walk, known from half of the line, or a quarter, alone."""
    count = len(np.load(BARE)["radar_m"])
    for parts in (2, 4):
        ends = np.arange(parts + 1) * count // parts
        found = [bias_of(BARE, slice(*pair)) for pair in itertools.pairwise(ends)]
        for (now, later), size in zip(itertools.pairwise(found), np.diff(ends), strict=False):
            mean, sigma = now.next_range_bias(np.zeros(size, dtype=np.int64))
            assert abs(mean - later.value[0]) < 1.96 * np.hypot(sigma, later.sigma[0])
            assert sigma < 0.35
    # As a constant it is known too well.
    one, other = (bias_of(BARE, slice(*pair)) for pair in ((0, count // 2), (count // 2, count)))
    assert abs(one.value[0] - other.value[0]) > 4 * np.hypot(one.sigma[0], other.sigma[0])


def test_over_woods_the_residuals_say_that_the_model_does_not_hold():
    found = bias_of(TREES, slice(None))
    assert found.rejected_by_chi2
    assert found.excess > 20
    # The interval is as much wider than that of readings which scatter by 0.5 m.
    assert found.sigma[0] > 4 * 0.5 / np.sqrt(2001)


# ----------------------------------------------------------------------------------------------------------- studies
def shares_inside(found: list[np.ndarray]) -> tuple[float, float]:
    """Shares of estimates within one and 1.96 standard deviations of the truth, printed."""
    results = np.array(found)
    score = np.abs(results[..., 0] / results[..., 1])
    print("inside 1 sigma", (score < 1).mean(axis=0), "1.96", (score < 1.96).mean(axis=0))
    print("told", results[..., 2].mean(axis=0), "sigma", np.median(results[..., 1], axis=0))
    return float(np.mean(score < 1)), float(np.mean(score < 1.96))


@pytest.mark.study
@pytest.mark.parametrize(("names", "surveys"), [(USUAL, 200), (tuple(SPREAD), 100)], ids=["usual", "lever arm, too"])
def test_the_truth_is_inside_what_is_stated_as_often_as_stated(names, surveys):
    """Over terrain that nothing was developed on: within 4 points of 68 and of 95 %."""
    of_68, of_95 = shares_inside([trial(seed, names, flight(60.0, seed, 21)) for seed in range(surveys)])
    assert abs(of_68 - 0.6827) < 0.04
    assert abs(of_95 - 0.95) < 0.04


@pytest.mark.study
def test_what_drifts_from_line_to_line_widens_what_is_stated():
    """Roll and range of each line by themselves: 100 surveys, 500 estimates."""
    between = {"roll": 0.1, "range_bias": 0.05}
    found = [trial(seed, USUAL, flight(60.0, seed, 21), between=between) for seed in range(100)]
    of_68, of_95 = shares_inside(found)
    assert abs(of_68 - 0.6827) < 0.06
    assert abs(of_95 - 0.95) < 0.04
    # Three lines tell no mean better than drifts, and what is known beforehand, let it be known.
    assert np.median([each[0, 1] for each in found]) > 1 / np.sqrt(3 / 0.1**2 + 1 / SPREAD["roll"] ** 2)


@pytest.mark.study
def test_over_unknown_ground_the_truth_is_inside_what_is_stated():
    """Lines of 140 m at a third of the chirps, each survey over other hills; half a minute each."""
    sparse = {"radar.chirp_rate_hz": 120.0}
    flights = [flight(140.0, seed, 1000 + seed, **sparse) for seed in range(40)]
    found = [trial(seed, USUAL, flown, solved_over_unknown_ground) for seed, flown in enumerate(flights)]
    of_68, of_95 = shares_inside(found)
    # Two standard deviations of a share of 160 estimates.
    assert abs(of_68 - 0.6827) < 0.074
    assert abs(of_95 - 0.95) < 0.035


@pytest.mark.study
def test_pitch_and_heading_by_doppler_alone_are_inside_what_is_stated(tmp_path):
    """40 lines, half over level ground and half over hills, with errors of mounting and velocity; 10 s each."""
    names, file = ("roll", "pitch", "heading", "range_bias", *DOPPLER_ERRORS), tmp_path / "line.nc"
    prior = np.array([UNKNOWNS[name].prior * UNKNOWNS[name].si for name in names])
    found = []
    for seed in range(40):
        rng = np.random.default_rng([42, seed])
        truth = dict(zip(("roll", "pitch", "heading"), 0.5 * rng.standard_normal(3), strict=True))
        hills = {} if seed % 2 else {"terrain": {"kind": "hills", "size_m": [420.0, 420.0], "seed": seed}}
        flown = coherent_line((0.02 * rng.standard_normal(3)).tolist(), 70.0, 30.0, seed=seed, **hills)
        run(prepared_with(truth, flown), recordings={"signals": file})
        with open_recording(file, {}) as source:
            spread = beam_nodes(source.antenna).spread
            rates, _ = _range_rates(source, source.believed(), spread, dict(zip(names, prior, strict=True)))
        file.unlink()
        value = np.zeros(len(names))
        for _ in range(3):
            errors = InstrumentErrors.of(dict(zip(names, map(float, value), strict=True)))
            change, excess = rates.linearised(errors, names)
            weighted = change / rates.sigma_mps[:, None] ** 2
            known = Posterior(names=names, prior=prior, information=change.T @ weighted)
            told = known.observable
            right = (excess @ weighted + known.information @ value)[told]
            value[told] = np.linalg.solve(known.information[np.ix_(told, told)] + np.diag(prior[told] ** -2.0), right)
        assert told.tolist() == [name in ("pitch", "heading") for name in names]
        sigma = np.sqrt(np.diag(known.considered(told)))
        error = np.rad2deg(value[1:3]) - [truth["pitch"], truth["heading"]]
        found.append(np.column_stack([error, np.rad2deg(sigma[1:3]), told[1:3]]))
    of_68, of_95 = shares_inside(found)
    # Two standard deviations of a share of 80 estimates.
    assert abs(of_68 - 0.6827) < 0.104
    assert abs(of_95 - 0.95) < 0.049


@pytest.mark.study
def test_lines_that_overlap_may_stand_in_several_recordings(tmp_path):
    """Three flights of a line each, over ground that none of them knows, with a roll that differs between them."""
    given = flight(120.0, 3, 7, **{"radar.chirp_rate_hz": 120.0, "platform.length_m": 120.0, "dem.method": "linear"})
    del given["platform.lines"]
    lines = [(90.0, [-60.0, 0.0]), (270.0, [60.0, 10.0]), (0.0, [0.0, -60.0])]
    for number, (heading, start) in enumerate(lines):
        own = {"seed": number + 1, "platform.heading_deg": heading, "platform.start_m": start}
        run(prepared_with(ERRORS, given | own), recordings={"signals": tmp_path / f"{number}.nc"})
    names = [tmp_path / f"{number}.nc" for number in range(3)]
    result = run_calibration(names, drift={"roll": np.deg2rad(0.05)})
    assert {"roll", "time_offset"} <= set(result.errors)
    for name, (value, sigma) in result.errors.items():
        assert abs(value - ERRORS.get(name, 0.0)) < 4 * sigma, name
    assert result.errors["roll"][1] > 0.05 / np.sqrt(3)
    assert (np.abs(result.solution.line_offsets) < 4 * result.solution.line_offsets_sigma).all()
    assert len(result.recordings) == 3
    assert result.manoeuvres == ()


@pytest.mark.study
def test_two_opposite_lines_and_a_crossing_one_tell_mounting_range_and_time():
    """In gusts of a wind of 6 m/s, with an antenna fixed to the body: lines of 200 m, 20 s each."""
    truth = {"roll": 0.5, "pitch": -0.4, "heading": 0.6, "range_bias": 0.3, "time_offset": -5.0}
    changes = {"terrain.size_m": [600.0, 600.0]}
    found = solved(truth, flight(200.0, 5, 22, **changes), tuple(truth))
    units = np.array([UNKNOWNS[name].si for name in truth])
    error, sigma = found.value / units - np.array(list(truth.values())), found.sigma / units
    print(dict(zip(truth, zip(error.round(4), sigma.round(4), strict=True), strict=True)))
    assert (np.abs(error[:3]) < 0.02 * 2).all()
    assert (sigma[:3] < 0.02).all()
    assert sigma[3] < 0.01
    assert sigma[4] < 1.0
    assert (np.abs(error) < 3.5 * sigma).all()


@pytest.mark.study
def test_in_still_air_these_lines_tell_no_time_but_a_rolling_one_does():
    """A clock late by dt moves all ground by v dt along the track: ranges by its slope over the cosine of incidence."""
    names = ("roll", "pitch", "heading", "range_bias", "time_offset")
    changes = {"terrain.size_m": [600.0, 600.0], "platform.wind": None}
    prepared = prepared_with({}, flight(200.0, 5, 22, **changes))
    echoes, ground = CombinedEchoes(parts=(echoes_of(prepared),)), ground_of(prepared)
    found = solve(echoes, ground, names, {"time_offset": 5e-3})
    assert not found.observable[4]
    assert found.sigma[2] > np.deg2rad(0.02)
    pose = echoes.parts[0].motion.pose
    hit = ground.first_hit(pose.position_m, pose.boresight, 200.0)
    slope = np.stack(ground.slope(*(pose.position_m + hit[:, None] * pose.boresight)[:, :2].T), axis=1)
    steep = pose.boresight[:, 2] - np.sum(slope * pose.boresight[:, :2], axis=1)
    along = np.sum(slope * pose.velocity_mps[:, :2], axis=1) / steep
    alone = 1 / np.sqrt(np.nansum((along / found.step.sigma_m) ** 2))
    # By axes of beams alone; the information of the whole beams, which sees more slopes, is as large.
    assert alone == pytest.approx(1 / np.sqrt(found.posterior.information[4, 4] * found.scatter), rel=0.15)
    assert alone > 3e-3
    (rolling,) = [each for name, each in _manoeuvres(echoes, ground, found).items() if "rolling" in name]
    sigma = found.posterior.with_more(rolling).sigma
    print(f"alone {1e3 * alone:.2f} ms; with a rolling line {1e3 * sigma[4]:.2f} ms, {np.rad2deg(sigma[2]):.4f} deg")
    assert sigma[4] < 1e-3
    assert sigma[2] < np.deg2rad(0.02)
