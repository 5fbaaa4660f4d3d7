"""The command line: exit codes, one clear error, nothing written on bad input."""

import json
import logging
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version

import numpy as np
import pytest
import rasterio

from elevation_files import from_origin, write_heights
from flight_logs import flown, regular, write_csv
from sionna_radar import __main__ as command
from sionna_radar.cli.session import log_to_stderr
from sionna_radar.foundation.errors import WorkersLostError

pytestmark = pytest.mark.usefixtures("rough_errors")


def bad_dem(tmp_path):
    path = tmp_path / "broken.tif"
    path.write_bytes(b"II*\x00 this is no GeoTIFF")
    return path


def without_crs(tmp_path):
    path = tmp_path / "grid.asc"
    rows = "\n".join(" ".join("10.0" for _ in range(20)) for _ in range(20))
    path.write_text(f"ncols 20\nnrows 20\nxllcorner 0\nyllcorner 0\ncellsize 10\nNODATA_value -9999\n{rows}\n")
    return path


@pytest.mark.parametrize(
    ("terminal", "kept", "arguments", "told"),
    [
        (True, False, ["demo"], "starting, Python compiles the modules first\n"),
        (True, True, ["demo"], ""),
        (False, False, ["demo"], ""),
        (True, False, ["demo", "-q"], ""),
    ],
)
def test_a_first_start_says_on_a_terminal_that_it_takes_longer(
    terminal, kept, arguments, told, monkeypatch, capsys, tmp_path
):
    byte_code = tmp_path / "app.pyc"
    if kept:
        byte_code.touch()
    monkeypatch.setattr(command, "cache_from_source", lambda _: str(byte_code))
    monkeypatch.setattr(sys, "argv", ["sionna-radar", *arguments])
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal)
    command._tell_of_first_start()
    assert capsys.readouterr().err == told


def test_run_writes_every_product(cli, small, tmp_path):
    done = cli("run", small, "-o", tmp_path / "out", "--figures", "--block-size", 7, "--set", "platform.length_m=10")
    # Where there is no terminal, no bar but a line for what takes long, as it may on a busy machine.
    plain = r"[a-z]+|[a-z]+: [\d,]+ of [\d,]+(, about [\d,]+ s left)?|compiling, first run only"
    assert all(re.fullmatch(plain, line) for line in done.stderr.splitlines()), done.stderr
    written = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    figures = {f"figures/{n}.png" for n in ("environment", "chirp", "power_map", "dem", "error_map")}
    assert written == {
        "manifest.json", "report.html", "summary.json", "costs.json", "scenario.toml", "points.laz", "points.csv",
        "trajectory.csv", "dem.tif", "dem_sigma.tif", "truth.tif", "error.tif", "lit.tif", *figures,
    }  # fmt: skip
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert set(summary) == {
        "scenario", "replaced", "warnings", "seed", "crs", "georeference", "engine", "pulses", "paths", "echoes",
        "flight_log", "dem_error", "lit_error", "off_wall_error", "breakdown", "dem_uncertainty", "overhang", "meaning",
        "reference", "points_sha256", "versions", "canopy", "no_echo", "receiver", "mapped", "readings", "obstacles",
        "canopy_check", "navigation",
    }  # fmt: skip
    assert set(summary["dem_error"]) == {
        "count", "coverage", "min_m", "max_m", "std_m", "mean_m", "rms_m", "nmad_m",
        "le68_m", "le90_m", "le95_m", "p95_p5_m", "over_1m",
    }  # fmt: skip
    costs = json.loads((tmp_path / "out" / "costs.json").read_text())
    assert costs["timing_s"]["total"] > costs["timing_s"]["trace"] > 0
    assert costs["peak_memory_mb"] > 100
    assert costs["byte_code_kept"] is not sys.dont_write_bytecode
    again = cli(
        "run", tmp_path / "out" / "scenario.toml", "-o", tmp_path / "again", "--figures", "--quiet", "--no-report"
    )
    assert not (tmp_path / "again" / "report.html").exists()
    assert again.stdout == ""
    # Byte for byte, whatever the size of the blocks; but for what it took, and the digests of a folder without a page.
    for name in written - {"report.html", "costs.json", "manifest.json"}:
        assert (tmp_path / "again" / name).read_bytes() == (tmp_path / "out" / name).read_bytes(), name


