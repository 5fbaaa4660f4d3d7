"""Leaves as sheets: against slow sums, energy, physical optics of single leaves, and a wave through explicit leaves."""

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.special import j1

from sionna_radar.surfaces.foliage import Foliage, sheet_coefficients
from sionna_radar.surfaces.permittivity import leaf_permittivity, vegetation_permittivity

BANDS_HZ = (24e9, 77e9)
COSINES = np.linspace(0.02, 1.0, 25)
LEAF = {"leaf_thickness_m": 2e-4, "water_content": 0.75}


def bounced(permittivity, thickness_m, wavelength_m, cosine):
    """The sum of all waves that a sheet's faces send back and forth, one by one."""
    inside = np.sqrt(permittivity - 1 + cosine**2 + 0j)
    for n in range(2):
        enter = (1.0, permittivity)[n] * cosine
        face = (enter - inside) / (enter + inside)
        through = np.exp(-2j * np.pi * thickness_m * inside / wavelength_m)
        reflected, passed, wave = face, 0j, (1 + face) * through
        for _ in range(400):
            passed = passed + wave * (1 - face)
            wave = wave * -face * through  # reflected at the far face, back at the near one
            reflected = reflected + wave * (1 - face)
            wave = wave * -face * through
        yield reflected, passed


@pytest.mark.parametrize("carrier_hz", BANDS_HZ)
@pytest.mark.parametrize("thickness_m", [1e-4, 3e-4, 2e-3])
def test_a_sheet_is_the_sum_of_its_bounces(carrier_hz, thickness_m):
    permittivity, wavelength_m = leaf_permittivity(carrier_hz, water_content=0.75), speed_of_light / carrier_hz
    reflection, transmission = sheet_coefficients(permittivity, thickness_m, wavelength_m, COSINES)
    for n, (reflected, passed) in enumerate(bounced(permittivity, thickness_m, wavelength_m, COSINES)):
        np.testing.assert_allclose(reflection[n], reflected, atol=1e-9)
        np.testing.assert_allclose(transmission[n], passed, atol=1e-9)


def test_a_sheet_without_loss_keeps_the_power_and_none_is_no_sheet():
    reflection, transmission = sheet_coefficients(7.0 + 0j, 3e-4, 0.004, COSINES)
    np.testing.assert_allclose(np.abs(reflection) ** 2 + np.abs(transmission) ** 2, 1.0, atol=1e-12)
    reflection, transmission = sheet_coefficients(7.0 - 3j, 0.0, 0.004, COSINES)
    np.testing.assert_allclose(reflection, 0.0, atol=1e-12)
    np.testing.assert_allclose(transmission, 1.0, atol=1e-12)


def test_a_thin_sheet_is_the_resistive_one_of_its_polarization_current():
    """Senior, Sarabandi and Ulaby 1987: R = -1 / (1 + 2 r) at normal incidence, r = -j / (k d (eps - 1))."""
    permittivity, wavelength_m = leaf_permittivity(24e9, water_content=0.8), speed_of_light / 24e9
    resistivity = -1j / (2 * np.pi / wavelength_m * 2e-5 * (permittivity - 1))
    reflection, _ = sheet_coefficients(permittivity, 2e-5, wavelength_m, np.ones(1))
    np.testing.assert_allclose(reflection[0], -1 / (1 + 2 * resistivity), rtol=0.01)


def test_leaves_are_maetzlers_and_dry_ones_those_of_itu():
    """0.51 + 3.84 m + 0.522 (1 - 1.32 m) eps: m the dry share, eps of saline water as Ulaby and El-Rayes 1987."""
    for carrier_hz in BANDS_HZ:
        relaxed = carrier_hz / 18e9
        saline = 4.9 + 74.4 / (1 + 1j * relaxed) - 18j * 1.57 / (carrier_hz / 1e9)
        expected = 0.51 + 3.84 * 0.2 + 0.522 * (1 - 1.32 * 0.2) * saline
        assert abs(leaf_permittivity(carrier_hz, water_content=0.8) - expected) < 0.05 * abs(expected)
    assert leaf_permittivity(77e9, water_content=0.3) == vegetation_permittivity(
        77e9, temperature_c=20.0, water_fraction=0.3
    )
    for wrong in (-0.1, 0.95, np.nan):
        with pytest.raises(ValueError, match="water_content"):
            leaf_permittivity(77e9, water_content=wrong)
    with pytest.raises(ValueError, match="frequency_hz"):
        leaf_permittivity(120e9, water_content=0.8)


def test_extinction_is_a_half_of_the_leaf_area_of_opaque_leaves_and_linear_in_it():
    thick = Foliage(leaf_area_per_m=2.0, leaf_thickness_m=0.02, water_content=0.85)
    reflected = np.abs(sheet_coefficients(leaf_permittivity(77e9, water_content=0.85), 0.02, 0.0039, np.ones(1))[0])
    assert thick.extinction_per_m(77e9) == pytest.approx(1.0, rel=1e-3)
    assert thick.backscatter_per_m(77e9) == pytest.approx(float(reflected[0, 0]) ** 2, rel=0.02)
    one, two = (Foliage(leaf_area_per_m=a, **LEAF) for a in (1.0, 2.0))
    for carrier_hz in BANDS_HZ:
        assert two.extinction_per_m(carrier_hz) == pytest.approx(2 * one.extinction_per_m(carrier_hz))
        assert two.backscatter_per_m(carrier_hz) == pytest.approx(2 * one.backscatter_per_m(carrier_hz))
        # No more is reflected than is lost: of isotropic scatter, which that of random mirrors is, eta is all of it.
        assert one.backscatter_per_m(carrier_hz) < one.extinction_per_m(carrier_hz)


