"""The echo of what fills the air, as the radar sees it: its power in every cell, its end at the ground, its motion."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import kstest

from beams import make_antenna, make_chirp
from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.execution.execution import Execution
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.equation import near_field_m, two_way_beam_sr
from sionna_radar.scenario import load_scenario
from sionna_radar.signal.beat import synthesise
from sionna_radar.survey.chain import run
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.atmosphere import Atmosphere
from sionna_radar.tracing.effects.volume_echo import VolumeEcho
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.paths import VOLUME
from sionna_radar.weather.conditions import NonUniformVolume, UniformVolume, Weather
from sionna_radar.weather.drops import marshall_palmer
from sionna_radar.weather.path import rain_clutter_power
from sionna_radar.weather.rain import RainCell, echo_speeds
from sionna_radar.weather.snow import snow_reflectivity_per_m
from sionna_radar.weather.validity import Precipitation
from worlds import make_scene, make_surface

C = 299_792_458.0
CARRIER_HZ = 77e9
RATE = 30.0
NOTHING = points_at([])


@pytest.fixture(scope="module")
def weather() -> Weather:
    return Weather(carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=RATE)


def closed_form(edges_m, weather, antenna: Antenna, loss_db_per_km: float):
    return rain_clutter_power(
        edges_m,
        reflectivity_per_m=weather.rain_reflectivity_per_m,
        two_way_beam_sr=two_way_beam_sr(antenna),
        peak_gain=antenna.peak_gain,
        wavelength_m=C / CARRIER_HZ,
        specific_attenuation_db_per_km=loss_db_per_km,
    )


def test_the_beam_integral_is_that_of_the_pattern():
    antenna = make_antenna(6.0, 9.0)
    angle = np.linspace(-np.pi / 2, np.pi / 2, 1501)
    azimuth, elevation = np.meshgrid(angle, angle, indexing="ij")
    direction = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    gain = antenna.gain(np.stack(direction, axis=-1).reshape(-1, 3)).reshape(azimuth.shape)
    sphere = np.trapezoid(np.trapezoid((gain / antenna.peak_gain) ** 2 * np.cos(elevation), angle, axis=1), angle)
    assert two_way_beam_sr(antenna) == pytest.approx(sphere, rel=1e-4)
    assert two_way_beam_sr(antenna) == pytest.approx(
        np.pi * np.prod(antenna.beamwidths_rad) / (8 * np.log(2)), rel=0.05
    )


@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_the_spectrum_holds_the_closed_form_in_every_cell(pencil, weather, sampling):
    """Level beam, radar at rest, no ground: no Doppler. 400 chirps, cells joined ten by ten."""
    chirp = make_chirp(sampling=sampling, samples=1024 if sampling == "real" else 512)
    pulses = make_pulses(400, incidence_deg=90.0, velocity_mps=(0.0, 0.0, 0.0))
    atmosphere = Atmosphere(weather, pencil, chirp, 5)
    beat = synthesise(atmosphere.through(atmosphere.with_volume(NOTHING, pulses), pulses), pulses, chirp)
    analyser = SpectrumAnalyser(chirp, "hann", 1)
    # A cell of the spectrum sums to its power times the window's noise bandwidth.
    bandwidth = chirp.samples * np.sum(analyser.window**2)
    found = analyser.power(beat)[:, 50:450].mean(axis=0).reshape(-1, 10).sum(axis=1) / bandwidth
    edges = (np.arange(50, 451, 10) - 0.5) * chirp.range_resolution_m
    loss = float(atmosphere.attenuation_db_per_km(pulses.true)[0])
    expected = closed_form(edges, weather, pencil, loss)
    # The window makes 10 cells some 6 independent ones: 2 % in 400 chirps.
    np.testing.assert_allclose(found, expected, rtol=4.5 * 0.02)
    assert found.sum() == pytest.approx(expected.sum(), rel=0.01)
    assert np.mean(found / expected) == pytest.approx(1.0, abs=4 * 0.02 / np.sqrt(40))


def test_a_cells_echo_is_gaussian_and_new_in_each_pulse(pencil, weather):
    rain = VolumeEcho(UniformVolume(weather), pencil, make_chirp(), 3)
    paths = rain.trace(make_pulses(3000), NOTHING)
    gain = paths.gain.reshape(3000, -1)
    cell = 300
    assert kstest(np.abs(gain[:, cell]) ** 2 / rain.cell_power[cell], "expon").pvalue > 0.01
    assert kstest(np.angle(gain[:, cell]) / (2 * np.pi) + 0.5, "uniform").pvalue > 0.01
    neighbour = np.mean(gain[:, cell] * np.conj(gain[:, cell + 1])) / rain.cell_power[cell]
    after = np.mean(gain[:-1, cell] * np.conj(gain[1:, cell])) / rain.cell_power[cell]
    assert max(abs(neighbour), abs(after)) < 4 / np.sqrt(3000)


@pytest.mark.parametrize("sweep", ["up", "down"])
@pytest.mark.parametrize("rate_hz", [100.0, 10_000.0])
def test_powers_are_exponential_however_far_drops_shift_their_echoes(pencil, weather, sweep, rate_hz):
    """In chirps of 10 ms fall speeds spread the echoes of a cell over ten others."""
    chirp = make_chirp(rate_hz=rate_hz, sweep=sweep, sampling="iq", samples=512)
    pulses = make_pulses(400, incidence_deg=30.0, velocity_mps=(0.0, 0.0, 0.0))
    rain = VolumeEcho(UniformVolume(weather), pencil, chirp, 5)
    tones = rain.trace(pulses, NOTHING)
    tones = dataclasses.replace(tones, gain=tones.gain * tones.delay_s * C / 2)
    analyser = SpectrumAnalyser(chirp, "hann", 2)
    power = analyser.power(synthesise(tones, pulses, chirp))[:, 160:860]
    power /= power.mean(axis=0)
    for probability in (1e-2, 1e-4):
        expected = probability * power.size
        # Zero padding and the window leave two bins of five independent.
        assert np.count_nonzero(power > -np.log(probability)) == pytest.approx(
            expected, abs=4 * np.sqrt(2.5 * expected)
        )
    # What is expected of the tones where they are, whatever their powers: the same in all bins of all pulses.
    beat_cell = (tones.delay_s * C / 2 + chirp.doppler_range_m(tones.range_rate_mps)) / chirp.range_resolution_m
    offset = (np.arange(100, 400) + 0.3)[:, None] - beat_cell[tones.pulse == pulses.index[7]]
    response = np.sinc(offset) + np.sinc(offset - 1) / 2 + np.sinc(offset + 1) / 2
    through_hann = np.sum(response**2, axis=1)
    np.testing.assert_allclose(through_hann, 1.5, rtol=1e-3)


APERTURES = {
    "uniform": (lambda x: np.ones_like(x), 0.3),
    "cosine": (lambda x: np.cos(np.pi * x), 0.3),
    "squared cosine": (lambda x: np.cos(np.pi * x) ** 2, 0.3),
    "Gaussian": (lambda x: np.exp(-((6 * x) ** 2)), 0.01),
}


@pytest.mark.parametrize("name", APERTURES)
def test_the_law_near_the_antenna_is_that_of_diffraction(name):
    """The integral of S^2 over a plane before a square aperture, in Fresnel's approximation, is that of a side squared.

    In wavelengths; the far field has the angular spectrum U of a normalised field, and G0^2 Omega_2 from it.
    """
    taper, within_db = APERTURES[name]
    side, extent, samples = 60.0, 4000.0, 2**16
    x = (np.arange(samples) - samples / 2) * extent / samples
    field = np.where(np.abs(x) < side / 2, taper(np.clip(x / side, -0.5, 0.5)), 0.0)
    field /= np.sqrt(np.sum(field**2) * extent / samples)
    spectrum, frequency = np.fft.fft(field), np.fft.fftfreq(samples, extent / samples)
    far = np.sum(np.abs(spectrum * extent / samples) ** 4) / extent
    # The gain of both sides is 4 pi times that of the spectrum's power: r_n = (G0 / 4 pi)^2 Omega_2 = far^2.
    near = far**2
    for place in (2.0, 3.0, 5.0, 8.0):
        turn = np.exp(-1j * np.pi * place * near * frequency**2)
        there = np.sum(np.abs(np.fft.ifft(spectrum * turn)) ** 4) * extent / samples
        over_far = (there / (far / (place * near))) ** 2
        assert abs(10 * np.log10(over_far * (1 + place**-2))) < within_db


def test_close_to_the_antenna_the_echo_is_that_of_a_gaussian_beam(pencil, weather):
    """P/P_t per metre is eta lambda / (4 pi r_n) at the antenna, and the far field's less r_n^2 / r^2 far away."""
    rain, near_m = VolumeEcho(UniformVolume(weather), pencil, make_chirp(), 1), near_field_m(pencil, C / CARRIER_HZ)
    assert near_m == pytest.approx(np.pi * (C / CARRIER_HZ) * 2 * np.log(2) / (np.pi * np.deg2rad(2.0)) ** 2, rel=0.05)
    at_antenna = weather.rain_reflectivity_per_m * (C / CARRIER_HZ) / (4 * np.pi * near_m) * rain.cell_m
    assert rain.cell_power[0] == pytest.approx(at_antenna, rel=(rain.cell_m / near_m) ** 2)
    edges = rain.cell_m * np.arange(20, len(rain.cell_power) + 1)
    less = edges[:-1] * edges[1:] / (edges[:-1] * edges[1:] + near_m**2)
    np.testing.assert_allclose(rain.cell_power[20:], less * closed_form(edges, weather, pencil, 0.0), rtol=1e-3)