@pytest.mark.usefixtures("undrawn")
def test_figures_of_a_finished_run_are_drawn_without_another_flight(cli, small, tmp_path, monkeypatch):
    arguments = ["run", small, "-o", tmp_path / "out", "--set", "platform.length_m=10"]
    cli(*arguments, "-q")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir() if path.name != "manifest.json"}
    monkeypatch.setattr("sionna_radar.survey.chain.observe", lambda *_: pytest.fail("flown again"))
    done = cli(*arguments, "--resume", "--figures")
    assert "already; 5 files added" in done.stdout, done.stderr
    assert len(list((tmp_path / "out" / "figures").glob("*.png"))) == 5
    assert {name: (tmp_path / "out" / name).read_bytes() for name in before} == before
    assert "nothing to do" in cli(*arguments, "--resume", "--figures").stdout


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("option", [["--points", "laz"], ["--set", "processing.navigation=refined"]])
def test_a_folder_that_lacks_what_is_drawn_is_flown_again(option, cli, small, tmp_path):
    """Without the table of points, and with a refined navigation, whose course is in no file."""
    arguments = ["run", small, "-o", tmp_path / "out", "--no-report", "--set", "platform.length_m=10", *option]
    cli(*arguments, "-q")
    done = cli(*arguments, "--resume", "--figures")
    assert "files added" not in done.stdout
    assert (tmp_path / "out" / "figures" / "dem.png").is_file()


def test_seed_and_set_replace_values(cli, small, tmp_path):
    cli("run", small, "-o", tmp_path / "out", "--seed", 9, "--set", "radar.antenna.beamwidth_deg=4", "-q")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["seed"] == 9
    assert summary["scenario"]["radar"]["antenna"]["beamwidth_deg"] == 4


BAD_VALUES = {
    "unknown key": ("radar.beam=3", "radar.beam"),
    "no KEY=VALUE": ("radar", "--set"),
    "contradiction": ("radar.noise_figure_db=10", "radar.snr_db"),
    "swath leaves the mesh": ("radar.scan.half_swath_deg=75", "radar"),
}


@pytest.mark.parametrize("kind", BAD_VALUES)
def test_bad_value_is_one_error_and_nothing_is_written(cli, kind, small, tmp_path):
    assignment, field = BAD_VALUES[kind]
    done = cli("run", small, "-o", tmp_path / "out", "--set", assignment, code=2)
    assert field in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_all_problems_are_told_at_once(cli, small):
    done = cli("validate", small, "--set", "radar.beam=3", "--set", "platform.speed_mps=-1", "--set", "seed=-1", code=2)
    assert all(key in done.stderr for key in ("radar.beam", "platform.speed_mps", "seed", "3 problems"))


@pytest.mark.parametrize(
    ("make", "word"),
    [(bad_dem, "broken.tif"), (without_crs, "terrain.crs"), (lambda folder: folder / "none.tif", "none.tif")],
)
def test_bad_elevation_file(cli, make, word, tmp_path):
    path = make(tmp_path)
    before = sorted(tmp_path.iterdir())
    done = cli("run", "own_dem", "--set", f"terrain.path={path}", "-o", tmp_path / "out", code=2)
    assert word in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_own_dem_of_1_m_in_utm(cli, tmp_path):
    """A slope of known form, flown with no edit but the path; the DEM lies on it and on its coordinates."""
    size, west, north = 300, 500_000.0, 5_040_000.0
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    height = 850 + 0.05 * column - 0.03 * row + 2 * np.sin(column / 20)
    corner = from_origin(west, north, 1.0, 1.0)
    path = write_heights(tmp_path / "utm.tif", height.astype(np.float32), corner, "EPSG:32631")
    cli("run", "own_dem", "--set", f"terrain.path={path}", "-o", tmp_path / "out", "-q")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["dem_error"]["rms_m"] < 0.3
    with rasterio.open(tmp_path / "out" / "dem.tif") as file:
        assert file.crs.to_epsg() == 32631
        rows, columns = np.nonzero(np.isfinite(file.read(1)))
        x, y = rasterio.transform.xy(file.transform, rows, columns)
        value = file.read(1)[rows, columns]
    x, y = np.asarray(x) - west, north - np.asarray(y)
    expected = 850 + 0.05 * x - 0.03 * y + 2 * np.sin(x / 20)
    assert len(value) > 1000
    assert np.sqrt(np.mean((value - expected) ** 2)) < 0.3


