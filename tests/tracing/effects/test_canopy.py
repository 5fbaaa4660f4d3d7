"""Vegetation as a volume: the water-cloud model, the height that a pulse reads, borders, and randomness by pulse."""

import numpy as np
import pytest
from scipy.integrate import quad

from elevation_files import from_origin, write_heights
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.raster import Grid
from sionna_radar.scenario import parse_scenario
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import FIRST_OBSTACLE, VEGETATION, Paths

EVERYWHERE = [[-100, -100], [290, -100], [290, 100], [-100, 100]]
HEIGHT_M, EXTINCTION_DB_PER_M, BACKSCATTER_DB_PER_M = 6.0, 0.5, -25.0
KAPPA, ETA = np.log(10) / 10 * EXTINCTION_DB_PER_M, 10 ** (BACKSCATTER_DB_PER_M / 10)
ALTITUDE_M = 60.0
DENSE = {"extinction_db_per_m": 1.0, "backscatter_db_per_m": -20.0}


def over_stand(incidence_deg, polygon=EVERYWHERE, **changes):
    """A level stand seen by a narrow beam that stands still on the platform."""
    stand = {
        "polygon_m": polygon,
        "height_m": HEIGHT_M,
        "extinction_db_per_m": EXTINCTION_DB_PER_M,
        "backscatter_db_per_m": BACKSCATTER_DB_PER_M,
    }
    return parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [600.0, 600.0]},
            "platform": {"altitude_m": ALTITUDE_M, "speed_mps": 10.0, "length_m": 6.0},
            "radar": {
                "snr_db": 40.0,
                "samples_per_chirp": 2048,
                "antenna": {"beamwidth_deg": 1.0},
                "scan": {"mode": "fixed", "incidence_deg": incidence_deg},
            },
            "vegetation": [stand],
        }
        | changes
    )


def traced(scenario, pulses=60, step=1):
    prepared = prepare(scenario)
    block = prepared.flight.pulses(np.arange(0, pulses, step))
    return prepared, block, prepared.sensor_inputs().tracer().trace(block)


@pytest.mark.parametrize("speckle", ["per_pulse", "persistent"])
@pytest.mark.parametrize("incidence_deg", [0.0, 45.0, 70.0])
def test_a_homogeneous_stand_is_a_water_cloud(speckle, incidence_deg):
    """Attema and Ulaby 1978, with the spreading loss of each depth, which they take for that of the ground."""
    prepared, _, paths = traced(over_stand(incidence_deg, tracing={"speckle": speckle}))
    cosine = np.cos(np.deg2rad(incidence_deg))
    ground_m = ALTITUDE_M / cosine
    power, plants = np.abs(paths.gain) ** 2, paths.surface == VEGETATION

    def returned(height_m, weight=1.0):
        range_m = (ALTITUDE_M - height_m) / cosine
        return weight * ETA * np.exp(-2 * KAPPA * (HEIGHT_M - height_m) / cosine) * (ground_m / range_m) ** 2

    volume = quad(returned, 0.0, HEIGHT_M)[0]
    sigma0 = prepared.world.scene.materials["ground"].co_polar.sigma0(np.array([np.deg2rad(incidence_deg)]))[0]
    passed = np.exp(-2 * KAPPA * HEIGHT_M / cosine)
    assert power[plants].sum() / power[~plants].sum() == pytest.approx(volume / (sigma0 * passed), rel=0.02)
    middle = quad(lambda z: returned(z, z), 0.0, HEIGHT_M)[0] / volume
    height_m = paths.hit_m[plants, 2]
    # Where scatterers stay, so do the places of the plants before them.
    places = len(np.unique(np.round(height_m, 2)))
    scatter_m = 4 * height_m.std() / np.sqrt(places if speckle == "persistent" else len(height_m))
    assert np.average(height_m, weights=power[plants]) == pytest.approx(middle, abs=scatter_m + 0.02)
    assert -0.1 < height_m.min() < 0.2 < HEIGHT_M - 0.2 < height_m.max() < HEIGHT_M + 0.1


