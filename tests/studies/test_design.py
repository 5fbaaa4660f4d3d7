"""What a study varies: ranges filled evenly whatever the key, tables read as they stand, and the rest refused."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.sweep.figures import errors
from sionna_radar.studies.sweep.plan import plan_sweep
from sionna_radar.studies.sweep.results import rows_of, write_runs_parquet
from sionna_radar.studies.sweep.settings import Axis, Design, Sampler, Span, parse_design, read_settings
from sionna_radar.studies.sweep.study import run_sweep

BEAM, SNR, SAMPLES = "radar.antenna.beamwidth_deg", "radar.snr_db", "radar.samples_per_chirp"


@pytest.fixture(scope="module")
def hills():
    return load_scenario("hills")


def sampled(base, *vary, sample="sobol:64"):
    return parse_design(vary, sample).settings(base)


@pytest.mark.parametrize("sample", ["sobol:64", "lhs:64", "lhs:50"])
def test_samples_fill_their_ranges_evenly_in_all_keys_at_once(hills, sample):
    settings = sampled(hills, f"{BEAM}=1:9", f"{SNR}=10:30", sample=sample)
    shares = np.array([[(s[BEAM] - 1) / 8, (s[SNR] - 10) / 20] for s in settings])
    # Each key alone: one sample in every one of as many equal parts.
    for share in shares.T:
        assert sorted(np.floor(share * len(share)).astype(int)) == list(range(len(share)))
    plain = np.random.default_rng(0).random(shares.shape)
    assert qmc.discrepancy(shares) < 0.5 * qmc.discrepancy(plain)


def test_a_logarithmic_range_is_even_in_the_logarithm(hills):
    values = [s[SNR] for s in sampled(hills, f"{SNR}=0.1:1000:log")]
    assert np.log10(values).mean() == pytest.approx(1.0, abs=0.05)
    assert sum(value < 1 for value in values) == 16  # a quarter of four decades


def test_a_key_of_whole_numbers_takes_every_one_alike(hills):
    values = [s[SAMPLES] for s in sampled(hills, f"{SAMPLES}=512:515")]
    assert all(type(value) is int for value in values)
    assert [values.count(number) for number in range(512, 516)] == [16, 16, 16, 16]


def test_the_seed_draws_the_samples_and_the_same_seed_the_same(hills):
    other = hills.model_copy(update={"seed": hills.seed + 1})
    first = sampled(hills, f"{BEAM}=1:9")
    assert sampled(hills, f"{BEAM}=1:9") == first
    assert sampled(other, f"{BEAM}=1:9") != first


def test_rows_samples_and_lists_are_all_combined(hills, tmp_path):
    table = tmp_path / "rows.csv"
    table.write_text("platform.altitude_m,seed\n50,1\n60,\n")
    settings = parse_design([f"{SNR}=10,20", f"{BEAM}=1:9"], "lhs:3", table).settings(hills)
    assert len(settings) == 2 * 3 * 2
    assert [list(s) for s in settings[:2]] == [["platform.altitude_m", "seed", BEAM, SNR]] * 2
    assert "seed" not in settings[-1]
    assert [s[SNR] for s in settings] == [10, 20] * 6


@pytest.mark.parametrize(
    ("vary", "sample", "says"),
    [
        ([f"{BEAM}=1:9"], None, "--sample sobol:64"),
        ([f"{BEAM}=1,9"], "sobol:8", "no range"),
        ([f"{BEAM}=9:1"], "sobol:8", "LOW below HIGH"),
        ([f"{BEAM}=1:1e999"], "sobol:8", "finite"),
        ([f"{BEAM}=0:9:log"], "sobol:8", "above 0"),
        ([f"{BEAM}=1:9"], "sobol", "sobol:N"),
        ([f"{BEAM}=1:9"], "sobol:0", "from 1"),
        ([f"{BEAM}=1:9"], "sobol:10001", "to 10,000"),
        ([f"{BEAM}=1:9"], "random:10", "sobol:N or lhs:N"),
        ([f"{BEAM}=1:9"], "sobol:-4", "sobol:N"),
        ([f"{BEAM}=1:9", f"{BEAM}=1,2"], "sobol:8", "varied twice"),
        ([f"{BEAM}=1:9", f"{SNR}=1,2,3"], "sobol:5000", "15,000 settings"),
        ([f"{SAMPLES}=512.2:512.8"], "sobol:8", "no whole number"),
    ],
)
def test_what_cannot_be_sampled_is_refused(hills, vary, sample, says):
    with pytest.raises(ScenarioError, match=says):
        parse_design(vary, sample).settings(hills)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no setting"),
        ("seed\n", "no setting"),
        ("seed,seed\n1,2\n", "of another one"),
        ("seed,\n1,2\n", "has no key"),
        ("seed\n1,2\n", "2 values for 1 keys"),
        ("seed\n1\n2\n1\n", "settings 1 and 3 are the same"),
        ('seed\n"1\n', "not CSV"),
        ("seed\n" + "\n".join(map(str, range(10_001))), "10,001 settings"),
        ("seed\n[1\n", "not a value"),
    ],
)
def test_what_is_no_table_of_settings_is_refused(tmp_path, text, says):
    path = tmp_path / "rows.csv"
    path.write_text(text)
    with pytest.raises((InputFileError, ScenarioError), match=says):
        read_settings(path)


def test_a_table_that_sets_nothing_is_no_design(tmp_path):
    path = tmp_path / "rows.csv"
    path.write_text("seed,radar.snr_db\n , \n")
    with pytest.raises(ScenarioError, match="nothing is varied"):
        parse_design([], table=path)
    assert parse_design(["seed=1,2"], table=path).keys == ("seed",)


def test_a_table_may_leave_keys_alone_take_them_out_and_name_files_beside_it(tmp_path):
    (tmp_path / "here.toml").write_text("")
    path = tmp_path / "rows.csv"
    path.write_text(
        "\ufeffterrain.path, radar.snr_db ,processing.window\r\nhere.toml,none,hann\r\n,20.5,\r\n\r\n,,\r\n"
    )
    first, second, third = read_settings(path)
    assert first == {"terrain.path": str(tmp_path / "here.toml"), "radar.snr_db": None, "processing.window": "hann"}
    assert second == {"radar.snr_db": 20.5}
    assert third == {}


@pytest.mark.parametrize("scene", ["hills", "buildings"])
def test_the_table_of_effects_is_one_of_scenarios(scene):
    settings = read_settings(Path(__file__).parents[2] / "examples" / "effects.csv")
    assert [len(setting) for setting in settings] == [0, 2, 2, 1, 1, 2, 2, 1, 1]
    scenarios = [load_scenario(scene, setting) for setting in settings]
    assert sum(scenario != scenarios[0] for scenario in scenarios) == 8


def test_the_command_flies_a_sample_and_tabulates_it(cli, small, tmp_path):
    given = ["--vary", f"{BEAM}=2:6", "--sample", "lhs:3", "--vary", "processing.ranging=peak,centroid"]
    cli("sweep", small, *given, "-o", tmp_path / "out")
    with (tmp_path / "out" / "runs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 6
    assert all(float(row["wall_s"]) > 0 and float(row["peak_memory_mb"]) > 50 for row in rows)
    figures = {path.name for path in (tmp_path / "out" / "figures").iterdir()}
    assert figures == {"sweep.png", "sweep_processing_ranging.png"}
    document = json.loads((tmp_path / "out" / "sweep.json").read_text())
    assert [axis["crossed"] for axis in document["axes"]] == [False, True]
    assert '"wall_s"' not in json.dumps(document)


@pytest.fixture(scope="module")
def flown_sample(small):
    design = Design(spans=(Span(key=BEAM, low=2.0, high=6.0),), sampler=Sampler(name="sobol", count=8))
    return run_sweep(plan_sweep(small, design))


def test_dots_of_a_sample_are_not_joined_and_their_rank_correlation_stands_beside(flown_sample):
    figure = errors(flown_sample)
    assert figure.axes[0].lines[0].get_linestyle() == "None"
    assert figure.axes[0].get_title(loc="right").startswith("rank correlation")


def test_a_setting_that_fails_has_its_row(small, tmp_path):
    table = tmp_path / "rows.csv"
    table.write_text(f"{BEAM},seed\n4,1\n400,\n")
    rows = rows_of(run_sweep(plan_sweep(small, parse_design([], table=table))))
    assert [(row["run_seed"], row["seed"], bool(row["reason"])) for row in rows] == [(1, 1, False), (None, "", True)]
    assert "beamwidth_deg" in rows[1]["reason"]


def test_the_table_as_parquet_has_columns_of_one_type(small, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    sweep = run_sweep(plan_sweep(small, {BEAM: [2, 4.5], "radar.antenna.side_lobe_db": [-20.0, -25.0]}))
    write_runs_parquet(tmp_path / "runs.parquet", sweep)
    read = parquet.read_table(tmp_path / "runs.parquet").to_pylist()
    assert [row[BEAM] for row in read] == [2.0, 2.0, 4.5, 4.5]
    assert [row["rms_m"] for row in read] == [case.mean("rms_m") for case in sweep.cases]


def test_parquet_without_its_library_is_refused_before_anything_is_flown(cli, small, tmp_path, monkeypatch):
    monkeypatch.setattr("sionna_radar.report.files.points_table.find_spec", lambda _: None)
    refused = cli("sweep", small, "--vary", f"{BEAM}=2,4", "--runs", "parquet", "-o", tmp_path / "out", code=2)
    assert "runs.parquet needs pyarrow" in refused.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("key", "values", "scale"),
    [
        (BEAM, (1, 2, 4, 8), "log"),
        (BEAM, tuple(range(1, 11)), "linear"),
        (SNR, (2, 4, 8, 16, 32), "linear"),
        (BEAM, (2, 4), "linear"),
    ],
)
def test_the_abscissa_is_logarithmic_where_that_spreads_the_values(flown_sample, key, values, scale):
    cases = [replace(flown_sample.cases[0], setting={key: value}) for value in values]
    figure = errors(replace(flown_sample, axes=(Axis(key=key, values=values),), cases=tuple(cases)))
    assert figure.axes[2].get_xscale() == scale
