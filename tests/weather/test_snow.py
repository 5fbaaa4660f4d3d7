"""Falling snow: its mass, its Rayleigh limit, and what others measured or computed of it."""

import math

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sionna_radar.weather.permittivity import ice_permittivity
from sionna_radar.weather.rain import rain_attenuation_db_per_km, rain_reflectivity_per_m
from sionna_radar.weather.scattering import clausius_mossotti, mie_backscatter
from sionna_radar.weather.snow import (
    LARGEST,
    flakes,
    form_factor,
    melting_factor,
    sekhon_srivastava,
    snow_attenuation_db_per_km,
    snow_reflectivity_per_m,
    snow_speeds,
)
from sionna_radar.weather.validity import Precipitation, ValidityError

DRY, WET = Precipitation.DRY_SNOW, Precipitation.WET_SNOW
COLD_K = 268.15
# |K|^2 of water that cloud radars take for the equivalent reflectivity, 0.75 at 94 GHz and 0.88 at 35 GHz.
WATER_FACTOR = {10e9: 0.93, 35e9: 0.88, 94e9: 0.75}


def dbz(eta_per_m, frequency_hz):
    z_m3 = eta_per_m * (speed_of_light / frequency_hz) ** 4 / math.pi**5 / WATER_FACTOR[frequency_hz]
    return 10 * math.log10(z_m3 * 1e18)


def reflectivity(frequency_hz, rate, kind=DRY):
    return snow_reflectivity_per_m(frequency_hz, snowfall_mm_per_h=rate, kind=kind, temperature_k=COLD_K)


def attenuation(frequency_hz, rate, kind=DRY):
    return snow_attenuation_db_per_km(frequency_hz, snowfall_mm_per_h=rate, kind=kind, temperature_k=COLD_K)


@pytest.mark.parametrize("kind", [DRY, WET])
@pytest.mark.parametrize("rate", [0.25, 1.0, 4.0])
def test_the_flakes_carry_their_snowfall_to_the_ground(kind, rate):
    assert flakes(rate, kind).rate_mm_per_h == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize("rate", [0.25, 1.0, 8.0])
def test_sizes_and_fall_speeds_of_two_sources_belong_together(rate):
    raw = sekhon_srivastava(rate, DRY, largest=30.0)
    assert raw.rate_mm_per_h == pytest.approx(rate, rel=0.11)
    # Mass of an exponential distribution: pi rho N0 / L^4.
    slope = 2290.0 * rate**-0.45
    mass_g_per_m3 = 1000.0 * np.sum(raw.count_per_m3 * raw.mass_kg)
    assert mass_g_per_m3 == pytest.approx(1e6 * math.pi * 2.5e6 * rate**-0.94 / slope**4, rel=1e-3)


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_the_cut_gives_the_reflectivity_factor_of_the_source(rate):
    """Sekhon and Srivastava 1970: Z = 1780 R^2.21 mm6/m3, of the melted diameters."""
    raw = sekhon_srivastava(rate, DRY, largest=LARGEST)
    melted_mm = np.cbrt(6 * raw.mass_kg / (1000 * math.pi)) * 1e3
    z = float(raw.count_per_m3 @ melted_mm**6)
    assert 10 * math.log10(z / (1780 * rate**2.21)) == pytest.approx(0.0, abs=0.5)


def test_small_flakes_are_rayleigh_scatterers():
    assert form_factor(np.array([1e-4]))[0] == pytest.approx(1.0, rel=1e-6)
    # Far below its band the sum is pi^5 |K_i|^2 / lambda^4 times the sixth moment of the ice alone.
    falling = flakes(0.01, DRY)
    ice_m3 = falling.mass_kg / 917.0
    frequency_hz = 10e9
    factor = abs(clausius_mossotti(ice_permittivity(frequency_hz, COLD_K))) ** 2
    expected = 36 * math.pi**3 * factor * (frequency_hz / speed_of_light) ** 4 * falling.count_per_m3 @ ice_m3**2
    assert reflectivity(frequency_hz, 0.01) == pytest.approx(expected, rel=0.05)


# Matrosov 2007 (J. Atmos. Sci. 64, 1735): Ze = 56 S^1.2 at Ka band, 10 S^0.8 at W band, good to factors of 2 or so for
# what is not known of the flakes (from memory of the literature).
@pytest.mark.parametrize(("frequency_hz", "a", "b"), [(35e9, 56.0, 1.2), (94e9, 10.0, 0.8)])
@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0, 4.0])
def test_cloud_radars_see_snow_as_strong(frequency_hz, a, b, rate):
    assert dbz(reflectivity(frequency_hz, rate), frequency_hz) == pytest.approx(10 * math.log10(a * rate**b), abs=3.3)


