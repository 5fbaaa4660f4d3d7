"""The speed ratios, run on their own: `pytest -m benchmark -n 0`."""

import pytest

from sionna_radar.studies.bench import measure


@pytest.mark.benchmark
def test_every_ratio_keeps_its_bound():
    missed = [str(ratio) for ratio in measure() if not ratio.kept]
    assert missed == []
