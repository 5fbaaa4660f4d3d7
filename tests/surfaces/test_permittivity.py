"""Permittivities against values published elsewhere, and at their limits."""

import ast
import math
from importlib import metadata
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sionna_radar.scenario.materials import BuildingMedium
from sionna_radar.surfaces.permittivity import (
    SOURCES,
    asphalt_permittivity,
    building_permittivity,
    dry_snow_permittivity,
    ice_permittivity,
    soil_bulk_density_g_cm3,
    soil_permittivity,
    vegetation_permittivity,
    water_permittivity,
    wet_snow_permittivity,
)
from sionna_radar.surfaces.rough_surface import fresnel_reflection

CARRIER_HZ = 77e9
BUILDING_MATERIALS = get_args(BuildingMedium.model_fields["kind"].annotation)
LOAM = {"sand_percent": 40.0, "clay_percent": 20.0, "specific_gravity": 2.65}


@pytest.mark.parametrize(
    ("temperature_c", "wavelength_mm", "index"),
    [  # refractive indices of water tabulated in pytmatrix 0.2 (refractive.py; wavelengths in tmatrix_aux.py)
        (10.0, 3.19, 3.117 - 1.665j),
        (20.0, 3.19, 3.382 - 1.941j),
        (10.0, 8.43, 4.638 - 2.672j),
        (20.0, 8.43, 5.206 - 2.801j),
    ],
)
def test_water_agrees_with_tabulated_indices(temperature_c, wavelength_mm, index):
    permittivity = water_permittivity(299.792458e9 / wavelength_mm, temperature_c=temperature_c)
    assert abs(np.sqrt(permittivity) - index) < 0.02 * abs(index)


@pytest.mark.parametrize("temperature_c", [0.0, 10.0, 20.0, 30.0])
def test_water_agrees_with_an_independent_double_debye_fit(temperature_c):
    # Ulaby and Long 2014, Code 4.1 (0 to 30 deg C, up to 1000 GHz); times in nanoseconds.
    t, f = temperature_c, 77.0
    static = 87.85306 * math.exp(-0.00456992 * t)
    middle = 6.3000075 * math.exp(-0.26242021e-2 * t)
    slow = 0.17667420e-3 * math.exp(583.66888 / (t + 126.34992))
    fast = 0.69227972e-4 * math.exp(307.42330 / (t + 126.34992))
    high = 3.7245044 + 0.92609781e-2 * t
    expected = (
        (static - middle) / (1 + 2j * math.pi * f * slow) + (middle - high) / (1 + 2j * math.pi * f * fast) + high
    )
    actual = water_permittivity(CARRIER_HZ, temperature_c=t)
    assert abs(actual - expected) < 0.03 * abs(expected)


@pytest.mark.parametrize(
    ("frequency_ghz", "kelvin", "loss"),
    [  # MEMLS values repeated in SMRT's smrt/permittivity/test_ice.py
        (10, 270, 9.093e-4),
        (20, 270, 0.0017449),
        (40, 270, 0.0034535),
        (10, 250, 6.0571e-4),
        (40, 250, 0.0023952),
    ],
)
def test_ice_agrees_with_memls(frequency_ghz, kelvin, loss):
    permittivity = ice_permittivity(frequency_ghz * 1e9, temperature_c=kelvin - 273.15)
    assert permittivity.imag == pytest.approx(-loss, rel=0.01)
    assert permittivity.real == pytest.approx(3.18567 if kelvin == 270 else 3.1675, abs=1e-3)


def test_dry_snow_agrees_with_the_cubic_law():
    # Ulaby and Long 2014, Code 4.5: eps' = 1 + 1.4667 v + 1.435 v^3 below a volume fraction v of 0.45.
    for density in (0.1, 0.2, 0.3, 0.4):
        volume = density / 0.9167
        expected = 1 + 1.4667 * volume + 1.435 * volume**3
        actual = dry_snow_permittivity(CARRIER_HZ, temperature_c=-5.0, density_g_cm3=density)
        assert actual.real == pytest.approx(expected, rel=0.04)
        assert -ice_permittivity(CARRIER_HZ, temperature_c=-5.0).imag > -actual.imag > 0.0


def test_dry_snow_of_no_density_is_air():
    assert dry_snow_permittivity(CARRIER_HZ, temperature_c=-5.0, density_g_cm3=0.0) == 1.0


