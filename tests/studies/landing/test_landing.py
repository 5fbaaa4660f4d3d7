"""Landing places: closed forms, a plain Monte Carlo, and the command on a small flight."""

import json
import shutil
import warnings

import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from pyproj import CRS
from scipy.optimize import brentq
from scipy.special import j0
from scipy.stats import ncx2, norm

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.inference.terrain.covariance import Covariance
from sionna_radar.inference.terrain.heights import Heights
from sionna_radar.studies.landing.correlation import DISTANCES_M, Correlation, expected_ground, shortest_correlation
from sionna_radar.studies.landing.results import landing_sites, read_ground
from sionna_radar.studies.landing.study import Ground, Limits, Obstacles, Places, assess, disc, error_fields

WHITE = Correlation(np.array([0.0, 1e-6]), np.array([1.0, 0.0]))
OPEN = Limits(footprint_m=5.0, slope_deg=89.0, roughness_m=1e3, obstacle_m=1e3, clearance_m=2.5)


def gaussian(length_m: float) -> Correlation:
    distance_m = np.linspace(0.0, 5 * length_m, 500)
    return Correlation(distance_m, np.exp(-((distance_m / length_m) ** 2)))


def ground(height_m, sigma_m, correlation=WHITE, spacing_m=1.0, **more) -> Ground:
    dem = Raster.from_array(np.asarray(height_m, dtype=float), spacing_m, west_m=0.0, south_m=0.0)
    return Ground(
        name="made", dem=dem, sigma_m=np.broadcast_to(sigma_m, dem.grid.shape), correlation=correlation, **more
    )


def tilted(degrees: float, size: int = 41) -> np.ndarray:
    return np.tan(np.deg2rad(degrees)) * np.tile(np.arange(float(size)), (size, 1))


def slope_variance(correlation: Correlation, sigma_m: float, radius_m: float = 2.5) -> float:
    """Variance of the least-squares slope along one axis, summed over all pairs of cells."""
    cell = disc(radius_m, 1.0).astype(float)
    weight = cell[:, 1] / np.sum(cell[:, 1] ** 2)
    away = np.hypot(*(cell[:, None] - cell[None]).transpose(2, 0, 1))
    return sigma_m**2 * weight @ np.interp(away, correlation.distance_m, correlation.value, right=0.0) @ weight


@pytest.mark.parametrize("correlation", [WHITE, gaussian(1.5), gaussian(6.0)], ids=["white", "short", "long"])
@pytest.mark.parametrize("degrees", [5.0, 7.0, 8.0])
def test_the_slope_of_a_tilted_plane_is_noncentral_chi_square(correlation, degrees):
    limits = Limits(**{**vars(OPEN), "slope_deg": 7.0})
    landing = assess(ground(tilted(degrees), 0.2, correlation), limits, draws=400)
    variance = slope_variance(correlation, 0.2)
    stated = ncx2.cdf(np.tan(np.deg2rad(7.0)) ** 2 / variance, 2, np.tan(np.deg2rad(degrees)) ** 2 / variance)
    # Places far apart are as good as further draws; those of long correlation are few.
    assert np.nanmean(landing.probability.height_m) == pytest.approx(stated, abs=0.02)
    assert landing.unknown == pytest.approx(1 - 37**2 / 41**2)


def test_a_plain_monte_carlo_agrees():
    """Correlated errors by Cholesky of all cells, planes by lstsq, one place after another."""
    rng, size, correlation = np.random.default_rng(3), 13, gaussian(2.0)
    height = tilted(4.0, size) + 0.05 * rng.standard_normal((size, size))
    sigma = 0.05 + 0.1 * np.tile(np.arange(size) / size, (size, 1))
    limits = Limits(footprint_m=4.0, slope_deg=7.0, roughness_m=0.2, obstacle_m=0.3, clearance_m=4.0)
    landing = assess(ground(height, sigma, correlation), limits, draws=2000)
    cell = np.argwhere(np.ones((size, size)))
    away = np.hypot(*(cell[:, None] - cell[None]).transpose(2, 0, 1))
    covariance = np.exp(-((away / 2.0) ** 2)) * np.outer(sigma, sigma)
    root = np.linalg.cholesky(covariance + 1e-8 * np.eye(len(cell)))
    fields = height.ravel() + (root @ rng.standard_normal((len(cell), 2000))).T
    for row, column in ((4, 4), (6, 6), (8, 5)):
        offset = cell - (row, column)
        distance = np.hypot(*offset.T)
        inside, ring = distance <= 2.0, (distance > 2.0) & (distance <= 4.0)
        design = np.column_stack([np.ones(len(cell)), offset])
        plane = np.linalg.lstsq(design[inside], fields[:, inside].T, rcond=None)[0]
        residual = fields - (design @ plane).T
        fit = np.hypot(plane[1], plane[2]) <= np.tan(np.deg2rad(7.0))
        fit &= (np.abs(residual[:, inside]).max(axis=1) <= 0.2) & (residual[:, ring].max(axis=1) <= 0.3)
        assert landing.probability.height_m[row, column] == pytest.approx(fit.mean(), abs=0.04)


