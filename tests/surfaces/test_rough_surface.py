"""Rough-surface models against published values, against each other in their limits, and against energy."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.constants import speed_of_light
from scipy.integrate import quad

from sionna_radar.surfaces.rough_surface import (
    GeometricalOptics,
    IntegralEquationModel,
    PhysicalOpticsModel,
    RoughSurface,
    SmallPerturbationModel,
    coherent_power_factor,
    fresnel_reflection,
)

CARRIER_HZ = 77e9
K = 2.0 * math.pi * CARRIER_HZ / speed_of_light
MODELS = (GeometricalOptics, PhysicalOpticsModel, SmallPerturbationModel, IntegralEquationModel)


def surface(ks: float, kl: float, correlation: str = "gaussian", permittivity: complex | float = 4.4 - 1.2j):
    return RoughSurface(
        permittivity=permittivity,
        rms_height_m=ks / K,
        correlation_length_m=kl / K,
        frequency_hz=CARRIER_HZ,
        correlation=correlation,
    )


def db(ratio):
    return 10.0 * np.log10(ratio)


def test_fresnel_has_its_known_values():
    # sqrt(4) = 2: nadir amplitude 1/3; Brewster at atan 2, where V vanishes; everything returns at grazing.
    assert fresnel_reflection(4.0, np.ones(1), "V") == pytest.approx([1 / 3])
    assert fresnel_reflection(4.0, np.ones(1), "H") == pytest.approx([-1 / 3])
    assert abs(fresnel_reflection(4.0, np.cos([math.atan(2.0)]), "V")) == pytest.approx([0.0], abs=1e-12)
    for polarization in ("V", "H"):
        assert abs(fresnel_reflection(4.0 - 1j, np.zeros(1), polarization)) == pytest.approx([1.0])


@pytest.mark.parametrize(
    ("polarization", "expected_db"),
    [
        ("V", [-20.25297061, -24.35232625, -26.74346526]),
        ("H", [-22.10327899, -28.69367149, -32.53013663]),
    ],
)
def test_iem_repeats_the_values_of_smrt(polarization, expected_db):
    # smrt/interface/test_iem_fung92.py: 2.2 GHz, eps 3 + 0.1j, s = 4.29 mm, L = 30 mm, exponential; 0.01 dB.
    ground = RoughSurface(
        permittivity=3.0 - 0.1j,
        rms_height_m=0.429e-2,
        correlation_length_m=3e-2,
        frequency_hz=2.2e9,
        correlation="exponential",
    )
    model = IntegralEquationModel(surface=ground, polarization=polarization, fresnel_angle="incidence")
    np.testing.assert_allclose(db(model.sigma0(np.radians([30.0, 50.0, 60.0]))), expected_db, atol=0.01)


# Printed by SMRT 1.7 (`IEM_Fung92`, 40 terms) at 10, 30, 50 and 70 deg: eps 5 - 0.5j, s = 0.3 mm, L = 1.5 mm.
# radarscatter (github djshiltz/radarscatter), whose field coefficients are written in another form, those of Fung and
# Chen (2010) with three terms each, prints the same within 0.001 dB.
IEM_OF_OTHERS_DB = {
    (77e9, "gaussian", "V"): [-4.2960, -7.7944, -14.8507, -25.8764],
    (77e9, "gaussian", "H"): [-4.6330, -10.0855, -18.2659, -27.3365],
    (77e9, "exponential", "V"): [-4.2539, -10.8550, -14.9613, -20.5933],
    (77e9, "exponential", "H"): [-4.6101, -13.0851, -19.6449, -27.2765],
    (94e9, "gaussian", "V"): [-2.4129, -7.4645, -17.0727, -32.7156],
    (94e9, "gaussian", "H"): [-2.7619, -9.3165, -17.8985, -27.6289],
    (94e9, "exponential", "V"): [-3.1994, -10.0329, -14.1319, -19.6811],
    (94e9, "exponential", "H"): [-3.5705, -12.0197, -18.1003, -24.9913],
}


@pytest.mark.parametrize(("case", "expected_db"), IEM_OF_OTHERS_DB.items())
def test_iem_at_millimetre_waves_is_that_of_two_other_programs(case, expected_db):
    frequency_hz, correlation, polarization = case
    ground = RoughSurface(
        permittivity=5.0 - 0.5j,
        rms_height_m=0.3e-3,
        correlation_length_m=1.5e-3,
        frequency_hz=frequency_hz,
        correlation=correlation,
    )
    model = IntegralEquationModel(surface=ground, polarization=polarization, fresnel_angle="incidence")
    sigma0_db = db(model.sigma0(np.radians([10.0, 30.0, 50.0, 70.0])))
    np.testing.assert_allclose(sigma0_db, expected_db, atol=2e-3)


@pytest.mark.parametrize("correlation", ["gaussian", "exponential"])
@pytest.mark.parametrize("polarization", ["V", "H"])
def test_iem_becomes_small_perturbation_for_a_nearly_smooth_surface(correlation, polarization):
    smooth = surface(0.03, 2.0, correlation)
    angles = np.radians([0.0, 20.0, 40.0, 60.0])
    iem = IntegralEquationModel(surface=smooth, polarization=polarization).sigma0(angles)
    spm = SmallPerturbationModel(surface=smooth, polarization=polarization).sigma0(angles)
    np.testing.assert_allclose(db(iem), db(spm), atol=0.03)


@pytest.mark.parametrize("polarization", ["V", "H"])
def test_iem_becomes_geometrical_optics_for_a_very_rough_surface(polarization):
    rough = surface(8.0, 60.0)
    angles = np.radians([0.0, 10.0, 20.0, 30.0])
    iem = IntegralEquationModel(surface=rough, polarization=polarization).sigma0(angles)
    optics = GeometricalOptics(surface=rough, polarization=polarization).sigma0(angles)
    np.testing.assert_allclose(db(iem), db(optics), atol=0.1)


def share_of_nadir_written_plainly(ground, angle):
    """Sum the series of Wu and others (2001) term by term, as `iemb.m` of the CReSIS toolbox does."""
    cs, s, eps = math.cos(angle), math.sin(angle), ground.permittivity
    depth = (ground.relative_height * cs) ** 2
    nadir = (np.sqrt(eps) - 1) / (np.sqrt(eps) + 1)
    ft = 8 * nadir**2 * s**2 * (cs + np.sqrt(eps - s**2)) / (cs * np.sqrt(eps - s**2))
    top = bottom = 0.0
    for n in range(1, 40):
        term = depth**n / math.factorial(n) * ground.spectrum(n, np.array([2 * ground.wavenumber * s]))[0]
        top += 0.25 * abs(ft) ** 2 * term
        bottom += term * abs(ft / 2 + 2 ** (n + 1) * nadir / cs * math.exp(-depth)) ** 2
    return 1 - top / bottom * abs(1 + 8 * nadir / (cs * ft)) ** 2


@pytest.mark.parametrize("correlation", ["gaussian", "exponential"])
@pytest.mark.parametrize(("ks", "kl"), [(0.1, 1.0), (0.7, 4.0), (1.5, 6.0)])
@pytest.mark.parametrize("incidence_deg", [3.0, 40.0, 75.0, 89.0])
@pytest.mark.parametrize("polarization", ["V", "H"])
def test_the_fresnel_coefficient_of_iem_goes_from_incidence_to_nadir(correlation, ks, kl, incidence_deg, polarization):
    ground, angle = surface(ks, kl, correlation), math.radians(incidence_deg)
    share = share_of_nadir_written_plainly(ground, angle)
    at_incidence = fresnel_reflection(ground.permittivity, np.cos([angle]), polarization)
    at_nadir = fresnel_reflection(ground.permittivity, np.ones(1), polarization)
    model = IntegralEquationModel(surface=ground, polarization=polarization)
    used = model._reflection(np.cos([angle]))
    assert used == pytest.approx(at_incidence + share * (at_nadir - at_incidence), rel=1e-9)


@pytest.mark.parametrize("polarization", ["V", "H"])
@pytest.mark.parametrize(("ks", "kl"), [(0.5, 3.0), (1.0, 10.0), (2.5, 12.0)])
def test_iem_falls_toward_grazing_however_rough_the_surface(polarization, ks, kl):
    angles = np.radians([85.0, 88.0, 89.5])
    for correlation in ("gaussian", "exponential"):
        ground = surface(ks, kl, correlation)
        falling = db(IntegralEquationModel(surface=ground, polarization=polarization).sigma0(angles))
        assert np.all(np.diff(falling) < -2.0)
    # A coefficient taken at nadir does not vanish there and lets sigma0 grow without bound.
    nadir = IntegralEquationModel(surface=ground, polarization=polarization, fresnel_angle="nadir").sigma0(angles)
    assert np.all(np.diff(db(nadir)) > 10.0)


def test_physical_optics_becomes_geometrical_optics_near_nadir():
    rough = surface(8.0, 60.0)
    angles = np.radians([0.0, 5.0])
    physical = PhysicalOpticsModel(surface=rough).sigma0(angles)
    np.testing.assert_allclose(db(physical), db(GeometricalOptics(surface=rough).sigma0(angles)), atol=0.1)


@pytest.mark.parametrize("slope", [0.1, 0.2, 0.3, 0.4])
def test_geometrical_optics_at_nadir(slope):
    # The surfaces of Ulaby, Moore and Fung II Fig. 12.2: eps = 1.6, R(0) = (sqrt(1.6) - 1)/(sqrt(1.6) + 1).
    ground = surface(5.0, 5.0 * math.sqrt(2.0) / slope, permittivity=1.6)
    reflection = (math.sqrt(1.6) - 1.0) / (math.sqrt(1.6) + 1.0)
    expected = reflection**2 / (2.0 * slope**2)
    assert GeometricalOptics(surface=ground).sigma0(np.zeros(1)) == pytest.approx([expected])


def test_small_perturbation_by_hand():
    # eps = 4 at 60 deg: q^2 = 4 - 3/4, alpha_hh = (1/2 - q)/(1/2 + q),
    # alpha_vv = 3 (4 (1 + 3/4) - 3/4) / (2 + q)^2; times 4 k^4 s^2 L^2 cos^4 exp(-(k L sin)^2), ks .1, kl 1.
    ground = surface(0.1, 1.0, permittivity=4.0)
    q = math.sqrt(3.25)
    common = 4.0 * 0.1**2 * 1.0**2 * 0.5**4 * math.exp(-0.75)
    angle = np.array([math.pi / 3])
    h = SmallPerturbationModel(surface=ground, polarization="H").sigma0(angle)
    v = SmallPerturbationModel(surface=ground, polarization="V").sigma0(angle)
    assert h == pytest.approx([common * ((0.5 - q) / (0.5 + q)) ** 2])
    assert v == pytest.approx([common * (3.0 * 6.25 / (2.0 + q) ** 2) ** 2])


def test_h_exceeds_v_under_physical_optics():
    # The tangent plane reflects by Fresnel, and |R_h| > |R_v| at every slant angle.
    ground = surface(1.0, 10.0)
    angles = np.radians([10.0, 30.0, 50.0])
    v = PhysicalOpticsModel(surface=ground, polarization="V").sigma0(angles)
    assert np.all(PhysicalOpticsModel(surface=ground, polarization="H").sigma0(angles) > v)


@pytest.mark.parametrize("model", MODELS)
def test_polarizations_agree_at_nadir(model):
    ground = surface(1.0, 8.0)
    v = model(surface=ground, polarization="V").sigma0(np.zeros(1))
    assert v == pytest.approx(model(surface=ground, polarization="H").sigma0(np.zeros(1)))


@given(
    ks=st.floats(0.01, 6.0),
    kl=st.floats(0.5, 60.0),
    real=st.floats(1.0, 40.0),
    loss=st.floats(0.0, 40.0),
    correlation=st.sampled_from(["gaussian", "exponential"]),
    polarization=st.sampled_from(["V", "H"]),
)
def test_sigma0_is_finite_and_never_negative(ks, kl, real, loss, correlation, polarization):
    ground = surface(ks, kl, correlation, complex(real, -loss))
    angles = np.array([0.0, 0.3, 1.0, 1.5, 1.5707, math.pi / 2, 2.0])
    for model in MODELS:
        if model is GeometricalOptics and correlation == "exponential":
            continue
        value = model(surface=ground, polarization=polarization).sigma0(angles)
        assert np.all(np.isfinite(value))
        assert np.all(value >= 0.0)
        assert np.all(value[-2:] == 0.0)


def hemisphere_share_at_nadir(model) -> float:
    """Return the diffuse power scattered over the hemisphere from a wave at nadir, over that which came in.

    Near the mirror direction a wave that leaves at an angle t from nadir met a facet tilted by t/2, which
    seen in backscatter is an incidence of t/2: sigma(0 -> t) = sigma0(t/2), exact in geometrical optics but
    for the Fresnel coefficient.
    """
    value, _ = quad(
        lambda half: model.sigma0(np.array([half]))[0] * 2.0 * math.sin(2.0 * half),
        0.0,
        math.pi / 4,
        limit=200,
    )
    return 0.5 * value


def test_geometrical_optics_scatters_what_fresnel_reflects():
    ground = surface(10.0, 60.0)
    reflected = abs(fresnel_reflection(ground.permittivity, np.ones(1), "V")[0]) ** 2
    slope = ground.rms_slope
    # Analytic: facets steeper than 45 deg would send the wave downwards, and are left out.
    expected = reflected * (1.0 - math.exp(-1.0 / (2.0 * slope**2)))
    assert hemisphere_share_at_nadir(GeometricalOptics(surface=ground)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("ks", [0.2, 0.5, 1.0])
def test_coherent_and_diffuse_power_add_up_to_fresnel(ks):
    ground = surface(ks, 60.0)
    reflected = abs(fresnel_reflection(ground.permittivity, np.ones(1), "V")[0]) ** 2
    coherent = reflected * coherent_power_factor(ground.rms_height_m, CARRIER_HZ, np.zeros(1))[0]
    for model in (PhysicalOpticsModel(surface=ground), IntegralEquationModel(surface=ground)):
        total = coherent + hemisphere_share_at_nadir(model)
        assert total == pytest.approx(reflected, rel=0.01)
        assert total <= 1.0


def test_coherent_power_factor():
    # k s = 1 at nadir: exp(-4); cos 60 = 1/2: exp(-1).
    factor = coherent_power_factor(1.0 / K, CARRIER_HZ, np.radians([0.0, 60.0]))
    assert factor == pytest.approx([math.exp(-4.0), math.exp(-1.0)])


@pytest.mark.parametrize(
    ("model", "ground", "words"),
    [
        (GeometricalOptics, surface(0.3, 20.0), ["not rough enough"]),
        (GeometricalOptics, surface(3.0, 4.0), ["too short", "too sharp"]),
        (PhysicalOpticsModel, surface(1.0, 3.0), ["too short", "too sharp"]),
        (SmallPerturbationModel, surface(0.5, 2.0), ["too rough"]),
        (SmallPerturbationModel, surface(0.2, 0.2), ["too steep"]),
        (IntegralEquationModel, surface(4.0, 20.0), ["too rough"]),
        (GeometricalOptics, surface(3.0, 30.0), []),
        (PhysicalOpticsModel, surface(0.5, 20.0), []),
        (SmallPerturbationModel, surface(0.1, 2.0), []),
        (IntegralEquationModel, surface(1.0, 5.0), []),
    ],
)
def test_validity_says_what_is_violated(model, ground, words):
    violated = model(surface=ground).validity()
    assert len(violated) == len(words)
    assert all(word in said for word, said in zip(words, violated, strict=True))


def test_iem_with_fresnel_at_incidence_is_limited_in_length():
    model = IntegralEquationModel(surface=surface(1.0, 20.0), fresnel_angle="incidence")
    assert "k s k L = 20" in model.validity()[0]


def test_models_refuse_surfaces_they_cannot_do():
    for model in (PhysicalOpticsModel, IntegralEquationModel):
        with pytest.raises(ValueError, match="use GeometricalOptics"):
            model(surface=surface(30.0, 300.0))
