"""Colours of pages against those of figures."""

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.colors import to_hex

from sionna_radar.report.colours import STOPS


@pytest.mark.parametrize("name", STOPS)
def test_pages_have_the_colours_of_figures(name: str) -> None:
    assert STOPS[name] == [to_hex(colormaps[name](stop)) for stop in np.linspace(0, 1, len(STOPS[name]))]