@pytest.mark.parametrize("correlation", [gaussian(2.0), WHITE], ids=["gaussian", "white"])
def test_drawn_errors_have_the_correlation(correlation):
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=60, rows=50)
    drawn = np.stack(list(error_fields(correlation, grid, 0, range(60))))
    expected = np.interp([0.0, 2.0, 5.0], correlation.distance_m, correlation.value, right=0.0)
    for field in (drawn.real, drawn.imag):
        pairs = [np.mean(field[:, :, : 60 - lag] * field[:, :, lag:]) for lag in (0, 2, 5)]
        np.testing.assert_allclose(pairs, expected, atol=0.03)
    assert np.mean(drawn.real * drawn.imag) == pytest.approx(0.0, abs=0.02)


def test_a_step_is_rough_and_stands_in_the_way():
    height = np.zeros((41, 41))
    height[:, 21:] = 1.0
    limits = Limits(footprint_m=4.0, slope_deg=60.0, roughness_m=0.2, obstacle_m=0.5, clearance_m=8.0)
    landing = assess(ground(height, 1e-6), limits, draws=100, seed=1)
    row = landing.probability.height_m[20]
    # From the lower side the step begins 8 cells off; from above nothing rises.
    assert np.all(row[8:13] > 0.98)
    assert np.all(row[13:23] < 0.02)
    assert np.all(row[23:33] > 0.98)
    assert landing.sites[0].probability > 0.98
    east = np.array([site.east_m for site in landing.sites])
    north = np.array([site.north_m for site in landing.sites])
    apart = np.hypot(east[:, None] - east, north[:, None] - north) + 1e3 * np.eye(len(east))
    assert apart.min() >= 4.0


def test_the_other_side_of_a_step_comes_with_its_neighbours():
    chance = np.full((41, 41), 0.1)
    alone = assess(ground(np.zeros((41, 41)), 1e-6, other_side=chance, step_m=np.full((41, 41), 2.0)), OPEN, draws=100)
    assert np.nanmean(alone.probability.height_m) > 0.98  # nothing is too rough
    limits = Limits(**{**vars(OPEN), "roughness_m": 0.5})
    for correlation, low, high in ((WHITE, 0.05, 0.15), (gaussian(20.0), 0.6, 0.95)):
        made = ground(np.zeros((41, 41)), 1e-6, correlation, other_side=chance, step_m=np.full((41, 41), 2.0))
        # 21 independent cells: 0.9^21 = 0.11; all alike: either no cell, or all of them.
        assert low < np.nanmean(assess(made, limits, draws=200).probability.height_m) < high


def test_an_obstacle_is_in_the_way_with_its_probability():
    obstacles = Obstacles(
        place_m=np.array([[20.0, 20.0], [35.0, 35.0]]),
        top_m=np.array([5.0, 0.6]),
        sigma_m=np.array([0.1, 0.2]),
        radius_m=np.array([1.0, 0.0]),
        probability=np.array([0.7, 1.0]),
    )
    limits = Limits(footprint_m=4.0, clearance_m=4.0, obstacle_m=0.5)
    landing = assess(ground(np.zeros((41, 41)), 1e-6, obstacles=obstacles), limits, draws=100)
    fit = landing.probability.height_m
    clear = 101 / 102
    assert fit[20, 24] == pytest.approx(0.3 * clear)
    assert fit[20, 26] == pytest.approx(clear)
    assert fit[35, 33] == pytest.approx(norm.cdf(-0.1 / 0.2) * clear, rel=1e-6)


