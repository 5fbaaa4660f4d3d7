"""The lidar as built over ground, edges and plants: energy, width on slopes, penetration, returns, and files."""

import laspy
import numpy as np
import pytest

from corners import plate
from flights import make_pulses
from sionna_radar import run
from sionna_radar.foundation.raster import Grid
from sionna_radar.report.survey.products import write_survey
from sionna_radar.scenario.lidar import LidarTable
from sionna_radar.scenario.weather import WeatherTable
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.vegetation import PlantCover
from sionna_radar.signal.build import waveform_receiver
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.sensors.lidar_as_built import LEAVES, LidarAsBuilt, beam_offsets
from sionna_radar.tracing.paths import VEGETATION, VOLUME
from surveys import hills
from worlds import make_surface

BEAM = {"divergence_mrad": 3.0, "second_divergence_mrad": 1.0}


def flat(x, y):
    return 0 * x


def lidar(height=flat, *, more=(), rays=64, plants=None, weather=None, **keys) -> LidarAsBuilt:
    receiver = waveform_receiver(
        LidarTable(model="as_built", wavelength_nm=905, rays=rays, **keys), WeatherTable(**(weather or {}))
    )
    caster = RayCaster([make_surface(height, size_m=300.0), *more])
    noise_m = keys.get("range_noise_m", 0.0)
    return LidarAsBuilt(
        caster,
        receiver,
        np.full(2, 0.3),
        rays=rays,
        seed=4,
        range_noise_m=noise_m,
        plants=plants,
        leaf_reflectivity=0.4,
    )


def canopy(extinction_per_m: float, height_m: float = 2.0) -> PlantCover:
    grid = Grid(west_m=-100.0, south_m=-100.0, spacing_m=1.0, columns=201, rows=201)
    return PlantCover(
        grid=grid,
        stand=np.zeros(grid.shape, dtype=np.int64),
        plant_m=np.full(grid.shape, height_m),
        top_m=np.full(grid.shape, height_m),
        bottom_m=np.full(grid.shape, -np.inf),
        extinction_per_m=np.zeros(1),
        backscatter_per_m=np.zeros(1),
        light_extinction_per_m=np.array([extinction_per_m]),
    )


def test_rays_are_those_of_a_gaussian_beam_and_agree_with_the_subrays_that_helios_publishes():
    """HELIOS++'s `EnergyModelsTest.h`: 4 W, rings whose 1 / e^2 radius is 0.3, the power of each subray of a ring."""
    offset = beam_offsets((3e-3, 1e-3), 64, np.linspace(0, 6, 50)).reshape(-1, 2)
    np.testing.assert_allclose(offset.std(axis=0), [3e-3 / 4, 1e-3 / 4], rtol=0.01)
    np.testing.assert_allclose(np.abs(offset.mean(axis=0)), 0, atol=2e-5)
    radius = np.hypot(*beam_offsets((0.6, 0.6), 4000, np.zeros(1))[0].T)
    edge = np.array([0.0, *(0.15 * (np.arange(5) + 0.5) / 4.5)])
    share = np.histogram(radius, edge)[0] / 4000
    published = np.array([0.02461531, 0.03192447, 0.02965419, 0.02622347, 0.0211937]) * [1, 6, 12, 18, 25] / 4
    np.testing.assert_allclose(share, published, atol=4e-4)


