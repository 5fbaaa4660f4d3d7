"""Tables, figures and maps of a sweep: what is shown of its settings, ranked, and compared over the same cells."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import poisson

from drawn_texts import texts_outside
from sionna_radar.foundation.raster import Raster
from sionna_radar.notebook import html_of
from sionna_radar.report.colours import BLUE
from sionna_radar.studies.sweep import figures
from sionna_radar.studies.sweep.common_cells import unequal_areas
from sionna_radar.studies.sweep.document import DOCUMENT
from sionna_radar.studies.sweep.figures import abscissa, errors
from sionna_radar.studies.sweep.plan import plan_sweep
from sionna_radar.studies.sweep.ranking import Ranking, ranked
from sionna_radar.studies.sweep.settings import Axis, label, parse_design
from sionna_radar.studies.sweep.study import run_sweep

pytestmark = pytest.mark.usefixtures("rough_errors")

BEAM = "radar.antenna.beamwidth_deg"


def test_the_numeric_key_is_drawn_against():
    words, numbers = Axis(key="w", values=("a", "b", "c")), Axis(key="n", values=(1, 2.5))
    assert abscissa((words, numbers)) is numbers
    assert abscissa((words, Axis(key="flag", values=(True, False)))) is words


def test_the_headline_is_of_lit_cells_and_all_cells_stand_beside_it(flown):
    _, sweep, _ = flown
    case = sweep.cases[0]
    assert case.mean("all_cells_rms_m") == pytest.approx(np.mean([r.dem_error.rms_m for r in case.trials]))
    assert np.isnan(case.mean("off_wall_rms_m"))  # flat ground has no walls
    assert len(repr(sweep)) < 1000
    page = re.sub(r"<[^>]*>", "", html_of(sweep))
    assert "beamwidth_deg" in page
    assert all(f"{case.mean('rms_m'):.3f}" in page for case in sweep.cases)


@pytest.mark.usefixtures("sketched_rain")
def test_rain_leaves_no_nan_in_the_table_and_says_what_happened(small, capsys):
    axes = parse_design(["weather.rain_rate_mm_per_h=0,20", "processing.volume_clutter=auto,off"])
    DOCUMENT.show(run_sweep(plan_sweep(small, axes)))
    printed = capsys.readouterr().out
    assert "nan" not in printed
    assert "come from the rain" in printed


def test_a_study_of_linear_maps_names_the_better_map(flown, capsys):
    DOCUMENT.show(flown[1])
    assert "hint: dem.method = 'refined' typically cuts this error by 15 to 53 %" in capsys.readouterr().out
    flown_twice = replace(flown[1], axes=(Axis(key="dem.method", values=("linear", "refined")),))
    DOCUMENT.show(flown_twice)
    assert "hint:" not in capsys.readouterr().out


def test_the_figure_names_its_axes_in_words_and_shows_the_runs(flown):
    figure = errors(flown[1])
    figure.draw_without_rendering()
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[0] == "RMS error of lit cells (m)"
    assert labels[3].startswith("Share of the planned swath")
    assert figure.axes[2].get_xlabel() == "Beamwidth (deg)"
    assert [text.get_text() for text in figure.legends[0].texts] == ["Ranging: peak", "Ranging: centroid"]
    # The dots of the runs are drawn beside the bar of their case.
    dots = [line for line in figure.axes[0].lines if line.get_alpha() == 0.6]
    assert len(dots) == 4
    bar = figure.axes[0].transData.transform((2.0, dots[0].get_ydata()[0]))
    assert dots[0].get_transform().transform((2.0, dots[0].get_ydata()[0]))[0] > bar[0] + 5


@pytest.mark.parametrize(("rate", "exposure"), [("km2", ("mapped_m2", 1e6)), ("minute", ("flown_s", 60.0))])
@pytest.mark.parametrize("alarms", [0, 3])
def test_the_interval_of_false_alarms_holds_the_means_that_could_have_made_them(flown, rate, exposure, alarms):
    """At its ends, 2.5 % of all Poisson counts are as few as those found, or as many."""
    _, sweep, _ = flown
    name, unit = exposure
    seen = [alarms // 3, alarms - alarms // 3]
    trials = [
        replace(sweep.cases[0].trials[0], **{name: amount, f"false_alarms_per_{rate}": count * unit / amount})
        for count, amount in zip(seen, (2.0, 6.0), strict=True)
    ]
    low, high = replace(sweep.cases[0], trials=tuple(trials)).interval(f"false_alarms_per_{rate}")
    units = 8.0 / unit
    assert poisson.cdf(alarms, high * units) == pytest.approx(0.025)
    assert low == 0.0 if alarms == 0 else poisson.sf(alarms - 1, low * units) == pytest.approx(0.025)


def test_long_values_are_told_in_short_and_apart():
    vans = [{"position_m": [float(k), 0.0], "rcs_dbsm": 10.0} for k in range(30)]
    told = label({"targets": vans, "radar.snr_db": 20.0})
    assert told == "targets = [{'position_m': [0.0, 0.0], 'rcs ... sm': 10.0}], snr_db = 20"
    assert label({}) == "nothing changed"


def of_methods(sweep, count):
    """Return a pretended sweep over beams and a number of methods, one trial each."""
    beams, names = (1.0, 2.0), tuple(f"a_long_name_of_a_method_{n}" for n in range(count))
    cases = tuple(
        replace(case, setting={BEAM: beam, "processing.ranging": name}, trials=case.trials[:1])
        for name in names
        for beam, case in zip(beams, sweep.cases[:2], strict=True)
    )
    axes = (Axis(key=BEAM, values=beams), Axis(key="processing.ranging", values=names))
    return replace(sweep, cases=cases, axes=axes, repeat=1)


def test_each_line_of_the_figure_has_a_colour_of_its_own_and_one_trial_no_bars(flown):
    single = of_methods(flown[1], 7)
    panel = errors(single).axes[0]
    assert len({line.get_color() for line in panel.lines}) == len(panel.lines) == 7
    assert not any(bars.has_yerr for bars in panel.containers)
    assert texts_outside(errors(single)) == []
    cases = (*(replace(case, trials=()) for case in single.cases[:2]), *single.cases[2:])
    assert len(errors(replace(single, cases=cases)).legends[0].texts) == 6
    assert all(bars.has_yerr for bars in errors(flown[1]).axes[0].containers)


def test_from_eight_lines_on_each_has_panels_of_its_own_before_all_others(flown, monkeypatch):
    figure = errors(of_methods(flown[1], 9))
    assert len(figure.axes) == 9 * 4
    assert not figure.legends
    for panel in figure.axes:
        assert [line.get_color() for line in panel.lines].count(BLUE) == 1
        assert len({line.get_color() for line in panel.lines if line.get_label() != "_child0"} - {"black"}) == 2
    assert texts_outside(figure) == []
    monkeypatch.setattr(figures, "MAX_MULTIPLES", 9)
    many = errors(of_methods(flown[1], 12))
    assert len(many.axes) == 9 * 4
    assert "9 of 12 settings" in many.get_suptitle()


def test_a_ranked_table_marks_what_meets_what_is_on_the_front_and_what_is_undecided(flown):
    _, sweep, _ = flown
    errors = [0.10, 0.11, 0.30, 0.20]
    cases = []
    for case, rms in zip(sweep.cases, errors, strict=True):
        trials = [
            replace(trial, lit_error=replace(trial.lit_error, rms_m=rms + 0.01 * turn, coverage=0.9))
            for trial, turn in zip(case.trials, (-1, 1), strict=True)
        ]
        cases.append(replace(case, trials=tuple(trials)))
    judged = replace(sweep, cases=tuple(cases))
    rows = ranked(judged, Ranking.parse("rms_m", ["rms_m < 0.25", "coverage > 0.5"], ["rms_m", "aperture_m"]))
    assert [case.mean("rms_m") for case, _ in rows] == pytest.approx([0.10, 0.11, 0.20, 0.30])
    assert [row["meets"] for _, row in rows] == [True, True, True, False]
    assert [row["undecided"] for _, row in rows] == [False, True, False, False]
    # Both narrow beams have one aperture, so that the worse of them is off the front; the wide one is smaller.
    assert [row["pareto"] for _, row in rows] == [True, False, True, False]
    assert {row["method"] for _, row in rows} == {"linear"}
    assert rows[0][1]["line_gap_m"] == pytest.approx(5.0)


@pytest.mark.usefixtures("undrawn")
def test_the_command_ranks_and_compare_reads_the_study(cli, small, tmp_path):
    vary = ["--vary", f"{BEAM}=2,4", "--require", "rms_m < 9", "--pareto", "rms_m", "--pareto", "aperture_m"]
    cli("sweep", small, *vary, "--sort", "-aperture_m", "-o", tmp_path / "a")
    with (tmp_path / "a" / "table.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert [float(row[BEAM]) for row in table] == [2.0, 4.0]
    assert float(table[0]["aperture_m"]) > float(table[1]["aperture_m"])
    assert {row["meets"] for row in table} == {"True"}
    assert {row["dem.method"] for row in table} == {"linear"}
    shown = cli("compare", tmp_path / "a", tmp_path / "a")
    assert shown.stdout.count("beamwidth_deg = 4") == 2
    cli("compare", tmp_path / "a", tmp_path / "b", code=2)
    cli("sweep", small, *vary, "--sort", "rsm_m", "-o", tmp_path / "c", code=2)


def error_by_place(path):
    """Return the errors of a map's filled cells by where they are, to a centimetre."""
    raster = Raster.read(path)
    return {
        tuple(np.round(place, 2)): height
        for place, height in zip(raster.grid.centres_m, raster.height_m.ravel(), strict=True)
        if np.isfinite(height)
    }


