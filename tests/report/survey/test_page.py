"""The page of a survey: whole in itself, bounded, escaped, and with the numbers of `summary.json`."""

import json
import logging
import re
from dataclasses import replace

import numpy as np
import pytest
from markupsafe import escape

from packed_pages import array_of, numbers_of
from sionna_radar.foundation.errors import OutputError
from sionna_radar.report.files.contents import strict_json
from sionna_radar.report.page import markup as document_module
from sionna_radar.report.survey.page import survey_page
from sionna_radar.report.survey.products import write_survey
from sionna_radar.report.survey.summary import reference_for, summary
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey

HOSTILE = "</script></title><script>window.stolen = 1</script><img src=x onerror='window.stolen=2'> & \"quoted\""


@pytest.fixture(scope="module")
def page(survey: Survey) -> str:
    return survey_page(survey)


def test_nothing_is_loaded_from_anywhere(page):
    outside_packs = re.sub(r'<script id="(numbers|plotly)" type="text/plain">[^<]*</script>', "", page)
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#)""", outside_packs)
    assert "http" not in re.sub(r"http-equiv", "", outside_packs)
    assert "url(" not in outside_packs
    assert "default-src 'none'" in outside_packs
    assert len(page) < 6_000_000


def test_sentences_stand_apart(page):
    words = re.sub(r"<[^>]*>", "", re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL))
    assert not re.search(r"[a-z]{2}\.[A-Z][a-z]+ [a-z]+ ", words)


def test_the_numbers_are_those_of_the_summary(page, survey):
    document, _ = numbers_of(page)
    expected = json.loads(strict_json(summary(survey)))
    assert document["summary"] == expected
    cells = dict(re.findall(r'data-key="([^"]+)" data-value="([^"]*)"', page))
    for table in ("lit_error", "dem_error"):
        for key in ("rms_m", "mean_m", "std_m", "nmad_m", "le90_m", "min_m", "max_m", "count", "coverage"):
            assert float(cells[f"{table}.{key}"]) == expected[table][key]


def test_maps_and_chirps_hold_the_surveys_values(page, survey):
    document, arrays = numbers_of(page)
    maps = {one["name"]: array_of(one["z"], arrays) for one in document["maps"]}
    np.testing.assert_allclose(maps["True surface"], survey.truth.height_m, atol=0.00051)
    np.testing.assert_allclose(maps["Error of the DEM"], survey.error.height_m, atol=0.00051)
    assert {"DEM", "Echo power", "Backscatter coefficient of the ground"} <= maps.keys()
    chirps = document["chirps"]
    assert len(array_of(chirps["power"], arrays)) == len(array_of(chirps["pulse"], arrays)) > 100


def test_map_coordinates_are_shown(georeferenced):
    document, arrays = numbers_of(survey_page(georeferenced))
    first = document["maps"][0]
    assert first["x0"] == georeferenced.dem.grid.west_m + 747_000.0
    assert np.nanmin(array_of(first["z"], arrays)) > 390.0
    assert document["frame"]["east"] == "Easting (m)"


def test_hostile_text_is_shown_as_text(survey):
    scenario = survey.scenario.model_copy(update={"description": HOSTILE})
    page = survey_page(
        replace(survey, prepared=replace(survey.prepared, scenario=scenario), warnings=(f"beware {HOSTILE}",))
    )
    assert "<script>window.stolen" not in page
    assert "<img" not in page
    assert page.count(str(escape(HOSTILE))) >= 3  # title, heading, warning
    assert page.count("</script>") == 3
    assert numbers_of(page)[0]["summary"]["scenario"]["description"] == HOSTILE


def test_a_survey_that_found_nothing_has_a_page(empty):
    page = survey_page(empty)
    assert "Errors of the elevation model" in page
    document, _ = numbers_of(page)
    assert document["summary"]["lit_error"]["rms_m"] is None


def test_a_page_too_large_is_refused_and_the_results_are_written_without(monkeypatch, survey, tmp_path, caplog):
    monkeypatch.setattr(document_module, "MAX_BYTES", 100_000)
    with pytest.raises(OutputError, match="--no-report"):
        survey_page(survey)
    with caplog.at_level(logging.WARNING, logger="sionna_radar"):
        files = write_survey(survey, tmp_path / "out")
    assert "summary.json" in [file.name for file in files]
    assert "report.html" not in [file.name for file in files]
    assert "no report.html" in caplog.text


def test_the_paper_is_quoted_only_where_it_compares():
    short = {"platform.length_m": 6.0}
    found = {
        name: reference_for(prepare(load_scenario(scene, {**short, **more})))
        for name, scene, more in (
            ("2 deg", "hills", {}),
            ("4 deg", "hills", {"radar.antenna.beamwidth_deg": 4.0}),
            ("3 deg", "hills", {"radar.antenna.beamwidth_deg": 3.0}),
            ("lidar", "hills", {"sensor": "lidar"}),
            ("higher", "hills", {"platform.altitude_m": 70.0, "radar.samples_per_chirp": 2048}),
            ("boxes", "buildings", {}),
        )
    }
    assert [row["rms_m"] for row in found["2 deg"][0].values()] == [0.29]
    assert [row["rms_m"] for row in found["4 deg"][0].values()] == [0.69]
    assert [row["rms_m"] for row in found["boxes"][0].values()] == [1.51, 0.19]
    assert not any(found[name][0] for name in ("3 deg", "lidar", "higher"))
    assert "50 m" in found["2 deg"][1]
    assert found["lidar"][1] == ""
