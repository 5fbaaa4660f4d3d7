"""Every product of a survey on the map, read by programs that are not ours, against its `summary.json`."""

import csv
import hashlib
import json
import re
import shutil
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from pyproj import CRS

from sionna_radar.accuracy.breakdown import Breakdown
from sionna_radar.accuracy.compare import DemError
from sionna_radar.foundation.progress import progress_to
from sionna_radar.report.files.contents import PointsFile, Report
from sionna_radar.report.files.points_table import ON_MAP, columns_of, write_points_csv
from sionna_radar.report.survey.products import write_survey
from sionna_radar.scenario import load_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.result import Survey

RASTERS = ("dem", "truth", "error")


@pytest.fixture(scope="module")
def flown() -> Survey:
    """A short flight over real ground with a vertical datum, with errors of navigation."""
    keys = {
        "platform.length_m": 8.0,
        "tracing.paths_per_pulse": 64,
        "platform.navigation": {"position_white_m": [0.05, 0.05, 0.1]},
    }
    return run(load_scenario("jacksboro", keys))


@pytest.fixture(scope="module")
def folder(flown, tmp_path_factory) -> Path:
    calls = []
    out = tmp_path_factory.mktemp("products") / "out"
    with progress_to(lambda *step: calls.append(step)):
        write_survey(flown, out, report=Report.NONE, points=[PointsFile.LAZ, PointsFile.CSV])
    assert calls == [("writing", done, len(calls) - 1) for done in range(len(calls))]
    return out


@pytest.fixture(scope="module")
def summary(folder) -> dict:
    return json.loads((folder / "summary.json").read_text())


# --------------------------------------------------------------------------------------------- rasters


def gdalinfo(path: Path, *options: str) -> dict:
    if shutil.which("gdalinfo") is None:
        pytest.skip("gdalinfo, of GDAL's own tools (Debian: gdal-bin), is not installed")
    # Without PAM: a statistic would come from the file itself, and nothing is written beside it.
    command = ["gdalinfo", "-json", "--config", "GDAL_PAM_ENABLED", "NO", *options, str(path)]
    return json.loads(subprocess.run(command, capture_output=True, check=True, text=True).stdout)


@pytest.mark.parametrize("name", RASTERS)
def test_gdal_sees_all_that_a_raster_says(folder, summary, name):
    seen = gdalinfo(folder / f"{name}.tif", "-checksum")
    band, structure = seen["bands"][0], seen["metadata"]["IMAGE_STRUCTURE"]
    assert (structure["LAYOUT"], structure["COMPRESSION"]) == ("COG", "DEFLATE")
    assert (band["type"], band["unit"], band["noDataValue"]) == ("Float32", "m", "NaN")
    assert band["description"] == {"dem": "DEM height", "truth": "true height", "error": "DEM minus truth"}[name]
    crs = CRS.from_wkt(seen["coordinateSystem"]["wkt"])
    assert crs.is_compound
    horizontal, vertical = (":".join(part.to_authority()) for part in crs.sub_crs_list)
    assert f"{horizontal} + {vertical}" == summary["crs"]
    stated = band["metadata"][""]
    computed = gdalinfo(folder / f"{name}.tif", "-stats")["bands"][0]
    for ours, theirs in (("MINIMUM", "minimum"), ("MAXIMUM", "maximum"), ("MEAN", "mean"), ("STDDEV", "stdDev")):
        assert float(stated[f"STATISTICS_{ours}"]) == pytest.approx(computed[theirs], abs=1e-3)
    assert not list(folder.glob("*.aux.xml"))


def test_the_error_raster_has_the_summary_s_errors(folder, summary):
    stated = gdalinfo(folder / "error.tif")["bands"][0]["metadata"][""]
    mean, std = float(stated["STATISTICS_MEAN"]), float(stated["STATISTICS_STDDEV"])
    error = summary["dem_error"]
    assert mean == pytest.approx(error["mean_m"], abs=1e-6)
    assert np.hypot(mean, std) == pytest.approx(error["rms_m"], rel=1e-6)
    assert float(stated["STATISTICS_MINIMUM"]) == pytest.approx(error["min_m"], abs=1e-6)
    with rasterio.open(folder / "error.tif") as file:
        values = file.read(1, masked=False).astype(float)
    values = values[np.isfinite(values)]
    assert len(values) == error["count"]
    assert np.percentile(np.abs(values), 95) == pytest.approx(error["le95_m"], rel=1e-6)
    assert np.ptp(np.percentile(values, [5, 95])) == pytest.approx(error["p95_p5_m"], rel=1e-6)