def test_validate_prints_a_scenario_that_loads(cli, small, tmp_path):
    done = cli("validate", small)
    *shown, verdict, expected = done.stdout.splitlines()
    assert re.search(r" can be flown: \d+ pulses in [\d.]+ s, DEM of \d+ x \d+ cells of 1 m, 0 warnings$", verdict)
    (tmp_path / "resolved.toml").write_text(done.stdout)
    again = cli("validate", tmp_path / "resolved.toml", "--all")
    assert again.stdout.count("\n") > 2 * len(shown)
    (tmp_path / "whole.toml").write_text(again.stdout)
    assert cli("validate", tmp_path / "whole.toml").stdout.splitlines()[:-2] == shown
    assert re.search(r"^# expected: [\d.e+]+ paths, \d\.\d GB of memory, and on two cores about [\d.e-]+ s ", expected)


def test_scenes_lists_the_shipped_scenarios(cli):
    lines = cli("scenes").stdout.splitlines()
    names = {line.split()[0] for line in lines}
    shipped = {"hills", "buildings", "roof_edge", "two_fields", "jacksboro", "san_francisco", "munich", "own_dem"}
    assert shipped <= names
    assert all(len(line.split(maxsplit=1)) == 2 for line in lines)


def test_doctor_names_variant_and_library():
    command = [sys.executable, "-m", "sionna_radar", "doctor"]
    kept = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=kept)
    assert "ad_mono_polarized" in done.stdout
    assert "one ray traced correctly" in done.stdout
    assert "byte code" not in done.stdout


