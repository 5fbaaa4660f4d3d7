"""Weather along the path: laws that follow from the radar equation, and a plain sum over volumes."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.weather.path import rain_clutter_power, two_way_attenuation
from sionna_radar.weather.validity import ValidityError

RADAR = {"two_way_beam_sr": 7e-4, "peak_gain": 1e4, "wavelength_m": 3.893e-3}


def clutter(edges_m, eta_per_m=1e-3, loss_db_per_km=0.0):
    return rain_clutter_power(
        np.asarray(edges_m, dtype=float),
        reflectivity_per_m=eta_per_m,
        specific_attenuation_db_per_km=loss_db_per_km,
        **RADAR,
    )


def test_ten_db_per_km_cost_one_db_in_fifty_metres():
    left = two_way_attenuation(np.array([0.0, 50.0, 500.0]), 10.0)
    assert -10 * np.log10(left) == pytest.approx([0.0, 1.0, 10.0])


def test_a_thin_cell_is_a_point_target_of_its_volume():
    # V = r^2 Omega_2 dr with cross-section eta V on the axis of the beam.
    r, dr = 80.0, 0.3
    found = clutter([r - dr / 2, r + dr / 2], eta_per_m=2e-4)[0]
    cross_section = 2e-4 * r**2 * RADAR["two_way_beam_sr"] * dr
    point = RADAR["peak_gain"] ** 2 * RADAR["wavelength_m"] ** 2 * cross_section / ((4 * math.pi) ** 3 * r**4)
    assert found == pytest.approx(point, rel=1e-5)


def test_the_sum_over_a_beam_and_its_cells_is_the_formula():
    beam_rad, loss, eta = math.radians(2.0), 12.0, 5e-4
    angle = np.linspace(-4 * beam_rad, 4 * beam_rad, 401)
    one_way = np.exp(-4 * math.log(2) * (angle[:, None] ** 2 + angle[None, :] ** 2) / beam_rad**2)
    omega_2 = np.sum(one_way**2) * (angle[1] - angle[0]) ** 2
    edges = np.linspace(20.0, 120.0, 5)
    fine = np.linspace(20.0, 120.0, 40_001)
    middle, dr = (fine[1:] + fine[:-1]) / 2, fine[1] - fine[0]
    power = 1e8 * 1e-5 * omega_2 * eta * middle**2 * dr / ((4 * math.pi) ** 3 * middle**4)
    power *= two_way_attenuation(middle, loss)
    expected = power.reshape(4, -1).sum(axis=1)
    found = rain_clutter_power(
        edges,
        reflectivity_per_m=eta,
        two_way_beam_sr=omega_2,
        peak_gain=1e4,
        wavelength_m=math.sqrt(1e-5),
        specific_attenuation_db_per_km=loss,
    )
    assert found == pytest.approx(expected, rel=1e-6)


@given(st.floats(1.0, 200.0), st.floats(0.1, 100.0), st.floats(0.1, 100.0), st.floats(0.0, 40.0))
def test_cells_join_without_a_seam(start_m, first_m, second_m, loss):
    split = clutter([start_m, start_m + first_m, start_m + first_m + second_m], loss_db_per_km=loss)
    whole = clutter([start_m, start_m + first_m + second_m], loss_db_per_km=loss)
    assert split.sum() == pytest.approx(whole[0], rel=1e-9)
    assert (split > 0).all()


@pytest.mark.parametrize("edges_m", [[0.0, 1.0], [5.0], [3.0, 2.0]])
def test_cells_that_are_none_are_refused(edges_m):
    with pytest.raises(ValidityError, match="range_edges_m"):
        clutter(edges_m)