def test_empty_cells_are_unknown_and_the_check_counts_them():
    height = np.zeros((41, 41))
    height[10, 10] = np.nan
    truth = Raster.from_array(np.zeros((41, 41)), 1.0, west_m=0.0, south_m=0.0)
    limits = Limits(footprint_m=4.0, clearance_m=2.0)
    landing = assess(ground(height, 0.01, truth=truth), limits, draws=200)
    assert np.isnan(landing.probability.height_m[8:13, 10]).all()
    assert np.isfinite(landing.probability.height_m[13, 10])
    assert landing.check.precision == 1.0
    assert landing.check.fit == 37**2
    assert landing.check.recall == pytest.approx((37**2 - 13) / 37**2)


def test_probabilities_hold_for_ground_drawn_from_the_prior():
    """Ground and errors of one seed: of the places of each stated probability that fraction is fit."""
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=120, rows=120)
    pair = next(error_fields(gaussian(6.0), grid, 7, range(1)))
    noise = next(error_fields(gaussian(3.0), grid, 8, range(1))).real
    truth = Raster.from_array(pair.real * 0.35, 1.0, west_m=0.0, south_m=0.0)
    made = ground(truth.height_m - 0.1 * noise, 0.1, gaussian(3.0), truth=truth)
    # The map is the truth less independent errors: ground drawn about it is rougher than the truth, never smoother.
    landing = assess(made, Limits(footprint_m=6.0, roughness_m=0.4), draws=200)
    for low in landing.check.bins[3:]:
        assert low["places"] < 30 or low["fit"] > low["stated"] - 0.1
    assert landing.check.precision >= 0.98


def test_large_footprints_are_tried_at_every_few_cells():
    landing = assess(ground(np.zeros((60, 60)), 0.01), Limits(footprint_m=32.0, clearance_m=16.0), draws=100)
    assert landing.probability.grid.spacing_m == 4.0
    at = landing.probability.grid
    assert np.isin(at.x_m, np.arange(60)).all()


@pytest.mark.parametrize(
    ("limits", "field"),
    [
        ({"slope_deg": 0.0}, "slope_deg"),
        ({"slope_deg": 90.0}, "slope_deg"),
        ({"roughness_m": -1.0}, "roughness_m"),
        ({"clearance_m": float("nan")}, "clearance_m"),
        ({"obstacle_m": float("inf")}, "obstacle_m"),
        ({"footprint_m": 100.0}, "footprint_m"),
        ({"footprint_m": 1.0}, "footprint_m"),
        ({"clearance_m": 1e9}, "clearance_m: 1e\\+09 m about a place reach beyond the map of 20 x 20 m"),
    ],
)
def test_impossible_limits_are_refused(limits, field):
    with pytest.raises(ScenarioError, match=field):
        assess(ground(np.zeros((20, 20)), 0.1), Limits(**limits), draws=100)


def test_a_map_without_heights_is_refused():
    with pytest.raises(ScenarioError, match="no cell"):
        assess(ground(np.full((20, 20), np.nan), 0.1), draws=100)
    assert Places.of(Limits(), Grid(west_m=0, south_m=0, spacing_m=1, columns=20, rows=20), np.zeros((20, 20), bool))


def made_echoes(seed=1, noise_m=0.3, count=3000):
    """Echoes of ground of a known covariance, 2 m apart on average over 110 m, and the ground on cells of 1 m."""
    grid = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=110, rows=110)
    matern = Correlation(DISTANCES_M, Covariance(1.5, 15.0, 1.0).at(DISTANCES_M))
    truth = 2 * next(error_fields(matern, grid, seed, range(1))).real
    place = np.random.default_rng(seed).uniform(0, 109, (count, 2))
    raster = Raster.from_array(truth, 1.0, west_m=0.0, south_m=0.0)
    height = raster.at(place) + noise_m * np.random.default_rng(seed + 1).standard_normal(count)
    return truth, Heights.at_places(place, height, np.full(count, noise_m))