def test_spheres_of_the_flakes_density_are_no_snow():
    """What `snow` says of them: at 94 GHz and 4 mm/h their echo is 10 dB too weak."""
    falling, ice = flakes(4.0, DRY), ice_permittivity(94e9, COLD_K)
    filled = falling.mass_kg / 917.0 / (math.pi / 6 * falling.diameter_m**3)
    mixed = (1 + 2 * filled * clausius_mossotti(ice)) / (1 - filled * clausius_mossotti(ice))  # Maxwell Garnett
    size = math.pi * falling.diameter_m * 94e9 / speed_of_light
    back = [mie_backscatter(size[i : i + 1], complex(m) ** 0.5)[0] for i, m in enumerate(mixed)]
    spheres_per_m = float(falling.count_per_m3 * math.pi / 4 * falling.diameter_m**2 @ np.array(back))
    assert dbz(reflectivity(94e9, 4.0), 94e9) - dbz(spheres_per_m, 94e9) > 10


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0])
def test_dry_snow_takes_more_than_gunn_and_east_and_less_than_battan(rate):
    """At 24 GHz, between Rayleigh formulas for Z = 200 R^1.6 and Z = 2000 R^2; both take ice to absorb more.

    Gunn and East 1954: 0.00349 R^1.6 / l^4 + 0.00224 R / l dB/km, l in cm, which gives the example of MathWorks' snowpl
    (77 GHz, 0.75 mm/h, 10 km: 1.0017 dB). Battan 1973: 0.035 R^2 / l^4 + 0.0022 R / l (from memory).
    """
    example_cm = 100 * speed_of_light / 77e9
    assert 10 * (0.00349 * 0.75**1.6 / example_cm**4 + 0.00224 * 0.75 / example_cm) == pytest.approx(1.0017, abs=1e-4)
    wave_cm = 100 * speed_of_light / 24e9
    low = 0.00349 * rate**1.6 / wave_cm**4 + 0.00224 * rate / wave_cm
    high = 0.035 * rate**2 / wave_cm**4 + 0.0022 * rate / wave_cm
    assert low < attenuation(24e9, rate) < high


def test_dry_flakes_fall_with_a_metre_a_second_and_wet_ones_faster():
    quantile = (np.arange(1000) + 0.5) / 1000
    speeds = [
        snow_speeds(77e9, snowfall_mm_per_h=1.0, kind=kind, temperature_k=COLD_K).at(quantile) for kind in (DRY, WET)
    ]
    assert speeds[0].mean() == pytest.approx(1.0, abs=0.15)
    assert 1.2 < speeds[1].mean() < 2.0


def test_wet_snow_takes_several_times_what_its_rain_does():
    # Jain and Watson 1985 (Electron. Lett. 21, 68, abstract): peaks of 8 to 13 dB/km at 36.25 GHz for 10 to 15 mm/h.
    assert attenuation(36.25e9, 10.0, WET) == pytest.approx(8.0, rel=0.25)
    assert attenuation(36.25e9, 15.0, WET) == pytest.approx(13.0, rel=0.25)
    # Li and Moisseev 2019 (as coded in cloudnetpy): the echo from above a melting layer loses 0.97 R^0.61 dB at Ka and
    # 2.9 R^0.42 at W band. Here two ways through the 500 m below the melting level, its mean factor 2.7.
    heights = np.linspace(-500.0, 0.0, 101)
    mean = np.mean([melting_factor(h) for h in heights])
    for frequency_hz, measured in ((35e9, 0.97), (94e9, 2.9)):
        rain = rain_attenuation_db_per_km(frequency_hz, rain_rate_mm_per_h=1.0, elevation_rad=math.pi / 2, tilt_rad=0.0)
        assert measured == pytest.approx(2 * 0.5 * mean * rain, rel=0.35)


def test_the_melting_factor_is_greatest_where_it_says():
    heights = np.linspace(-1200.0, 0.0, 2401)
    factors = np.array([melting_factor(h) for h in heights])
    assert factors.max() == pytest.approx(attenuation(50e9, 3.0, WET) / attenuation_of_rain(50e9, 3.0), rel=1e-4)
    assert factors[0] == pytest.approx(1.0, abs=0.05)
    assert factors[-1] == 0.0


def attenuation_of_rain(frequency_hz, rate):
    return rain_attenuation_db_per_km(frequency_hz, rain_rate_mm_per_h=rate, elevation_rad=0.0, tilt_rad=math.pi / 4)


def test_a_bright_band_shows_below_20_ghz_only():
    """Klaassen 1990 (IEE Proc. H 137, 39, abstract): melting snow reflects more than its rain only below 20 GHz."""
    brighter = {f: reflectivity(f, 2.0, WET) / rain_reflectivity_per_m(f, rain_rate_mm_per_h=2.0, temperature_k=283.15)
                for f in (10e9, 35e9, 77e9, 140e9)}  # fmt: skip
    assert brighter[10e9] > 1.5
    assert max(brighter[f] for f in (35e9, 77e9, 140e9)) < 1


@pytest.mark.parametrize("frequency_hz", [9e9, 160e9])
def test_snow_beyond_its_band_is_refused(frequency_hz):
    with pytest.raises(ValidityError, match="frequency_hz"):
        attenuation(frequency_hz, 1.0)
    with pytest.raises(ValidityError, match="frequency_hz"):
        reflectivity(frequency_hz, 1.0)
    with pytest.raises(ValidityError, match="snowfall"):
        flakes(0.0, DRY)
