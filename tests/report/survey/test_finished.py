"""A survey read back from its folder, and its figures drawn there later."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blank_figures import leave_blank
from elevation_files import NORTH, WEST, from_origin, write_heights
from sionna_radar import load_scenario, run
from sionna_radar.foundation.errors import InputFileError, OutputError
from sionna_radar.foundation.raster import Raster
from sionna_radar.report import drawing
from sionna_radar.report.files.contents import Figures, PointsFile, Report
from sionna_radar.report.files.manifest import MANIFEST, Manifest
from sionna_radar.report.survey.finished import draw_figures, read_survey
from sionna_radar.report.survey.products import write_survey
from sionna_radar.survey.result import Survey

pytestmark = pytest.mark.usefixtures("rough_errors")

FILES = ["chirp.png", "dem.png", "environment.png", "error_map.png", "power_map.png"]


# Ground of the scenario's own, and on the map.
both = pytest.mark.parametrize("flown", ["hills", "jacksboro"], indirect=True)


@pytest.fixture(scope="module")
def flown(request: pytest.FixtureRequest) -> Survey:
    name = getattr(request, "param", "jacksboro")
    return run(load_scenario(name, {"platform.length_m": 8.0, "tracing.paths_per_pulse": 64}))


@pytest.fixture
def folder(flown: Survey, tmp_path: Path) -> Path:
    write_survey(flown, str(tmp_path / "out"), report=Report.NONE)
    return tmp_path / "out"


@both
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


@both
def test_stated_errors_are_read_and_written_again(flown: Survey, folder: Path, tmp_path: Path) -> None:
    again = read_survey(folder)
    assert flown.dem_sigma is not None
    assert again.dem_sigma is not None
    assert again.dem_sigma.quantity == flown.dem_sigma.quantity
    assert np.array_equal(again.dem_sigma.height_m, flown.dem_sigma.height_m.astype(np.float32), equal_nan=True)
    stated, read = flown.dem_uncertainty, again.dem_uncertainty
    assert stated is not None
    assert read is not None
    assert read.cells.rms_z == pytest.approx(stated.cells.rms_z, abs=1e-3)
    write_survey(again, tmp_path / "again", report=Report.NONE)
    for name in ("dem_sigma.tif", "dem.tif", "lit.tif", "truth.tif"):
        first, second = (Raster.read(place / name) for place in (folder, tmp_path / "again"))
        assert first.grid == second.grid
        # Ground truth of the map is computed again, not read.
        assert np.array_equal(first.height_m, second.height_m, equal_nan=True), name


def test_stated_errors_of_the_navigation_and_cells_without_echo_are_read(tmp_path: Path) -> None:
    keys = {"platform.length_m": 8.0, "tracing.paths_per_pulse": 64, "platform.navigation.position_markov_m": 0.1}
    survey = run(load_scenario("hills", keys))
    silent = np.zeros(survey.dem.grid.shape, dtype=bool)
    silent[3, 4] = True
    write_survey(replace(survey, no_echo=silent), tmp_path / "out", report=Report.NONE)
    again = read_survey(tmp_path / "out")
    navigation, read = survey.dem_sigma_navigation, again.dem_sigma_navigation
    assert navigation is not None
    assert read is not None
    assert np.array_equal(read.height_m, navigation.height_m.astype(np.float32), equal_nan=True)
    assert again.no_echo is not None
    assert np.array_equal(again.no_echo, silent)
    (tmp_path / "out" / "no_echo.tif").unlink()
    assert read_survey(tmp_path / "out").no_echo is None
    (tmp_path / "out" / "dem_sigma.tif").write_bytes((tmp_path / "out" / "dem.tif").read_bytes())
    with pytest.raises(InputFileError, match=r"changed since they were written: dem_sigma\.tif"):
        read_survey(tmp_path / "out")


@both
def test_figures_drawn_later_are_those_drawn_at_once(
    flown: Survey, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drawing, "DPI", 60)
    write_survey(flown, tmp_path / "at once", report=Report.NONE, figures=Figures.PNG)
    before = {path.name: path.read_bytes() for path in folder.iterdir() if path.name != "manifest.json"}
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
    for other in (tmp_path, tmp_path / "none", folder / "dem.tif", tmp_path / ("long" * 100)):
        with pytest.raises(InputFileError, match="holds no survey; name a folder"):
            read_survey(other)
    (folder / "dem.tif").write_bytes((folder / "truth.tif").read_bytes())
    with pytest.raises(InputFileError, match=r"changed since they were written: dem.tif; run the survey again"):
        draw_figures(folder)
    (folder / "lit.tif").unlink()
    with pytest.raises(InputFileError, match=r"lacks lit\.tif; run the survey again"):
        draw_figures(folder)
    write_survey(flown, tmp_path / "laz", report=Report.NONE, points=[PointsFile.LAZ])
    with pytest.raises(InputFileError, match=r"lacks points.csv"):
        draw_figures(tmp_path / "laz")


def signed(folder: Path) -> None:
    """Write a manifest that fits the files of a folder, whatever they hold."""
    (folder / MANIFEST).unlink()
    (folder / MANIFEST).write_text(Manifest.of(folder, "summary.json").text())


def other_column(text: str) -> str:
    return text.replace("echo_snr_db", "snr", 1)


def cell(value: str) -> Callable[[str], str]:
    """Return a change of the first cell of a table's first row."""

    def changed(text: str) -> str:
        head, first, rest = text.split("\n", 2)
        return "\n".join([head, ",".join([value, *first.split(",")[1:]]), rest])

    return changed


