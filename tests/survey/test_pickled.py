"""A survey in another process: its arrays, and the scenario from which world and flight are prepared again."""

import pickle
import subprocess
import sys
from pathlib import Path

from sionna_radar import load_scenario, run, write_survey
from sionna_radar.report.files.contents import Report

# Writes surveys that were pickled into folders of their names beside them.
WRITE = (
    "import pickle, sys\nfrom pathlib import Path\nfrom sionna_radar import write_survey\n"
    "from sionna_radar.report.files.contents import Report\n"
    "for path in map(Path, sys.argv[1:]):\n"
    "    report = Report.PAGE if path.stem == 'demo' else Report.NONE\n"
    "    write_survey(pickle.loads(path.read_bytes()), path.with_suffix(''), report=report)"
)


def test_another_process_writes_the_same_files(tmp_path: Path) -> None:
    """One other process, which loads the heavy libraries once."""
    scenes = {
        "hills": {"dem.method": "refined"},
        "demo": {"dem.spacing_m": 2.0},
        "jacksboro": {"platform.navigation": {"position_white_m": [0.05, 0.05, 0.1]}},
    }
    here, there = tmp_path / "here", tmp_path / "there"
    there.mkdir()
    for name, keys in scenes.items():
        survey = run(load_scenario(name, {"platform.length_m": 8.0, "tracing.paths_per_pulse": 64, **keys}))
        survey.breakdown  # noqa: B018  (what was computed on first use goes along)
        (there / f"{name}.pickle").write_bytes(pickle.dumps(survey))
        write_survey(survey, here / name, report=Report.PAGE if name == "demo" else Report.NONE)
    packed = sorted(there.glob("*.pickle"))
    subprocess.run([sys.executable, "-c", WRITE, *packed], check=True, capture_output=True)
    for path in packed:
        path.unlink()
    files = sorted(path.relative_to(here) for path in here.rglob("*") if path.is_file())
    assert {file.parts[0] for file in files} == set(scenes)
    assert files == sorted(path.relative_to(there) for path in there.rglob("*") if path.is_file())
    assert [str(file) for file in files if (here / file).read_bytes() != (there / file).read_bytes()] == []


def test_other_navigation_goes_along() -> None:
    keys = {"platform.length_m": 4.0, "tracing.paths_per_pulse": 64}
    survey = run(load_scenario("hills", {**keys, "platform.navigation": {"position_white_m": [1.0, 1.0, 1.0]}}))
    exact = survey.prepared.with_navigation(None)
    assert survey.prepared.flight.navigation is not None
    again = pickle.loads(pickle.dumps(exact))
    assert again.flight.navigation is None
    assert run(again).points.sha256() == run(exact).points.sha256()
