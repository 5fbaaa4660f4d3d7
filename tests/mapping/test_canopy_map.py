"""Ground and plants from one flight: over maize, over bare hills, and as files."""

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio

from sionna_radar import ScenarioError, load_scenario, prepare, process, read_survey, run, write_survey
from sionna_radar.accuracy.canopy import check_canopy
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.canopy.point_classes import classified
from sionna_radar.mapping.mapper import BOTH, GROUND_ALONE, PLANTS_ALONE, CanopyMap, Estimate
from sionna_radar.mapping.points import Points

FLIGHT = {"platform.length_m": 14.0, "platform.start_m": [-12.0, 0.0]}
MAX = "dem.method_parameters.max_plants_m"
SMALL = {**FLIGHT, "dem.method": "canopy", MAX: 2.0}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Return where the signals over the field are recorded."""
    return tmp_path_factory.mktemp("maize") / "maize.nc"


@pytest.fixture(scope="module")
def maize(recording):
    """Fly over the edge of a field of maize, 1.1 m high."""
    return run(load_scenario("maize", SMALL), recordings={"signals": recording})


def test_ground_and_plants_of_maize(maize):
    """The ground is known to a few centimetres under the plants, their height to 0.2 m, and bare soil is bare."""
    check = maize.canopy_check
    under = check.ground["60 to 90 %"]
    assert under.count > 80
    assert under.rms_m < 0.08
    assert under.coverage["95"] > 0.9
    assert check.bare.rms_m < 0.03
    assert check.height.rms_m < 0.2
    assert check.missed < 0.02
    assert check.invented < 0.005
    assert check.f1 > 0.95


def test_one_surface_lies_among_the_plants(maize):
    """Of the same echoes a map of one surface errs by most of their height."""
    one = run(load_scenario("maize", {**FLIGHT, "dem.method": "linear"}))
    planted = maize.prepared.world.scene.vegetation.fraction_over(one.dem.grid) > 0.6
    error_m = one.error.height_m[planted & one.error.filled]
    assert np.sqrt(np.mean(error_m**2)) > 5 * maize.canopy_check.ground["60 to 90 %"].rms_m


def test_the_map_of_the_top(maize):
    """`dem.surface = "top"` maps the tops of the same survey, and is held against them."""
    top = run(load_scenario("maize", {**SMALL, "dem.surface": "top"}))
    np.testing.assert_array_equal(top.dem.height_m, maize.canopy.top.height_m)
    plants_m = maize.prepared.world.scene.vegetation.mean_over(top.dem.grid)
    np.testing.assert_allclose(top.truth.height_m, maize.truth.height_m + np.nan_to_num(plants_m))
    assert top.lit_error.rms_m < 0.25
    assert top.canopy_check.ground["60 to 90 %"] == maize.canopy_check.ground["60 to 90 %"]


def test_files_of_ground_and_plants(maize, tmp_path):
    """Rasters, classes of points and the summary; points come back as they were."""
    write_survey(maize, tmp_path / "maize")
    for name in ("top", "top_sigma", "height", "height_sigma"):
        with rasterio.open(tmp_path / "maize" / f"canopy_{name}.tif") as file:
            assert np.isfinite(file.read(1)).any()
    with rasterio.open(tmp_path / "maize" / "cover.tif") as file:
        assert set(np.unique(file.read(1)[np.isfinite(file.read(1))])) <= {GROUND_ALONE, PLANTS_ALONE, BOTH}
    summary = json.loads((tmp_path / "maize" / "summary.json").read_text())
    assert summary["canopy_check"]["f1"] == pytest.approx(maize.canopy_check.f1)
    again = read_survey(tmp_path / "maize").points
    np.testing.assert_allclose(again.ground_probability, maize.points.ground_probability, atol=1e-4)


def test_bare_hills_stay_bare():
    """No plants are invented; the map is that of whole echoes: steps of two thirds of a cell put it 1.3 cm higher."""
    scan = {"incidence_deg": 20.0, "half_swath_deg": 20.0, "rotation_rpm": 300.0}
    radar = {"radar.bandwidth_hz": 1e9, "radar.chirp_rate_hz": 1500.0, "radar.scan": scan}
    hills = radar | {"platform.length_m": 8.0, "platform.altitude_m": 20.0, "terrain.height_m": 2.0}
    canopy = {"dem.method": "canopy", "dem.method_parameters.max_plants_m": 2.0}
    both, one = (run(load_scenario("hills", hills | method)) for method in (canopy, {"dem.method": "refined"}))
    assert both.canopy_check.invented < 0.005
    assert both.lit_error.rms_m < 1.3 * one.lit_error.rms_m + 0.005
    assert abs(both.lit_error.mean_m - one.lit_error.mean_m) < 0.004
    assert np.all(both.points.ground_probability > 0.5)


@pytest.mark.parametrize("keys", [{"radar.bandwidth_hz": 2e6}, {"radar.bandwidth_hz": 1e8, MAX: 0.4}, {MAX: 0.2}])
def test_plants_that_a_range_cell_hides_are_not_looked_for(keys, tmp_path):
    few = {"platform.length_m": 3.0, "radar.bandwidth_hz": 2e8}
    with pytest.raises(ScenarioError, match=r"dem\.method: 'canopy' is not supported with range cells longer than"):
        load_scenario("maize", few | {"dem.method": "canopy"} | keys)


def test_of_a_recording_with_long_range_cells_no_plants_are_mapped(tmp_path):
    long = {"platform.length_m": 3.0, "radar.bandwidth_hz": 1e7, "dem.method": "linear"}
    run(load_scenario("maize", long), recordings={"signals": tmp_path / "long.nc"})
    with pytest.raises(ScenarioError, match=r"dem\.method: 'canopy' "):
        process(tmp_path / "long.nc", {"dem.method": "canopy"})


def test_too_few_pulses_map_nothing():
    """A flight of a few pulses has no map, and no plants."""
    survey = run(load_scenario("maize", {**SMALL, "platform.length_m": 0.2}))
    assert not survey.dem.filled.any()
    assert survey.canopy_check is None


def test_plants_taller_than_those_looked_for_are_warned_of():
    """Maize of 1.1 m, where plants of at most half a metre are looked for."""
    flight = {**SMALL, "platform.length_m": 8.0, "dem.method_parameters.max_plants_m": 0.5}
    warnings = run(load_scenario("maize", flight)).warnings
    assert any("reach dem.method_parameters.max_plants_m = 0.5 m" in warning for warning in warnings)


def test_the_top_needs_a_map_that_knows_it():
    """Other methods know one surface."""
    with pytest.raises(ScenarioError, match=r"dem\.surface.*'canopy'"):
        load_scenario("hills", {"dem.surface": "top"})


GRID = Grid(west_m=0.0, south_m=0.0, spacing_m=1.0, columns=20, rows=10)
PLANTED = np.arange(20)[None] < 10 + np.zeros((10, 1))


def layer(values, quantity="height"):
    return Raster(grid=GRID, height_m=np.broadcast_to(values, GRID.shape).astype(float), quantity=quantity)


def canopy_of(plants, height_m, ground_m=0.0):
    """Return a map of plants and of the ground under them."""
    high = np.where(plants > 0.5, height_m, 0.0)
    sigma = layer(0.1, "standard deviation of the height")
    return CanopyMap(
        ground=layer(ground_m),
        ground_sigma=sigma,
        top=layer(ground_m + high),
        top_sigma=sigma,
        height=layer(high, "height difference"),
        height_sigma=sigma,
        plants=layer(plants, "probability"),
        cover=layer(1.0, "mask"),
    )


def points_at(height_m, east_m, north_m=5.0):
    count = len(height_m)
    position = np.column_stack([east_m, np.broadcast_to(north_m, count), height_m])
    origin = position + np.array([0.0, 0.0, 30.0])
    ones = np.ones(count)
    return Points(
        pulse=np.arange(count),
        number=np.zeros(count, dtype=int),
        position_m=position,
        origin_m=origin,
        range_m=30.0 * ones,
        range_sigma_m=0.05 * ones,
        power=ones,
        echo_snr_db=30.0 * ones,
    )


class PlantsKnownWorse:
    """A map of plants on the western half, of known ground and uncertain tops."""

    profiles = "unused"

    def __call__(self, inputs):
        """Return the ground, its error, and plants whose tops err more."""
        canopy = canopy_of(PLANTED, 2.0)
        top_sigma = layer(np.where(PLANTED > 0.5, 0.4, 0.1), "standard deviation of the height")
        return Estimate(dem=canopy.ground, sigma=canopy.ground_sigma, canopy=replace(canopy, top_sigma=top_sigma))


@pytest.mark.parametrize(("surface", "kept"), [("ground", 200), ("top", 100)])
def test_cells_are_left_out_by_the_error_of_the_surface_that_is_mapped(surface, kept):
    mapper = prepare(load_scenario("maize", SMALL)).mapper
    mapper = replace(mapper, grid=GRID, method=PlantsKnownWorse(), surface=surface, min_confidence_m=0.2)
    points = points_at(np.zeros(4), np.arange(4.0), np.array([5.0, 8.0, 5.0, 8.0]))
    estimate = mapper.map(points, None, lambda pulse: pulse)
    assert estimate.dem.filled.sum() == estimate.sigma.filled.sum() == kept


@pytest.mark.parametrize("surface", ["ground", "top"])
def test_an_error_of_all_heights_is_one_of_ground_and_top_and_not_of_the_plants_between(surface):
    """Rays straight down: a range error of 0.3 m behind rain is one of the height."""
    mapper = prepare(load_scenario("maize", SMALL)).mapper
    mapper = replace(mapper, grid=GRID, method=PlantsKnownWorse(), surface=surface)
    place = np.array([1.0, 3.0, 5.0, 15.0]), np.array([5.0, 8.0, 5.0, 8.0])
    clear = points_at(np.array([0.0, 0.2, 2.0, 0.0]), *place)
    rain = replace(clear, shared_sigma_m=np.full(4, 0.3))
    alone, shared = (mapper.map(points, None, lambda pulse: pulse) for points in (clear, rain))
    for before, after in (
        (alone.sigma, shared.sigma),
        (alone.canopy.ground_sigma, shared.canopy.ground_sigma),
        (alone.canopy.top_sigma, shared.canopy.top_sigma),
    ):
        np.testing.assert_allclose(after.height_m**2 - before.height_m**2, 0.09)
    np.testing.assert_array_equal(shared.canopy.height_sigma.height_m, alone.canopy.height_sigma.height_m)
    # Points and map err alike.
    of_ground = [classified(points, made).ground_probability for points, made in ((clear, alone), (rain, shared))]
    np.testing.assert_allclose(*of_ground)


def test_points_are_of_the_ground_or_of_plants():
    """By their height: on the ground, half-way up, on the top; on bare ground and beyond the map all are of it."""
    estimate = Estimate(dem=layer(0.0), canopy=canopy_of(np.where(PLANTED, 1.0, 0.0), 2.0))
    points = points_at(np.array([0.0, 1.0, 2.0, 0.0, 1.0]), np.array([5.0, 5.0, 5.0, 15.0, 50.0]))
    probability = classified(points, estimate).ground_probability
    assert probability[0] > 0.8
    assert np.all(probability[1:3] < 1e-3)
    assert np.all(probability[3:] == 1.0)
    assert classified(points, Estimate(dem=layer(0.0))).ground_probability is None


def test_a_map_is_held_against_both_surfaces():
    """Errors of known size and place are found, by share of cover; cells beside plants are neither."""
    share = np.where(PLANTED, 0.5, 0.0)
    found = np.where(np.arange(20)[None] < 9, 0.9, 0.1) + np.zeros((10, 1))
    found[:2, 15:] = 0.9
    canopy = canopy_of(found, 1.7, 0.2)
    points = points_at(np.array([0.0, 0.0, 1.0, 1.0]), np.full(4, 5.0))
    points = points.__class__(**{**vars(points), "ground_probability": np.array([0.9, 0.9, 0.9, 0.1])})
    truth = layer(0.0), np.where(PLANTED, 1.5, np.nan), share
    of_plants = np.array([False, False, True, True])
    lit = np.ones(GRID.shape, dtype=bool)
    check = check_canopy(canopy, truth, lit, (points, of_plants), 2.0)
    assert (check.ground["up to 60 %"].count, check.ground["up to 60 %"].coverage) == (100, {"68": 0.0, "95": 0.0})
    assert check.ground["up to 60 %"].mean_m == pytest.approx(0.2)
    assert check.ground["up to 60 %"].rms_m == pytest.approx(0.2)
    assert check.ground["over 90 %"].count == 0
    assert check.bare.count == 80
    assert check.invented == pytest.approx(10 / 80)
    assert check.height.mean_m == pytest.approx(0.2)
    assert check.height.count == 90
    assert (check.precision, check.recall) == (pytest.approx(2 / 3), 1.0)
    assert check.f1 == pytest.approx(0.8)
    none = points.__class__(**{**vars(points), "ground_probability": np.zeros(4)})
    assert check_canopy(canopy, truth, lit, (none, of_plants), 2.0).f1 == 0.0
    check = check_canopy(canopy, truth, lit, (none, np.ones(4, dtype=bool)), 2.0)
    assert np.isnan([check.precision, check.recall, check.f1]).all()


def test_a_recording_is_mapped_as_the_flight_was(maize, recording):
    """Beat signals of the flight give the same ground, plants and classes, bit for bit."""
    again = process(recording)
    for name in ("ground", "top", "height", "plants", "cover"):
        np.testing.assert_array_equal(getattr(again.canopy, name).height_m, getattr(maize.canopy, name).height_m)
    np.testing.assert_array_equal(again.points.ground_probability, maize.points.ground_probability)
    assert again.points.sha256() == maize.points.sha256()