def test_rain_ends_at_the_ground(plane, weather):
    """Of a wide beam on a plane, the share still in the air at a range is that of the rays that reach farther."""
    antenna, chirp, pulses = make_antenna(10.0, 10.0), make_chirp(), make_pulses(64, incidence_deg=60.0, first=9)
    ground = BeamEngine(plane, antenna, chirp, 1, 512, 0.05).trace(pulses)
    rain = VolumeEcho(UniformVolume(weather), antenna, chirp, 1)
    tones = rain.trace(pulses, ground)
    assert np.all(tones.surface == VOLUME)
    range_m = tones.delay_s * C / 2
    # Quadrature of the two-way pattern over the directions below the cone that meets the plane at each range.
    u, v = np.meshgrid(np.linspace(-0.4, 0.4, 401), np.linspace(-0.4, 0.4, 401), indexing="ij")
    x = np.sqrt(1 - u**2 - v**2)
    weight = antenna.gain(np.stack([x, u, v], axis=-1).reshape(-1, 3)).reshape(u.shape) ** 2 / x
    down = np.cos(np.deg2rad(60)) * x - np.sin(np.deg2rad(60)) * v
    reach = np.where(down > 0, 50.0 / np.maximum(down, 1e-9), np.inf)
    for low, high in ((40.0, 50.0), (90.0, 95.0), (100.0, 105.0), (115.0, 120.0)):
        inside = (range_m >= low) & (range_m < high)
        cells = slice(round(low / rain.cell_m), round(high / rain.cell_m))
        share = weight[reach > (low + high) / 2].sum() / weight.sum()
        full = 64 * rain.cell_power[cells].sum()
        found = np.sum(np.abs(tones.gain[inside]) ** 2)
        assert found == pytest.approx(share * full, rel=0.12, abs=0.01 * full)
    narrow = make_antenna(2.0, 2.0)
    pulses = make_pulses(8, incidence_deg=0.0)
    ground = BeamEngine(plane, narrow, chirp, 1, 512, 0.05).trace(pulses)
    below = VolumeEcho(UniformVolume(weather), narrow, chirp, 1).trace(pulses, ground).delay_s * C / 2
    assert 49.5 < below.max() < 51.5