@pytest.mark.usefixtures("undrawn")
def test_kept_maps_are_compared_over_their_common_cells(small, tmp_path, cli):
    """The cells are found once more by their coordinates; both grids differ in size, their cells coincide."""
    out = tmp_path / "out"
    vary = ["--vary", "platform.altitude_m=30,40", "--set", "platform.length_m=15"]
    cli("sweep", small, *vary, "--keep", "all", "-q", "-o", out)
    with (out / "runs.csv").open(newline="") as file:
        told = [float(row["common_rms_m"]) for row in csv.DictReader(file)]
    errors_at = [error_by_place(out / "maps" / f"{case}_seed_5_error.tif") for case in (1, 2)]
    assert len({len(cells) for cells in errors_at}) > 1
    shared = set.intersection(*(set(cells) for cells in errors_at))
    assert len(shared) > 100
    rms_m = [np.sqrt(np.mean([cells[place] ** 2 for place in shared])) for cells in errors_at]
    np.testing.assert_allclose(told, rms_m, rtol=1e-6)
    cli("sweep", small, *vary, "--keep", "best", "-q", "-o", tmp_path / "best")
    rms = [case["statistics"]["common_rms_m"]["mean"] for case in json.loads((out / "sweep.json").read_text())["cases"]]
    number = 1 + int(np.argmin(rms))
    kept = {path.name: path.read_bytes() for path in (tmp_path / "best" / "maps").iterdir()}
    assert kept == {path.name: path.read_bytes() for path in (out / "maps").glob(f"{number}_*")}


