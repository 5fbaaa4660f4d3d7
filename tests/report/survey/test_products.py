"""Products read back as what went in."""

import json
from dataclasses import replace
from datetime import date
from importlib.metadata import version
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS

from beams import make_antenna
from sionna_radar import run
from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.raster import Raster
from sionna_radar.report.files.contents import Report, strict_json
from sionna_radar.report.files.points_table import write_laz, write_points_csv
from sionna_radar.report.survey.products import write_survey
from sionna_radar.report.survey.summary import summary
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.result import Survey

KEYS = [
    "scenario",
    "replaced",
    "warnings",
    "seed",
    "crs",
    "georeference",
    "flight_log",
    "engine",
    "pulses",
    "paths",
    "echoes",
    "readings",
    "receiver",
    "dem_error",
    "lit_error",
    "off_wall_error",
    "mapped",
    "breakdown",
    "dem_uncertainty",
    "reference",
    "overhang",
    "canopy",
    "canopy_check",
    "obstacles",
    "navigation",
    "no_echo",
    "meaning",
    "points_sha256",
    "versions",
]
FILES = [
    "costs.json",
    "dem.tif",
    "error.tif",
    "lit.tif",
    "manifest.json",
    "points.csv",
    "points.laz",
    "report.html",
    "scenario.toml",
    "summary.json",
    "trajectory.csv",
    "truth.tif",
]


# ----------------------------------------------------------------------------------------- summary


def test_summary_holds_the_survey(survey: Survey) -> None:
    document = summary(survey)
    assert list(document) == KEYS
    assert document["echoes"] == len(survey.points)
    assert document["engine"] == "sionna"
    assert document["receiver"] is None  # no converter with a full scale
    assert document["seed"] == 7
    assert document["dem_error"]["rms_m"] == survey.dem_error.rms_m
    assert document["points_sha256"] == survey.points.sha256()
    assert document["versions"]["numpy"] == np.__version__
    assert document["scenario"]["platform"]["altitude_m"] == 50.0


def test_summary_of_nothing_is_strict_json(empty: Survey) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    document = json.loads(strict_json(summary(empty)), parse_constant=refuse)
    assert document["dem_error"] == {"count": 0, "coverage": 0.0} | dict.fromkeys(
        name for name in DemError.__annotations__ if name.endswith(("_m", "over_1m"))
    )


# --------------------------------------------------------------------------------------- the folder


def test_all_files_are_written(survey: Survey, tmp_path: Path) -> None:
    out = tmp_path / "new" / "result"
    paths = write_survey(survey, out)
    assert [p.relative_to(out).as_posix() for p in paths] == FILES
    assert [p.name for p in out.parent.iterdir()] == ["result"]
    assert load_scenario(out / "scenario.toml") == survey.scenario
    # The folder has the permissions that any new folder gets.
    (tmp_path / "plain").mkdir()
    assert out.stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("method", ["linear", "smooth"])
def test_the_file_of_stated_errors_says_what_they_hold(method: str, tmp_path: Path) -> None:
    flown = run(load_scenario("hills", {"platform.length_m": 6.0, "terrain.spacing_m": 2.0, "dem.method": method}))
    write_survey(flown, tmp_path / "out", report=Report.NONE)
    with rasterio.open(tmp_path / "out" / "dem_sigma.tif") as file:
        (described,) = file.descriptions
        assert file.tags()["QUANTITY"] == described
    assert described.startswith("standard deviation of the DEM height: speckle and noise of the echoes")
    holds, leaves_out = described.split("without what is common to all cells: ")
    assert "navigation" in leaves_out
    assert "navigation" not in holds
    assert ("bias of the beam on slopes" in leaves_out) == (method == "linear")


def test_nothing_found_is_a_result_too(empty: Survey, tmp_path: Path) -> None:
    assert len(write_survey(empty, tmp_path / "out")) == len(FILES)


def test_what_was_replaced_is_told(survey: Survey, tmp_path: Path) -> None:
    flown = replace(survey, prepared=replace(survey.prepared, custom=CustomParts(antenna=make_antenna(6.0, 6.0))))
    horn = "sionna_radar.radar.antenna.Antenna, half-power beam 6 x 6 deg"
    assert summary(flown)["replaced"] == flown.replaced == {"radar.antenna": horn}
    write_survey(flown, tmp_path / "out")
    text = (tmp_path / "out" / "scenario.toml").read_text()
    assert text.startswith("# This file alone does not repeat the survey")
    assert f"#   radar.antenna: {horn}\n" in text
    assert load_scenario(tmp_path / "out" / "scenario.toml") == survey.scenario


def test_le90_is_defined_where_it_is_written(survey: Survey) -> None:
    assert "90th percentile of |error|" in summary(survey)["meaning"]["le90_m"]


# ------------------------------------------------------------------------------------------ rasters


def test_local_geotiff_warns_of_nothing(survey: Survey, tmp_path: Path) -> None:
    # Unit cells in the corner of the frame: the transform nearest to the identity that GDAL takes for none.
    grid = replace(survey.dem.grid, west_m=0.5, south_m=0.5 - survey.dem.grid.rows)
    Raster(grid=grid, height_m=survey.dem.height_m).to_geotiff(tmp_path / "dem.tif")
    with rasterio.open(tmp_path / "dem.tif") as file:
        assert file.crs is None
        assert file.bounds.left == 0.0
        assert file.bounds.top == 0.0