DAMAGE: dict[str, list[Callable[[str], str]]] = {
    "summary.json": [
        *(lambda _: "", lambda _: "{}", lambda _: "[" * 100_000),
        lambda text: text.replace('"paths": ', '"paths": "x'),
    ],
    "points.csv": [
        *(lambda _: "", other_column, lambda text: text[:-40]),
        *map(cell, ("nan", "-1", "99999", "word")),
    ],
}


@pytest.mark.parametrize(("name", "damage"), [(name, one) for name, all_of in DAMAGE.items() for one in all_of])
def test_damaged_files_end_in_one_error(folder: Path, name: str, damage: Callable[[str], str]) -> None:
    path = folder / name
    path.write_text(damage(path.read_text(encoding="utf-8")), encoding="utf-8")
    signed(folder)
    with pytest.raises(InputFileError, match="run the survey again"):
        draw_figures(folder)
    assert not (folder / "figures").exists()


def test_a_raster_of_another_place_is_refused(flown: Survey, folder: Path) -> None:
    moved = replace(flown.dem, grid=replace(flown.dem.grid, west_m=flown.dem.grid.west_m + 5.0))
    (folder / "dem.tif").unlink()
    moved.to_geotiff(folder / "dem.tif")
    signed(folder)
    with pytest.raises(InputFileError, match="has other cells than its scenario"):
        read_survey(folder)


def test_ground_that_has_changed_since_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "ground.tif"
    heights = np.zeros((120, 120), dtype=np.float32)
    write_heights(path, heights, from_origin(WEST, NORTH, 2.0, 2.0))
    keys = {"terrain.path": str(path), "platform.length_m": 4.0, "platform.altitude_m": 40.0}
    survey = run(load_scenario("own_dem", keys | {"tracing.paths_per_pulse": 64}))
    write_survey(survey, tmp_path / "out", report=Report.NONE)
    assert read_survey(tmp_path / "out").lit_error.count == survey.lit_error.count
    path.unlink()
    write_heights(
        path, heights + np.indices(heights.shape)[0].astype(np.float32) / 10, from_origin(WEST, NORTH, 2.0, 2.0)
    )
    with pytest.raises(InputFileError, match=r"(other ground|other cells) than its scenario"):
        read_survey(tmp_path / "out")


@pytest.mark.usefixtures("undrawn")
def test_what_is_there_under_the_name_of_the_figures_is_left_alone(flown: Survey, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (folder / "figures").symlink_to(tmp_path / "mine")
    with pytest.raises(OutputError, match="is not a folder of this result; move it away"):
        draw_figures(folder)
    with pytest.raises(OutputError, match="is a link to another folder"):
        write_survey(flown, folder, report=Report.NONE, figures=Figures.PNG)
    assert not list((tmp_path / "mine").iterdir())
    (folder / "figures").unlink()
    (folder / "figures").write_text("mine")
    with pytest.raises(OutputError, match="is not a folder of this result"):
        draw_figures(folder)
    assert (folder / "figures").read_text() == "mine"


def test_a_survey_without_echoes_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = {"platform.length_m": 4.0, "tracing.paths_per_pulse": 64, "radar.snr_db": -60.0, "dem.method": "linear"}
    survey = run(load_scenario("hills", keys))
    assert len(survey.points) == 0
    write_survey(survey, tmp_path / "out", report=Report.NONE)
    assert [path.name for path in draw_figures(tmp_path / "out")] == FILES
    leave_blank(monkeypatch)  # in place of the first ones
    assert [path.name for path in draw_figures(tmp_path / "out")] == FILES
