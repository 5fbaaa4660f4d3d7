"""What rain sends back: against measurements at W band, the Rayleigh limit, and P.838 for what it removes."""

import math

import numpy as np
import pytest
from miepython import efficiencies_mx
from scipy.constants import speed_of_light
from scipy.integrate import trapezoid

from sionna_radar.weather import rain
from sionna_radar.weather.drops import ExponentialDrops, marshall_palmer
from sionna_radar.weather.permittivity import water_permittivity
from sionna_radar.weather.rain import (
    drop_reflectivity_per_m,
    rain_attenuation_db_per_km,
    rain_reflectivity_per_m,
)
from sionna_radar.weather.validity import ValidityError

TEMPERATURE_K = 283.15


def dielectric_factor(frequency_hz):
    permittivity = water_permittivity(frequency_hz, TEMPERATURE_K)
    return abs((permittivity - 1) / (permittivity + 2)) ** 2


def scattered_attenuation_db_per_km(frequency_hz, drops):
    """What the drops' extinction takes away."""
    diameter_m = np.linspace(1e-6, 20 / drops.slope_per_m, 2001)
    index = np.conj(water_permittivity(frequency_hz, TEMPERATURE_K) ** 0.5)
    extinction = efficiencies_mx(index, np.pi * diameter_m * frequency_hz / speed_of_light)[0]
    area = trapezoid(drops.density_per_m4(diameter_m) * np.pi / 4 * diameter_m**2 * extinction, diameter_m)
    return 4342.945 * area


def equivalent_reflectivity_dbz(eta_per_m, frequency_hz):
    wavelength_m = speed_of_light / frequency_hz
    z_m3 = eta_per_m * wavelength_m**4 / (math.pi**5 * dielectric_factor(frequency_hz))
    return 10 * math.log10(z_m3 * 1e18)


@pytest.mark.parametrize("rate", [3.0, 5.0, 7.0, 10.0])
def test_a_w_band_radar_sees_19_dbz_at_250_m(rate):
    # Hogan et al. 2003 (J. Atmos. Oceanic Technol. 20, 572, abstract): 94/95 GHz, 250 m, 3 to 10 mm/h, nearly
    # constant 19 dBZ for the loss on the way included; natural spread about 1.5 dB.
    eta_per_m = rain_reflectivity_per_m(94e9, rain_rate_mm_per_h=rate, temperature_k=TEMPERATURE_K)
    loss_db = 2 * 0.25 * scattered_attenuation_db_per_km(94e9, marshall_palmer(rate))
    assert equivalent_reflectivity_dbz(eta_per_m, 94e9) - loss_db == pytest.approx(19.0, abs=1.5)


@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0, 50.0])
def test_mie_extinction_agrees_with_p838(rate):
    # P.838 stands for other mean drops, which are flattened too; Marshall-Palmer's carry more water than
    # their rain rate (below). The band is 1.3 dB wide upwards, as one rain differs from another.
    law = rain_attenuation_db_per_km(77e9, rain_rate_mm_per_h=rate, elevation_rad=0.0, tilt_rad=math.pi / 4)
    drops = scattered_attenuation_db_per_km(77e9, marshall_palmer(rate))
    assert 0.9 < drops / law < 1.35


def test_drizzle_at_low_frequency_is_rayleigh():
    # eta = pi^5 |K|^2 / lambda^4 * integral of N D^6 = 720 N0 / L^7.
    drops = ExponentialDrops(intercept_per_m4=8e6, slope_per_m=40_000.0)
    wavelength_m = speed_of_light / 3e9
    sixth_moment_m3 = 720 * drops.intercept_per_m4 / drops.slope_per_m**7
    expected = math.pi**5 * dielectric_factor(3e9) / wavelength_m**4 * sixth_moment_m3
    found = drop_reflectivity_per_m(3e9, drops=drops, temperature_k=TEMPERATURE_K)
    assert found == pytest.approx(expected, rel=2e-3)


def test_rayleigh_overstates_rain_at_77_ghz():
    drops = marshall_palmer(10.0)
    wavelength_m = speed_of_light / 77e9
    sixth_moment_m3 = 720 * drops.intercept_per_m4 / drops.slope_per_m**7
    rayleigh = math.pi**5 * dielectric_factor(77e9) / wavelength_m**4 * sixth_moment_m3
    assert drop_reflectivity_per_m(77e9, drops=drops, temperature_k=TEMPERATURE_K) < 0.1 * rayleigh


@pytest.mark.parametrize("rate", [0.1, 10.0, 150.0])
def test_the_quadrature_has_converged(rate, monkeypatch):
    arguments = {"rain_rate_mm_per_h": rate, "temperature_k": TEMPERATURE_K}
    found = rain_reflectivity_per_m(77e9, **arguments)
    monkeypatch.setattr(rain, "NODES", 500)
    monkeypatch.setattr(rain, "MEAN_DIAMETERS", 30.0)
    assert found == pytest.approx(rain_reflectivity_per_m(77e9, **arguments), rel=1e-4)


def test_marshall_palmer_drops_carry_roughly_their_rain_rate():
    # Fall speed 9.65 - 10.3 exp(-0.6 D/mm) m/s (Atlas et al. 1973, eq. 24, doi 10.1029/RG011i001p00001, as
    # restated in several disdrometer codes). The excess of 16 % is that of Marshall and Palmer's fit.
    rate = 10.0
    drops = marshall_palmer(rate)
    diameter_m = np.linspace(1e-4, 8e-3, 4000)
    speed_mps = np.clip(9.65 - 10.3 * np.exp(-600.0 * diameter_m), 0, None)
    flux_mps = trapezoid(drops.density_per_m4(diameter_m) * math.pi / 6 * diameter_m**3 * speed_mps, diameter_m)
    assert flux_mps * 3.6e6 == pytest.approx(1.16 * rate, rel=0.02)


def test_no_rain_is_silent_and_less_than_none_is_refused():
    assert rain_reflectivity_per_m(77e9, rain_rate_mm_per_h=0.0, temperature_k=TEMPERATURE_K) == 0.0
    with pytest.raises(ValidityError, match="rain_rate"):
        rain_reflectivity_per_m(77e9, rain_rate_mm_per_h=-1.0, temperature_k=TEMPERATURE_K)
    with pytest.raises(ValidityError, match="rain_rate"):
        marshall_palmer(0.0)