@pytest.mark.parametrize("name", RASTERS)
def test_pixels_are_those_of_the_survey_bit_for_bit(flown, folder, name):
    offset_m = 0.0 if name == "error" else flown.georeference.origin_m[2]
    raster = getattr(flown, name)
    with rasterio.open(folder / f"{name}.tif") as file:
        pixels = file.read(1)
        assert (file.dtypes, file.compression.name) == (("float32",), "deflate")
        assert np.isnan(file.nodata)
        assert file.bounds.left == pytest.approx(raster.grid.extent_m[0] + flown.georeference.origin_m[0], abs=1e-6)
        assert file.bounds.top == pytest.approx(raster.grid.extent_m[3] + flown.georeference.origin_m[1], abs=1e-6)
    np.testing.assert_array_equal(pixels, (raster.height_m[::-1] + offset_m).astype(np.float32))


def test_a_large_raster_is_a_valid_cog_with_overviews(flown, tmp_path):
    cogeo = pytest.importorskip("rio_cogeo.cogeo")
    grid = replace(flown.dem.grid, columns=700, rows=600)
    height = np.add.outer(np.arange(600.0), np.arange(700.0))
    height[:100, :100] = np.nan
    paths = [tmp_path / name for name in ("a.tif", "b.tif")]
    for path in paths:
        replace(flown.dem, grid=grid, height_m=height).to_geotiff(path, "DEM height")
    valid, errors, warnings = cogeo.cog_validate(paths[0], strict=True)
    assert (valid, errors, warnings) == (True, [], [])
    with rasterio.open(paths[0]) as file:
        assert file.overviews(1) == [2, 4]
        assert file.block_shapes == [(256, 256)]
        half = file.read(1, out_shape=(300, 350))
    # An average of four, without the empty ones; rows from the north.
    origin_height_m = flown.georeference.origin_m[2]
    assert half[0, 0] == pytest.approx(height[-2:, :2].mean() + origin_height_m)
    assert np.isnan(half[-1, 0])
    assert paths[0].read_bytes() == paths[1].read_bytes()


# ---------------------------------------------------------------------------------------------- points


def test_the_cloud_s_header_is_right(flown, folder, summary):
    with laspy.open(folder / "points.laz") as file:
        header = file.header
        las = file.read()
    assert header.point_count == summary["echoes"] == len(las.points)
    np.testing.assert_array_equal(header.mins, las.xyz.min(axis=0))
    np.testing.assert_array_equal(header.maxs, las.xyz.max(axis=0))
    np.testing.assert_allclose(
        las.xyz.min(axis=0), (flown.points.position_m + flown.georeference.origin_m).min(axis=0), atol=0.00051
    )
    returns = np.bincount(np.asarray(las.return_number), minlength=16)[1:16]
    np.testing.assert_array_equal(np.asarray(header.number_of_points_by_return)[:15], returns)
    assert header.global_encoding.gps_time_type == laspy.header.GpsTimeType.WEEK_TIME
    described = {dimension.name: dimension.description for dimension in las.point_format.extra_dimensions}
    assert described["range_sigma_m"] == "standard dev. of range (m)"
    assert {"echo_snr_db", "range_m", "range_sigma_m", "pulse", "echo"} <= set(described)
    assert header.parse_crs().to_2d() == CRS.from_wkt(flown.georeference.crs_wkt).to_2d()