@pytest.mark.parametrize("carrier_hz", BANDS_HZ)
def test_extinction_is_its_integral(carrier_hz):
    cosine = (np.arange(20000) + 0.5) / 20000
    permittivity = leaf_permittivity(carrier_hz, water_content=0.75)
    passed = np.abs(sheet_coefficients(permittivity, 2e-4, speed_of_light / carrier_hz, cosine)[1]) ** 2
    made = Foliage(leaf_area_per_m=1.5, **LEAF).extinction_per_m(carrier_hz)
    assert made == pytest.approx(1.5 * np.mean(cosine * (1 - passed.mean(axis=0))), rel=1e-5)


@pytest.mark.parametrize("radius_wavelengths", [2.0, 5.0])
def test_the_echo_of_leaves_is_the_mean_flash_of_discs(radius_wavelengths):
    """Physical optics of a disc, over normals spread over the sphere: area |R|^2 / 2 of each."""
    wavelength_m, area_m2 = 0.0039, np.pi * (radius_wavelengths * 0.0039) ** 2
    angle = np.linspace(1e-9, np.pi / 2, 400_001)
    x = 4 * np.pi * radius_wavelengths * np.sin(angle)
    sigma_m2 = 4 * np.pi * area_m2**2 / wavelength_m**2 * (2 * j1(x) / x) ** 2 * np.cos(angle) ** 2
    mean_m2 = np.trapezoid(sigma_m2 * np.sin(angle), angle)
    assert mean_m2 == pytest.approx(area_m2 / 2, rel=0.06)


def through_leaves(carrier_hz, leaf_area_per_m, height_m, radius_m, slabs, fields, rng):
    """A plane wave through slabs of explicit discs: the mean field, power and squared power below them.

    Each disc is a screen of its outline seen along the way, with its sheet's transmission; between slabs the angular
    spectrum propagates.
    """
    wavelength_m, spacing_m, size = speed_of_light / carrier_hz, 0.005, 384
    permittivity, side_m = leaf_permittivity(carrier_hz, water_content=LEAF["water_content"]), 384 * 0.005
    wave = 2 * np.pi / wavelength_m
    kx, ky = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(size, spacing_m)] * 2)
    down = np.sqrt(np.maximum(wave**2 - kx**2 - ky**2, 0.0)) - wave
    around = int(radius_m / spacing_m) + 2
    field = np.ones((fields, size, size), dtype=complex)
    for n in range(fields):
        for _ in range(slabs):
            screen = np.ones((size, size), dtype=complex)
            count = rng.poisson(leaf_area_per_m * height_m / slabs * side_m**2 / (np.pi * radius_m**2))
            cosine = rng.uniform(0, 1, count)
            passed = sheet_coefficients(permittivity, LEAF["leaf_thickness_m"], wavelength_m, cosine)[1]
            passed = passed[rng.integers(0, 2, count), np.arange(count)]
            passed = passed * np.exp(1j * wave * LEAF["leaf_thickness_m"] * cosine)
            centre, turn = rng.uniform(0, size, (count, 2)), rng.uniform(0, np.pi, count)
            for k in range(count):
                rows, columns = (int(c) + np.arange(-around, around + 1) for c in centre[k])
                x, y = np.meshgrid((columns - centre[k, 1]) * spacing_m, (rows - centre[k, 0]) * spacing_m)
                short = (x * np.cos(turn[k]) + y * np.sin(turn[k])) / max(cosine[k], 1e-3)
                long = y * np.cos(turn[k]) - x * np.sin(turn[k])
                cell = np.ix_(rows % size, columns % size)
                screen[cell] *= np.where(short**2 + long**2 <= radius_m**2, passed[k], 1.0)
            field[n] = np.fft.ifft2(np.fft.fft2(field[n] * screen) * np.exp(-1j * down * height_m / slabs))
    power = np.abs(field) ** 2
    return np.abs(field.mean()) ** 2, power.mean(), (power**2).mean()


@pytest.mark.parametrize("carrier_hz", BANDS_HZ)
def test_the_power_on_the_ground_falls_as_the_extinction_says(carrier_hz):
    """The mean field falls faster, by the forward-scattering theorem; what it loses by diffraction still arrives.

    Ground is seen there and back, by the square of the power at each place of it, whose mean exceeds the squared mean.
    """
    area_per_m, height_m = 2.0, 1.0
    field, power, squared = through_leaves(carrier_hz, area_per_m, height_m, 0.03, 10, 4, np.random.default_rng(1))
    foliage = Foliage(leaf_area_per_m=area_per_m, **LEAF)
    lost = foliage.extinction_per_m(carrier_hz) * height_m
    assert -np.log(power) == pytest.approx(lost, abs=0.03)
    cosine = (np.arange(2000) + 0.5) / 2000
    permittivity, wavelength_m = leaf_permittivity(carrier_hz, water_content=0.75), speed_of_light / carrier_hz
    passed = sheet_coefficients(permittivity, 2e-4, wavelength_m, cosine)[1].mean(axis=0)
    passed = passed * np.exp(2j * np.pi * 2e-4 / wavelength_m * cosine)
    theorem = area_per_m * height_m * np.mean(cosine * 2 * (1 - passed.real))
    assert -np.log(field) == pytest.approx(theorem, abs=0.08)
    assert theorem > 1.25 * lost
    # Backscatter enhancement: none without leaves, a factor of 2 (3 dB) behind many.
    assert 1.2 < squared / power**2 < 2.0
