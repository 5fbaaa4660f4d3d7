"""Navigation that echoes refine: priors in time, the joint system against a plain one, flights with known errors."""

import shutil
from functools import cache

import h5py
import numpy as np
import pytest

from calibration_surveys import every_echo_of
from sionna_radar import process, run
from sionna_radar.flight.build import build_stated_errors
from sionna_radar.flight.instrument import InstrumentErrors
from sionna_radar.flight.navigation import StatedError
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.mapping.navigation.joint import FirstGround, MeasuredPlaces, Varying, ground_grid, joint_system
from sionna_radar.mapping.navigation.refinement import BETWEEN_KNOTS, Wandering, refine_navigation
from sionna_radar.report import draw_navigation
from sionna_radar.report.files.navigation import write_navigation
from sionna_radar.report.survey.summary import summary, survey_table
from sionna_radar.scenario import load_scenario
from sionna_radar.scenario.platform import LoggedErrorsTable
from sionna_radar.scenario.processing import RefinedNavigationTable
from sionna_radar.survey.preparation import prepare

# Two lines to and fro and one across: each sees ground that another one sees from elsewhere.
CROSSING = {
    "terrain.size_m": [300.0, 300.0],
    "platform.lines": {"count": 2, "spacing_m": 10.0, "length_m": 30.0, "crossing": True},
    "platform.start_m": None,
    "radar.chirp_rate_hz": 120.0,
    "radar.antenna.beamwidth_deg": 4.0,
    "dem.spacing_m": 6.0,
}
ROLL = {"platform.navigation.boresight_error_deg": [0.5, 0.0, 0.0], "platform.navigation.attitude_markov_deg": 0.05}


def process_of(sigma: float, correlation_s: float, name: str = "roll") -> StatedError:
    return StatedError(name=name, sigma=lambda time_s: np.full(len(time_s), sigma), correlation_s=correlation_s)


def test_knots_hold_a_gauss_markov_process_but_for_what_they_say():
    time_s, error = np.linspace(0.0, 20.0, 801), process_of(2.0, 10.0)
    walk = Wandering(error=error, knot_s=np.linspace(0.0, 20.0, 41))
    basis = walk.basis(time_s)
    covariance = basis @ basis.T
    at = np.arange(0, 801, 20)
    expected = 4.0 * np.exp(-np.abs(time_s[at][:, None] - time_s[at]) / 10.0)
    np.testing.assert_allclose(covariance[np.ix_(at, at)], expected, rtol=1e-9)
    # Between knots the variance is less by the mean that is stated, for each of the twenty times of a step; to the next
    # order in the step over the correlation time, 1/20.
    missing = 4.0 - np.diag(covariance).mean()
    assert walk.left_out(time_s)[0] / (801 / 40) == pytest.approx(missing, rel=0.05)


def test_knots_are_as_dense_as_the_echoes_tell():
    time_s, error = np.linspace(0.0, 60.0, 6001), process_of(1.0, 60.0)
    for per_echo in (0.1, 10.0):
        walk = Wandering.of(error, time_s, np.full(6001, per_echo), most=10_000)
        step_s = float(np.diff(walk.knot_s)[0])
        echoes = per_echo * 100 * step_s
        assert step_s / (3 * 60.0) == pytest.approx(BETWEEN_KNOTS / echoes, rel=0.1)
    assert len(Wandering.of(error, time_s, np.full(6001, 10.0), most=7).knot_s) == 7
    constant = Wandering.of(process_of(1.0, np.inf), time_s, np.ones(6001), most=7)
    np.testing.assert_array_equal(constant.basis(time_s), np.ones((6001, 1)))


@cache
def first_estimate():
    """Echoes of a short flight, the ground they are to determine, and their linearised likelihood."""
    flown = {
        "dem.method": "refined",
        "platform.length_m": 12.0,
        "radar.antenna.beamwidth_deg": 4.0,
        "dem.spacing_m": 6.0,
    }
    prepared = prepare(load_scenario("hills", flown))
    echoes = every_echo_of(prepared)
    echoes = echoes.rows(np.arange(len(echoes)) % 3 == 0)
    begin = FirstGround.of(echoes, ground_grid(prepared.mapper.grid, echoes, 8.0))
    surface = begin.waves.surface(begin.ground)
    names = ("roll", "datum_up")
    return echoes, begin, surface, names, echoes.linearise(InstrumentErrors(), surface, names, begin.speckle_scatter)