def test_drops_recede_from_a_radar_above_and_approach_one_that_flies_into_them(pencil, weather):
    speeds = echo_speeds(CARRIER_HZ, drops=marshall_palmer(RATE), temperature_k=288.15)
    mean_fall = speeds.at((np.arange(10_000) + 0.5) / 10_000).mean()
    pulses = make_pulses(50, incidence_deg=60.0, velocity_mps=(0.0, 12.0, 0.0))
    rate = VolumeEcho(UniformVolume(weather), pencil, make_chirp(), 1).trace(pulses, NOTHING).range_rate_mps
    expected = mean_fall * np.cos(np.deg2rad(60)) - 12.0 * np.sin(np.deg2rad(60))
    assert rate.mean() == pytest.approx(expected, abs=0.02)
    assert rate.std() > 0.2


def test_snow_sinks_and_the_wind_carries_it(pencil):
    weather = Weather(carrier_hz=CARRIER_HZ, snowfall_mm_per_h={Precipitation.DRY_SNOW: 2.0})
    volume, pulses = UniformVolume(weather), make_pulses(50, incidence_deg=60.0, velocity_mps=(0.0, 12.0, 0.0))
    assert volume.reflectivity_per_m == pytest.approx(
        snow_reflectivity_per_m(
            CARRIER_HZ, snowfall_mm_per_h=2.0, kind=Precipitation.DRY_SNOW, temperature_k=weather.temperature_k
        )
    )
    calm = VolumeEcho(volume, pencil, make_chirp(), 1).trace(pulses, NOTHING)
    assert calm.range_rate_mps.mean() == pytest.approx(1.04 * 0.5 - 12.0 * np.sin(np.deg2rad(60)), abs=0.05)
    windy = VolumeEcho(volume, pencil, make_chirp(), 1, (3.0, -5.0, 1.0)).trace(pulses, NOTHING)
    carried = pulses.true.boresight[windy.pulse - pulses.index[0]] @ np.array([3.0, -5.0, 1.0])
    np.testing.assert_allclose(windy.range_rate_mps - calm.range_rate_mps, carried, atol=1e-9)
    np.testing.assert_array_equal(windy.gain, calm.gain)