def test_the_stated_variance_sets_how_far_errors_of_a_surface_are_alike():
    """The longer the waves that echoes cannot tell, the smaller what is left: by Wiener both follow from sigma."""
    truth, heights = made_echoes()
    lengths = []
    for sigma_m in (0.03, 0.1, 0.3):
        height_m, sigma, correlation = expected_ground(truth, np.full(truth.shape, sigma_m), 1.0, heights, "smooth", 0)
        assert height_m is truth
        np.testing.assert_array_equal(sigma, sigma_m)
        assert correlation.value[0] == 1.0
        assert np.abs(correlation.value).max() == 1.0
        lengths.append(correlation.length_m)
    assert lengths[0] < lengths[1] < lengths[2] < DISTANCES_M[-1]


def test_of_a_prior_alone_errors_are_the_shortest_that_it_allows():
    """All waves of the ground below a length: their variance, its correlation, and any other error of it is longer."""
    prior = Covariance(1.5, 15.0, 1.0)
    wave = np.linspace(1e-3, 40.0, 400_001)
    power = prior.power(wave) * wave
    for cut in (0.3, 1.0):
        above = wave >= cut
        sigma_m = np.sqrt(np.trapezoid(power[above], wave[above]) / (2 * np.pi))
        found = shortest_correlation(prior, np.full((3, 3), sigma_m))
        for distance_m in (0.5, 1.0, 3.0):
            alike = np.trapezoid((power * j0(wave * distance_m))[above], wave[above]) / (2 * np.pi * sigma_m**2)
            assert np.interp(distance_m, found.distance_m, found.value) == pytest.approx(alike, abs=0.02)
        noise = brentq(lambda n, sigma_m=sigma_m: variance_by(wave, power, n) - sigma_m**2, 1e-9, 1e6)
        best = wave / (1 / prior.power(wave) + 1 / noise)
        for distance_m in (0.5, 1.0, 1.5):
            alike = np.trapezoid(best * j0(wave * distance_m), wave) / np.trapezoid(best, wave)
            assert np.interp(distance_m, found.distance_m, found.value) < alike


def variance_by(wave, power, noise):
    """Return the variance that white noise leaves of a ground."""
    return np.trapezoid(power / (1 + power / wave / noise), wave) / (2 * np.pi)


def test_the_noise_of_a_linear_map_is_filtered_by_what_it_states():
    from scipy.interpolate import griddata

    truth, heights = made_echoes()
    x, y = np.meshgrid(np.arange(110.0), np.arange(110.0))
    linear = griddata(heights.place_m, heights.height_m, (x, y))
    rms = float(np.sqrt(np.nanmean((linear - truth) ** 2)))
    height_m, sigma_m, correlation = expected_ground(linear, np.full(x.shape, rms), 1.0, heights, "linear", 0.0)
    inner = slice(10, 100), slice(10, 100)
    error = (height_m - truth)[inner]
    assert np.sqrt(np.mean(error**2)) < 0.85 * rms
    assert np.sqrt(np.mean(error**2)) == pytest.approx(np.mean(sigma_m[inner]), rel=0.1)
    three = np.mean(error[:, 3:] * error[:, :-3]) / np.mean(error**2)
    assert np.interp(3.0, correlation.distance_m, correlation.value) == pytest.approx(three, abs=0.2)


def test_an_isolated_hump_of_a_linear_map_stands():
    truth, heights = made_echoes()
    made_m = truth.copy()
    made_m[50:53, 50:53] += 6.0
    height_m, sigma_m, _ = expected_ground(made_m, np.full(made_m.shape, 0.3), 1.0, heights, "linear", 0.0)
    np.testing.assert_array_equal(height_m[50:53, 50:53], made_m[50:53, 50:53])
    np.testing.assert_array_equal(sigma_m[50:53, 50:53], 0.3)
    assert np.median(sigma_m) < 0.3


def write_obstacles(path, crs=None, layer="obstacles", place_m=(0.0, 0.0), **changed):
    values = {"top_m": [9.0], "sigma_m": [0.1], "radius_m": [0.5], "probability": [0.9]} | changed
    place = np.array(shapely.to_wkb([shapely.Point(*place_m)]), dtype=object)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # without a CRS
        pyogrio.raw.write(
            str(path),
            place,
            [np.array(value) for value in values.values()],
            np.array(list(values), dtype=object),
            layer=layer,
            driver="GPKG",
            geometry_type="Point",
            crs=crs,
        )


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    from sionna_radar import load_scenario, run, write_survey
    from sionna_radar.report.files.contents import Report

    folder = tmp_path_factory.mktemp("flight") / "hills"
    changes = {"platform.length_m": 12.0, "dem.method": "smooth", "tracing.paths_per_pulse": 128}
    write_survey(run(load_scenario("hills", changes | {"terrain.spacing_m": 2.0})), folder, report=Report.NONE)
    return folder


