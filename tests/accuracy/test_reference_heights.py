"""DEMs against measured heights: the shift within its stated intervals, the statistics, and files that do not fit."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS
from rasterio.transform import Affine
from scipy.ndimage import binary_erosion, gaussian_filter
from typer.testing import CliRunner

from elevation_files import write_heights
from sionna_radar import Survey, load_scenario, process, run
from sionna_radar.accuracy.coregistration import trend_of
from sionna_radar.accuracy.illumination import Walls
from sionna_radar.accuracy.reference import ReferenceSurface, read_reference
from sionna_radar.accuracy.reference_check import ReferenceCheck, compare_with_reference
from sionna_radar.cli.app import app
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.report.page.sections import reference_section
from sionna_radar.scene.footprints import Box
from sionna_radar.studies.comparison.document import print_references

GRID = Grid(west_m=-40.0, south_m=-35.0, spacing_m=1.0, columns=81, rows=71)


@pytest.fixture(scope="module")
def survey() -> Survey:
    return run(load_scenario("hills", {"platform.length_m": 6.0}))


def relief(seed: int) -> Raster:
    """Hills of 3 m, some 12 m apart, on cells of 0.5 m over 150 m."""
    z = gaussian_filter(np.random.default_rng(seed).normal(size=(300, 300)), 12)
    return Raster.from_array(3.0 * z / z.std(), 0.5)


def noise(rng: np.random.Generator, shape: tuple[int, int], rms_m: float, cells: float = 2.0) -> np.ndarray:
    """Errors that neighbouring cells share."""
    z = gaussian_filter(rng.normal(size=shape), cells)
    return rms_m * z / z.std()


def seen(surface: Raster, shift_m: tuple[float, float], up_m: float, tilt: tuple[float, float], rng) -> Raster:
    """A DEM of a surface, shifted, tilted, and with errors of 0.08 m."""
    place = GRID.centres_m
    height = surface.at(place - shift_m) + up_m + (place - [0.0, 0.0]) @ tilt
    return Raster(grid=GRID, height_m=height.reshape(GRID.shape) + noise(rng, GRID.shape, 0.08))


def written(raster: Raster, path: Path) -> Path:
    raster.to_geotiff(path)
    return path


def test_the_shift_lies_in_its_stated_intervals(tmp_path):
    z = []
    for seed in range(700, 720):
        rng = np.random.default_rng(seed)
        surface = relief(seed)
        shift, up, tilt = rng.uniform(-15, 15, 2), rng.normal(0, 0.3), rng.normal(0, 0.002, 2)
        measured = replace(surface, height_m=surface.height_m + rng.normal(0, 0.03, surface.grid.shape))
        path = written(measured, tmp_path / f"{seed}.tif")
        found = compare_with_reference(path, seen(surface, tuple(shift), up, tuple(tilt), rng)).shift
        true = (*shift, up, *tilt)
        estimate = (found.east_m, found.north_m, found.up_m, found.tilt_east, found.tilt_north)
        sigma = (found.east_sigma_m, found.north_sigma_m, found.up_sigma_m)
        sigma += (found.tilt_east_sigma, found.tilt_north_sigma)
        z.append((np.array(estimate) - true) / sigma)
        assert max(sigma[:2]) < 0.08
    # Of 100 intervals of 95 %, fewer than 87 hold the truth with a probability below 0.001.
    assert (np.abs(z) < 1.96).sum() >= 87
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.3


def test_heights_of_a_reference_are_those_of_its_scale_and_offset(tmp_path):
    """Packed in 0.05 m, over an offset, with cells that nothing declares to be empty."""
    surface = relief(5)
    packed = np.round((surface.height_m[::-1] + 20.0) / 0.05).astype(np.int16)
    packed[100:104, 150:154] = -9999
    path = write_heights(
        tmp_path / "packed.tif", packed, Affine(*surface.grid.transform), crs=None, scale_offset=(0.05, -20.0)
    )
    reference = read_reference(path, GRID)
    heights, there = reference.on(GRID), surface.at(GRID.centres_m).reshape(GRID.shape)
    assert 2 <= (~heights.filled).sum() <= 12
    whole = binary_erosion(heights.filled, np.ones((3, 3)), border_value=1)
    np.testing.assert_allclose(heights.height_m[whole], there[whole], atol=0.03)


@pytest.mark.parametrize("spacing_m", [1.0, 2.5])
def test_heights_of_a_reference_lie_at_their_places_beside_its_empty_cells_and_at_its_edges(spacing_m):
    """On a plane, of which an extrapolated height would be that of another place."""
    plane = lambda x, y: 0.3 * x - 0.2 * y  # noqa: E731
    x, y = np.meshgrid(spacing_m * np.arange(24) - 30.0, spacing_m * np.arange(24) - 30.0)
    height_m = np.where(np.random.default_rng(3).random(x.shape) < 0.04, np.nan, plane(x, y))
    surface = ReferenceSurface.of(Raster.from_array(height_m, spacing_m, west_m=-30.0, south_m=-30.0))
    for shift_m in ((0.0, 0.0), (0.4, -0.3)):
        heights = surface.on(GRID, shift_m)
        error = heights.height_m - plane(*(GRID.centres_m - shift_m).T).reshape(GRID.shape)
        assert heights.filled.sum() > 0.7 * (24 * spacing_m) ** 2 * 0.9
        np.testing.assert_allclose(error[heights.filled], 0.0, atol=1e-3)


def test_flat_ground_tells_no_horizontal_shift(tmp_path):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        flat = Raster.from_array(noise(rng, (300, 300), 0.03, 1.0), 0.5)
        dem = Raster(grid=GRID, height_m=0.1 + noise(rng, GRID.shape, 0.08))
        found = compare_with_reference(written(flat, tmp_path / f"{seed}.tif"), dem).shift
        assert found.east_m is None
        assert found.north_sigma_m is None
        assert abs(found.up_m - 0.1) < 4 * found.up_sigma_m < 0.1


def test_a_plane_tells_no_horizontal_shift(tmp_path):
    surface = Raster.from_array(np.zeros((300, 300)), 0.5)
    dem = Raster(grid=GRID, height_m=np.full(GRID.shape, -0.006))
    found = compare_with_reference(written(surface, tmp_path / "plane.tif"), dem).shift
    assert found.east_m is None
    assert found.north_m is None
    np.testing.assert_allclose(found.up_m, -0.006, atol=1e-6)


def test_a_shift_beyond_what_is_searched_is_not_told(tmp_path):
    rng = np.random.default_rng(4)
    path = written(relief(4), tmp_path / "reference.tif")
    assert compare_with_reference(path, seen(relief(4), (30.0, 0.0), 0.0, (0.0, 0.0), rng)).shift.east_m is None


def test_the_shift_is_that_of_xdem(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        xdem = pytest.importorskip("xdem")
        surface, rng = relief(3), np.random.default_rng(3)
        place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(500_000.0, 4_000_000.0, 0.0))
        at = lambda raster: replace(raster, grid=replace(raster.grid, georeference=place))  # noqa: E731
        dem = at(seen(surface, (1.3, -0.7), 0.4, (0.0, 0.0), rng))
        ours = compare_with_reference(written(at(surface), tmp_path / "reference.tif"), dem).shift
        dem.to_geotiff(tmp_path / "dem.tif")
        coreg = xdem.coreg.NuthKaab()
        coreg.fit(xdem.DEM(str(tmp_path / "reference.tif")), xdem.DEM(str(tmp_path / "dem.tif")), random_state=1)
        theirs = coreg.meta["outputs"]["affine"]
    # xDEM gives what moves the DEM onto the reference.
    np.testing.assert_allclose((-theirs["shift_x"], -theirs["shift_y"]), (ours.east_m, ours.north_m), atol=0.05)
    np.testing.assert_allclose(-theirs["shift_z"], ours.up_m, atol=0.03)


def test_a_shift_that_is_applied_is_gone_from_the_errors(tmp_path):
    surface, rng = relief(1), np.random.default_rng(1)
    dem = seen(surface, (2.0, 1.0), 0.5, (0.001, -0.002), rng)
    path = written(surface, tmp_path / "surface.tif")
    raw, shifted = (compare_with_reference(path, dem, apply_shift=apply) for apply in (False, True))
    assert raw.shift == shifted.shift
    assert raw.statistics.rms_m > 0.6
    assert 0.07 < shifted.statistics.rms_m < 0.09
    assert shifted.error is not None
    assert not raw.applied


def test_the_true_surface_as_reference_gives_the_errors_of_a_survey(survey, tmp_path):
    path = written(survey.truth, tmp_path / "truth.tif")
    check = survey.with_reference(path).reference
    assert isinstance(check, ReferenceCheck)
    # The file has 32-bit heights.
    np.testing.assert_allclose(check.statistics.rms_m, survey.lit_error.rms_m, atol=1e-5)
    np.testing.assert_allclose(check.statistics.coverage, survey.lit_error.coverage, atol=1e-3)
    ours, theirs = check.calibration.cells.coverage, survey.dem_uncertainty.cells.coverage
    np.testing.assert_allclose(list(ours.values()), list(theirs.values()), atol=0.01)
    assert "with an error unknown" in check.breakdown.checkpoints.statement
    wider = survey.with_reference(path, sigma_m=0.1).reference
    assert wider.calibration.cells.sigma_rms_m > check.calibration.cells.sigma_rms_m
    assert "an error of 10.0 cm" in wider.breakdown.checkpoints.statement


def test_a_reference_tells_the_errors_by_cover_and_by_distance_from_walls(tmp_path):
    """A reference 0.4 m too low on a field, and 0.2 m too high within 5 m of a wall of which the scenario knows."""
    stand = {"polygon_m": [[-45, 15], [-30, 15], [-30, 30], [-45, 30]], "height_m": 3.0}
    changes = {
        "platform.length_m": 40.0,
        "terrain.spacing_m": 1.0,
        "terrain.fields": [{"centre_m": [-40.0, -25.0], "size_m": [20.0, 20.0], "material": "gravel"}],
        "materials.gravel": {"model": "constant_gamma", "gamma_db": -10.0},
        "buildings": [{"position_m": [-22.0, -5.0], "size_m": [8.0, 8.0, 6.0]}],
        "vegetation": [{**stand, "extinction_db_per_m": 1.0, "backscatter_db_per_m": -20.0}],
        "dem.method": "linear",  # it fills the cells beside walls
    }
    survey = run(load_scenario("hills", changes), recordings={"signals": tmp_path / "signals.nc"})
    x, y = survey.truth.grid.centres_m.T.reshape(2, *survey.truth.grid.shape)
    field = (np.abs(x + 40) <= 10) & (np.abs(y + 25) <= 10)
    beyond = np.maximum(np.abs(x + 22), np.abs(y + 5)) - 4
    beside = (np.abs(beyond) <= 5) & (np.minimum(np.abs(x + 22), np.abs(y + 5)) <= 4)
    surveyed = survey.dem.height_m + np.where(beside, 0.2, np.where(field, -0.4, 0.0))
    path = written(replace(survey.dem, height_m=surveyed), tmp_path / "surveyed.tif")
    result = survey.with_reference(path)
    found = result.reference.breakdown
    covers = {name: error.mean_m for name, error in found.by_cover.items()}
    assert set(covers) == {"ground", "gravel", "vegetation", "building"}
    # Cells of the border, which follows the mesh, and those of the wall's corners.
    assert covers["gravel"] == pytest.approx(0.4, abs=0.05)
    assert covers["vegetation"] == pytest.approx(0.0, abs=1e-5)
    assert abs(covers["ground"]) < 0.02
    walls = {entry.low: entry.mean_m for entry in found.by_wall_distance}
    assert all(walls[low] < -0.1 for low in (0.0, 1.0, 2.0))
    assert walls[20.0] > -0.01
    names = {name: error.count for name, error in survey.breakdown.by_cover.items()}
    assert sum(names.values()) == survey.lit_error.count
    assert reference_section(result.reference)["classes"]["Cover"][0][0] == "building"
    assert result.reference.missing == {}
    # A recording knows the covers of its scenario, without what stands on them.
    again = process(tmp_path / "signals.nc").with_reference(path).reference
    assert set(again.breakdown.by_cover) == {"ground", "gravel"}
    assert again.breakdown.by_cover["gravel"].mean_m == pytest.approx(0.4, abs=0.05)
    inside = survey.dem.filled & field
    assert abs(again.breakdown.by_cover["gravel"].count - inside.sum()) <= 0.02 * inside.sum()


def block(raster: Raster) -> Raster:
    """Level ground with an upright block, 24 m by 16 m and 6 m high, about the origin."""
    x, y = np.abs(raster.grid.centres_m.T.reshape(2, *raster.grid.shape))
    return replace(raster, height_m=np.where((x < 12) & (y < 8), 6.0, 0.0))


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
@pytest.mark.parametrize("crs", [None, "EPSG:32616", "EPSG:32617"])
def test_the_walls_of_a_raster_are_those_of_its_steps(tmp_path, crs):
    """Also where the reference lies turned by 3 deg, in the next zone."""
    import rasterio
    from rasterio.warp import calculate_default_transform, reproject

    surface, grid, path = block(relief(1)), GRID, tmp_path / "block.tif"
    if crs:
        place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(700_000.0, 4_000_000.0, 0.0))
        surface, grid = (
            replace(surface, grid=replace(surface.grid, georeference=place)),
            replace(grid, georeference=place),
        )
    written(surface, path)
    if crs == "EPSG:32617":
        with rasterio.open(path) as file:
            size = file.width, file.height
            transform, width, height = calculate_default_transform(file.crs, crs, *size, *file.bounds, resolution=0.5)
            profile = {**file.profile, "crs": crs, "transform": transform, "width": width, "height": height}
            with rasterio.open(tmp_path / "turned.tif", "w", **{**profile, "driver": "GTiff"}) as out:
                reproject(rasterio.band(file, 1), rasterio.band(out, 1), resampling=rasterio.warp.Resampling.nearest)
        path = tmp_path / "turned.tif"
    exact = Walls(
        buildings=(Box(position_m=(2.0, -1.0), size_m=(16.0, 24.0, 6.0), heading_rad=0.0),), foot_m=np.zeros((0, 2))
    )
    reference = read_reference(path, grid)
    found = reference.walls(grid, (2.0, -1.0))
    here, there = (walls.distance_m(GRID.centres_m, 15.0) for walls in (found, exact))
    near = np.isfinite(here) & np.isfinite(there)
    assert near.sum() > 2000
    # Cells of 0.5 m.
    assert np.abs(here[near] - there[near]).max() < 0.5
    assert not ReferenceSurface.walls(replace(reference, height_m=0.15 * reference.height_m), grid, (0.0, 0.0))


def test_a_cloud_tells_the_errors_by_its_classes_and_by_its_steps(tmp_path):
    """A DEM 0.3 m too high on a block of class 6, and 0.2 m too low over plants of two classes in the east."""
    surface = block(relief(1))
    place = surface.grid.centres_m
    x = place[:, 0]
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.header.scales = [0.001] * 3
    cloud.x, cloud.y, cloud.z = *place.T, surface.height_m.ravel()
    cloud.return_number = np.ones(len(place), dtype=np.uint8)
    cloud.classification = np.where(surface.height_m.ravel() > 0, 6, np.where(x > 30, 5, np.where(x > 20, 3, 2)))
    cloud.write(tmp_path / "cloud.laz")
    truth = block(Raster(grid=GRID, height_m=np.zeros(GRID.shape)))
    east = GRID.centres_m[:, 0].reshape(GRID.shape)
    error = np.where(truth.height_m > 0, 0.3, np.where(east > 20, -0.2, 0.0))
    check = compare_with_reference(tmp_path / "cloud.laz", replace(truth, height_m=truth.height_m + error))
    covers = {name: (cover.count, cover.mean_m) for name, cover in check.breakdown.by_cover.items()}
    # Cells of 1 m whose centres lie within: of walls through cells, with a mean of both heights, those inside.
    assert set(covers) == {"ground", "low vegetation", "high vegetation", "building"}
    assert covers["high vegetation"] == (10 * GRID.rows, pytest.approx(-0.2))
    assert covers["low vegetation"] == (10 * GRID.rows, pytest.approx(-0.2))
    walls = {entry.low: entry.mean_m for entry in check.breakdown.by_wall_distance}
    assert set(walls) >= {0.0, 1.0, 2.0, 5.0}
    outline = Box(position_m=(0.0, 0.0), size_m=(16.0, 24.0, 6.0), heading_rad=0.0)
    exact = Walls(buildings=(outline,), foot_m=np.zeros((0, 2))).distance_m(GRID.centres_m, 100.0)
    assert walls[20.0] == pytest.approx(error.ravel()[exact >= 20].mean(), abs=0.005)
    assert walls[2.0] == pytest.approx(error.ravel()[(exact >= 2) & (exact < 5)].mean(), abs=0.03)
    assert check.missing == {"incidence": "no echoes"}


@pytest.mark.parametrize("every", [1, 9])
def test_a_cloud_is_a_surface_where_it_is_dense_and_checkpoints_where_it_is_not(tmp_path, caplog, every):
    surface, rng = relief(5), np.random.default_rng(5)
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    place = surface.grid.centres_m.reshape(*surface.grid.shape, 2)[::every, ::every].reshape(-1, 2)
    cloud.header.scales = [0.001] * 3
    cloud.x, cloud.y, cloud.z = *place.T, surface.height_m[::every, ::every].ravel()
    cloud.return_number = np.ones(len(place), dtype=np.uint8)
    cloud.write(tmp_path / "cloud.laz")
    check = compare_with_reference(tmp_path / "cloud.laz", seen(surface, (0.0, 0.0), 0.25, (0.0, 0.0), rng))
    assert check.kind == ("cloud" if every == 1 else "sparse cloud")
    assert "lies +0.25 m off" not in caplog.text
    compare_with_reference(tmp_path / "cloud.laz", seen(surface, (0.0, 0.0), 20.0, (0.0, 0.0), rng))
    assert "the DEM lies +20." in caplog.text
    assert (check.shift.east_m is None) == (every == 9)
    assert abs(check.shift.up_m - 0.25) < 3 * check.shift.up_sigma_m + 0.01
    np.testing.assert_allclose(check.statistics.mean_m, 0.25, atol=0.03)


def test_checkpoints_give_offset_tilt_and_the_share_in_the_intervals_of_both(tmp_path):
    rng = np.random.default_rng(8)
    surface = relief(8)
    dem = seen(surface, (0.0, 0.0), 0.2, (0.003, 0.0), rng)
    place = rng.uniform([-39, -34], [39, 34], (400, 2))
    measured = surface.at(place) + rng.normal(0, 0.05, len(place))
    rows = [f"{x:.3f},{y:.3f},{z:.4f},0.05" for (x, y), z in zip(place, measured, strict=True)]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(["X, Y, Z, Sigma", *rows, ""]))
    sigma = Raster(grid=GRID, height_m=np.full(GRID.shape, 0.08))
    check = compare_with_reference(path, dem, sigma, apply_shift=True)
    assert check.kind == "checkpoints"
    assert check.statistics.count == 400
    assert check.statistics.coverage == 1.0
    assert abs(check.shift.up_m - 0.2) < 4 * check.shift.up_sigma_m < 0.05
    assert abs(check.shift.tilt_east - 0.003) < 4 * check.shift.tilt_east_sigma < 0.002
    assert abs(check.calibration.coverage["95"] - 0.95) < 0.04
    assert abs(check.calibration.coverage["68"] - 0.68) < 0.08


def test_errors_before_and_after_a_shift_are_those_of_the_same_places():
    """Two outliers at one end, which the tilt follows: left out of the raw errors alone, they add to the later RMS."""
    rng = np.random.default_rng(10)
    place, error = rng.uniform(-50, 50, (40, 2)), rng.normal(0, 0.06, 40)
    place[:2], error[:2] = 50.0, (-0.30, -0.33)
    shift = trend_of(error, place, np.zeros(2))
    assert shift.shifted_rms_m < shift.rms_m < np.sqrt(np.mean(error**2)) + 1e-9


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2,3\n", "line 1 reads '1,2,3', and is not a header of column names; give"),
        ("x,y\n1,2\n", "with the columns x, y, z"),
        ("x,y,z\n0,0,1\n0,1,high\n", "line 3 reads '0,1,high'; give finite numbers"),
        ("x,y,z\n0,0\n", "line 2 reads '0,0'"),
        ("x,y,z,sigma\n0,0,1,-1\n", "line 2 has a negative sigma"),
        ("x,y,z\n0,0,1\n0,1,-9999\n1,1,-32767\n", "line 3 has z = -9999, not a height on Earth (2 of 3 lines)"),
        ("x,y,z\n900,0,1\n901,0,1\n902,0,1\n", "0 of 3 places lie within the DEM"),
        ("", "line 1 reads ''"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_by_its_line(tmp_path, text, words):
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputFileError) as refused:
        compare_with_reference(path, seen(relief(1), (0, 0), 0.0, (0, 0), np.random.default_rng(1)))
    assert words in str(refused.value)
    assert str(path) in str(refused.value) or path.name in str(refused.value)


@pytest.mark.filterwarnings("error")
def test_single_filled_cells_tell_the_vertical_shift_alone_and_no_warning_of_numpy(tmp_path):
    """Cells without filled neighbours have no slope, and without one no horizontal shift is seen."""
    surface = relief(3)
    lattice = np.zeros(surface.grid.shape, dtype=bool)
    lattice[1::3, 1::3] = True
    dem = replace(surface, height_m=np.where(lattice, surface.height_m + 0.5, np.nan))
    surface.to_geotiff(tmp_path / "truth.tif")
    for apply_shift in (False, True):
        check = compare_with_reference(tmp_path / "truth.tif", dem, apply_shift=apply_shift)
        assert check.shift.east_m is None
        assert check.shift.up_m == pytest.approx(0.5, abs=0.05)


def test_a_reference_elsewhere_or_in_other_coordinates_is_refused(tmp_path):
    dem = seen(relief(1), (0, 0), 0.0, (0, 0), np.random.default_rng(1))
    far = replace(relief(1), grid=replace(relief(1).grid, west_m=5000.0))
    with pytest.raises(InputFileError, match="has no height within the DEM"):
        compare_with_reference(written(far, tmp_path / "far.tif"), dem)
    place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(500_000.0, 4_000_000.0, 0.0))
    mapped = replace(relief(1), grid=replace(relief(1).grid, georeference=place))
    with pytest.raises(InputFileError, match="has a CRS, and the DEM is in local metres"):
        compare_with_reference(written(mapped, tmp_path / "mapped.tif"), dem)
    placed = replace(dem, grid=replace(dem.grid, georeference=place))
    with pytest.raises(InputFileError, match="has no CRS, and the DEM has one"):
        compare_with_reference(written(relief(1), tmp_path / "local.tif"), placed)


@pytest.mark.parametrize(
    ("theirs", "words"),
    [
        ("EPSG:32616+5703", ""),
        ("EPSG:32616", ""),
        ("EPSG:32616+5773", "heights count from EGM96 geoid, and those of the DEM from North American Vertical Datum"),
        ("EPSG:32616", "heights count from the ellipsoid, and those of the DEM"),
    ],
)
def test_another_vertical_datum_is_told(tmp_path, caplog, theirs, words):
    place = Georeference(crs_wkt=CRS.from_user_input("EPSG:32616+5703").to_wkt(), origin_m=(5e5, 4e6, 0.0))
    dem = seen(relief(1), (0, 0), 0.0, (0, 0), np.random.default_rng(1))
    placed = replace(dem, grid=replace(dem.grid, georeference=place))
    reference = relief(1)
    crs = CRS.from_user_input(theirs).to_3d() if "ellipsoid" in words else CRS.from_user_input(theirs)
    there = replace(place, crs_wkt=crs.to_wkt())
    path = written(replace(reference, grid=replace(reference.grid, georeference=there)), tmp_path / "reference.tif")
    compare_with_reference(path, placed)
    assert words in caplog.text if words else "heights count from" not in caplog.text


@pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")
def test_a_reference_in_another_projection_is_the_same_ground(tmp_path):
    place = Georeference(crs_wkt=CRS.from_epsg(32616).to_wkt(), origin_m=(500_000.0, 4_000_000.0, 100.0))
    surface, rng = relief(2), np.random.default_rng(2)
    at = lambda raster: replace(raster, grid=replace(raster.grid, georeference=place))  # noqa: E731
    written(at(surface), tmp_path / "utm.tif")
    import rasterio
    from rasterio.warp import calculate_default_transform, reproject

    with rasterio.open(tmp_path / "utm.tif") as file:
        size = file.width, file.height
        transform, width, height = calculate_default_transform(file.crs, "EPSG:4326", *size, *file.bounds)
        profile = {**file.profile, "driver": "GTiff", "crs": "EPSG:4326", "transform": transform, "width": width}
        with rasterio.open(tmp_path / "degrees.tif", "w", **{**profile, "height": height}) as out:
            reproject(rasterio.band(file, 1), rasterio.band(out, 1), resampling=rasterio.warp.Resampling.bilinear)
    dem = at(seen(surface, (1.0, -2.0), 0.1, (0.0, 0.0), rng))
    shift = compare_with_reference(tmp_path / "degrees.tif", dem).shift
    np.testing.assert_allclose((shift.east_m, shift.north_m, shift.up_m), (1.0, -2.0, 0.1), atol=0.06)


def test_commands_compare_with_a_reference_and_refuse_one_that_does_not_fit_before_the_flight(survey, tmp_path):
    reference = written(survey.truth, tmp_path / "truth.tif")
    field = "terrain.fields=[{centre_m=[-40.0, 0.0], size_m=[40.0, 400.0], material='gravel'}]"
    gravel = "materials.gravel={model='constant_gamma', gamma_db=-10.0}"
    short = ["--set", "platform.length_m=6", "--set", field, "--set", gravel, "--no-report", "-q"]
    done = CliRunner().invoke(app, ["run", "hills", *short, "--reference", str(reference), "-o", str(tmp_path / "a")])
    assert done.exit_code == 0, done.output
    summary = json.loads((tmp_path / "a" / "summary.json").read_text())
    np.testing.assert_allclose(summary["reference"]["statistics"]["rms_m"], summary["lit_error"]["rms_m"], atol=1e-4)
    assert (tmp_path / "a" / "reference_error.tif").is_file()
    done = CliRunner().invoke(app, ["compare", str(tmp_path / "a"), "--reference", str(reference)])
    assert done.exit_code == 0, done.output
    assert "RMSE against reference" in done.output
    shown = " ".join(done.output.replace("│", " ").split())
    for words in (
        "no step of the reference is as high",
        "class: Slope of the reference (deg)",
        "class: Cover",
        "gravel",
    ):
        assert words in shown
    with pytest.raises(InputFileError, match="does not exist"):
        CliRunner().invoke(app, ["run", "hills", "--reference", str(tmp_path / "none.tif")], catch_exceptions=False)


def test_process_refuses_a_reference_that_does_not_fit_before_it_processes(tmp_path, monkeypatch):
    recording = tmp_path / "signals.nc"
    run(load_scenario("hills", {"platform.length_m": 4.0}), recordings={"signals": recording})
    (tmp_path / "elsewhere.csv").write_text("x,y,z\n9000,9000,1\n9001,9000,1\n9002,9000,1\n")

    def processed(*_args, **_kwargs):
        pytest.fail("it is processed first")

    monkeypatch.setattr("sionna_radar.survey.reprocessing.observe", processed)
    for reference, says in (("elsewhere.csv", "0 of 3 places lie within the DEM"), ("none.csv", "does not exist")):
        asked = ["process", str(recording), "--reference", str(tmp_path / reference), "-o", str(tmp_path / "out")]
        with pytest.raises(InputFileError, match=says):
            CliRunner().invoke(app, asked, catch_exceptions=False)
        assert not (tmp_path / "out").exists()


def test_a_cloud_that_is_a_surface_for_one_folder_and_single_points_for_another_is_printed_for_both(tmp_path, capsys):
    surface = relief(5)
    place = surface.grid.centres_m
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.header.scales = [0.001] * 3
    cloud.x, cloud.y, cloud.z = *place.T, surface.height_m.ravel()
    cloud.return_number = np.ones(len(place), dtype=np.uint8)
    cloud.write(tmp_path / "cloud.laz")
    checks = []
    for spacing_m in (0.2, 1.0):
        grid = Grid(
            west_m=-20.0, south_m=-20.0, spacing_m=spacing_m, columns=int(40 / spacing_m), rows=int(40 / spacing_m)
        )
        dem = Raster(grid=grid, height_m=surface.at(grid.centres_m).reshape(grid.shape))
        checks.append(compare_with_reference(tmp_path / "cloud.laz", dem))
    assert [check.kind for check in checks] == ["sparse cloud", "cloud"]
    print_references([tmp_path / "fine", tmp_path / "coarse"], checks)
    assert "class: Slope of the reference (deg)" in " ".join(capsys.readouterr().out.split())
