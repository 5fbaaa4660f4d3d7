"""The pages, opened in a headless Chromium: nothing fails, nothing is fetched, and what is drawn moves."""

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from browser import chromium, colours_in, opened, started
from sionna_radar import load_scenario, process, run
from sionna_radar import twin as run_twin
from sionna_radar.report.page.show import show_page
from sionna_radar.report.survey.page import survey_page
from sionna_radar.report.survey.processed import recording_page
from sionna_radar.studies.comparison.document import comparison_page
from sionna_radar.studies.comparison.study import compare_results
from sionna_radar.studies.twin.document import twin_page

pytest.importorskip("playwright", reason="playwright, of the development extra, is not installed")
if chromium() is None:
    pytest.skip("no Chromium or Chrome on the PATH to open pages with", allow_module_level=True)

HOSTILE = "</script><script>window.stolen = 1</script><img src=x onerror='window.stolen=2'>"


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    with started() as browser:
        yield browser


def seen(page, path: Path) -> None:
    """Assert that a page fetched nothing and met no error."""
    assert page.errors == []
    assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
    assert len([url for url in page.requests if url.startswith("file:")]) == 1
    assert page.page.evaluate("window.stolen") is None
    assert page.page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_the_page_of_a_survey_draws_turns_and_follows_its_sliders(browser, survey, tmp_path):
    path = tmp_path / "report.html"
    scenario = survey.scenario.model_copy(update={"description": HOSTILE})
    path.write_text(survey_page(replace(survey, prepared=replace(survey.prepared, scenario=scenario))))
    page = opened(browser, path)
    world = page.picture("#world", tmp_path / "world.png")
    assert colours_in(world) > 60
    for part in ("#swipe", "#spectrum", "#beat", "#histogram", '[data-map="2"]'):
        assert colours_in(page.picture(part, tmp_path / "part.png")) > 8, part

    before = page.text('[data-shows="pulse-world"]'), page.text('[data-shows="pulse-chirp"]')
    page.slide("pulse-chirp", 3)
    after = page.text('[data-shows="pulse-world"]'), page.text('[data-shows="pulse-chirp"]')
    assert before[0] != after[0]
    assert before[1] != after[1]
    assert page.page.evaluate("document.querySelector('[data-control=pulse-world]').value") == "3"

    page.page.select_option('[data-control="paint"]', label="Error (m)")
    page.until(lambda: np.abs(page.picture("#world", tmp_path / "error.png") - world).mean() > 0.01)

    # The bar of the swipe follows the mouse.
    page.page.locator(".grip").scroll_into_view_if_needed()
    box = page.page.locator(".grip").bounding_box()
    page.page.mouse.move(box["x"] + 17, box["y"] + 17)
    page.page.mouse.down()
    page.page.mouse.move(box["x"] - 80, box["y"] + 17)
    page.page.mouse.up()
    page.until(lambda: page.page.locator(".grip").bounding_box()["x"] < box["x"] - 60)
    seen(page, path)


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    small = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
    path = tmp_path_factory.mktemp("recording") / "signals.nc"
    run(load_scenario("hills", small), recordings={"signals": path})
    return path


@pytest.mark.parametrize("located", [True, False])
def test_the_page_of_a_recording_draws_what_is_known(browser, recording, tmp_path, located):
    shutil.copy(recording, tmp_path / "signals.nc")
    if not located:
        with h5py.File(tmp_path / "signals.nc", "a") as file:
            for name in ("measured_position", "measured_velocity", "measured_rotation", "scenario"):
                del file[name]
    path = tmp_path / "report.html"
    path.write_text(recording_page(process(tmp_path / "signals.nc")))
    page = opened(browser, path)
    parts = ("#world", "#swipe", "#histogram", "#beat", "#spectrum") if located else ("#beat", "#spectrum")
    for part in parts:
        assert colours_in(page.picture(part, tmp_path / "part.png")) > 8, part
    assert page.page.locator("#world").count() == located
    before = page.text('[data-shows="pulse-chirp"]')
    page.slide("pulse-chirp", 0)
    assert page.text('[data-shows="pulse-chirp"]') != before
    seen(page, path)


@pytest.mark.study
def test_the_page_of_a_scenario_draws_its_world(browser, survey, tmp_path):
    path = tmp_path / "show.html"
    path.write_text(show_page(survey.prepared, HOSTILE))
    page = opened(browser, path, width=900)
    assert colours_in(page.picture("#world", tmp_path / "world.png")) > 60
    before = page.text('[data-shows="pulse-world"]')
    page.slide("pulse-world", 0)
    assert page.text('[data-shows="pulse-world"]') != before
    seen(page, path)


@pytest.mark.study
def test_the_page_of_a_twin_draws_its_rows_and_its_echo(browser, tmp_path):
    run(load_scenario("hills", {"platform.length_m": 10.0}), recordings={"signals": tmp_path / "flown.nc"})
    twin = run_twin(tmp_path / "flown.nc", overrides={"radar.snr_db": 10.0})
    path = tmp_path / "twin.html"
    path.write_text(twin_page(replace(twin, source=Path(f"{HOSTILE}.nc"))))
    page = opened(browser, path, width=1600)
    for place in ("#profile", "#scores"):
        assert colours_in(page.picture(place, tmp_path / "chart.png")) > 4
    assert "noise floor" in page.page.inner_text("table")
    seen(page, path)


def test_the_page_of_a_comparison_zooms_its_maps_together(browser, results, tmp_path):
    path = tmp_path / "compare.html"
    named = [replace(one, name=f"{one.name} {HOSTILE}") for one in results]
    path.write_text(comparison_page(compare_results(named)))
    page = opened(browser, path, width=1600)
    assert colours_in(page.picture('[data-map="0"]', tmp_path / "map.png")) > 8
    zoom = (
        "Plotly.relayout(document.querySelector('[data-map=\"0\"]'), {'xaxis.range': [-5, 5], 'yaxis.range': [-4, 4]})"
    )
    page.page.evaluate(zoom)
    wide = "Math.abs(document.querySelector('[data-map=\"3\"]')._fullLayout.yaxis.range[1] - 4) < 3"
    page.until(lambda: page.page.evaluate(wide))
    before = page.text('[data-shows="line"]')
    page.slide("line", 2)
    assert page.text('[data-shows="line"]') != before
    assert colours_in(page.picture("#profile", tmp_path / "profile.png")) > 8
    seen(page, path)
