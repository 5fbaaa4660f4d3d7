"""The sweep by the numbers of Rouveure et al. 2017, Table 2, and the radar equation over a plane by quadrature."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp, plane_power
from sionna_radar.radar.build import build_chirp
from sionna_radar.radar.equation import plane_echo
from sionna_radar.scenario.radar import RadarTable
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter

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


WAVELENGTH_M = 299_792_458.0 / 77e9


def echo_db(antenna, model, height_m, incidence_deg):
    return 10 * np.log10(plane_echo(antenna, model, WAVELENGTH_M, height_m, np.deg2rad(incidence_deg)))


@pytest.mark.parametrize("incidence_deg", [0, 30, 45, 60, 70])
@pytest.mark.parametrize("widths", [(2.0, 2.0), (6.0, 3.0)])
def test_plane_echo_is_the_quadrature_over_the_pattern(widths, incidence_deg):
    antenna = make_antenna(*widths)
    expected = 10 * np.log10(plane_power(antenna, 50.0, incidence_deg, gamma=0.02))
    measured = echo_db(antenna, ConstantGammaBackscatter(0.02), 50.0, incidence_deg)
    assert measured == pytest.approx(expected, abs=0.02)


def test_plane_echo_falls_6_db_per_doubled_height(pencil):
    # The lit area grows with r^2 while a point's echo falls with r^4.
    low, high = (echo_db(pencil, ConstantGammaBackscatter(0.02), h, 45) for h in (50.0, 100.0))
    assert low - high == pytest.approx(20 * np.log10(2), abs=1e-6)


def test_plane_echo_of_a_narrow_beam_follows_the_backscatter(pencil):
    incidence_deg = 40.0
    gamma = echo_db(pencil, ConstantGammaBackscatter(0.1), 50.0, incidence_deg)
    lambert = echo_db(pencil, LambertianBackscatter(0.1), 50.0, incidence_deg)
    assert lambert - gamma == pytest.approx(10 * np.log10(np.cos(np.deg2rad(incidence_deg))), abs=0.01)