def test_a_geotiff_says_what_made_it(survey: Survey, tmp_path: Path) -> None:
    described = survey.scenario.model_copy(update={"description": "H\u00fcgel [/x]\0 <&> \x01"})
    write_survey(replace(survey, prepared=replace(survey.prepared, scenario=described)), tmp_path / "out")
    for name, quantity in {"dem": "DEM height", "truth": "true height", "error": "DEM minus truth"}.items():
        with rasterio.open(tmp_path / "out" / f"{name}.tif") as file:
            tags = file.tags()
        assert tags["TIFFTAG_SOFTWARE"] == f"sionna-radar {version('sionna-radar')}"
        assert tags["TIFFTAG_IMAGEDESCRIPTION"].strip() == "H\u00fcgel [/x]  <&>"
        assert (tags["SEED"], tags["QUANTITY"], tags["UNITS"]) == ("7", quantity, "m")
        assert tags["POINTS_SHA256"] == survey.points.sha256()


# ------------------------------------------------------------------------------------------- points


def test_laz_reads_back(georeferenced: Survey, tmp_path: Path) -> None:
    path, points, place = tmp_path / "points.laz", georeferenced.points, georeferenced.georeference
    assert place is not None
    write_laz(path, points, georeferenced.schedule.time_s, georeferenced.prepared.measured, place)
    las = laspy.read(path)
    assert las.header.creation_date == date(2000, 1, 1)  # no clock, no time zone
    assert (str(las.header.version), las.header.point_format.id) == ("1.4", 6)
    assert las.header.parse_crs() == CRS.from_epsg(32616)
    assert las.header.global_encoding.wkt
    np.testing.assert_allclose(las.xyz, points.position_m + place.origin_m, atol=0.00051, rtol=0)
    np.testing.assert_array_equal(las["pulse"], points.pulse)
    np.testing.assert_array_equal(las["echo"], points.number)
    np.testing.assert_array_equal(las["range_m"], points.range_m)
    np.testing.assert_array_equal(las["echo_snr_db"], points.echo_snr_db.astype(np.float32))
    np.testing.assert_array_equal(las.gps_time, georeferenced.schedule.time_s[points.pulse])
    np.testing.assert_array_equal(las["range_sigma_m"], points.range_sigma_m.astype(np.float32))
    radar = np.column_stack([las["radar_x"], las["radar_y"], las["radar_z"]])
    np.testing.assert_allclose(radar, points.origin_m + place.origin_m, atol=1e-6)
    # The beam runs from the radar to the point.
    np.testing.assert_allclose(np.linalg.norm(las.xyz - radar, axis=1), points.range_m, atol=0.001)
    above_db = 10 * np.log10(points.power / points.power.min())
    np.testing.assert_allclose(las.intensity / 100, above_db, atol=0.0051)


def test_laz_numbers_the_echoes_of_a_pulse(survey: Survey, tmp_path: Path) -> None:
    points = survey.points
    row = np.zeros(20, dtype=int)
    columns = ("position_m", "origin_m", "range_m", "range_sigma_m", "power", "echo_snr_db")
    twenty = replace(
        points,
        pulse=points.pulse[row],
        number=np.arange(20),
        **{name: getattr(points, name)[row] for name in columns},
    )
    write_laz(tmp_path / "points.laz", twenty, survey.schedule.time_s, survey.prepared.measured, None)
    las = laspy.read(tmp_path / "points.laz")
    assert list(las["echo"]) == list(range(20))
    assert np.asarray(las.return_number).max() == 15
    assert set(np.asarray(las.number_of_returns)) == {15}
    assert las.header.parse_crs() is None


def test_points_at_measured_directions_tell_how_well_they_are_known(survey: Survey, tmp_path: Path) -> None:
    across_m = np.linspace(0.01, 0.2, len(survey.points))
    points = replace(survey.points, across_sigma_m=across_m)
    time_s = np.arange(survey.pulses) / 360.0
    write_laz(tmp_path / "points.laz", points, time_s, survey.prepared.measured, None)
    write_points_csv(tmp_path / "points.csv", points, time_s, None)
    np.testing.assert_array_equal(laspy.read(tmp_path / "points.laz")["across_sigma_m"], across_m.astype(np.float32))
    read = np.genfromtxt(tmp_path / "points.csv", delimiter=",", names=True)
    np.testing.assert_allclose(read["across_sigma_m"], across_m, atol=5e-5)


def test_laz_scan_angle_is_to_the_right_of_the_flight(survey: Survey, tmp_path: Path) -> None:
    write_laz(tmp_path / "points.laz", survey.points, survey.schedule.time_s, survey.prepared.measured, None)
    las = laspy.read(tmp_path / "points.laz")
    # A whisk broom's scan angle is the one about the forward axis.
    scan_deg = np.rad2deg(survey.schedule.pulses(survey.points.pulse).scan_rad)
    assert np.ptp(scan_deg) > 60
    np.testing.assert_allclose(0.006 * las.scan_angle, scan_deg, atol=0.0031)
    heading = np.deg2rad(70.0)
    away = survey.points.position_m - survey.points.origin_m
    to_the_right = away[:, 0] * np.cos(heading) - away[:, 1] * np.sin(heading)
    np.testing.assert_array_equal(np.sign(np.round(to_the_right, 2)) * las.scan_angle >= 0, True)


def test_laz_of_no_points(empty: Survey, tmp_path: Path) -> None:
    write_laz(tmp_path / "points.laz", empty.points, empty.schedule.time_s, empty.prepared.measured, None)
    las = laspy.read(tmp_path / "points.laz")
    assert len(las.points) == 0
    assert {"echo_snr_db", "range_m", "pulse", "echo"} <= set(las.point_format.extra_dimension_names)