def test_wet_snow_has_the_right_ends():
    dry = dry_snow_permittivity(CARRIER_HZ, temperature_c=0.0, density_g_cm3=0.3)

    def wet(fraction: float) -> complex:
        return wet_snow_permittivity(CARRIER_HZ, temperature_c=0.0, dry_density_g_cm3=0.3, liquid_fraction=fraction)

    assert wet(0.0) == pytest.approx(dry)
    assert wet(1.0) == pytest.approx(water_permittivity(CARRIER_HZ, temperature_c=0.0))


@pytest.mark.parametrize(
    ("frequency_ghz", "liquid", "measured"),
    [  # Ulaby and Long 2014, Figs. 4-22 and 4-23, as read off in SMRT's test_snow_mixing_formula.py
        (3, 0.02, 1.604 - 0.051j),
        (3, 0.06, 2.129 - 0.218j),
        (37, 0.02, 1.303 - 0.056j),
        (37, 0.06, 1.43 - 0.239j),
    ],
)
def test_wet_snow_falls_short_of_measured_loss_as_documented(frequency_ghz, liquid, measured):
    actual = wet_snow_permittivity(
        frequency_ghz * 1e9, temperature_c=0.0, dry_density_g_cm3=0.25, liquid_fraction=liquid
    )
    assert actual.real == pytest.approx(measured.real, rel=0.25)
    assert abs(actual.imag) < 0.5 * abs(measured.imag)


@pytest.mark.parametrize("moisture", [0.10, 0.20, 0.30])
def test_soil_agrees_with_hallikainen_where_it_was_measured(moisture):
    # Hallikainen and others 1985, polynomial at 18 GHz, 40 % sand and 20 % clay (as in radarscatter).
    texture = np.array([1.0, 40.0, 20.0])
    powers = moisture ** np.arange(3)
    real = np.array([[1.912, 0.007, 0.021], [29.123, -0.190, -0.545], [6.960, 0.822, 1.195]]) @ texture
    loss = np.array([[-0.071, 0.000, 0.003], [6.938, 0.029, -0.128], [29.945, 0.275, 0.377]]) @ texture
    actual = soil_permittivity(18e9, temperature_c=23.0, water_fraction=moisture, **LOAM)
    assert actual.real == pytest.approx(powers @ real, rel=0.27)
    assert -actual.imag == pytest.approx(powers @ loss, rel=0.15)


def test_soil_equals_the_second_transcription_of_the_recommendation():
    # elvd/rf_sewer_pipes, itur_p527.py (P.527-4), worked by hand with its formulas at 10 GHz.
    f, moisture, grains = 10.0, 0.2, 2.65
    bulk = 1.07256 + 0.078886 * math.log(40) + 0.038753 * math.log(20) + 0.032732 * math.log(40)
    first = 0.0467 + 0.2204 * bulk - 0.004111 * 40 - 0.006614 * 20
    second = -1.645 + 1.939 * bulk - 0.0225622 * 40 + 0.01594 * 20
    common = (first - second) / (1 + (f / 1.35) ** 2)
    correction = 18 / f * (grains - bulk) / (grains * moisture)
    water = water_permittivity(f * 1e9, temperature_c=20.0)
    free = water.real + correction * common * f / 1.35
    free_loss = -water.imag + correction * (common + second)
    solid = (1.01 + 0.44 * grains) ** 2 - 0.062
    real = 1 - moisture + moisture ** (1.2748 - 0.00519 * 40 - 0.00152 * 20) * free**0.65
    real += bulk / grains * (solid**0.65 - 1)
    loss = moisture ** (1.33797 - 0.00603 * 40 - 0.00166 * 20) * free_loss**0.65
    actual = soil_permittivity(10e9, temperature_c=20.0, water_fraction=moisture, **LOAM)
    assert actual == pytest.approx(complex(real ** (1 / 0.65), -(loss ** (1 / 0.65))))


def test_dry_soil_is_lossless_and_bulk_density_ignores_traces():
    dry = soil_permittivity(CARRIER_HZ, temperature_c=20.0, water_fraction=0.0, **LOAM)
    assert dry.imag == 0.0
    nearly_dry = soil_permittivity(CARRIER_HZ, temperature_c=20.0, water_fraction=1e-300, **LOAM)
    assert nearly_dry == pytest.approx(dry)
    assert soil_bulk_density_g_cm3(100.0, 0.0) == pytest.approx(1.07256 + 0.078886 * math.log(100.0))


