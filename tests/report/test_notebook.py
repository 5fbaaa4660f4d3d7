"""Results in a notebook and in a terminal: a table and a picture, or a few lines; never a dump of arrays."""

import base64
import re
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module

import pytest
from IPython.core.displaypub import CapturingDisplayPublisher
from IPython.core.interactiveshell import InteractiveShell
from traitlets import Type
from traitlets.config import Config

from sionna_radar import load_scenario, prepare, run
from sionna_radar.foundation import progress, progress_bars
from sionna_radar.notebook import _records, html_of, register_with_ipython
from sionna_radar.studies.budget.study import navigation_budget as run_budget
from sionna_radar.studies.budget.study import navigation_errors
from sionna_radar.studies.crosscheck.study import crosscheck as run_crosscheck
from sionna_radar.studies.images.study import image as run_images
from sionna_radar.studies.link.study import link_budget
from sionna_radar.studies.sweep import plan_sweep, run_sweep
from sionna_radar.survey.result import Survey

pytestmark = pytest.mark.usefixtures("rough_errors")

SHORT = {"platform.length_m": 8.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 64}
SIDE = {"tracing.speckle": "per_pulse", "platform.length_m": 4.0, "tracing.paths_per_pulse": 64}

RESULTS = {
    "sweep": (lambda: run_sweep(plan_sweep("hills", {"radar.snr_db": [20.0, 30.0]}, overrides=SHORT)), "radar.snr_db"),
    "crosscheck": (lambda: run_crosscheck(load_scenario("hills", SHORT)), "mean_power_difference_db"),
    "budget": (
        lambda: run_budget(load_scenario("hills", SHORT), errors=navigation_errors()[:1], grades={}),
        "Gauss-Markov",
    ),
    "imagery": (lambda: run_images(load_scenario("slar", SIDE)), "SLAR, theory"),
}


@pytest.mark.parametrize("name", ["survey", *RESULTS])
def test_a_result_shows_a_table_and_a_picture(name, survey):
    make, words = RESULTS.get(name, (lambda: survey, "RMSE of lit cells"))
    result = make()
    shown = html_of(result)
    assert words in shown
    pictures = [base64.b64decode(data) for data in re.findall(r'src="data:image/png;base64,([^"]+)"', shown)]
    assert pictures
    assert all(picture.startswith(b"\x89PNG") and len(picture) > 3000 for picture in pictures)
    assert 1 <= len(repr(result).splitlines()) <= 6
    assert "array(" not in repr(result)


def test_any_record_is_shown_by_the_document_of_its_study():
    budget = link_budget(load_scenario("hills", SHORT), incidences_deg=[40.0], rains_mm_per_h=[0.0], pulses=100)
    shown = html_of(budget)
    assert "Echo of the ground in one pulse" in shown
    assert shown.count("data:image/png") == 1


def test_a_warning_is_shown():
    survey = run(load_scenario("hills", SHORT | {"radar.snr_db": -60.0}))
    assert "<p>warning: no echo was detected" in html_of(survey)


def test_ipython_shows_a_result_as_its_page_and_all_that_have_one(shell, survey):
    register_with_ipython()
    records = list(_records())
    assert len(records) == 18
    assert all(hasattr(import_module(module), name) for module, name in records)
    data, _ = shell.display_formatter.format(survey)
    assert data["text/html"] == html_of(survey)
    assert data["text/plain"] == repr(survey)
    prepared = prepare(load_scenario("hills", SHORT))
    assert "text/html" not in shell.display_formatter.format(prepared)[0]
    assert len(repr(prepared).splitlines()) == 2


def test_a_notebook_shows_progress_and_a_script_does_not(monkeypatch):
    stages = []

    @contextmanager
    def bar():
        yield lambda stage, done, total: stages.append(stage)

    monkeypatch.setattr(progress_bars, "notebook_bar", bar)
    run(load_scenario("hills", SHORT))
    assert stages == []
    monkeypatch.setattr(progress_bars, "in_notebook", lambda: True)
    run(load_scenario("hills", SHORT))
    assert set(stages) == {"preparing", "tracing", "mapping"}


class ZMQInteractiveShell(InteractiveShell):
    """A shell that is taken for a notebook's, and keeps what it is told to show."""

    display_pub_class = Type(CapturingDisplayPublisher)


@pytest.fixture
def shell():
    config = Config()
    config.HistoryManager.enabled = False
    InteractiveShell.clear_instance()
    shell = ZMQInteractiveShell.instance(config=config)
    shell.user_ns |= {"shown_progress": progress_bars.shown_progress, "report": progress.report}
    yield shell
    ZMQInteractiveShell.clear_instance()


LOOP = """
for _ in range(50):
    with shown_progress(None):
        for stage in ("preparing", "tracing"):
            for done in range(4):
                report(stage, done, 3)
"""


def test_many_surveys_of_a_cell_share_one_bar_that_goes(shell):
    for cell in (LOOP, LOOP, LOOP + "        raise ValueError"):
        shell.display_pub.outputs.clear()
        assert shell.run_cell(cell, store_history=True).success == (cell == LOOP)
        outputs = shell.display_pub.outputs
        assert len({output["transient"]["display_id"] for output in outputs}) == 1
        # One place in the cell; everything else changes what is shown there, and nothing is left in it.
        assert [output["update"] for output in outputs] == [False] + [True] * (len(outputs) - 1)
        assert outputs[-1]["data"] == {"text/plain": ""}
        assert any('<progress value="0" max="3">' in output["data"].get("text/html", "") for output in outputs)
        assert not any("widget" in kind for output in outputs for kind in output["data"])


def test_a_survey_without_an_echo_is_shown_too(empty: Survey) -> None:
    assert "data:image/png" in html_of(empty)


def test_a_warning_is_text_and_not_markup(survey: Survey) -> None:
    page = html_of(replace(survey, warnings=("rain <b>falls</b> & falls",)))
    assert page.rstrip().endswith("<p>warning: rain &lt;b&gt;falls&lt;/b&gt; &amp; falls</p>")