def test_denser_plants_are_read_nearer_to_their_tops():
    """The mean height over the ground of an opaque stand is that of one extinction length under its top."""
    dense = {"polygon_m": EVERYWHERE, "height_m": HEIGHT_M, "extinction_db_per_m": 6.0, "backscatter_db_per_m": -10.0}
    _, _, paths = traced(over_stand(0.0, vegetation=[dense]))
    power, plants = np.abs(paths.gain) ** 2, paths.surface == VEGETATION
    read_m = np.average(paths.hit_m[plants, 2], weights=power[plants])
    assert read_m == pytest.approx(HEIGHT_M - 1 / (2 * np.log(10) / 10 * 6.0), abs=0.05)


def test_beside_a_stand_nothing_changes():
    """Paths that pass no plants are those of the scene without them; those through a border pass a part of it."""
    half = [[0, -290], [290, -290], [290, 290], [0, 290]]
    beam = {"platform": {"altitude_m": 60.0, "speed_mps": 10.0, "length_m": 60.0, "start_m": [-90.0, 0.0]}}
    _, _, bare = traced(over_stand(45.0, vegetation=[], **beam), pulses=2000, step=10)
    _, _, half_bare = traced(over_stand(45.0, half, **beam), pulses=2000, step=10)
    ground = half_bare.rows(np.flatnonzero(half_bare.surface >= 0))
    np.testing.assert_array_equal(ground.hit_m, bare.hit_m)
    loss_db = -20 * np.log10(np.abs(ground.gain) / np.abs(bare.gain))
    whole_db = 2 * EXTINCTION_DB_PER_M * HEIGHT_M / np.cos(np.deg2rad(45.0))
    deep_m = bare.hit_m[:, 0]
    assert np.all(loss_db[deep_m < -0.5] < 1e-4)
    well_inside = deep_m > HEIGHT_M + 1.0
    np.testing.assert_allclose(np.median(loss_db[well_inside]), whole_db, rtol=0.03)
    # A ray down to a place x behind the border enters through the edge, at the height x: it passes x of depth.
    between = (deep_m > 1.0) & (deep_m < HEIGHT_M - 1.0)
    along_m = deep_m[between] / np.cos(np.deg2rad(45.0))
    # Side lobes look elsewhere.
    assert np.quantile(np.abs(loss_db[between] - 2 * EXTINCTION_DB_PER_M * along_m), 0.99) < 0.9


@pytest.mark.parametrize(("height_m", "deep_m"), [(0.0, 6.0), (2.0, 4.0), (6.5, 0.0)])
def test_plants_dim_a_target_among_them(height_m, deep_m):
    """By what stands above it, both ways along the line of sight."""

    def level_db(**changes):
        target = {"position_m": [0.0, 0.0], "height_m": height_m, "rcs_dbsm": 20.0}
        platform = {"altitude_m": 60.0, "speed_mps": 10.0, "length_m": 6.0, "start_m": [-60.0, 0.0]}
        _, _, paths = traced(over_stand(45.0, targets=[target], platform=platform, **changes), pulses=1)
        assert np.count_nonzero(paths.surface == FIRST_OBSTACLE) == 1
        return 20 * np.log10(np.abs(paths.gain[paths.surface == FIRST_OBSTACLE][0]))

    slant = np.sqrt(60.0**2 + (60.0 - height_m) ** 2) / (60.0 - height_m)
    loss_db = level_db(vegetation=[]) - level_db()
    np.testing.assert_allclose(loss_db, 2 * EXTINCTION_DB_PER_M * deep_m * slant, rtol=0.02, atol=1e-9)


def test_plants_dim_the_flash_of_calm_water_under_them():
    def level_db(**changes):
        water = {"model": "constant_gamma", "gamma_db": -60.0, "specular": True, "rms_height_m": 0.0}
        materials = {"ground": water | {"medium": {"kind": "water", "temperature_c": 10.0}}}
        _, _, paths = traced(over_stand(0.0, materials=materials, **changes), pulses=1)
        return 20 * np.log10(np.abs(paths.gain).max())

    loss_db = level_db(vegetation=[]) - level_db()
    np.testing.assert_allclose(loss_db, 2 * EXTINCTION_DB_PER_M * HEIGHT_M, rtol=0.02)


def test_a_pulse_draws_the_same_in_any_block():
    scenario = over_stand(45.0)
    prepared, block, whole = traced(scenario, 40)
    tracer = prepared.sensor_inputs().tracer()
    parts = [tracer.trace(block.rows(np.arange(a, b))) for a, b in ((0, 7), (7, 40))]
    again = Paths.concatenate(parts)
    np.testing.assert_array_equal(again.gain, whole.gain)
    np.testing.assert_array_equal(again.delay_s, whole.delay_s)