def test_vegetation_agrees_with_ulaby_and_long():
    # Ulaby and Long 2014, Code 4.8 (22 deg C, salinity 15), at 10 GHz and a moisture of 0.5.
    f, m = 10.0, 0.5
    conductivity = 0.17 * 15 - 0.0013 * 15**2
    free = 4.9 + 74.4 / (1 + 1j * f / 18) - 18j * conductivity / f
    root = math.sqrt(f / 0.36)
    bound = 2.9 + 55 * (1 + root - 1j * root) / ((1 + root) ** 2 + f / 0.36)
    expected = 1.7 - 0.74 * m + 6.16 * m**2
    expected += m * (0.55 * m - 0.076) * free + 4.64 * m**2 / (1 + 7.36 * m**2) * bound
    actual = vegetation_permittivity(10e9, temperature_c=22.0, water_fraction=m)
    assert abs(actual - expected) < 0.03 * abs(expected)


@pytest.mark.parametrize(
    ("material", "conductivity"),
    [("wood", 0.049528)],  # MathWorks buildingMaterialPermittivity, example at 9 GHz (P.2040 Table 3)
)
def test_building_conductivity_agrees_with_a_published_example(material, conductivity):
    permittivity = building_permittivity(material, 9e9)
    assert -permittivity.imag * 2 * math.pi * 9e9 * 8.8541878128e-12 == pytest.approx(conductivity, rel=1e-4)
    assert permittivity.real == pytest.approx(1.99)


def test_building_materials_are_those_of_the_installed_sionna():
    # Read as text: importing sionna.rt would load Mitsuba.
    files = metadata.files("sionna-rt") or []
    table = next(file for file in files if file.as_posix().endswith("radio_materials/itu.py"))
    tree = ast.parse(table.read_text())
    literal = next(node.value for node in tree.body if isinstance(node, ast.Assign))
    published = ast.literal_eval(literal)
    for material in BUILDING_MATERIALS:
        (_, highest_ghz), (a, b, c, d) = next(iter(published[material].items()))
        f = highest_ghz
        permittivity = building_permittivity(material, f * 1e9)
        conductivity = -permittivity.imag * 2 * math.pi * f * 1e9 * 8.8541878128e-12
        assert permittivity.real == pytest.approx(a * f**b)
        assert conductivity == pytest.approx(c * f**d)
        with pytest.raises(ValueError, match="frequency_hz"):
            building_permittivity(material, highest_ghz * 1.001e9)


def test_glass_agrees_with_a_measured_index_at_77_ghz():
    # n = 2.51 at 77 GHz: OpenMATERIAL issue 10, from Zhekov and others 2020 (whose loss is half more).
    assert math.sqrt(building_permittivity("glass", CARRIER_HZ).real) == pytest.approx(2.51, abs=0.005)


def test_metal_is_a_conductor():
    assert abs(building_permittivity("metal", CARRIER_HZ)) > 1e6


@pytest.mark.parametrize("material", ["brick", "plywood", "marble", "asphalt_concrete"])
def test_building_materials_are_refused_outside_their_band(material):
    with pytest.raises(ValueError, match=rf"frequency_hz = 7.7e\+10 .*{material}.*measured"):
        building_permittivity(material, CARRIER_HZ)


@pytest.mark.parametrize(("mix", "real"), [("AC11DS", 8.6), ("SMA8S", 10.4), ("SMA11S", 8.3)])
def test_asphalt_is_as_measured_at_77_ghz(mix, real):
    # OpenMATERIAL materials/data/<mix>_permittivity.gltf: 76-81 GHz, 45 deg (Kurz and others 2021).
    assert asphalt_permittivity(CARRIER_HZ, mix=mix) == real


def test_asphalt_is_refused_outside_the_measured_band():
    for frequency_hz in (24e9, 94e9, math.nan):
        with pytest.raises(ValueError, match=r"frequency_hz = .* is outside 7.6e\+10 to 8.1e\+10; give a measured"):
            asphalt_permittivity(frequency_hz, mix="SMA8S")


