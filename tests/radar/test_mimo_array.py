"""Virtual arrays against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from modules import line_of
from sionna_radar.radar.mimo_array import MimoArray, code_of


def directions(cosine):
    return np.column_stack([np.sqrt(1 - cosine**2), cosine, np.zeros(len(cosine))])


def factor(array, cosine, toward=0.0):
    """Array factor of the virtual array: the mean over its channels, steered toward a direction cosine."""
    own, steered = (array.steering(directions(np.atleast_1d(c)), np.zeros(np.size(c))) for c in (cosine, toward))
    return np.abs(own @ steered[0].conj()) / array.channels


def test_a_filled_line_has_the_pattern_of_a_uniform_one():
    """sin(N x / 2) / (N sin(x / 2)), x the phase from element to element."""
    cosine = np.linspace(-0.95, 0.95, 381)
    x = np.pi * cosine
    with np.errstate(invalid="ignore"):
        expected = np.where(x == 0, 1.0, np.sin(6 * x) / (12 * np.sin(x / 2)))
    assert factor(line_of(3, 4), cosine) == pytest.approx(np.abs(expected), abs=1e-9)


def test_elements_a_wavelength_apart_repeat_their_beam():
    array = line_of(2, 4, spacing=1.0)
    assert factor(array, 0.6, -0.4)[0] == pytest.approx(1.0)
    assert factor(line_of(2, 4), 0.6, -0.4)[0] < 0.3
    assert array.widest_gap_wavelengths == pytest.approx(1.0)


def test_doubled_virtual_elements_are_counted():
    array = line_of(2, 4)
    assert array.duplicates.tolist() == [1] * 8
    doubled = replace(array, transmitter_m=array.transmitter_m * 0.75)  # three spacings instead of four
    assert sorted(doubled.duplicates.tolist()) == [1] * 6 + [2]
    assert doubled.channels == 8


@pytest.mark.parametrize("code", ["tdm", "ddm", "bpm"])
@pytest.mark.parametrize("transmitters", [1, 3, 4])
def test_codes_tell_transmitters_apart(code, transmitters):
    factors = code_of(code, transmitters)
    gram = factors.conj().T @ factors
    assert gram == pytest.approx(gram[0, 0] * np.eye(transmitters), abs=1e-12)
    assert gram[0, 0].real == pytest.approx(1 if code == "tdm" else len(factors))


def test_near_steering_is_that_of_exact_ways():
    array = line_of(12, 16)
    direction, range_m = directions(np.array([0.4, -0.6])), 4.0
    found = array.steering(direction, np.zeros(2), range_m)
    for n, u in enumerate(direction):
        ways = [np.linalg.norm(range_m * u - e, axis=1) - range_m for e in (array.transmitter_m, array.receiver_m)]
        way = np.add.outer(*ways).ravel()
        exact = np.exp(2j * np.pi * way / array.wavelength_m)
        assert np.abs(found[n] - exact).max() < 1e-9
        assert np.abs(array.steering(direction[n : n + 1], np.zeros(1))[0] - exact).max() > 1.0


def test_motion_between_transmitters_turns_their_phases():
    array = line_of(3, 1)
    vectors = array.steering(directions(np.zeros(2)), np.array([0.0, 2.0]))
    turn = np.angle(vectors[1, 2] * np.conj(vectors[1, 1]))
    assert turn == pytest.approx(4 * np.pi * 2.0 * array.period_s / array.wavelength_m)
    assert vectors[0] == pytest.approx(np.ones(3))


def test_a_planar_array_reaches_in_both_axes():
    places = np.array([[0.0, x, z] for x in (0.0, 1.0) for z in (0.0, 2.0)])
    array = MimoArray(
        transmitter_m=places, receiver_m=places[:1], code=code_of("bpm", 4), blocks=8, period_s=1e-4, wavelength_m=4e-3
    )
    assert array.size_m.tolist() == [0.0, 1.0, 2.0]
    assert array.chirps == 32
    assert array.highest_rate_mps == pytest.approx(4e-3 / (4 * 4e-4))
    assert array.rate_cell_mps == pytest.approx(4e-3 / (2 * 32e-4))
