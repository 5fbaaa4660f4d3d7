"""Calm water: a flash straight below, nothing aside, and a map that says so."""

from functools import cache

import numpy as np
import pytest
from matplotlib.path import Path as Outline

from sionna_radar import ScenarioError, load_scenario, prepare, run
from sionna_radar.surfaces.rough_surface import fresnel_reflection

C = 299_792_458.0
POND = [[-30.0, -20.0], [20.0, -25.0], [30.0, 15.0], [-20.0, 20.0]]
CALM = {
    "model": "small_perturbation",
    "medium": {"kind": "water", "temperature_c": 10.0},
    "rms_height_m": 1e-5,
    "correlation_length_m": 0.01,
    "specular": True,
}
OVER_POND = {
    "terrain.cover": [{"polygon_m": POND, "material": "water"}],
    "materials.water": CALM,
    "buildings": [],
    "radar.snr_db": 5.0,
    "tracing.paths_per_pulse": 128,
}


def surveyed(**changes):
    return run(load_scenario("buildings", {**OVER_POND, **{k.replace("__", "."): v for k, v in changes.items()}}))


@cache
def by_radar(method):
    return surveyed(dem__method=method)


def on_pond(survey):
    grid = survey.dem.grid
    return Outline(POND).contains_points(grid.centres_m).reshape(grid.shape)


def test_the_flash_is_the_radars_image_and_nothing_comes_back_aside():
    nadir = {"radar.scan.incidence_deg": 0.0, "radar.scan.half_swath_deg": 30.0, "platform.start_m": [-40.0, 0.0]}
    prepared = prepare(load_scenario("buildings", {**OVER_POND, **nadir, "platform.length_m": 60.0}))
    tracer, pulses = prepared.sensor_inputs().tracer(), prepared.flight.pulses(np.arange(len(prepared)))
    paths = tracer.trace(pulses)
    position, antenna = pulses.true.position_m, prepared.instrument.antenna
    over = Outline(POND).contains_points(position[:, :2], radius=-3.0)
    # Pulses straight above the pond, whose axis is within a tenth of a degree of the plumb line.
    down = -pulses.true.boresight[:, 2]
    straight = int(np.flatnonzero(over)[np.argmax(down[over])])
    wavelength = C / 77e9
    water = prepared.world.scene.materials["water"].mirror.permittivity
    reflection = abs(fresnel_reflection(water, np.ones(1), "H")[0])
    plumb = (pulses.true.R_world_antenna[straight].T @ [0.0, 0.0, -1.0])[None]
    image = antenna.gain(plumb)[0] * reflection * wavelength / (4 * np.pi * 2 * position[straight, 2])
    own = paths.rows(np.flatnonzero(paths.pulse == pulses.index[straight]))
    flash = own.rows(np.array([np.argmax(np.abs(own.gain))]))
    assert abs(20 * np.log10(abs(flash.gain[0]) / image)) < 0.3
    assert flash.delay_s[0] == pytest.approx(2 * position[straight, 2] / C, rel=1e-9)
    # The diffuse echo of the same water, 20 to 30 deg aside, is far under the noise after pulse compression.
    noise = prepared.receiver.noise_power_w / prepared.receiver.transmit_power_w / 1024
    aside = over & (down < np.cos(np.deg2rad(20.0)))
    names = np.array([surface.material for surface in prepared.world.scene.surfaces])
    on_water = (paths.surface >= 0) & (names[paths.surface] == "water") & (paths.incidence_rad > np.deg2rad(10.0))
    diffuse = np.abs(paths.gain[on_water & np.isin(paths.pulse, pulses.index[aside])]) ** 2
    assert aside.sum() > 10
    assert diffuse.sum() / aside.sum() < noise


@pytest.mark.parametrize("method", ["linear", "smooth"])
def test_the_map_does_not_bridge_the_pond(method):
    survey = by_radar(method)
    pond = on_pond(survey) & survey.lit
    assert survey.no_echo[pond].mean() > 0.6
    assert (survey.dem.filled & pond).sum() < 0.3 * pond.sum()
    # Nearly nothing outside of the pond is silent, and no silent cell is filled.
    assert (survey.no_echo & ~on_pond(survey)).sum() < 0.02 * survey.lit.sum()
    assert not (survey.no_echo & survey.dem.filled).any()


def test_dry_ground_has_no_silent_cell():
    survey = surveyed(**{"terrain.cover": []}, dem__method="linear", radar__snr_db=30.0, platform__length_m=20.0)
    assert not survey.no_echo.any()


def test_light_is_mirrored_away_too():
    light = {
        "sensor": "lidar",
        "dem.method": "linear",
        "lidar.wavelength_nm": 905,
        "lidar.reflectivities": {"water": 0},
    }
    survey = surveyed(**light)
    pond = on_pond(survey) & survey.lit
    assert survey.no_echo[pond].mean() > 0.6
    radar = by_radar("linear")
    # Where light fails the radar fails too, but for the shores that its beam reaches.
    assert (radar.no_echo & survey.no_echo)[pond].sum() > 0.8 * min(radar.no_echo.sum(), survey.no_echo.sum())


def test_reflectivities_are_of_materials():
    with pytest.raises(ScenarioError, match=r"lidar.reflectivities.lake"):
        load_scenario("buildings", {"lidar.wavelength_nm": 905, "lidar.reflectivities": {"lake": 0.0}})


def test_noise_does_not_count_from_ground_that_returns_nothing():
    """Aside of its flash: noise 5 dB under such an echo is none."""
    calm = {**OVER_POND, "terrain.material": "water", "terrain.cover": []}
    with pytest.raises(ScenarioError, match=r"radar\.snr_db: counts from the echo of 'water' at 45 deg"):
        prepare(load_scenario("buildings", calm))
    powers = {"radar.snr_db": None, "radar.transmit_power_dbm": 10.0, "radar.noise_figure_db": 12.0}
    assert prepare(load_scenario("buildings", calm | powers)).receiver.noise_power_w > 0