@pytest.fixture
def copied(survey, tmp_path):
    return shutil.copytree(survey, tmp_path / "hills")


def test_the_command_writes_raster_sites_numbers_and_page(cli, copied, tmp_path):
    best = landing_sites(copied, draws=100).sites[0]
    write_obstacles(copied / "obstacles.gpkg", place_m=(best.east_m, best.north_m), top_m=[99.0])
    said = cli("landing", copied, "-o", tmp_path / "out", "--draws", 100, "--clearance", "3").stdout
    assert "Landing sites" in said
    assert "stated fit at 99%" in said
    numbers = json.loads((tmp_path / "out/landing.json").read_text())
    assert numbers["limits"]["clearance_m"] == 3.0
    assert numbers["obstacles"] == 1
    assert numbers["check"]["precision"] >= 0.98
    with rasterio.open(tmp_path / "out/fit_probability.tif") as file, rasterio.open(copied / "dem.tif") as dem:
        fit = file.read(1)
        assert file.transform == dem.transform
        assert np.nanmax(fit) > 0.98
        row, column = dem.index(best.east_m, best.north_m)
    assert best.probability > 0.98
    assert 0 < fit[row, column] <= 0.1
    sites = json.loads((tmp_path / "out/sites.geojson").read_text())["features"]
    assert [site["properties"]["probability"] for site in sites] == [site["probability"] for site in numbers["sites"]]
    assert {"slope_value", "roughness_sigma", "clearance_probability"} <= set(sites[0]["properties"])
    assert "Where to land: hills" in (tmp_path / "out/report.html").read_text()


def repeat_first_point(path):
    header, first, *others = path.read_text().splitlines()
    path.write_text("\n".join([header, *[first] * (1 + len(others))]))


def test_a_processed_folder_and_one_without_truth_are_read(survey, tmp_path, cli):
    folder = shutil.copytree(survey, tmp_path / "processed")
    (folder / "truth.tif").unlink()
    (folder / "scenario.toml").unlink()
    (folder / "settings.toml").write_text('[radar.antenna]\nbeamwidth_deg = 2.0\n[dem]\nmethod = "smooth"\n')
    cli("landing", folder, "-o", tmp_path / "out", "--draws", 100)
    assert json.loads((tmp_path / "out/landing.json").read_text())["check"] is None


def test_a_processed_recording_of_a_scenario_is_read_as_its_flight(tmp_path):
    from sionna_radar import load_scenario, process, run, write_survey
    from sionna_radar.report.files.contents import Report
    from sionna_radar.report.survey.processed import processed_document

    changes = {"platform.length_m": 8.0, "dem.method": "linear", "terrain.spacing_m": 2.0, "seed": 4}
    flown = run(load_scenario("ridges", changes), recordings={"signals": tmp_path / "signals.nc"})
    write_survey(flown, tmp_path / "flown", report=Report.NONE)
    processed_document().write(process(tmp_path / "signals.nc"), tmp_path / "processed")
    one, other = (landing_sites(tmp_path / name, draws=30).probability for name in ("flown", "processed"))
    np.testing.assert_array_equal(one.height_m, other.height_m)


def as_fused(folder, **prior):
    """Make a survey's folder one of `fuse`, which holds no points but the terrain prior."""
    (folder / "points.csv").unlink(missing_ok=True)
    (folder / "scenario.toml").unlink(missing_ok=True)
    known = {"smoothness": 2.0, "length_m": 50.0, "variance_m2": 20.0, "microrelief_m": 0.0}
    (folder / "fuse.json").write_text(json.dumps({"terrain_prior": known | prior}))


def test_a_fused_map_is_read_with_its_prior(copied, tmp_path, cli):
    as_fused(copied)
    cli("landing", copied, "-o", tmp_path / "out", "--draws", 100, "--clearance", "3")
    check = json.loads((tmp_path / "out/landing.json").read_text())["check"]
    assert check["stated"] > 100
    assert check["precision"] >= 0.98
    lengths = []
    for smoothness in (0.8, 3.0):
        as_fused(copied, smoothness=smoothness)
        lengths.append(read_ground(copied, Limits(clearance_m=3.0)).correlation.length_m)
    assert lengths[0] < lengths[1]


