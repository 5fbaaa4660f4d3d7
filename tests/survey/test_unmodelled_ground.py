"""Warnings of ground unlike what a map is made for: plants on it, roofs beyond the expected ground, few far errors."""

from dataclasses import replace

import numpy as np
import pytest

from sionna_radar import Raster, load_scenario, prepare, run
from sionna_radar.accuracy.truth import compare_dem
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.mapper import Estimate
from sionna_radar.survey.unmodelled_ground import expected_ground_warnings, plant_warnings
from sionna_radar.survey.warnings import interval_warnings

FLIGHT = {"platform.length_m": 16.0, "platform.start_m": [-8.0, 0.0], "tracing.paths_per_pulse": 128}
HOUSE = {"position_m": [12.0, 3.0], "size_m": [14.0, 12.0, 9.0]}
STAND = {"height_m": 2.5, "extinction_db_per_m": 3.0, "backscatter_db_per_m": -6.0}
FIELD = {"polygon_m": [[-4.0, -15.0], [4.0, -15.0], [4.0, 15.0], [-4.0, 15.0]], **STAND}


@pytest.mark.parametrize(("tolerance_m", "warned"), [(5.0, True), (12.0, False)])
def test_roofs_beyond_the_expected_ground_are_warned_of(tolerance_m, warned):
    over = {"buildings": [HOUSE], "radar.scan.incidence_deg": 20.0, "terrain.kind": "flat"}
    scenario = load_scenario("buildings", FLIGHT | over | {"processing.expected_ground.tolerance_m": tolerance_m})
    found = list(expected_ground_warnings(prepare(scenario)))
    assert bool(found) == warned
    assert all("beyond processing.expected_ground, up to 9 m above it" in text for text in found)


def test_ground_below_the_expected_is_warned_of_and_nothing_where_none_is_expected():
    scenario = load_scenario("hills", FLIGHT | {"processing.expected_ground.tolerance_m": 0.2})
    (only,) = expected_ground_warnings(prepare(scenario))
    assert "of the beams the surface lies beyond processing.expected_ground" in only
    assert list(expected_ground_warnings(prepare(load_scenario("hills", FLIGHT)))) == []


def test_a_survey_tells_of_roofs_that_it_was_told_not_to_expect():
    over = {"buildings": [HOUSE], "radar.scan.incidence_deg": 20.0, "processing.expected_ground.tolerance_m": 5.0}
    warnings = run(load_scenario("buildings", FLIGHT | over)).warnings
    assert any("beyond processing.expected_ground" in warning for warning in warnings)


@pytest.fixture(scope="module")
def field():
    """Prepare a flight over a stand of plants, 2.5 m high."""
    return prepare(load_scenario("maize", FLIGHT | {"vegetation": [FIELD], "dem.method": "linear"}))


@pytest.mark.parametrize(("above_m", "sigma_m", "warned"), [(1.0, 0.2, True), (1.0, 0.6, False), (0.1, 0.2, False)])
def test_plants_that_a_map_takes_for_ground_are_warned_of(field, above_m, sigma_m, warned):
    truth, grid = field.truth.ground, field.mapper.grid
    planted = field.world.scene.vegetation.fraction_over(grid) > 0
    dem = replace(truth, height_m=truth.height_m + np.where(planted, above_m, 0.01))
    estimate = Estimate(dem=dem, sigma=replace(truth, height_m=np.full(grid.shape, sigma_m)))
    compared = compare_dem(dem, truth, np.ones(grid.shape, dtype=bool), None)
    found = list(plant_warnings(field, compared, estimate))
    assert bool(found) == warned
    assert all(f"is {above_m:g} m RMS off the ground" in text for text in found)
    assert list(plant_warnings(field, compared, Estimate(dem=dem))) == []


def test_a_survey_among_plants_warns_of_them_and_over_bare_ground_of_nothing():
    over = FLIGHT | {"vegetation": [FIELD], "dem.method": "refined"}
    assert any("over [[vegetation]]" in warning for warning in run(load_scenario("maize", over)).warnings)
    assert run(load_scenario("maize", over | {"vegetation": []})).warnings == ()


GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=40, rows=30)


@pytest.mark.parametrize(("roof_m", "warned"), [(0.0, False), (1.0, False), (6.0, True)])
def test_few_cells_that_err_by_far_are_warned_of(roof_m, warned):
    """Of 1,200 cells 48 miss a roof: intervals of 95 % hold some 91 %, errors are 0.3, 0.36 and 1.24 m RMS."""
    error_m = np.random.default_rng(3).normal(0, 0.3, GRID.shape)
    error_m[:6, :8] -= roof_m
    truth = Raster(grid=GRID, height_m=np.zeros(GRID.shape))
    compared = compare_dem(Raster(grid=GRID, height_m=error_m), truth, np.ones(GRID.shape, dtype=bool), None)
    found = list(interval_warnings(compared, Raster(grid=GRID, height_m=np.full(GRID.shape, 0.3))))
    assert bool(found) == warned
    assert all("`dem_sigma.tif` states 0.3 m" in text for text in found)
