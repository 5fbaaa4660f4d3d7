"""`calibrate` over ground that is not that of the echoes ends with 1, and says why even when quiet."""

import numpy as np
import pytest

from sionna_radar import load_scenario, run
from sionna_radar.foundation.raster import Raster
from sionna_radar.studies.calibration import estimation


@pytest.mark.usefixtures("undrawn")
def test_a_calibration_without_an_estimate_ends_with_1(cli, tmp_path, monkeypatch):
    changes = {"platform.length_m": 30.0, "terrain.spacing_m": 2.0}
    survey = run(load_scenario("hills", changes), recordings={"signals": tmp_path / "line.nc"})
    # So rough that the axes of the beams meet none of it where the first estimate ends.
    rough = np.random.default_rng(1).normal(0.0, 8.0, size=survey.truth.height_m.shape)
    Raster(grid=survey.truth.grid, height_m=survey.truth.height_m + rough).to_geotiff(tmp_path / "other.tif")
    monkeypatch.setattr(estimation, "MAX_STEPS", 2)  # far from settled, as after all of them
    arguments = ["calibrate", tmp_path / "line.nc", "--no-report", "--reference", tmp_path / "other.tif"]
    refused = cli(*arguments, "-q", "-o", tmp_path / "out", code=1)
    assert refused.stdout == ""
    assert "no estimate: the echoes are not those of this ground" in refused.stderr
    assert "No estimate is stated" in refused.stderr
