"""A survey read back from its folder, and its figures drawn there later."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from sionna_radar import load_scenario, run
from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.report.files.contents import Figures, PointsFile, Report
from sionna_radar.report.survey.finished import draw_figures, read_survey
from sionna_radar.report.survey.products import write_survey
from sionna_radar.survey.result import Survey

FILES = ["chirp.png", "dem.png", "environment.png", "error_map.png", "power_map.png"]


@pytest.fixture(scope="module", params=["hills", "jacksboro"])
def flown(request: pytest.FixtureRequest) -> Survey:
    return run(load_scenario(request.param, {"platform.length_m": 8.0, "tracing.paths_per_pulse": 64}))


@pytest.fixture
def folder(flown: Survey, tmp_path: Path) -> Path:
    write_survey(flown, tmp_path / "out", report=Report.NONE)
    return tmp_path / "out"


def test_a_survey_is_read_as_its_files_hold_it(flown: Survey, folder: Path) -> None:
    again = read_survey(folder)
    assert np.array_equal(again.points.pulse, flown.points.pulse)
    # Tenths of a millimetre in the table; heights of several hundred metres in single precision.
    assert np.allclose(again.points.position_m, flown.points.position_m, atol=1e-4)
    assert np.allclose(again.dem.height_m, flown.dem.height_m, atol=1e-4, equal_nan=True)
    assert np.array_equal(again.lit, flown.lit)
    assert again.lit_error.rms_m == pytest.approx(flown.lit_error.rms_m, abs=1e-5)
    assert again.warnings == flown.warnings
    assert again.chirp is not None
    assert np.array_equal(again.chirp.beat, flown.chirp.beat)


def test_figures_drawn_later_are_those_drawn_at_once(flown: Survey, folder: Path, tmp_path: Path) -> None:
    write_survey(flown, tmp_path / "at once", report=Report.NONE, figures=Figures.PNG)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "manifest.json"}
    for _ in range(2):  # the second time in place of the first ones
        assert [path.name for path in draw_figures(folder)] == FILES
    for name in FILES:
        one, two = (np.asarray(Image.open(place / "figures" / name)) for place in (folder, tmp_path / "at once"))
        assert one.shape == two.shape
        # Rounded heights change a shade here and there.
        assert np.mean(np.abs(one.astype(int) - two) > 16) < 2e-3, name
    assert {name: (folder / name).read_bytes() for name in before} == before
    listed = json.loads((folder / "manifest.json").read_text())["files"]
    assert {f"figures/{name}" for name in FILES} < set(listed)
    # The folder can still be replaced by a run, which takes old figures away.
    write_survey(flown, folder, report=Report.NONE)
    assert not (folder / "figures").exists()


def test_other_folders_are_refused(flown: Survey, folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="holds no survey; name a folder"):
        read_survey(tmp_path)
    with pytest.raises(InputFileError, match="holds no survey"):
        read_survey(tmp_path / "none")
    (folder / "dem.tif").write_bytes((folder / "truth.tif").read_bytes())
    with pytest.raises(OutputError, match=r"changed since \(dem.tif\)"):
        draw_figures(folder)
    (folder / "lit.tif").unlink()
    with pytest.raises(InputFileError, match=r"lacks lit\.tif; run the survey again"):
        draw_figures(folder)
    write_survey(flown, tmp_path / "laz", report=Report.NONE, points=[PointsFile.LAZ])
    with pytest.raises(InputFileError, match=r"lacks points.csv"):
        draw_figures(tmp_path / "laz")