def test_concrete_reflects_as_measured_on_a_road():
    # The same campaign found 4.64 on concrete plates and 4.34 on a broom finish; P.2040-3 has 5.24.
    ours = building_permittivity("concrete", CARRIER_HZ)
    cosine = np.cos([math.radians(45.0)])
    for measured in (4.64, 4.34):
        ratio = abs(fresnel_reflection(ours, cosine, "H") / fresnel_reflection(measured, cosine, "H"))[0]
        assert 20 * math.log10(ratio) == pytest.approx(0.0, abs=1.1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: water_permittivity(2e12, temperature_c=20.0), "frequency_hz"),
        (lambda: water_permittivity(0.0, temperature_c=20.0), "must be positive"),
        (lambda: water_permittivity(CARRIER_HZ, temperature_c=60.0), "temperature_c = 60"),
        (lambda: water_permittivity(CARRIER_HZ, temperature_c=math.nan), "temperature_c = nan"),
        (lambda: ice_permittivity(CARRIER_HZ, temperature_c=1.0), "use water above"),
        (
            lambda: dry_snow_permittivity(140e9, temperature_c=-5.0, density_g_cm3=0.3),
            "frequency_hz",
        ),
        (
            lambda: dry_snow_permittivity(CARRIER_HZ, temperature_c=-5.0, density_g_cm3=300.0),
            "density_g_cm3 = 300",
        ),
        (
            lambda: wet_snow_permittivity(CARRIER_HZ, temperature_c=0.0, dry_density_g_cm3=0.3, liquid_fraction=6.0),
            "not a percentage",
        ),
        (
            lambda: soil_permittivity(CARRIER_HZ, temperature_c=20.0, water_fraction=0.6, **LOAM),
            "water cannot exceed",
        ),
        (
            lambda: soil_permittivity(CARRIER_HZ, temperature_c=-5.0, water_fraction=0.1, **LOAM),
            "frozen soil",
        ),
        (
            lambda: vegetation_permittivity(CARRIER_HZ, temperature_c=20.0, water_fraction=0.9),
            "water_fraction = 0.9",
        ),
    ],
)
def test_values_outside_their_range_are_refused(call, words):
    with pytest.raises(ValueError, match=words):
        call()


def test_every_published_band_holds_the_carrier():
    assert all(source.published_hz[0] < CARRIER_HZ <= source.published_hz[1] for source in SOURCES.values())


@given(
    frequency_hz=st.floats(1e9, 100e9),
    temperature_c=st.floats(1.0, 39.0),
    sand=st.floats(0.0, 100.0),
    clay_share=st.floats(0.0, 1.0),
    moisture=st.floats(0.0, 0.3),
)
def test_wet_matter_is_passive(frequency_hz, temperature_c, sand, clay_share, moisture):
    soil = soil_permittivity(
        frequency_hz,
        temperature_c=temperature_c,
        sand_percent=sand,
        clay_percent=clay_share * (100.0 - sand),
        water_fraction=moisture,
        specific_gravity=2.65,
    )
    leaf = vegetation_permittivity(frequency_hz, temperature_c=temperature_c, water_fraction=2 * moisture)
    for permittivity in (soil, leaf, water_permittivity(frequency_hz, temperature_c=temperature_c)):
        assert permittivity.real >= 1.0
        assert permittivity.imag <= 0.0


@given(
    frequency_hz=st.floats(1e9, 100e9),
    density=st.floats(0.0, 0.9),
    liquid=st.floats(0.0, 1.0),
    temperature_c=st.floats(-4.0, 0.0),
)
def test_snow_is_passive(frequency_hz, density, liquid, temperature_c):
    dry = dry_snow_permittivity(frequency_hz, temperature_c=temperature_c, density_g_cm3=density)
    wet = wet_snow_permittivity(
        frequency_hz, temperature_c=temperature_c, dry_density_g_cm3=density, liquid_fraction=liquid
    )
    assert dry.real >= 1.0
    assert dry.imag <= 0.0
    assert wet.real >= 1.0 - 1e-9
    assert wet.imag <= 1e-12


@pytest.mark.parametrize("material", BUILDING_MATERIALS)
def test_building_materials_are_passive(material):
    frequency_hz = 60e9 if material == "floorboard" else 30e9
    permittivity = building_permittivity(material, frequency_hz)
    assert permittivity.real >= 1.0
    assert permittivity.imag < 0.0
