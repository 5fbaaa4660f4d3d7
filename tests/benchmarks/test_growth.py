"""What the growth of surveys is measured by, on small numbers."""

import sys
import tempfile

import pytest

from benchmark_cases import over_facets, over_pulses

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")


def test_a_survey_leaves_no_handle_and_no_file(tmp_path, monkeypatch):
    # Other tests run beside this one, and put files into the common place.
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    found = over_pulses(600)
    assert found["pulses"] == pytest.approx(600, rel=0.02)
    assert (found["handles"], found["temporary_files"]) == (0, 0)
    assert 0 < min(found["settled_mb"]) <= max(found["settled_mb"]) <= found["peak_mb"] * 1.01


def test_a_terrain_has_the_facets_asked_for():
    assert over_facets(20_000)["facets"] == pytest.approx(20_000, rel=0.2)