def scale_sigmas(path, factor, cells=slice(None)):
    """Multiply the first known standard deviations of a raster."""
    with rasterio.open(path) as file:
        sigma_m, profile = file.read(1), file.profile
    sigma_m.flat[np.flatnonzero(sigma_m > 0)[cells]] *= factor
    with rasterio.open(path, "w", **profile) as file:
        file.write(sigma_m, 1)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "fuse.json").write_text("[]"), "holds no terrain_prior"),
        (lambda folder: (folder / "fuse.json").write_text("{"), "holds no terrain_prior"),
        (lambda folder: as_fused(folder, length_m=-1.0), "no positive numbers"),
        (lambda folder: as_fused(folder, length_m=float("nan")), "no positive numbers"),
        (lambda folder: as_fused(folder, slope=1.0), "unexpected keyword"),
        (lambda folder: (folder / "dem.tif").unlink(), "holds no dem.tif"),
        (lambda folder: (folder / "points.csv").unlink(), "--points csv"),
        (lambda folder: (folder / "points.csv").write_text("pulse,echo\n1,2\n"), "no table of points"),
        (lambda folder: (folder / "points.csv").write_text(""), "no table of points"),
        (lambda folder: (folder / "scenario.toml").unlink(), "no scenario.toml"),
        (lambda folder: (folder / "scenario.toml").write_text("[dem]\nmethod = 3\n"), "dem.method"),
        (lambda folder: (folder / "scenario.toml").write_text(""), "terrain"),
        (lambda folder: repeat_first_point(folder / "points.csv"), "echoes from 1 places, too few"),
        (lambda folder: (folder / "dem_sigma.tif").write_bytes(b"II*\0"), "cannot be read"),
        (lambda folder: scale_sigmas(folder / "dem_sigma.tif", -1, [0]), "that are zero or negative"),
        (lambda folder: scale_sigmas(folder / "dem_sigma.tif", 0), "that are zero or negative"),
        (lambda folder: scale_sigmas(folder / "dem_sigma.tif", 0, [7]), "that are zero or negative"),
        (lambda folder: write_obstacles(folder / "obstacles.gpkg", crs="EPSG:32633"), "WGS 84 / UTM zone 33N"),
        (lambda folder: write_obstacles(folder / "obstacles.gpkg", layer="others"), "no layer 'obstacles'"),
        (lambda folder: write_obstacles(folder / "obstacles.gpkg", probability=[1.5]), "no obstacle has"),
        (lambda folder: write_obstacles(folder / "obstacles.gpkg", top_m=[np.nan]), "no obstacle has"),
        (lambda folder: write_obstacles(folder / "obstacles.gpkg", sigma_m=[-1.0]), "no obstacle has"),
        (lambda folder: (folder / "obstacles.gpkg").write_bytes(b"SQLite format 3\0" + bytes(80)), "not a GeoJSON"),
    ],
)  # fmt: skip
def test_damaged_folders_are_refused_and_nothing_is_written(cli, copied, tmp_path, damage, message):
    damage(copied)
    assert message in cli("landing", copied, "-o", tmp_path / "out", code=2).stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("draws", [0, 10**9])
def test_draws_are_neither_none_nor_endless(survey, draws):
    with pytest.raises(ScenarioError, match=f"draws: must be at least 1 and at most 100000, not {draws}"):
        landing_sites(survey, draws=draws)


@pytest.mark.parametrize("option", ["--footprint=-1", "--slope=0", "--footprint=500", "--roughness=nan"])
def test_impossible_options_are_refused(cli, survey, tmp_path, option):
    cli("landing", survey, "-o", tmp_path / "out", option, code=2)
    assert not (tmp_path / "out").exists()


def test_obstacles_of_local_metres_may_name_an_engineering_crs(copied):
    local = CRS.from_wkt('LOCAL_CS["Undefined Cartesian SRS",UNIT["metre",1]]')
    write_obstacles(copied / "obstacles.gpkg", crs=local.to_wkt())
    assert len(read_ground(copied, Limits()).obstacles.top_m) == 1