def test_the_table_has_the_cloud(folder, summary):
    with (folder / "points.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    las = laspy.read(folder / "points.laz")
    assert len(rows) == summary["echoes"]
    columns = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    np.testing.assert_allclose(np.column_stack([columns[name] for name in ON_MAP]), las.xyz, atol=0.0006)
    np.testing.assert_allclose(columns["range_m"], las["range_m"], atol=0.00006)
    np.testing.assert_allclose(columns["time_s"], las.gps_time, atol=1e-6)
    np.testing.assert_array_equal(columns["pulse"], las["pulse"])
    away = np.column_stack([columns[name] - columns[f"radar_{name}"] for name in ON_MAP])
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), columns["range_m"], atol=0.0003)


def test_parquet_has_every_bit(flown, tmp_path, summary):
    parquet = pytest.importorskip("pyarrow.parquet")
    from sionna_radar.report.files.points_table import write_points_parquet

    path = tmp_path / "points.parquet"
    write_points_parquet(path, flown.points, flown.schedule.time_s, flown.georeference)
    table = parquet.read_table(path)
    for name, column in columns_of(flown.points, flown.schedule.time_s, flown.georeference).items():
        np.testing.assert_array_equal(table[name].to_numpy(), column)
    # Local positions give the digest of the summary, but for the round-off of adding the origin.
    local = np.column_stack([table[name].to_numpy() for name in ON_MAP]) - flown.georeference.origin_m
    np.testing.assert_allclose(local, flown.points.position_m, atol=1e-8)
    digest = hashlib.sha256(np.ascontiguousarray(flown.points.position_m, dtype="<f8").tobytes())
    for name in ("range_m", "power_w", "echo_snr_db"):
        digest.update(table[name].to_numpy().tobytes())
    assert digest.hexdigest() == summary["points_sha256"]
    assert CRS.from_wkt(table.schema.metadata[b"crs"].decode()).is_compound
    assert b"slant range" in table.schema.field("range_m").metadata[b"description"]


def test_without_pyarrow_one_error_before_the_flight(monkeypatch, cli, small, tmp_path):
    from sionna_radar.report.files import points_table

    monkeypatch.setattr(points_table, "find_spec", lambda name: None)
    done = cli("run", small, "-o", tmp_path / "out", "--points", "parquet", "-q", code=2)
    assert "sionna-radar[parquet]" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_table_of_local_points_and_one_of_none(survey, empty, tmp_path):
    write_points_csv(tmp_path / "local.csv", survey.points, survey.schedule.time_s, None)
    write_points_csv(tmp_path / "none.csv", empty.points, empty.schedule.time_s, None)
    head, *rows = (tmp_path / "local.csv").read_text().splitlines()
    assert head.startswith(
        "pulse,echo,time_s,east_m,north_m,up_m,range_m,range_sigma_m,echo_snr_db,power_w,radar_east_m"
    )
    assert len(rows) == len(survey.points)
    assert (tmp_path / "none.csv").read_text() == head + "\n"


# ------------------------------------------------------------------------------------------- the guide


GUIDE = (Path(__file__).parents[3] / "examples" / "PRODUCTS.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", GUIDE, flags=re.DOTALL)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("number", range(len(BLOCKS)))
def test_the_guide_s_lines_run(folder, monkeypatch, capsys, number, summary):
    monkeypatch.chdir(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            exec(compile(BLOCKS[number], f"PRODUCTS.md block {number + 1}", "exec"), {})
        except ImportError as error:
            pytest.skip(f"{error.name} is not installed")
    printed = capsys.readouterr().out
    if "RMSE {(error_m" in BLOCKS[number]:
        assert f"RMSE {summary['dem_error']['rms_m']:.3f} m of {summary['dem_error']['count']:,} cells" in printed


def test_the_guide_names_every_field(folder):
    with (folder / "points.csv").open() as file:
        names = file.readline().strip().split(",")
    with (folder / "trajectory.csv").open() as file:
        names += file.readline().strip().split(",")
    for name in names:
        first_of_three = re.sub(r"(northing|height|north|up|pitch|heading)(_deg|_m|_mps)$", r"", name)
        assert f"`{name}`" in GUIDE or f"`{first_of_three}" in GUIDE, name
    for name in (*DemError.__annotations__, *Breakdown.__annotations__):
        assert f"`{name}`" in GUIDE or name in ("count", "min_m", "max_m"), name
