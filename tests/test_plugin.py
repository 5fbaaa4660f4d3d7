"""The example plug-in, as an installed distribution: built as a wheel, unpacked beside the package, found by name."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

PLUGIN = Path(__file__).resolve().parents[1] / "examples" / "plugin"
BROKEN = """Metadata-Version: 2.1
Name: broken-plugin
Version: 0.3
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """A folder of installed distributions with the plug-in in it."""
    folder = tmp_path_factory.mktemp("plugin")
    source = shutil.copytree(PLUGIN, folder / "source")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(build, cwd=source, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as file:
        file.extractall(folder / "site")
    return folder / "site"


# Several commands in one interpreter, which loads the heavy libraries once.
CALLS = """
import contextlib, io, json, sys
from sionna_radar.cli.app import main

done = []
for call in json.loads(sys.argv[1]):
    sys.argv = ["sionna-radar", *call]
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main()
        except SystemExit as stop:
            code = stop.code or 0
    done.append({"code": code, "out": out.getvalue(), "err": err.getvalue()})
print(json.dumps(done))
"""


def commands(site: Path | None, *calls: list[object]) -> list[dict]:
    environment = os.environ | ({"PYTHONPATH": str(site)} if site else {})
    texts = json.dumps([[str(argument) for argument in call] for call in calls])
    done = subprocess.run(
        [sys.executable, "-c", CALLS, texts], env=environment, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


SURVEY = PLUGIN / "survey.toml"
WRONG = [
    "dem.method_parameters.radius_m=-1",
    "processing.ranging_parameters.gate=3",
    "processing.ranging_parameters.gate_db=true",
    "materials.lichen_on_rock.exponent=none",
    "materials.lichen_on_rock.exponents=2",
]


def test_it_works_as_an_installed_distribution(site, tmp_path):
    """One test, so that the commands that need the plug-in run once."""
    out = tmp_path / "out"
    run, resolved, misspelt, wrong, doctor = commands(
        site,
        ["run", SURVEY, "-o", out, "-q", "--set", "terrain.spacing_m=2"],
        ["validate", out / "scenario.toml", "--all"],
        ["validate", SURVEY, "--set", "dem.method=medium"],
        ["validate", SURVEY, *(word for value in WRONG for word in ("--set", value))],
        ["doctor"],
    )
    # Its parts fly: a median over 4 m of a hillside, of echoes with a few decimetres of speckle.
    assert run["code"] == 0, run["err"]
    error = json.loads((out / "summary.json").read_text())["lit_error"]
    assert error["rms_m"] < 0.5
    assert error["coverage"] > 0.5
    # The resolved scenario holds its parameters, those given and those by default.
    assert resolved["code"] == 0, resolved["err"]
    assert resolved["out"].partition("# ")[0].rstrip() == (out / "scenario.toml").read_text().rstrip()
    assert all(line in resolved["out"] for line in ("gate_db = 10.0", "exponent = 1.5", "radius_m = 4.0"))
    # A misspelt name says what there is, and where from.
    assert misspelt["code"] == 2
    assert "canopy, median (from terrain-extras 1.0). Did you mean median?" in misspelt["err"]
    # Its parameters are checked like ours.
    assert wrong["code"] == 2
    for words in (
        "dem.method_parameters.radius_m: must be greater than 0, not -1",
        "processing.ranging_parameters.gate: unknown key; remove it or correct its spelling. Did you mean",
        "processing.ranging_parameters.gate_db: must be a number without quotes, not True",
        "materials.lichen_on_rock.exponents: unknown key",
    ):
        assert words in wrong["err"]
    assert "terrain-extras 1.0: median, gated_centroid, lichen" in doctor["out"]


def test_without_it_the_names_are_unknown(cli):
    said = cli("validate", SURVEY, code=2)
    assert "processing.ranging: 'gated_centroid' is unknown; give one of peak, centroid" in said.stderr
    assert "materials.lichen_on_rock.model: 'lichen' is unknown" in said.stderr
    assert "dem.method: 'median' is unknown; give one of linear, smooth, refined, stepped" in said.stderr


def test_parameters_of_a_part_that_has_none_are_refused(cli):
    said = cli("validate", "hills", "--set", "processing.ranging_parameters.gate_db=1", code=2)
    assert "processing.ranging_parameters: range estimator 'centroid' has no parameters; remove them" in said.stderr


@pytest.mark.study
def test_a_broken_plugin_stops_nobody_who_does_not_need_it(tmp_path):
    info = tmp_path / "broken_plugin-0.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(BROKEN)
    (info / "entry_points.txt").write_text("[sionna_radar.plugins]\nbroken = broken_plugin\n")
    (tmp_path / "broken_plugin.py").write_text("raise RuntimeError('out of order')\n")
    wrong = ["validate", "hills", "--set", "processing.ranging=mine"]
    unconcerned, concerned = commands(tmp_path, ["validate", "hills"], wrong)
    assert unconcerned["code"] == 0
    assert concerned["code"] == 2
    assert "the plug-in 'broken' of broken-plugin 0.3 cannot be loaded (RuntimeError: out of order)" in concerned["err"]
