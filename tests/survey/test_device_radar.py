"""A radar whose signals stay in the memory of the ray tracer: the survey of any radar, but for rounding."""

import numpy as np
import pytest
import xarray as xr

from sionna_radar import load_scenario, prepare, run
from sionna_radar.detection.spectrum import HOST
from sionna_radar.execution.execution import BLOCK_SIZE, Execution
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.sensors import device_radar
from sionna_radar.survey.sensors.device_radar import DeviceRadar
from sionna_radar.survey.sensors.radar import Radar

pytestmark = pytest.mark.usefixtures("rough_errors", "sketched_rain")

SHORT = {"platform.length_m": 4.0, "terrain.spacing_m": 2.0, "tracing.paths_per_pulse": 128}
SMOOTH = {
    "model": "constant_gamma",
    "terrain_class": "rolling_hills",
    "specular": True,
    "permittivity": [5.0, 0.2],
    "rms_height_m": 1e-4,
}
# The host takes the drift of a beat during the sweep from the mean of a pulse's paths, to this share of its amplitude.
POWER, RANGE_M, HEIGHT_M = 2e-3, 1e-3, 1e-3


def flown(settings, sensor=None, block_size=BLOCK_SIZE, recordings=None):
    return run(
        load_scenario("hills", SHORT | settings),
        parts=CustomParts(sensor=sensor),
        recordings=recordings,
        execution=Execution(block_size=block_size),
    )


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"tracing.speckle": "per_pulse"},
        {"radar.sampling": "iq", "radar.sweep": "down"},
        {"radar.transmit_power_dbm": 12.0, "radar.noise_figure_db": 12.0},
        {"weather.rain_rate_mm_per_h": 0.0, "dem.method": "refined"},
    ],
)
def test_the_survey_is_that_of_any_radar(settings):
    if "radar.transmit_power_dbm" in settings:
        settings = settings | {"radar.snr_db": None}
    host = flown(settings)
    device = flown(settings, sensor=lambda given: DeviceRadar(given, HOST))
    assert device.sensor.on_device
    np.testing.assert_array_equal(device.points.pulse, host.points.pulse)
    np.testing.assert_allclose(device.points.range_m, host.points.range_m, atol=RANGE_M)
    np.testing.assert_allclose(device.points.power, host.points.power, rtol=POWER)
    np.testing.assert_array_equal(device.dem.filled, host.dem.filled)
    np.testing.assert_allclose(device.dem.height_m, host.dem.height_m, atol=HEIGHT_M)
    np.testing.assert_array_equal(device.lit, host.lit)
    assert device.paths == host.paths


def test_blocks_of_any_size_and_wavefronts_give_the_same_bits(monkeypatch):
    from sionna_radar.tracing.engines.beam import beam

    settings = {"tracing.speckle": "per_pulse"}
    whole = flown(settings, sensor=lambda given: DeviceRadar(given, HOST))
    monkeypatch.setattr(beam, "RAYS_AT_ONCE", 3000)
    small = flown(settings, sensor=lambda given: DeviceRadar(given, HOST), block_size=13)
    assert small.points.sha256() == whole.points.sha256()
    assert small.paths == whole.paths


@pytest.mark.parametrize(
    "settings",
    [
        {"weather.rain_rate_mm_per_h": 5.0},
        {"tracing.bounces": 2, "materials.ground": SMOOTH, "terrain.spacing_m": 20.0},
        {"tracing.engine": "gamma"},
        {"radar.sweep": "triangular"},
        {"radar.receiver.high_pass_corner_hz": 20e3},
        {"radar.receiver.converter": {"bits": 12, "full_scale_over_noise_db": 60.0}},
        {"processing.leakage": "subtract"},
        {"processing.interference": "zeroing"},
        {"processing.average.chirps": 2},
        {"targets": [{"position_m": [0.0, 0.0], "rcs_dbsm": 20.0}]},
    ],
)
def test_whatever_else_there_is_takes_the_way_by_the_host(settings):
    prepared = prepare(load_scenario("hills", SHORT | settings))
    pulses = prepared.flight.pulses(np.arange(6))
    host, device = Radar(prepared.sensor_inputs()), DeviceRadar(prepared.sensor_inputs(), HOST)
    assert not device.on_device
    device.expect(pulses)
    one, other = host.observe(pulses), device.observe(pulses)
    np.testing.assert_array_equal(one.echoes.range_m, other.echoes.range_m)
    np.testing.assert_array_equal(one.beats[0], other.beats[0])


def test_beat_signals_are_fetched_by_whoever_records_them(tmp_path):
    files = [tmp_path / name for name in ("host.nc", "device.nc")]
    host = flown({}, recordings={"signals": files[0]})
    flown({}, recordings={"signals": files[1]}, sensor=lambda given: DeviceRadar(given, HOST))
    with xr.open_dataset(files[0], engine="h5netcdf") as one, xr.open_dataset(files[1], engine="h5netcdf") as other:
        error = other.beat_i - one.beat_i
        assert float(np.sqrt((error**2).mean() / (one.beat_i**2).mean())) < POWER / 2
    assert host.pulses == one.sizes["pulse"]


@pytest.mark.parametrize(("backend", "kind"), [("llvm", Radar), ("cuda", DeviceRadar)])
def test_a_gpu_that_traces_also_makes_the_signals(monkeypatch, backend, kind):
    monkeypatch.setattr(device_radar, "chosen_backend", lambda: backend)
    sensor = prepare(load_scenario("hills", SHORT)).build_sensor()
    assert type(sensor) is kind