def test_level_ground_returns_the_lidar_equation_and_a_slope_stretches_the_echo():
    """Over R w tan(a) / 4, one standard deviation of a beam of the full width w at 1 / e^2, in range."""
    slope_deg = 40.0
    slope = np.tan(np.deg2rad(slope_deg))
    for angle_deg, height in ((0.0, flat), (slope_deg, lambda x, y: slope * x)):
        sensor = lidar(height, **BEAM)
        light = sensor.trace(make_pulses(40, position_m=(0.0, 0.0, 80.0)))
        level = 0.3 * np.cos(np.deg2rad(angle_deg)) * sensor.receiver.white_echo(np.array([80.0]))[0]
        echo = light.reflectivity * light.cosine * sensor.receiver.white_echo(light.range_m) / 64
        assert echo.sum() / 40 == pytest.approx(level, rel=5e-3)
        # The long axis of the beam lies across the track, up the slope; the waveform has the pulse beside it.
        beam_m = 80 * 3e-3 / 4 * np.tan(np.deg2rad(angle_deg))
        assert light.range_m.std() == pytest.approx(beam_m, rel=0.02, abs=1e-3)
        wave = sensor.receiver.waveforms(light.row, light.range_m, echo, 40).sum(axis=0)
        range_m = sensor.receiver.range_m
        wide_m = np.sqrt(np.average((range_m - np.average(range_m, weights=wave)) ** 2, weights=wave))
        pulse_m = 299_792_458.0 * 5e-9 / 2.3548 / 2
        assert wide_m == pytest.approx(np.hypot(pulse_m, beam_m), rel=0.005)


@pytest.mark.parametrize("incidence_deg", [0.0, 50.0])
def test_the_share_that_reaches_the_ground_under_a_canopy_is_that_of_beer_and_lambert(incidence_deg):
    """Light returns by the way it came: exp(-k h / cos), not its square; and a leaf has the mean cosine 2 / 3."""
    rays, count = 16, 300
    sensor = lidar(plants=canopy(0.6), rays=rays, divergence_mrad=1.0)
    light = sensor.trace(make_pulses(count, incidence_deg=incidence_deg))
    leaf = light.kind == LEAVES
    expected = np.exp(-0.6 * 2.0 / np.cos(np.deg2rad(incidence_deg)))
    sigma = np.sqrt(expected * (1 - expected) / (rays * count))
    assert 1 - leaf.mean() == pytest.approx(expected, abs=4 * sigma)
    assert light.cosine[leaf].mean() == pytest.approx(2 / 3, abs=4 * np.sqrt(1 / 18 / leaf.sum()))
    # Depths of the leaves that are met, from the top: an exponential up to the ground.
    depth = 2.0 - (50.0 - light.range_m[leaf] * np.cos(np.deg2rad(incidence_deg)))
    rate = 0.6 / np.cos(np.deg2rad(incidence_deg))
    mean = 1 / rate - 2.0 * np.exp(-2 * rate) / -np.expm1(-2 * rate)
    assert depth.mean() == pytest.approx(mean, abs=0.04)
    # A beam narrower than a leaf meets either: so many of its pulses have the ground as their last return.
    single = lidar(plants=canopy(0.6), rays=1, returns="last").observe(make_pulses(count, incidence_deg=incidence_deg))
    of_ground = count - np.sum(single.paths.surface == VEGETATION)
    assert of_ground / count == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / count))


def test_first_and_last_returns_over_an_edge_and_over_plants():
    roof = plate("roof", [[-50, -50, 8], [0, -50, 8], [0, 50, 8], [-50, 50, 8]], "ground")
    seen = lidar(more=(roof,), returns="all").observe(make_pulses(20)).echoes
    first, last = seen.range_m[seen.number == 0], seen.range_m[seen.number == 1]
    assert len(first) == len(last) == 20
    np.testing.assert_allclose(first, 42.0, atol=0.1)
    np.testing.assert_allclose(last, 50.0, atol=0.1)
    trees = lidar(plants=canopy(0.15, 8.0), returns="all").observe(make_pulses(50))
    np.testing.assert_allclose(trees.echoes.range_m[np.append(np.diff(trees.echoes.pulse) > 0, True)], 50.0, atol=0.3)
    assert np.mean(np.bincount(trees.echoes.pulse)) > 2
    assert np.sum(trees.paths.surface == VEGETATION) > 50


