"""Designs: the optimum of what is known, however it is computed, how sure it is; failures and contradictions told."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fronts import hypervolume
from sionna_radar.execution.checkpoints import Checkpoints
from sionna_radar.execution.execution import Execution
from sionna_radar.execution.workers import Failure
from sionna_radar.foundation.columns import packed
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.studies.design import search, statement
from sionna_radar.studies.design.document import (
    DOCUMENT,
    design_page,
    sentence,
    statements,
)
from sionna_radar.studies.design.plan import plan_design, standing_of, worst
from sionna_radar.studies.design.study import run_design
from sionna_radar.studies.design.surrogate import Space, Surrogate, flown_probability, improvement, pareto
from sionna_radar.studies.sweep import trial as trials
from sionna_radar.studies.sweep.costs import read_costs
from sionna_radar.studies.sweep.expressions import parse_requirement
from sionna_radar.studies.sweep.quantities import Area
from sionna_radar.studies.sweep.settings import Axis, Span

pytestmark = pytest.mark.usefixtures("rough_errors")

BEAM, HEIGHT = "radar.antenna.beamwidth_deg", "platform.altitude_m"
FREE = [f"{BEAM}=1:8:log", f"{HEIGHT}=30:60"]
ERROR = {"count": 900, "min_m": -1.0, "max_m": 1.0, "std_m": 0.1, "mean_m": 0.0, "nmad_m": 0.1, "le90_m": 0.2}
ERROR |= {"le68_m": 0.1, "le95_m": 0.3, "p95_p5_m": 0.4}


def rms_m(beam: float, height: float) -> float:
    """The law of the pretended surveys: the error grows with the footprint."""
    return 0.05 * beam * height / 50


def pretended(task):
    """Return the trial of a survey that is not flown: `rms_m` with 3 % of noise from its seed; some places fail."""
    scenario = Scenario.model_validate_json(task["scenario"])
    beam, height = scenario.radar.antenna.beamwidth_deg, scenario.platform.altitude_m
    if beam > 5.0:
        message = "no echo at all"
        raise RuntimeError(message)
    noise = np.random.default_rng(scenario.seed).standard_normal(2)
    rain = 1.5 if scenario.weather.rain_rate_mm_per_h else 1.0
    rms_m_found = rain * rms_m(beam, height) * (1 + 0.03 * noise[0])
    error = ERROR | {"rms_m": rms_m_found, "coverage": 0.95 + 0.005 * noise[1]}
    trial = {"seed": scenario.seed, "echoes": 9, "points_sha256": "", "dem_error": error, "lit_error": error}
    rest = {"off_wall_error": None, "warnings": (), "stated_sigma_m": 0.1, "wall_s": 0.0, "peak_memory_mb": 0.0}
    # The higher, the wider is the ground that is mapped, on cells that coincide; the outer ones are worse.
    columns = int(height)
    grid = Grid(west_m=-float(columns), south_m=0.0, spacing_m=1.0, columns=2 * columns + 1, rows=20)
    map_m = np.where(np.abs(grid.centres_m[:, 0]) > 30, 2.0, 1.0).reshape(grid.shape) * rms_m_found
    rest |= {"mapped_m2": 20.0 * (2 * columns + 1), "mapped_swath_m": 2.0 * columns + 1, "coverage_of_swath": 0.97}
    return packed(trial=json.dumps(trial | rest).encode(), error=Raster(grid=grid, height_m=map_m.astype(np.float32)))


def pretend(patch):
    """Fly nothing, and look at fewer candidates: two parameters need no more."""
    sizes = ((search, "POOL", 128), (search, "NEAR", 24), (statement, "SOBOL_SAMPLES", 64), (statement, "MAPS", 1))
    patch.setattr(trials, "trial_task", pretended)
    for module, name, value in sizes:
        patch.setattr(module, name, value)


@pytest.fixture(autouse=True)
def _pretend(monkeypatch):
    pretend(monkeypatch)


@pytest.fixture(scope="module")
def plan(small):
    return plan_design(small, FREE, minimise=["aperture_m"], require=["rms_m < 0.1", "coverage > 0.5"], surveys=40)


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    return Checkpoints(tmp_path_factory.mktemp("parts"))


@pytest.fixture(scope="module")
def designed(plan, kept):
    with pytest.MonkeyPatch.context() as patch:
        pretend(patch)
        return run_design(plan, execution=Execution(checkpoints=kept))


def test_the_optimum_lies_where_the_error_reaches_its_limit(designed):
    """The least aperture has the widest beam of which the error allows: at the least height, 0.1 / 0.05 * 50 / 30."""
    best = designed.best.setting
    assert designed.holds
    assert best[HEIGHT] == pytest.approx(30.0, abs=2.0)
    assert best[BEAM] == pytest.approx(0.1 / 0.05 * 50 / 30, rel=0.07)
    assert rms_m(best[BEAM], best[HEIGHT]) < 0.1
    assert designed.surveys <= 40


def test_it_says_what_binds_and_what_relaxing_saves(designed):
    """A tenth more of error is a tenth more of beam, and a tenth less of aperture; the rest is of no matter."""
    error, coverage, swath = designed.relaxations
    assert error.saving == pytest.approx(1 - 1 / 1.1, abs=0.03)
    assert [coverage.saving, swath.saving] == pytest.approx([0.0, 0.0], abs=0.02)
    assert designed.noise["rms_m"] == pytest.approx(0.03, rel=0.5)
    tolerance = {cut.key: cut.tolerance for cut in designed.slices}
    assert 0.95 * designed.best.setting[BEAM] < tolerance[BEAM][0] <= designed.best.setting[BEAM]
    assert designed.best.setting[BEAM] <= tolerance[BEAM][-1] < 1.06 * designed.best.setting[BEAM]


def test_the_sensitivities_are_those_of_the_law(designed):
    """The logarithm of the error is a sum: its shares are the variances of both terms."""
    beam, height = np.log(8), np.log(np.linspace(30, 60, 10_001))
    parts = np.array([beam**2 / 12, height.var()])
    assert list(designed.sensitivity["rms_m"].values()) == pytest.approx(parts / parts.sum(), abs=0.1)


def test_settings_that_fail_are_kept_with_their_reason_and_avoided(designed):
    failed = [one for one in designed.observations if one.reason]
    assert failed
    assert all("no echo at all" in one.reason for one in failed)
    assert len(failed) <= 5


def test_the_same_seed_gives_the_same_answer_on_a_resumed_run(designed, plan, kept):
    calls = len(kept)
    for part in list(kept.folder.glob("*.part"))[::2]:
        part.unlink()
    again = run_design(plan, execution=Execution(checkpoints=kept, block_size=7))
    assert repr(again.observations) == repr(designed.observations)
    assert again.best.standing == designed.best.standing
    assert len(kept) == calls


def test_the_worst_of_several_worlds_counts(small):
    """In rain the error is half as large again, so that the beam is two thirds as wide."""
    worlds = ["weather.rain_rate_mm_per_h=10"]
    plan = plan_design(
        small, FREE, minimise=["aperture_m"], require=["rms_m < 0.1"], worst_of=worlds, surveys=60, repeat=3
    )
    found = run_design(plan)
    assert found.best.setting[BEAM] == pytest.approx(2 / 3 * 0.1 / 0.05 * 50 / 30, rel=0.08)
    assert found.surveys <= 60


def test_costs_of_a_table_are_minimised_over_words_and_whole_numbers_too(small, tmp_path):
    (tmp_path / "costs.toml").write_text(
        "[a]\nmass_kg = '1 + 10 * aperture_m + 0.1 * radar.samples_per_chirp / 1024'\n"
    )
    free = [f"{BEAM}=1:6:log", "dem.method=linear,smooth", "radar.samples_per_chirp=1024:2048"]
    plan = plan_design(
        small,
        free,
        minimise=["mass_kg"],
        require=["rms_m < 0.1", "mass_kg < 5", "flying_time_s < 600"],
        costs=read_costs(tmp_path / "costs.toml"),
        area=Area(size_m=(300.0, 300.0)),
        surveys=30,
        repeat=3,
    )
    found = run_design(plan)
    assert found.holds
    assert found.best.setting[BEAM] == pytest.approx(2.0, rel=0.08)
    assert found.best.setting["radar.samples_per_chirp"] < 1300
    assert found.best.setting["dem.method"] in ("linear", "smooth")
    assert isinstance(found.best.setting["radar.samples_per_chirp"], int)


def test_two_objectives_give_the_front(small):
    """Over the beam the error trades against the aperture, at the least height: the product of both is constant."""
    plan = plan_design(small, FREE, minimise=["aperture_m", "rms_m"], surveys=40, repeat=3)
    found = run_design(plan)
    front = np.array([one.objectives for one in found.front])
    assert len(front) >= 8
    assert (np.diff(front[:, 0]) > 0).all()
    assert (np.diff(front[:, 1]) < 0).all()
    truth = np.array([[one.values["aperture_m"], rms_m(one.setting[BEAM], one.setting[HEIGHT])] for one in found.front])
    beams = np.geomspace(1, 5, 200)
    ideal = np.column_stack([0.0 * beams, [rms_m(beam, 30.0) for beam in beams]])
    scale = found.front[0].values["aperture_m"] * found.front[0].setting[BEAM]
    ideal[:, 0] = scale / beams
    corner = ideal.max(axis=0) * 1.1
    assert hypervolume(truth, corner) > 0.93 * hypervolume(ideal, corner)
    assert found.best.seeds >= 3


def test_designs_are_compared_over_the_cells_that_all_of_them_fill(designed):
    """The outer cells, which only higher flights map, err twice as much: over the inner ones all err by their law."""
    compared = [one for one in designed.checked if "common_rms_m" in one.values]
    assert len(compared) != 1
    for one in compared:
        narrow = min(int(other.setting[HEIGHT]) for other in designed.checked)
        outer = max(narrow - 30, 0) / (narrow + 0.5)
        expected = one.values["rms_m"] * np.sqrt(1 + 3 * outer)
        assert one.values["common_rms_m"] == pytest.approx(expected, rel=1e-3)
    areas = [one.values["mapped_m2"] for one in designed.checked]
    told = any("mapped areas differ" in text for text in statements(designed))
    assert told == (min(areas) < 0.95 * max(areas))


def test_an_optimum_that_leaves_its_swath_dark_is_told(designed):
    dark = replace(designed.best, values=designed.best.values | {"coverage_of_swath": 0.7})
    plan = replace(designed.plan, requirements=designed.plan.requirements[:-1], keeps_swath=False)
    told = [text for text in statements(replace(designed, plan=plan, best=dark)) if "planned swath" in text]
    assert told == [
        "the best design maps 70% of its planned swath; --require 'coverage_of_swath > 0.95' leaves out designs that "
        "map less of theirs"
    ]
    assert not any("planned swath" in text for text in statements(designed))


def test_the_probability_of_a_wire_is_no_surer_than_its_surveys(designed):
    """Five of five say 0.57 or more (Wilson), however the mean of the margins stands."""
    plan = replace(designed.plan, requirements=(parse_requirement("pd_wire > 0.99"),), keeps_swath=False)
    best = replace(designed.best, values=designed.best.values | {"pd_wire": 1.0}, seeds=5)
    told = [text for text in statements(replace(designed, plan=plan, best=best)) if "pd_wire" in text]
    assert any(text.startswith("pd_wire = 1 in 5 surveys is at least 0.57 (95 %, Wilson)") for text in told)
    assert not any("Wilson" in text for text in statements(designed))


def test_a_design_for_obstacles_alone_need_not_map_its_swath():
    """Reports of wires gain nothing from ground left dark; errors do."""
    asked = {"minimise": ["aperture_m"], "overrides": {"platform.length_m": 30.0}}
    free = [f"{BEAM}=2:8"]
    alone = plan_design("power_line", free, require=["pd_wire > 0.99", "warning_s > 4"], **asked)
    assert [r.text for r in alone.requirements] == ["pd_wire > 0.99", "warning_s > 4"]
    mapped = plan_design("power_line", free, require=["pd_wire > 0.99", "rms_m < 0.5"], **asked)
    assert mapped.keeps_swath
    assert "coverage_of_swath" in mapped.requirements[-1].text


def dark_at_480(task):
    """Return a pretended trial in which 480 rpm light a quarter less of the swath, and err a tenth less where lit."""
    scenario = Scenario.model_validate_json(task["scenario"])
    dark = scenario.radar.scan.rotation_rpm == 480
    noise = np.random.default_rng(scenario.seed).standard_normal(2)
    error = ERROR | {"rms_m": (0.09 if dark else 0.1) * (1 + 0.01 * noise[0]), "coverage": 0.99}
    trial = {"seed": scenario.seed, "echoes": 9, "points_sha256": "", "dem_error": error, "lit_error": error}
    rest = {"off_wall_error": None, "warnings": (), "stated_sigma_m": 0.1, "wall_s": 0.0, "peak_memory_mb": 0.0}
    return packed(
        trial=json.dumps(trial | rest | {"coverage_of_swath": (0.7 if dark else 0.9) + 0.003 * noise[1]}).encode()
    )


@pytest.mark.parametrize(("require", "best"), [([], (90, 120, 240)), (["coverage_of_swath > 0.1"], (480,))])
def test_a_search_gains_from_dark_ground_only_if_asked_to(small, monkeypatch, require, best):
    monkeypatch.setattr(trials, "trial_task", dark_at_480)
    free = ["radar.scan.rotation_rpm=90,120,240,480"]
    found = run_design(plan_design(small, free, minimise=["rms_m"], require=require, surveys=24))
    assert found.holds
    assert found.best.setting["radar.scan.rotation_rpm"] in best
    told = [text for text in statements(found) if "largest seen" in text]
    assert len(told) == (not require)
    seen = max(one.results["coverage_of_swath"] for one in found.observations)
    assert all(float(text.split(":")[0].split(">")[1]) == pytest.approx(0.95 * seen, abs=1e-3) for text in told)


def test_a_scan_whose_swath_is_not_known_is_searched_without_it(small, monkeypatch):
    monkeypatch.setattr("sionna_radar.survey.swath.sector", lambda *_: None)  # as of a scan from Python
    plan = plan_design(small, [f"{BEAM}=1:4"], minimise=["rms_m"])
    assert (plan.results, plan.requirements) == (("rms_m",), ())


def test_one_parameter_and_one_result_have_a_sensitivity(small):
    plan = plan_design(small, [f"{BEAM}=1:4:log"], minimise=["rms_m"], surveys=16, repeat=2)
    assert run_design(plan).sensitivity["rms_m"] == {BEAM: pytest.approx(1.0, abs=0.05)}


def test_a_range_that_binds_is_told(small):
    """Any error is allowed, so that the least aperture is that of the widest beam, at the end of its range."""
    free = [f"{BEAM}=1:4:log", f"{HEIGHT}=30:60"]
    told = statements(run_design(plan_design(small, free, minimise=["aperture_m"], require=["rms_m < 9"], surveys=20)))
    assert [text.split(":")[0] for text in told if "lies at the end of its range" in text] == [BEAM]


def test_a_key_may_be_given_by_its_range_alone_and_values_that_never_fly_are_refused(small):
    power = {"radar.snr_db": None, "radar.noise_figure_db": 12.0}
    free = ["radar.transmit_power_dbm=0.5:20", f"{BEAM}=1:4"]
    plan = plan_design(small, free, minimise=["transmit_power_w"], require=["rms_m < 9"], overrides=power)
    assert plan.base.radar.transmit_power_dbm == 1.0
    free = ["radar.scan.mode=whisk_broom,fixed,electronic", "radar.scan.rotation_rpm=60:240"]
    plan = plan_design(small, free, minimise=["swath_m"], require=["rms_m < 9"])
    with pytest.raises(ScenarioError, match=r"radar.scan.mode = electronic cannot be flown"):
        run_design(plan)


def test_settings_that_leave_a_quantity_undefined_are_not_flown(small):
    """At incidence 0 a conical scan has no swath."""
    free = ["radar.scan.mode=conical,whisk_broom", "radar.scan.incidence_deg=0,30", f"{BEAM}=1:4"]
    plan = plan_design(small, free, maximise=["swath_m"], require=["rms_m < 9"], surveys=20)
    flown = [tuple(o.setting.values())[1:] for o in run_design(plan).observations]
    assert ("whisk_broom", 0) in flown
    assert ("conical", 0) not in flown


def test_what_no_setting_meets_is_told(small):
    plan = plan_design(small, FREE, minimise=["aperture_m"], require=["rms_m < 0.01"], surveys=24)
    found = run_design(plan)
    assert not found.holds
    assert sentence(found).startswith("No design was shown to meet all requirements")
    assert found.best.probability < 0.01


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"free": []}, "nothing is free"),
        ({"free": [*FREE, f"{BEAM}=2,3"]}, "free twice"),
        ({"overrides": {BEAM: 3.0}}, "both set and free"),
        ({"free": ["seed=1:9"]}, "seed is no part of a radar"),
        ({"minimise": []}, "0 objectives"),
        ({"minimise": ["aperture_m", "rms_m", "swath_m"]}, "3 objectives"),
        ({"require": []}, "no survey is needed"),
        ({"require": ["rsm_m < 1"]}, "Did you mean rms_m"),
        ({"require": ["common_rms_m < 1"]}, "common_rms_m is no key"),
        ({"require": ["rms_m < 1", "transmit_power_w < 1"]}, "transmit_power_dbm"),
        ({"require": ["rms_m < radar.scan.mode"]}, "'whisk_broom' is no number"),
        (
            {"require": ["rms_m < 0.1", "coverage > 0.5", "rms_m > 0.2"]},
            r"0.1.* and .*> 0.2.* contradict",
        ),
        ({"free": ["platform.altitude_m=3:3"]}, "--free: platform.altitude_m = 3:3"),
        ({"free": [*FREE, "dem.method=linear,linear"]}, "--free: .*twice"),
        ({"free": [f"{BEAM}=-1:4:log"]}, "--free: .*logarithm"),
        ({"surveys": 9}, "must be 13"),
        ({"repeat": 1}, "at least 2"),
        ({"confidence": 1.0}, "below 1"),
        ({"free": ["radar.no_such=1:2"]}, "no_such"),
        ({"free": [f"{BEAM}=400:900"]}, "400|600|650|60"),
        ({"worst_of": ["weather.no_such=1"]}, "no_such"),
    ],
)
def test_contradictory_requests_are_refused(small, changed, says):
    given = {"free": FREE, "minimise": ["aperture_m"], "require": ["rms_m < 0.1"], "surveys": 40} | changed
    with pytest.raises(ScenarioError, match=says):
        plan_design(small, given.pop("free"), **given)


def test_a_backend_that_cannot_run_ends_the_design(small, monkeypatch):
    def missing(task):
        from sionna_radar.foundation.errors import BackendError

        message = "no libLLVM"
        raise BackendError(message)

    monkeypatch.setattr(trials, "trial_task", missing)
    plan = plan_design(small, FREE, minimise=["aperture_m"], require=["rms_m < 0.1"], surveys=20)
    with pytest.raises(Exception, match="no libLLVM"):
        run_design(plan)


def test_results_of_a_design_are_written(designed, tmp_path, capsys):
    files = {file.name for file in DOCUMENT.write(designed, tmp_path / "out")}
    assert files == {
        *("design.json", "design.toml", "scenario.toml", "surveys.csv", "report.html", "manifest.json"),
        *("slices.png", "sensitivity.png", "maps.png"),
    }
    document = json.loads((tmp_path / "out" / "design.json").read_text())
    assert document["best"]["setting"] == designed.best.setting
    assert len(document["observations"]) == designed.surveys
    again = load_scenario(tmp_path / "out" / "scenario.toml")
    assert again == designed.best.scenario
    DOCUMENT.show(designed)
    printed = capsys.readouterr().out
    assert "rms_m < 0.1: active constraint" in printed
    assert "linear" in printed
    assert DOCUMENT.content(designed)["answer"] in printed.replace("\n", " ")
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png") == 3
    assert "rms_m &lt; 0.1: active constraint" in page


def test_a_front_is_drawn(designed):
    front = tuple(replace(one, objectives=(*one.objectives, 1.0)) for one in designed.checked)
    plan = replace(designed.plan, objectives=designed.plan.objectives * 2)
    cuts = tuple(replace(cut, objectives=np.repeat(cut.objectives, 2, axis=1), tolerance=()) for cut in designed.slices)
    assert (
        design_page(replace(designed, plan=plan, front=front, best=front[0], slices=cuts)).count("data:image/png") == 4
    )


def test_the_probability_is_students():
    """Of margins with mean 1 and standard deviation 1 over four seeds, the mean is two standard errors from zero."""
    margins = np.array([1.0, 1.0, 1.0, 1.0]) + np.array([1, -1, 1, -1]) * np.sqrt(3 / 4)
    found = standing_of(parse_requirement("rms_m < 1"), margins)
    assert found.spread == pytest.approx(1.0)
    assert found.probability == pytest.approx(0.9303, abs=1e-4)  # Student's t, 3 degrees of freedom, at 2
    assert found.of_one_survey == pytest.approx(0.7810, abs=2e-3)  # at 2 / sqrt(5)


def test_the_worst_is_the_largest_error_and_the_least_coverage():
    assert worst("rms_m", [0.1, 0.3]) == 0.3
    assert worst("mean_m", [0.1, -0.3]) == -0.3
    assert worst("coverage", [0.9, 0.8]) == 0.8
    assert worst("mapped_m2", [900.0, 800.0]) == 800.0


def test_settings_and_points_of_the_cube_are_each_others_inverse():
    axes = Axis(key="n", values=(1, 2, 4)), Axis(key="w", values=("a", "b"))
    space = Space((Span(key="x", low=1.0, high=100.0, logarithmic=True),), axes)
    settings = [{"x": 10.0, "n": 4, "w": "a"}, {"x": 1.0, "n": 1, "w": "b"}]
    share = space.shares(settings)
    assert share[0] == pytest.approx([0.5, 5 / 6, 0.25])
    assert space.settings(share) == settings
    assert space.inputs(settings)[0] == pytest.approx([0.5, 5 / 6, 1.0, 0.0])


def test_the_model_tells_noise_from_signal():
    rng = np.random.default_rng(1)
    x = rng.random((60, 2))
    y = 0.1 * np.exp(x[:, 0]) * (1 + 0.05 * rng.standard_normal(60))
    model = Surrogate.fit("rms_m", x, y)
    assert model.noise == pytest.approx(0.05, rel=0.3)
    assert model.mean(x) == pytest.approx(0.1 * np.exp(x[:, 0]), rel=0.06)


def test_improvement_is_the_growth_of_the_hypervolume():
    front = np.array([[0.2, 0.8], [0.5, 0.5], [0.8, 0.1]])
    corner = np.array([1.0, 1.0])
    before = hypervolume(front, corner)
    assert before == pytest.approx(0.3 * 0.2 + 0.3 * 0.5 + 0.2 * 0.9)
    values = np.random.default_rng(2).random((40, 2)) * 1.2
    gained = improvement(values[:, None], np.concatenate([corner[None], front]))[:, 0]
    after = [hypervolume(np.vstack([front, value]), corner) for value in values]
    assert gained == pytest.approx(np.array(after) - before, abs=1e-12)
    assert len(pareto(np.vstack([front, front + 0.01]))) == 3


def test_a_region_that_fails_is_known_by_then():
    x = np.linspace(0, 1, 12)[:, None]
    chance = flown_probability(x, (x[:, 0] < 0.6).tolist(), np.array([[0.1], [0.95]]))
    assert chance[0] > 0.7
    assert chance[1] < 0.3
    assert (flown_probability(x, [True] * 12, x) == 1).all()


def test_failures_of_all_settings_end_the_design(small, monkeypatch):
    def fails(task):
        raise RuntimeError(str(Failure(kind="", text="broken").text))

    monkeypatch.setattr(trials, "trial_task", fails)
    plan = plan_design(small, FREE, minimise=["aperture_m"], require=["rms_m < 0.1"], surveys=20)
    with pytest.raises(ScenarioError, match=r"no setting could be flown: .*broken"):
        run_design(plan)


@pytest.mark.usefixtures("undrawn")
def test_the_command_flies_a_design_and_says_what_is_wrong(cli, small, tmp_path):
    given = ["--free", f"{BEAM}=2:6:log", "--minimise", "aperture_m", "--surveys", 11, "--repeat", 2]
    asked = ["design", small, *given, "--require", "rms_m < 9", "--confidence", 0.6, "-o", tmp_path / "out"]
    done = cli(*asked)
    assert "Best design after" in done.stdout
    document = json.loads((tmp_path / "out" / "design.json").read_text())
    # Every requirement holds, so that the widest beam that can be flown has the least aperture.
    assert 4.5 < document["best"]["setting"][BEAM] <= 5.0
    shown = cli("compare", tmp_path / "out")
    assert "beamwidth_deg" in shown.stdout
    refused = cli("design", small, *given, "--require", "rsm_m < 9", "-o", tmp_path / "other", code=2)
    assert "Did you mean rms_m?" in refused.stderr
    assert not (tmp_path / "other").exists()
    again = cli(
        "design", small, *given, "--require", "rms_m < 9", "--confidence", 0.6, "-o", tmp_path / "out", "--resume"
    )
    assert "nothing to do" in again.stdout
