"""The radar equation over a plane against a quadrature in other coordinates."""

import numpy as np
import pytest

from beams import make_antenna, plane_power
from sionna_radar.radar.equation import plane_echo
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter

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
