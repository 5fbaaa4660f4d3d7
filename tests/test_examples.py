"""The examples run, and leave the pictures they promise; continuous integration runs them for the documentation."""

import os
import runpy
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

pytestmark = pytest.mark.study

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run_example(path: Path, folder: Path) -> None:
    os.environ["SIONNA_RADAR_SMALL"] = "1"
    os.chdir(folder)
    sys.argv = [str(path)]
    runpy.run_path(str(path), run_name="__main__")


@pytest.fixture(scope="module")
def user():
    """One interpreter for all examples, as a user has it: nothing checks types, and the heavy libraries load once."""
    with ProcessPoolExecutor(max_workers=1, mp_context=get_context("spawn")) as pool:
        yield pool


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("plot_*.py")), ids=lambda path: path.stem)
def test_example_runs(path, tmp_path, user):
    user.submit(run_example, path, tmp_path).result()
    pictures = list(tmp_path.glob("*.png"))
    assert pictures
    assert all(picture.stat().st_size > 5000 for picture in pictures)
