"""`calibrate` over ground that is not that of the echoes ends with 1, and says why even when quiet."""

import numpy as np

from sionna_radar import load_scenario, run
from sionna_radar.foundation.raster import Raster


def test_a_calibration_without_an_estimate_ends_with_1(cli, tmp_path):
    changes = {"platform.length_m": 40.0, "terrain.spacing_m": 2.0}
    survey = run(load_scenario("hills", changes), recordings={"signals": tmp_path / "line.nc"})
    # Undulations as high and as long as the hills themselves, at other places.
    x, y = survey.truth.grid.x_m, survey.truth.grid.y_m
    rough = 2.5 * np.sin(2 * np.pi * x / 30)[None] * np.cos(2 * np.pi * y / 40)[:, None]
    Raster(grid=survey.truth.grid, height_m=survey.truth.height_m + rough).to_geotiff(tmp_path / "other.tif")
    arguments = ["calibrate", tmp_path / "line.nc", "--no-report", "--reference"]
    refused = cli(*arguments, tmp_path / "other.tif", "-q", "-o", tmp_path / "out", code=1)
    assert refused.stdout == ""
    assert "no estimate: the echoes are not those of this ground" in refused.stderr
    assert "No estimate is stated" in refused.stderr
    survey.truth.to_geotiff(tmp_path / "true.tif")
    told = cli(*arguments, tmp_path / "true.tif", "-q", "-o", tmp_path / "good")
    assert (told.stdout, "no estimate" in told.stderr) == ("", False)