def test_dark_ground_sunlight_and_fog_cost_returns():
    """Ground of 30 % at 120 m; with a clear range of 70 m at 10 % it is detected to 121 m."""
    pulses = make_pulses(200, position_m=(0.0, 0.0, 120.0))

    def share(sensor: LidarAsBuilt) -> float:
        return np.sum(np.abs(sensor.observe(pulses).echoes.range_m - 120) < 1) / 200

    weak = {"clear_range_m": 70.0}
    assert share(lidar(**weak)) == pytest.approx(0.5, abs=0.25)
    assert share(lidar(clear_range_m=120.0)) == 1.0
    assert share(lidar(clear_range_m=120.0, weather={"dust_visibility_m": 150.0})) == 0.0
    wide = {"clear_range_m": 70.0, "field_of_view_mrad": 60.0}
    assert share(lidar(**wide, sun=0.0)) > share(lidar(**wide)) + 0.1
    fog = lidar(weather={"fog_visibility_m": 60.0}).observe(pulses)
    assert np.sum(fog.paths.surface == VOLUME) == len(fog.echoes) == 200
    rain = lidar(weather={"rain_rate_mm_per_h": 50.0}, returns="all", least_reflectivity=1e-4).observe(pulses)
    assert np.sum(np.abs(rain.echoes.range_m - 120) < 1) == 200
    assert 0 < np.sum(rain.paths.surface == VOLUME) < 200


def test_no_drop_is_seen_behind_the_ground_and_a_stated_range_noise_adds_to_that_of_the_signal():
    low = make_pulses(200, position_m=(0.0, 0.0, 4.0))
    heavy = {"weather": {"rain_rate_mm_per_h": 100.0}, "least_reflectivity": 1e-5, "returns": "all"}
    assert np.all(lidar(**heavy).observe(low).echoes.range_m < 4.2)
    over = lidar(**heavy).observe(make_pulses(200)).echoes.range_m
    assert np.sum((over > 4.2) & (over < 20.0)) > 20
    clear, rough = (lidar(range_noise_m=noise_m).observe(make_pulses(200)).echoes for noise_m in (0.0, 0.3))
    assert np.std(rough.range_m - clear.range_m) == pytest.approx(0.3, rel=0.2)
    np.testing.assert_allclose(rough.range_sigma_m, np.hypot(clear.range_sigma_m, 0.3))


KEYS = {"model": "as_built", "wavelength_nm": 905, "returns": "all", "rays": 16}


def test_returns_do_not_depend_on_blocks_or_the_measured_pose():
    sensor = prepare(hills(sensor="lidar", lidar=KEYS, weather={"rain_rate_mm_per_h": 20.0})).build_sensor()
    pulses = prepare(hills(sensor="lidar")).flight.pulses(np.arange(12))
    whole = sensor.observe(pulses)
    parts = [sensor.observe(pulses.rows(np.arange(*bounds))) for bounds in ((0, 5), (5, 12))]
    for name in ("pulse", "number", "range_m", "range_sigma_m", "power"):
        together = np.concatenate([getattr(part.echoes, name) for part in parts])
        np.testing.assert_array_equal(getattr(whole.echoes, name), together)


def test_a_survey_over_plants_numbers_its_returns_in_the_file(tmp_path):
    field = {"polygon_m": [[-80, -80], [80, -80], [80, 80], [-80, 80]], "height_m": 6.0}
    field |= {"extinction_db_per_m": 5.0, "backscatter_db_per_m": -20.0, "light_extinction_db_per_m": 1.0}
    survey = run(hills(sensor="lidar", lidar=KEYS, vegetation=[field]))
    write_survey(survey, tmp_path / "out")
    las = laspy.read(tmp_path / "out" / "points.laz")
    number, of = np.asarray(las.return_number), np.asarray(las.number_of_returns)
    assert of.max() > 1
    assert np.all(number <= of)
    pulse, count = np.unique(np.asarray(las["pulse"]), return_counts=True)
    np.testing.assert_array_equal(count[np.searchsorted(pulse, np.asarray(las["pulse"]))], of)
    assert not any("does not model" in warning for warning in survey.warnings)
    # The last return is nearer to the ground than the first.
    ends = [run(hills(sensor="lidar", lidar={**KEYS, "returns": end}, vegetation=[field])) for end in ("first", "last")]
    assert ends[1].lit_error.mean_m < ends[0].lit_error.mean_m - 1.0
