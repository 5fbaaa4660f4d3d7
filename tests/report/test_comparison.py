"""Folders of results side by side: their own numbers, what differs, and one clear error for what is no result."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import rasterio

from packed_pages import array_of, unpacked
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.studies.comparison.document import comparison_page
from sionna_radar.studies.comparison.results import read_results
from sionna_radar.studies.comparison.study import compare_results, differing_settings


def test_what_is_read_is_what_was_written(results, survey):
    first, second = results
    assert first.name == "first"
    assert first.dem.grid == survey.dem.grid
    np.testing.assert_allclose(first.dem.height_m, survey.dem.height_m, atol=1e-5)
    np.testing.assert_allclose(second.error.height_m, survey.error.height_m + 0.1, atol=1e-5)
    assert first.summary["lit_error"]["rms_m"] == survey.lit_error.rms_m


def test_settings_that_differ_are_found_by_dotted_keys(results):
    assert compare_results(results).differing == {"radar.chirp_rate_hz": (360.0, 720.0), "seed": (7, 8)}
    one = {"a": {"b": 1}, "list": [1, 2], "tables": [{"x": 1}, {"x": 2}]}
    other = {"a": {"b": 1}, "list": [1, 3], "tables": [{"x": 1}], "new": True}
    assert differing_settings([one, other]) == {
        "list": ([1, 2], [1, 3]),
        "new": ("-", True),
        "tables.1.x": (2, "-"),
    }


def test_profiles_differ_by_the_decimetre_between_the_two(results):
    result = compare_results(results)
    west, east, south, north = result.common
    assert (west, east, south, north) == results[0].dem.grid.extent_m
    places = np.column_stack([np.linspace(west, east, 200), np.full(200, (south + north) / 2)])
    difference = results[1].dem.at(places) - results[0].dem.at(places)
    np.testing.assert_allclose(difference[np.isfinite(difference)], 0.1, atol=1e-5)


def test_the_page_has_the_numbers_of_the_folders(results, folders):
    page = comparison_page(compare_results(results))
    cells = dict(re.findall(r'data-key="([^"]+)" data-value="([^"]*)"', page))
    for number, folder in enumerate(folders):
        expected = json.loads((folder / "summary.json").read_text())["lit_error"]
        for key in ("rms_m", "mean_m", "count", "coverage"):
            assert float(cells[f"{number}.lit_error.{key}"]) == expected[key]
    document, arrays = unpacked(re.search(r'<script id="numbers" type="text/plain">([^<]*)</script>', page)[1])
    assert [one["name"] for one in document["maps"]] == ["first: DEM", "first: error", "second: DEM", "second: error"]
    lines = [array_of(place, arrays) for place in document["profiles"]["error"]]
    np.testing.assert_allclose(np.nanmean(lines[1] - lines[0]), 0.1, atol=0.001)
    assert "chirp_rate_hz" in page


def test_maps_in_different_systems_have_no_profile(results):
    other = replace(results[1], crs="EPSG:32616")
    result = compare_results([results[0], other])
    assert result.common is None
    assert "no ground that all maps show" in comparison_page(result)


def test_too_few_folders_are_refused(results):
    with pytest.raises(ScenarioError, match="give 2 to"):
        compare_results(results[:1])


def damaged(folder, what):
    if what == "no folder":
        shutil.rmtree(folder)
    elif what == "cut raster":
        path = folder / "dem.tif"
        path.write_bytes(path.read_bytes()[:300])
    elif what == "other cells":
        profile = {"driver": "GTiff", "width": 3, "height": 3, "count": 1, "dtype": "float32"}
        with rasterio.open(folder / "error.tif", "w", transform=rasterio.Affine(2, 0, 5, 0, -2, 5), **profile) as file:
            file.write(np.zeros((1, 3, 3), dtype=np.float32))
    elif what == "text as raster":
        (folder / "dem.tif").write_text("<VRTDataset/>")
    elif what == "no JSON":
        (folder / "summary.json").write_text('{"lit_error": ')
    elif what == "deep JSON":
        (folder / "summary.json").write_text("[" * 100_000)
    elif what == "other JSON":
        (folder / "summary.json").write_text('{"lit_error": {"rms_m": "</script>"}}')
    elif what == "huge number":
        text = (folder / "summary.json").read_text()
        (folder / "summary.json").write_text(re.sub(r'"rms_m": [0-9.e-]+', f'"rms_m": 1{"0" * 400}', text))
    elif what == "no TOML":
        (folder / "scenario.toml").write_text("= 3")


@pytest.mark.parametrize(
    "what",
    [
        "no folder",
        "cut raster",
        "other cells",
        "text as raster",
        "no JSON",
        "deep JSON",
        "other JSON",
        "huge number",
        "no TOML",
    ],
)
def test_what_is_no_result_is_refused_in_one_sentence(folders, tmp_path, what):
    bad = tmp_path / "bad"
    shutil.copytree(folders[0], bad)
    damaged(bad, what)
    with pytest.raises(InputFileError) as error:
        read_results([folders[0], bad])
    assert "bad" in str(error.value)
    assert "\n" not in str(error.value)
    assert "; " in str(error.value)  # the remedy


def test_compare_prints_tables_and_writes_a_page(cli, folders, tmp_path):
    done = cli("compare", *folders, "-o", tmp_path / "both")
    assert done.stderr == ""
    assert "radar.chirp_rate_hz" in done.stdout
    assert sorted(path.name for path in (tmp_path / "both").iterdir()) == ["compare.html", "manifest.json"]
    cli("compare", *reversed(folders), "-o", tmp_path / "both")
    assert "-o: is for the page of two folders" in cli("compare", folders[0], "-o", tmp_path / "one", code=2).stderr
    none = cli("compare", folders[0], tmp_path, code=2)
    assert none.stderr.startswith("error: summary = ")
    assert none.stderr.count("\n") == 1