def test_a_survey_says_how_far_it_reads_the_tops():
    dense = {"polygon_m": EVERYWHERE, "height_m": 6.0, "extinction_db_per_m": 4.0, "backscatter_db_per_m": -10.0}
    platform = {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 12.0}
    scenario = over_stand(45.0, vegetation=[dense], platform=platform, radar={"snr_db": 30.0})
    reading = run(scenario).canopy_reading
    assert reading.count > 100
    assert reading.height_m == 6.0
    assert 0.8 < reading.share < 1.05
    assert run(over_stand(45.0, vegetation=[], platform=platform, radar={"snr_db": 30.0})).canopy_reading is None


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"polygon": [[900, 900], [950, 900], [950, 950]]}, "holds no plants over the terrain"),
        ({"polygon": [[0, 0], [0.01, 0], [0.01, 0.01]]}, "holds no plants"),
        ({"polygon": [[-1e15, 900], [1e15, 900], [0, 910]]}, "encloses no area"),
        ({"radar": {"snr_db": 30.0, "antenna": {"polarization": "RHCP"}}}, "linear co-polar"),
        ({"vegetation": [{"polygon_m": EVERYWHERE, "height_m": 70.0, **DENSE}]}, "10.0 m under the tops"),
    ],
)
def test_stands_that_cannot_be_are_refused(changes, says):
    with pytest.raises(ScenarioError, match=says):
        prepare(over_stand(45.0, **changes))


def test_a_vast_stand_is_no_coarser_than_a_small_one():
    """Only what the survey sees of it takes cells; a stand beyond that is none that is missing."""
    beyond = {"polygon_m": [[280, 280], [290, 280], [290, 290]], "height_m": 2.0, **DENSE}
    vast = {"polygon_m": [[-1e15, -5], [1e15, -5], [1e15, 5], [-1e15, 5]], "height_m": 3.0, **DENSE}
    stand = prepare(over_stand(0.0, vegetation=[vast, beyond])).world.scene.vegetation
    assert stand.grid.spacing_m == 0.25
    assert stand.highest_m == 3.0


@pytest.mark.parametrize("none", [np.inf, 3.4e38])
def test_a_raster_with_a_value_for_none_that_it_does_not_declare_is_refused(tmp_path, none):
    heights = np.full((60, 60), none, dtype=np.float32)
    file = write_heights(tmp_path / "chm.tif", heights, from_origin(-60.0, 60.0, 2.0, 2.0), None)
    with pytest.raises(InputFileError, match="declare the value for none"):
        prepare(over_stand(0.0, vegetation=[{"path": str(file), **DENSE}]))


def test_heights_come_from_a_raster(tmp_path, caplog):
    """A canopy-height model in metres over the local frame: half of it 4 m high, the rest lower than plants are."""
    file, place = tmp_path / "chm.tif", from_origin(-60.0, 60.0, 2.0, 2.0)
    heights = np.full((60, 60), 0.2, dtype=np.float32)
    heights[:, 30:] = 4.0
    heights[0, :] = -9999.0
    write_heights(file, heights, place, None, nodata=-9999.0)
    stand = {"path": str(file), "extinction_db_per_m": 1.0, "backscatter_db_per_m": -20.0}
    vegetation = prepare(over_stand(0.0, vegetation=[stand])).world.scene.vegetation
    grid = Grid(west_m=-50.0, south_m=-50.0, spacing_m=10.0, columns=12, rows=12)
    found = vegetation.over(grid)
    east = np.tile(grid.x_m, (12, 1))
    north = np.tile(grid.y_m[:, None], (1, 12))
    inside = (np.abs(east) < 60) & (np.abs(north) < 58)
    assert np.all(found[inside & (east > 1)] == 4.0)
    assert np.all(np.isnan(found[(east < -1) | ~inside & (east < 60) & (north < 58)]))
    assert vegetation.highest_m == 4.0
    assert "taken for that" not in caplog.text
    heights[40, 35:40] = 250.0
    write_heights(file, heights, place, None, nodata=-9999.0)
    assert prepare(over_stand(0.0, vegetation=[stand])).world.scene.vegetation.highest_m == 100.0
    assert "cells are higher than 100 m, and taken for that" in caplog.text
    with pytest.raises(ScenarioError, match="either height_m or path"):
        over_stand(0.0, vegetation=[stand | {"height_m": 2.0}])
