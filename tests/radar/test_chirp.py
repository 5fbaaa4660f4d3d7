"""The sweep, by the numbers that Rouveure et al. 2017 derive from their Table 2."""

import numpy as np
import pytest

from beams import make_chirp
from sionna_radar.radar.chirp import build_chirp
from sionna_radar.scenario.radar import RadarTable

C = 299_792_458.0


def test_derived_numbers_of_the_papers_radar():
    chirp = make_chirp()
    assert chirp.range_resolution_m == pytest.approx(0.2998, abs=1e-4)
    assert chirp.beat_per_metre_hz == pytest.approx(1200, rel=1e-3)
    assert chirp.wavelength_m == pytest.approx(3.893e-3, abs=1e-6)
    assert chirp.max_range_m == pytest.approx(512 * 0.2998, rel=1e-3)
    assert make_chirp(sampling="iq").max_range_m == pytest.approx(1024 * 0.2998, rel=1e-3)
    assert chirp.sampling_rate_hz == 1024 * 360


def test_samples_are_spread_about_the_middle_of_the_sweep():
    chirp = make_chirp(samples=8)
    np.testing.assert_allclose(chirp.sample_time_s * 8 * 360, [-4, -3, -2, -1, 0, 1, 2, 3], atol=1e-12)


@pytest.mark.parametrize("sweep", ["up", "down"])
def test_doppler_of_14_mps_at_30_deg_from_the_beam(sweep):
    approaching = -14 * np.cos(np.deg2rad(30)) * np.ones(1)
    sign = {"up": -1, "down": 1}[sweep]  # approaching reads short on an up-sweep, long on a down-sweep
    chirp = make_chirp(sweep=sweep)
    assert sign * chirp.doppler_hz(approaching)[0] == pytest.approx(6228, abs=1)
    assert sign * chirp.doppler_range_m(approaching)[0] == pytest.approx(5.187, abs=0.002)


@pytest.mark.parametrize(("angle_deg", "hertz", "metre"), [(0, 26, 0.021), (45, 18, 0.015)])
def test_a_velocity_error_of_5_cm_per_second(angle_deg, hertz, metre):
    error = 0.05 * np.cos(np.deg2rad(angle_deg)) * np.ones(1)
    assert make_chirp().doppler_hz(error)[0] == pytest.approx(hertz, abs=0.5)
    assert make_chirp().doppler_range_m(error)[0] == pytest.approx(metre, abs=0.0006)


def test_a_scenario_gives_its_chirp():
    radar = RadarTable(
        carrier_hz=76e9,
        bandwidth_hz=1e9,
        chirp_rate_hz=500.0,
        samples_per_chirp=256,
        sweep="down",
        sampling="iq",
        snr_db=10.0,
    )
    chirp = build_chirp(radar)
    assert chirp.slope_hz_s == -1e9 * 500
    assert chirp.duration_s == pytest.approx(2e-3)
    assert chirp.max_range_m == pytest.approx(256 * C / 2e9)
    assert radar.max_range_m == pytest.approx(chirp.max_range_m)