def test_doctor_says_when_every_start_compiles_all_modules(cli, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert "not kept (PYTHONDONTWRITEBYTECODE is set)" in cli("doctor").stdout


def test_a_warning_is_shown_once_in_a_command(monkeypatch, capsys):
    monkeypatch.setattr(logging.getLogger("sionna_radar"), "handlers", [])
    for _ in range(2):
        log_to_stderr()
        for name in ("surfaces.build", "surfaces.build", "execution.cluster", "execution.cluster"):
            logging.getLogger(f"sionna_radar.{name}").warning("of %s", name)
        assert capsys.readouterr().err.splitlines() == [
            "WARNING: of surfaces.build",
            "WARNING: of execution.cluster",
            "WARNING: of execution.cluster",
        ]


def test_help_loads_no_heavy_library():
    code = (
        "import sys\n"
        "from sionna_radar.cli.app import app\n"
        "from typer.testing import CliRunner\n"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0\n"
        "print([m for m in ('mitsuba', 'drjit', 'sionna', 'scipy', 'matplotlib') if m in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_budget_writes_its_table_and_figure(cli, small, tmp_path, monkeypatch):
    from sionna_radar.studies.budget import study as budget

    few = tuple(error for error in budget.navigation_errors() if error.name == "position, up")
    monkeypatch.setattr(budget, "navigation_errors", lambda: few)
    done = cli("budget", small, "-o", tmp_path / "out", "--repeat", 1)
    assert "position, up" in done.stdout
    assert "Gauss-Markov" in done.stdout
    written = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert written == {"manifest.json", "budget.json", "figures/budget.png"}
    refused = cli("budget", small, "-o", tmp_path / "other", "--grades", tmp_path / "none.toml", code=2)
    assert "none.toml" in refused.stderr
    assert not (tmp_path / "other").exists()


def test_image_writes_both_images_or_nothing(cli, small, tmp_path):
    sparse = ("--set", "platform.length_m=7", "--set", "platform.start_m=[-3.0, 0.0]")
    done = cli("image", "slar", "-o", tmp_path / "out", *sparse, "--set", "tracing.scatterers_per_m2=5")
    assert "SAR, theory" in done.stdout
    written = {p.relative_to(tmp_path / "out").as_posix() for p in (tmp_path / "out").rglob("*") if p.is_file()}
    files = {"manifest.json", "image.json", "scenario.toml", "slar.nc", "sar.nc"}
    assert written == files | {"figures/slar.png", "figures/sar.png"}
    refused = cli("image", small, "-o", tmp_path / "other", code=2)
    assert "radar.scan.mode: 'whisk_broom' does not look to the side" in refused.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_a_plan_is_a_scenario_that_flies(cli, small, tmp_path):
    file = tmp_path / "plan.toml"
    done = cli("plan", "--area", "40x30", "--sampling", 4, "-o", file)
    assert "altitude" in done.stdout
    assert "100.00% of the area" in done.stdout
    cli("run", file, "-o", tmp_path / "out", "-q", "--set", "sensor=lidar")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["dem_error"]["coverage"] > 0.9
    cli("plan", "--area", "40x30", "--sampling", 4, "--base", small, "-o", file)
    assert "paths_per_pulse = 64" in file.read_text()


@pytest.mark.parametrize(
    "options",
    [
        ("--area", "40", "--sampling", "4"),
        ("--area", "40x30", "--sampling", "0"),
        ("--area", "40xa", "--sampling", "4"),
        ("--area", "40x30", "--sampling", "4", "--position", "12"),
        ("--area", "40x30", "--sampling", "4", "--heading", "720"),
        ("--area", "40x30", "--sampling", "4", "--base", "jacksboro", "--position", "90000,0"),
    ],
)
def test_a_plan_of_nothing_is_refused(cli, tmp_path, options):
    done = cli("plan", *options, "-o", tmp_path / "plan.toml", code=2)
    assert done.stderr.startswith("error:")
    assert not (tmp_path / "plan.toml").exists()


def test_a_plan_of_an_area_elsewhere(cli, tmp_path):
    file = tmp_path / "plan.toml"
    options = ("--area", "40x30", "--sampling", 4, "--position", "-120,60", "--heading", "-30")
    done = cli("plan", *options, "-o", file)
    assert "100.00% of the area" in done.stdout
    # One line, along the longer side, which at heading -30 points 60 deg clockwise from north: over the centre.
    start, end = np.array(tomllib.loads(file.read_text())["platform"]["waypoints_m"])
    assert np.rad2deg(np.arctan2(*(end - start))) == pytest.approx(60.0)
    assert np.rad2deg(np.arctan2(*((-120, 60) - start))) == pytest.approx(60.0)


def test_a_plan_needs_a_place_to_be_written(cli, tmp_path):
    done = cli("plan", "--area", "40x30", "--sampling", "4", "-o", tmp_path / "no" / "plan.toml", code=2)
    assert "cannot be written" in done.stderr


def test_no_command_prints_help_and_the_version_is_told(cli):
    shown = cli(code=None)
    assert "sweep" in shown.stdout + shown.stderr
    assert cli("--version").stdout == f"sionna-radar {version('sionna-radar')}\n"


def test_a_scenario_written_by_hand_is_not_planned_over(cli, tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text("seed = 1\n")
    done = cli("plan", "--area", "40x30", "--sampling", 4, "-o", file, code=2)
    assert "was not written by plan or was edited since" in done.stderr
    assert file.read_text() == "seed = 1\n"


def test_a_side_looking_run_points_to_its_image(cli, tmp_path):
    sparse = ("--set", "platform.length_m=3", "--set", "tracing.scatterers_per_m2=2")
    done = cli("run", "slar", "-o", tmp_path / "out", *sparse)
    assert "sionna-radar image slar" in done.stdout


def test_two_echoes_of_a_chirp_are_printed(cli, tmp_path):
    done = cli("run", "roof_edge", "-o", tmp_path / "out")
    roof, ground = re.search(r"ranges in pulse 18 *│ ([\d.]+) m, ([\d.]+) m", done.stdout).groups()
    assert float(roof) == pytest.approx(36.4, abs=0.3)
    assert float(ground) == pytest.approx(44.0, abs=0.3)


def test_another_run_leaves_the_user_s_files_and_refuses_edited_ones(cli, small, tmp_path):
    out = tmp_path / "keep"
    cli("run", small, "-o", out, "-q")
    (out / "mysite.qgz").write_text("mine")
    cli("run", small, "-o", out, "-q", "--seed", 8)
    assert (out / "mysite.qgz").read_text() == "mine"
    assert json.loads((out / "summary.json").read_text())["seed"] == 8
    (out / "scenario.toml").write_text("edited")
    done = cli("run", small, "-o", out, "-q", "--seed", 9, code=2)
    assert "scenario.toml" in done.stderr
    assert json.loads((out / "summary.json").read_text())["seed"] == 8


def test_a_log_is_shown_and_drawn_before_any_scenario_exists(cli, tmp_path):
    flight = flown(regular(10.0, 5.0))
    path = write_csv(tmp_path / "flight.csv", flight)
    done = cli("log", path, "-o", tmp_path / "shown")
    assert "east_m,north_m,up_m, with velocities" in done.stdout
    assert "the whole log can be flown" in done.stdout
    numbers = json.loads((tmp_path / "shown" / "log.json").read_text())
    assert numbers["speed_mps"][1] == pytest.approx(10.0, abs=0.2)
    assert numbers["sources"][0] == {"name": "east_m,north_m,up_m", "rows": 51, "rate_hz": pytest.approx(10.0)}
    assert (tmp_path / "shown" / "figures" / "flight.png").stat().st_size > 20_000


def test_what_would_be_refused_of_a_log_is_said_and_it_is_drawn_over_a_terrain(cli, tmp_path):
    flight = flown(np.delete(regular(10.0, 9.0), slice(30, 60)))
    path = write_csv(tmp_path / "flight.csv", flight, on_map=True)
    done = cli("log", path, "--over", "hills", "-o", tmp_path / "shown")
    assert "cannot be flown: at 2.90 s: no position for 3.1 s" in done.stdout
    assert "moved to the terrain" in done.stdout
    assert "contradicts --over" in cli("log", path, "--over", "hills", "--terrain", "dem.tif", code=2).stderr
    path.write_text(path.read_text().replace("time_s", "zeit", 1))
    assert "in the scenario of --over" in cli("log", path, "--over", "hills", code=2).stderr
    scenario = '[platform]\nlog = "flight.csv"\nlog_columns = { time_s = "zeit" }\n[terrain]\nkind = "flat"\n'
    (tmp_path / "own.toml").write_text(scenario + "[radar]\nsnr_db = 30.0\n")
    assert "3.1 s" in cli("log", path, "--over", tmp_path / "own.toml", "-o", tmp_path / "shown").stdout
    missing = cli("log", tmp_path / "none.csv", code=2)
    assert missing.stdout == ""
    assert "does not exist; give a log of a flight" in missing.stderr


def test_control_characters_of_names_reach_no_terminal(cli, small, tmp_path):
    evil = tmp_path / "a\x1b[31m\x07b"
    done = cli("run", small, "-o", evil)
    assert r"a\x1b[31m\x07b" in done.stdout
    missing = cli("run", evil / "c.toml", code=2)
    refused = cli("validate", small, "--set", 'description="a\\u001bb"', code=2)
    assert "description: holds the control character" in refused.stderr
    assert not {"\x1b", "\x07"} & set(done.stdout + done.stderr + missing.stderr + refused.stderr)


def test_workers_that_are_lost_are_no_bad_input(cli, small, tmp_path, monkeypatch):
    def lost(*_, **__):
        raise WorkersLostError("the dask scheduler is gone")

    monkeypatch.setattr("sionna_radar.execution.cluster.open_workers", lost)
    done = cli("sweep", small, "--vary", "seed=1,2", "-q", "-o", tmp_path / "out", code=1)
    assert done.stderr == "error: the dask scheduler is gone\n"


def test_help_lists_every_command_by_task_with_its_whole_first_line():
    from typer.testing import CliRunner

    from sionna_radar.cli.app import LISTED, TASKS, app

    said = CliRunner().invoke(app, ["--help"]).output
    places = [said.index(f"\n{task}:\n") for task in TASKS]
    assert places == sorted(places)
    assert "..." not in said[places[0] :]
    assert len(LISTED) == 32
    assert {command.name for command in LISTED} == {command.name for command in app.registered_commands}