def test_the_joint_system_is_that_of_all_rows_written_out():
    echoes, begin, surface, names, linear = first_estimate()
    waves, ground, heights = begin.waves, begin.ground, linear.heights
    rng = np.random.default_rng(3)
    basis, coefficients = rng.standard_normal((len(echoes), 4)), rng.standard_normal(4)
    places = MeasuredPlaces(
        place_m=np.array([[-60.0, 3.0], [-40.0, -8.0]]), height_m=np.ones(2), sigma_m=np.array([1.0, 2.0])
    )
    varying = [Varying(name="roll", basis=basis)]
    system = joint_system(linear, surface, waves, ground, names, varying, [coefficients], places=places)
    rows, score = [], np.zeros(len(ground) + 4)
    for pulse in range(len(echoes)):
        factor = heights.factor[heights.rows_of(pulse)].astype(float)
        under = surface.weights(*np.nan_to_num(heights.place_m[pulse]).T) @ waves.height_m
        by_error = factor @ linear.per_error[pulse][:, 0]
        rows.append(np.hstack([factor @ under, by_error[:, None] * basis[pulse]]))
        score[: len(ground)] += under.T @ linear.node_score[pulse]
        score[len(ground) :] += basis[pulse] * linear.score[pulse, 0]
    known = surface.weights(*places.place_m.T) @ waves.height_m
    rows.append(np.hstack([known / places.sigma_m[:, None], np.zeros((2, 4))]))
    score[: len(ground)] += known.T @ ((1.0 - known @ ground) / places.sigma_m**2)
    every = np.vstack(rows)
    np.testing.assert_allclose(system.normal, every.T @ every + np.eye(len(score)), rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(system.right, score - np.concatenate([ground, coefficients]), rtol=1e-6, atol=1e-6)


def test_the_height_of_a_flight_is_known_from_places_alone():
    """Over unknown ground an error of height is one of all the ground: what places say of it is all that is known."""
    echoes, begin, surface, names, linear = first_estimate()
    del begin, names, linear
    grid, flown = ground_grid(surface.grid, echoes, 8.0), echoes.motion
    stated = [process_of(2.0, np.inf, "datum_up")]
    alone = refine_navigation(echoes, flown, grid, stated)
    np.testing.assert_allclose(alone.sigma, 2.0, rtol=1e-3)
    assert not alone.observable.any()
    around = np.stack(np.meshgrid(np.arange(-70.0, -30.0, 5.0), np.arange(-30.0, 31.0, 5.0)), axis=-1).reshape(-1, 2)
    truth_m = prepare(load_scenario("hills", {"platform.length_m": 12.0})).truth.ground
    height_m = truth_m.height_m[truth_m.grid.cell_of(around)[:2]]
    kept = np.isfinite(height_m)
    places = MeasuredPlaces(place_m=around[kept], height_m=height_m[kept] + 1.0, sigma_m=np.full(kept.sum(), 0.05))
    held = refine_navigation(echoes, flown, grid, stated, places)
    # The reference lies a metre higher, and so is the flight over it.
    assert held.value.mean() == pytest.approx(-1.0, abs=0.1)
    assert held.sigma.mean() < 0.05
    assert held.observable.all()


@pytest.fixture(scope="module")
def crossing(tmp_path_factory):
    """A survey with an error of its mounting that is refined, its recording, and that survey as it is reported."""
    file = tmp_path_factory.mktemp("refined") / "signals.nc"
    scenario = load_scenario("hills", CROSSING | ROLL | {"processing.navigation": "refined"})
    return run(scenario, recordings={"signals": file}), file


def test_crossing_lines_tell_an_error_of_roll(crossing):
    survey, _ = crossing
    navigation, way = survey.navigation, survey.way_error
    roll = navigation.names.index("roll")
    assert navigation.observable[roll]
    assert navigation.holds
    error = navigation.value[:, roll] - way.true["roll"]
    assert np.abs(error).max() < 4 * navigation.sigma[:, roll].min()
    assert np.sqrt(np.mean(error**2)) < np.deg2rad(0.5) / 4
    assert way.pointing_deg[1] < way.pointing_deg[0] / 2
    assert any("roll" not in warning and "heading" in warning for warning in survey.warnings)


def test_a_line_that_takes_hills_for_a_rough_plain_bends_no_flight():
    """The longest line alone fits rough ground of 0.3 m; hills of 1.2 m lie under all of them."""
    drifting = {
        "seed": 2,
        "platform.navigation.attitude_markov_deg": [0.5, 0.5, 0.2],
        "processing.navigation": "refined",
    }
    survey = run(load_scenario("hills", CROSSING | drifting))
    navigation, way = survey.navigation, survey.way_error
    for name in ("roll", "pitch"):
        column = navigation.names.index(name)
        error = navigation.value[:, column] - way.true[name]
        assert abs(error.mean()) < 2.5 * navigation.sigma[:, column].mean()
    assert way.pointing_deg[1] < way.pointing_deg[0]


def test_what_is_written_of_it(crossing, tmp_path):
    survey, _ = crossing
    write_navigation(survey, tmp_path)
    lines = (tmp_path / "navigation.csv").read_text().splitlines()
    header, values = lines[0].split(","), np.array(lines[7].split(","), dtype=float)
    row = dict(zip(header, values, strict=True))
    place = survey.navigation.poses.pose.position_m[6]
    np.testing.assert_allclose([row[f"antenna_{axis}_m"] for axis in ("east", "north", "up")], place, atol=1e-6)
    roll = survey.navigation.names.index("roll")
    assert row["roll_error_deg"] == pytest.approx(np.rad2deg(survey.navigation.value[6, roll]), abs=1e-6)
    assert len(lines) == survey.pulses + 1
    document = summary(survey)["navigation"]
    assert document["errors"]["roll (deg)"]["observable"]
    assert document["errors"]["roll (deg)"]["stated"] == pytest.approx(np.hypot(0.5, 0.05), rel=0.02)
    assert document["way"]["refined"]["axes_deg"] < document["way"]["reported"]["axes_deg"]
    shown = [axes.get_ylabel() for axes in draw_navigation(survey).axes]
    assert shown == ["Roll\n(deg)", "Pitch\n(deg)", "Heading\n(deg)"]
    assert "navigation refined" in survey_table(survey).columns[0]._cells


def test_a_recording_is_mapped_with_the_same_refined_poses(crossing):
    survey, file = crossing
    again = process(file)
    assert again.points.sha256() == survey.points.sha256()
    np.testing.assert_array_equal(again.dem.height_m, survey.dem.height_m)
    reported = process(file, {"processing.navigation": "reported"})
    assert survey.lit_error.rms_m < 0.7 * reported.comparison.lit_error.rms_m
    assert reported.navigation is None
    assert np.nanmedian(survey.dem_sigma_navigation.height_m) < 0.2


def test_exact_navigation_is_left_as_it_is():
    scenario = {"platform.length_m": 10.0}
    exact = run(load_scenario("hills", scenario))
    with pytest.raises(ValueError, match="was not refined"):
        draw_navigation(exact)
    asked = run(load_scenario("hills", scenario | {"processing.navigation": "refined"}))
    assert asked.navigation is None
    assert asked.points.sha256() == exact.points.sha256()


def test_what_is_not_stated_cannot_be_refined(tmp_path):
    with pytest.raises(ScenarioError, match=r"processing\.refined_navigation: states nothing of the errors; give"):
        build_stated_errors(RefinedNavigationTable(), LoggedErrorsTable())
    table = RefinedNavigationTable(position_m=(1.0, 1.0, 2.0), attitude_deg=0.5, attitude_correlation_s=30.0)
    stated = {each.name: each for each in build_stated_errors(table, None)}
    assert stated["datum_up"].sigma(np.zeros(1)) == 2.0
    assert stated["heading"].correlation_s == 30.0
    base = CROSSING | ROLL | {"platform.lines": None, "platform.length_m": 10.0, "processing.navigation": "refined"}
    missing = base | {"processing.refined_navigation.reference": str(tmp_path / "none.tif")}
    with pytest.raises(InputFileError, match=r"processing\.refined_navigation\.reference = .*none\.tif"):
        run(load_scenario("hills", missing))


def test_a_reference_of_no_use_is_refused_before_the_flight(tmp_path, monkeypatch):
    def flown(*_):
        raise AssertionError("it was flown")

    monkeypatch.setattr("sionna_radar.survey.chain.observe", flown)
    (tmp_path / "places.csv").write_text("x,y,z\n" + "".join(f"{x},0,1\n" for x in range(-50, -30)))
    (tmp_path / "empty.tif").touch()
    keys = ROLL | {"platform.length_m": 10.0, "processing.navigation": "refined"}
    for name, refused in (
        ("none.tif", InputFileError), ("empty.tif", InputFileError), ("places.csv", ScenarioError)
    ):  # fmt: skip
        reference = {"processing.refined_navigation.reference": str(tmp_path / name)}
        with pytest.raises(refused, match="refined_navigation"):
            run(load_scenario("hills", keys | reference))


def test_a_flight_without_errors_or_with_few_echoes_says_that_nothing_is_refined():
    short = {"platform.length_m": 6.0, "processing.navigation": "refined"}
    for errors in ({}, ROLL):
        warnings = run(load_scenario("hills", short | errors)).warnings
        assert any("the navigation is not refined: that needs errors" in warning for warning in warnings)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"sensor": "lidar"}, r"processing\.navigation: 'refined' is not supported with a sensor without range prof"),
        ({"radar.sweep": "triangular"}, "'refined' is not supported with pairs of sweeps"),
        ({"processing.navigation": "reported", "processing.refined_navigation.position_m": 1.0}, "set 'refined'"),
        ({"processing.refined_navigation.reference_sigma_m": 1.0}, "give reference, or remove it"),
    ],
)
def test_settings_that_contradict_it_are_refused(keys, message):
    with pytest.raises(ScenarioError, match=message):
        load_scenario("hills", {"processing.navigation": "refined"} | keys)