def test_maps_whose_cells_do_not_coincide_share_none(small):
    plan = plan_sweep(small, {"dem.spacing_m": [1.0, 1.5]})
    trials = [trial for case in run_sweep(plan, keep_maps=True).cases for trial in case.trials]
    assert [trial.common_rms_m for trial in trials] == [None, None]
    assert all(set(trial.maps) >= {"dem", "error"} for trial in trials)


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_says_that_mapped_areas_differ_and_compares_the_same_ground(small, cli, tmp_path):
    """The swath grows with the height; the errors of the common cells are stated without kept maps."""
    short = ["--set", "platform.length_m=30"]
    shown = cli("sweep", small, "--vary", "platform.altitude_m=35,50", *short, "-o", tmp_path / "a").stdout
    said = " ".join(shown.split())
    assert "mapped areas differ by" in said
    assert "altitude_m = 35" in said[said.index("mapped areas differ") :]
    with (tmp_path / "a" / "table.csv").open(newline="") as file:
        low, high = csv.DictReader(file)
    areas = [float(row["mapped_m2"]) for row in (low, high)]
    swaths = [float(row["mapped_swath_m"]) for row in (low, high)]
    assert 1.2 < areas[1] / areas[0] < 1.8
    assert swaths == pytest.approx([area / 30 for area in areas])
    assert all(0.5 < float(row["coverage_of_swath"]) <= 1 for row in (low, high))
    assert float(high["common_rms_m"]) != float(high["rms_m"])
    assert json.loads((tmp_path / "a" / "sweep.json").read_text())["notes"]
    assert not (tmp_path / "a" / "maps").exists()
    asked = ["--require", "mapped_m2 > 1", "--sort", "-coverage_of_swath", "--vary", "radar.snr_db=20,30"]
    shown = cli("sweep", small, *asked, *short, "-o", tmp_path / "b").stdout
    assert "mapped areas differ" not in shown


def test_areas_that_differ_by_no_more_than_a_twentieth_are_alike():
    assert unequal_areas([("a", 95.0), ("b", 100.0), ("c", np.nan)]) == ""
    assert "6% (94 m2 at a, 100 m2 at b)" in unequal_areas([("a", 94.0), ("b", 100.0)])
    assert unequal_areas([("a", 94.0)]) == ""
