"""The two engines over one small survey, and a cross-check that finds out a wrong one."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import sionna_radar.studies.crosscheck.study
from blank_figures import leave_blank
from sionna_radar.execution.execution import Execution
from sionna_radar.scenario import parse_scenario
from sionna_radar.studies.crosscheck.document import DOCUMENT, verdict_table
from sionna_radar.studies.crosscheck.study import CrossCheck, Tolerances
from sionna_radar.studies.crosscheck.study import crosscheck as run_crosscheck


def small_hills(**tracing):
    return parse_scenario(
        {
            "terrain": {"kind": "hills", "size_m": [200.0, 200.0], "height_m": 6.0},
            "platform": {"altitude_m": 40.0, "speed_mps": 10.0, "start_m": [-50.0, 0.0], "length_m": 15.0},
            "radar": {"snr_db": 30.0, "scan": {"half_swath_deg": 40.0}},
            "tracing": tracing,
        }
    )


@pytest.fixture(scope="module")
def progress():
    return []


@pytest.fixture(scope="module")
def check(progress) -> CrossCheck:
    return run_crosscheck(
        small_hills(), execution=Execution(block_size=50, progress=lambda *done: progress.append(done))
    )


def test_the_engines_agree_on_hills(check):
    assert abs(check.mean_power_difference_db) < 0.02
    assert check.p95_abs_power_difference_db < 0.1
    assert check.agrees


def test_sampling_of_the_beam_is_not_called_a_difference(check):
    """Every tenth pulse off by 3 dB in both seeds of the Sionna engine, each to its own side: too few rays."""
    some = np.arange(len(check.sionna.power)) % 10 == 0
    noisy = {
        name: replace(getattr(check, name), power=getattr(check, name).power * np.where(some, 10**exponent, 1.0))
        for name, exponent in (("sionna", 0.3), ("sionna_again", -0.3))
    }
    assert replace(check, **noisy).verdict()["p95_abs_power_difference_db"]["agrees"]
    wrong = replace(check, sionna=noisy["sionna"], sionna_again=noisy["sionna"])
    assert not wrong.verdict()["p95_abs_power_difference_db"]["agrees"]


@pytest.mark.parametrize("scatterers", [12, 200])
def test_scatter_is_rarely_called_a_difference_and_a_difference_is_found(check, scatterers):
    """Sums of scatterers whose power is drawn, zero or twice the mean: of 100 comparisons one in a thousand."""
    rng, count = np.random.default_rng(2), len(check.sionna.power)
    names, strength = ("sionna", "sionna_again", "gamma", "gamma_again"), rng.uniform(0.5, 2.0, count)

    def drawn(louder=1.0):
        shown = {}
        for name in names:
            power = strength * (1 + rng.binomial(scatterers, 0.5, count)) / (1 + scatterers / 2)
            shown[name] = replace(getattr(check, name), power=power * (louder if "gamma" in name else 1.0))
        verdict = replace(check, **shown).verdict()
        return all(verdict[f"{name}_power_difference_db"]["agrees"] for name in ("mean", "p95_abs"))

    assert sum(not drawn() for _ in range(100)) <= 1
    # Four standard deviations of the mean beyond what they may differ by.
    scatter_db = 10 / np.log(10) * np.sqrt(2 * scatterers / 4 / (1 + scatterers / 2) ** 2 / count)
    assert not any(drawn(10 ** (0.1 * (0.1 + 9 * scatter_db))) for _ in range(10))


def test_engines_agree_on_what_a_circular_wave_shows():
    """Signs of the scattering matrix are drawn, and with them power: by both engines, anew with each seed."""
    scenario = small_hills()
    antenna = scenario.radar.antenna.model_copy(update={"polarization": "RHCP"})
    radar = scenario.radar.model_copy(update={"antenna": antenna})
    found = run_crosscheck(scenario.model_copy(update={"radar": radar}))
    assert found.agrees
    for one, other in ((found.sionna, found.sionna_again), (found.gamma, found.gamma_again)):
        spread = np.std(one.power - other.power) / np.sqrt(2) / np.mean(one.power)
        # Of some hundred scatterers in a beam, with a power of zero or twice the mean each.
        assert 0.03 < spread < 0.3


def test_the_dems_differ_by_speckle(check):
    assert check.dem_speckle_rms_m > 0.02
    assert check.dem_rms_difference_m < 1.25 * check.dem_speckle_rms_m
    assert abs(DOCUMENT.content(check)["dem_mean_difference_m"]) < 0.5 * check.dem_speckle_rms_m


def test_the_mean_ranges_agree_to_a_tenth_of_a_cell(check):
    spread = DOCUMENT.content(check)["range_difference_m"]
    assert abs(spread["mean"]) < 0.01
    assert spread["p95_abs"] < 0.03


def test_progress_counts_all_four_runs(check, progress):
    count = len(check.sionna.power)
    assert progress[-1] == ("tracing", 4 * count, 4 * count)
    traced = [done for stage, done, _ in progress if stage == "tracing"]
    assert traced == sorted(set(traced))


def test_a_fifth_of_a_decibel_too_much_is_found_out(check):
    louder = replace(check, gamma=replace(check.gamma, power=check.gamma.power * 10**0.02))
    assert louder.mean_power_difference_db == pytest.approx(check.mean_power_difference_db + 0.2)
    assert not louder.agrees


def test_a_dem_half_a_metre_too_high_is_found_out(check):
    higher = {}
    for name in ("gamma", "gamma_again"):
        engine_run = getattr(check, name)
        higher[name] = replace(engine_run, dem=replace(engine_run.dem, height_m=engine_run.dem.height_m + 0.5))
    assert check.dem_test.probability > 0.001
    wrong = replace(check, **higher)
    assert wrong.dem_test.probability <= 0.001
    assert not wrong.agrees


def test_a_trend_with_incidence_is_found(check):
    tilted = check.gamma.power * 10 ** (np.rad2deg(check.sionna.incidence_rad) / 10 * 0.03)
    trend = replace(check, gamma=replace(check.gamma, power=tilted)).power_trend_db_per_10deg()
    assert trend == pytest.approx(check.power_trend_db_per_10deg() + 0.3, abs=1e-6)


def test_without_any_dem_nothing_agrees_and_the_summary_says_none(check):
    dem = replace(check.gamma.dem, height_m=np.full_like(check.gamma.dem.height_m, np.nan))
    empty = replace(check, gamma=replace(check.gamma, dem=dem))
    assert not empty.agrees
    assert DOCUMENT.content(empty)["dem_rms_difference_m"] is None
    json.dumps(DOCUMENT.content(empty), allow_nan=False)
    assert "not comparable" in list(verdict_table(empty).columns[3].cells)


def test_few_cells_of_equal_engines_are_not_called_different(check):
    """Two tiles of the map, whose speckle happens to be more unlike between engines than between seeds."""
    rows, columns = np.nonzero(check.common())
    random, runs = np.random.default_rng(3), {}
    for name in ("sionna", "sionna_again", "gamma", "gamma_again"):
        height_m = np.full(check.gamma.dem.height_m.shape, np.nan)
        height_m[rows[:8], columns[:8]] = random.normal(size=8) + (2.0 if "gamma" in name else 0.0)
        runs[name] = replace(getattr(check, name), dem=replace(check.gamma.dem, height_m=height_m))
    few = replace(check, **runs)
    assert not few.dem_test.can_reject(few.tolerances.false_alarm_probability)
    assert few.dem_rms_difference_m > few.tolerances.dem_factor * few.dem_speckle_rms_m
    assert few.agrees


def test_the_results_are_written_and_replaced_and_what_is_the_user_s_stays(check, tmp_path, monkeypatch):
    place = tmp_path / "deep" / "check"
    files = {path.relative_to(place).as_posix() for path in DOCUMENT.write(check, place)}
    assert files == {"manifest.json", "crosscheck.json", "figures/power.png", "figures/ranges.png", "figures/dems.png"}
    assert json.loads((place / "crosscheck.json").read_text())["agrees"] is True
    (place / "figures" / "mine.png").touch()
    leave_blank(monkeypatch)
    assert len(DOCUMENT.write(check, place)) == 5
    assert (place / "figures" / "mine.png").exists()
    assert [path.name for path in place.parent.iterdir()] == ["check"]


@pytest.mark.usefixtures("undrawn")
def test_the_command_fails_where_the_engines_differ(cli, small, tmp_path, monkeypatch):
    strict = partial(Tolerances, mean_power_db=-1.0)
    monkeypatch.setattr(sionna_radar.studies.crosscheck.study, "Tolerances", strict)
    done = cli("crosscheck", small, "-o", tmp_path / "check", "--set", "platform.length_m=2", code=1)
    assert "DIFFER" in done.stdout
    assert (tmp_path / "check" / "crosscheck.json").is_file()