@pytest.fixture(scope="module")
def short_recording(tmp_path_factory):
    """A recorded flight of 10 m, and the same without its scenario: its ground is not known before detection."""
    folder = tmp_path_factory.mktemp("recording")
    keys = ROLL | {"terrain.size_m": [300.0, 300.0], "platform.length_m": 10.0}
    run(load_scenario("hills", keys), recordings={"signals": folder / "flight.nc"})
    shutil.copy(folder / "flight.nc", folder / "measured.nc")
    with h5py.File(folder / "measured.nc", "r+") as file:
        del file["scenario"]
        for name in [name for name in file if name.startswith("truth")]:
            del file[name]
    return folder


@pytest.mark.parametrize("name", ["flight.nc", "measured.nc"])
@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("none.tif", r"refined_navigation\.reference = .*none\.tif does not exist"),
        ("empty.tif", r"refined_navigation\.reference = .*empty\.tif"),
        ("elsewhere.csv", "0 of 20 places lie within the DEM"),
        ("places.csv", r"reference_sigma_m: missing"),
    ],
)
def test_a_reference_of_no_use_is_refused_before_a_recording_is_read(
    short_recording, tmp_path, monkeypatch, name, reference, message
):
    monkeypatch.setattr("sionna_radar.survey.reprocessing.observe", lambda *_, **__: pytest.fail("it was detected"))
    for file, away in (("places.csv", 0), ("elsewhere.csv", 90_000)):
        (tmp_path / file).write_text("x,y,z\n" + "".join(f"{x + away},0,1\n" for x in range(-40, -20)))
    (tmp_path / "empty.tif").touch()
    keys = {
        "processing.navigation": "refined",
        "processing.refined_navigation.attitude_deg": 0.5,
        "processing.refined_navigation.reference": str(tmp_path / reference),
    }
    with pytest.raises((InputFileError, ScenarioError), match=message):
        process(short_recording / name, keys)


def test_errors_that_nothing_states_are_refused_before_a_recording_is_read(short_recording, monkeypatch):
    monkeypatch.setattr("sionna_radar.survey.reprocessing.observe", lambda *_, **__: pytest.fail("it was detected"))
    with pytest.raises(ScenarioError, match="states nothing of the errors"):
        process(short_recording / "measured.nc", {"processing.navigation": "refined"})
