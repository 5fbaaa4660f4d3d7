"""The examples run, and leave the pictures they promise."""

import runpy
import sys
from pathlib import Path

import matplotlib
import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("plot_*.py")), ids=lambda path: path.stem)
def test_example_runs(path, tmp_path, monkeypatch):
    """As a script, but in this process, which has the heavy libraries loaded already."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIONNA_RADAR_SMALL", "1")
    monkeypatch.setattr(sys, "argv", [str(path)])
    with matplotlib.rc_context():
        runpy.run_path(str(path), run_name="__main__")
    pictures = list(tmp_path.glob("*.png"))
    assert pictures
    assert all(picture.stat().st_size > 5000 for picture in pictures)
