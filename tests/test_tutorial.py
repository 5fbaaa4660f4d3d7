"""The tutorial notebook runs from top to bottom, and its cells show something."""

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import matplotlib.pyplot as plt
import pytest

NOTEBOOK = Path(__file__).parents[1] / "examples" / "tutorial.ipynb"


@pytest.mark.usefixtures("rough_errors")
def test_the_tutorial_runs_from_top_to_bottom(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plt, "show", lambda: plt.close("all"))
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, object] = {}
    printed = StringIO()
    with redirect_stdout(printed):
        for cell in cells:
            if cell["cell_type"] == "code":
                assert not cell["outputs"], "committed without outputs"
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert "paths" in printed.getvalue()
    assert printed.getvalue().count("RMS error") == 2