def test_a_shower_echoes_where_the_wind_has_taken_it(pencil):
    """Level beam through a shower that stood 60 m ahead, and has drifted 30 m on."""
    pulses, chirp = make_pulses(200, incidence_deg=90.0, velocity_mps=(0.0, 0.0, 0.0)), make_chirp()
    pulses = dataclasses.replace(pulses, time_s=np.full(200, 3.0))
    ahead, start = pulses.true.boresight[0, :2], pulses.true.position_m[0, :2]
    east, north = (float(v) for v in start + 60.0 * ahead)
    shower = RainCell(centre_m=(east, north), radius_m=10.0, peak_mm_per_h=60.0)
    volume = NonUniformVolume(Weather(carrier_hz=CARRIER_HZ, rain_map=shower), shower)
    wind = (float(10 * ahead[0]), float(10 * ahead[1]), 0.0)
    echo = VolumeEcho(volume, pencil, chirp, 1, wind)
    tones = echo.trace(pulses, NOTHING)
    cell = np.floor(tones.delay_s * C / 2 / echo.cell_m).astype(int)
    power = np.bincount(cell, np.abs(tones.gain) ** 2, minlength=len(echo.cell_power)) / 200
    for range_m in (60.0, 75.0, 90.0, 105.0):
        cells = slice(round((range_m - 2) / echo.cell_m), round((range_m + 2) / echo.cell_m))
        rate = 60.0 * np.exp(-abs(range_m - 90.0) / 10.0)
        local = Weather(carrier_hz=CARRIER_HZ, rain_rate_mm_per_h=float(rate)).rain_reflectivity_per_m
        expected = (echo.cell_power[cells] * local / volume.reflectivity_per_m).sum()
        # 27 cells in 200 chirps: 1.4 %; over the 4 m the profile is curved.
        assert power[cells].sum() == pytest.approx(expected, rel=0.08)


@pytest.mark.study
def test_rainy_surveys_do_not_know_their_block_size():
    target = {"position_m": [-60.0, 10.0], "rcs_dbsm": 20.0}
    scenario = load_scenario(
        "hills",
        {
            "platform.length_m": 2.0,
            "terrain.spacing_m": 2.0,
            "tracing.paths_per_pulse": 64,
            "weather": {
                "rain_rate_mm_per_h": 5.0,
                "rain_field": {"correlation_m": 20.0, "spread_db": 3.0},
                "wet_radome": {"radius_m": 0.1},
                "snowfall_mm_per_h": 0.5,
                "wind_mps": [3.0, 1.0, 0.0],
                "fog": "medium",
                "gases": True,
            },
            "processing.min_range_m": 30.0,
            "targets": [target | {"swerling": case} for case in range(5)],
        },
    )
    digests = {run(scenario, execution=Execution(block_size=size)).points.sha256() for size in (23, 1000)}
    assert len(digests) == 1
    calm = run(scenario.model_copy(update={"weather": type(scenario.weather)()}))
    assert calm.points.sha256() not in digests


def test_a_roof_ends_the_rain_for_its_share_of_the_beam(weather):
    """Ground 50 m below in one half of the beam, a roof 30 m below in the other."""
    roof = make_surface(lambda x, y: 0 * x + 20.0, size_m=40.0, centre_m=(20.0, 0.0), name="roof")
    step = make_scene(make_surface(lambda x, y: 0 * x), roof)
    antenna, chirp, pulses = make_antenna(6.0, 6.0), make_chirp(), make_pulses(200)
    ground = BeamEngine(step, antenna, chirp, 1, 256, 0.05).trace(pulses)
    rain = VolumeEcho(UniformVolume(weather), antenna, chirp, 1)
    tones = rain.trace(pulses, ground)
    between = (tones.delay_s * C / 2 > 33.0) & (tones.delay_s * C / 2 < 48.0)
    cells = slice(round(33.0 / rain.cell_m), round(48.0 / rain.cell_m))
    found = np.sum(np.abs(tones.gain[between]) ** 2) / (200 * rain.cell_power[cells].sum())
    assert found == pytest.approx(0.5, abs=0.03)


def rain_over_a_platform(material: dict, **antenna):
    """Trace 16 chirps straight down through rain on a wide platform 6 m high, and return the rain and the rest."""
    scenario = load_scenario(
        "roof_edge",
        {
            "platform.altitude_m": 30.0,
            "radar.scan": {"mode": "fixed", "incidence_deg": 0.0},
            "radar.antenna": {"beamwidth_deg": 8.0, **antenna},
            "weather.rain_rate_mm_per_h": RATE,
            "materials.building": material,
            "buildings": [{"position_m": [0.0, 0.0], "size_m": [60.0, 2.0, 6.0]}],
        },
    )
    ready = prepare(scenario)
    paths = ready.sensor_inputs().tracer().trace(ready.flight.pulses(np.arange(16)))
    rain = paths.surface == VOLUME
    return paths.delay_s[rain], paths.gain[rain], paths.gain[~rain]


def test_a_mirror_does_not_hide_the_rain_beside_it():
    rough = {"model": "lambertian", "nadir_sigma0_db": -15.0}
    smooth = {**rough, "specular": True, "medium": {"kind": "metal"}, "rms_height_m": 1e-5}
    delay, gain, others = rain_over_a_platform(rough)
    beside_mirror = rain_over_a_platform(smooth)
    assert np.abs(beside_mirror[2]).max() > 10 * np.abs(others).max()
    np.testing.assert_array_equal(beside_mirror[0], delay)
    np.testing.assert_allclose(beside_mirror[1], gain, rtol=1e-6)


def test_a_cross_polar_receiver_sees_what_flat_drops_turn():
    """Straight down a drop is round, but for its canting."""
    rough = {"model": "lambertian", "nadir_sigma0_db": -15.0, "cross_polar_db": -10.0}
    kept, turned = (
        np.sum(np.abs(rain_over_a_platform(rough, receive_polarization=p)[1]) ** 2) for p in ("co", "cross")
    )
    assert -70 < 10 * np.log10(turned / kept) < -55
