"""Fitting a constant gamma to a material."""

import numpy as np
import pytest

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import load_scenario
from sionna_radar.studies.crosscheck.gamma_fit import fit_gamma, fit_material
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter, LambertianBackscatter


def test_a_constant_gamma_fits_itself():
    fit = fit_gamma(ConstantGammaBackscatter(0.01))
    assert fit.gamma_db == pytest.approx(-20.0)
    np.testing.assert_allclose(fit.residual_db, 0.0, atol=1e-9)
    assert fit.rms_db == pytest.approx(0.0, abs=1e-9)
    assert fit.failures == []


def test_a_lambertian_surface_needs_the_mean_of_its_cosine_in_db():
    fit = fit_gamma(LambertianBackscatter(1.0), 30.0, 60.0)
    cosine_db = 10 * np.log10(np.cos(np.deg2rad(np.arange(30, 61))))
    assert fit.gamma_db == pytest.approx(cosine_db.mean())
    assert fit.residual_db[0] == pytest.approx(-cosine_db.mean())
    assert fit.rms_db == pytest.approx(cosine_db.std())
    near_nadir, near_grazing = fit.failures
    assert near_nadir.startswith("0 to")
    assert "near nadir" in near_nadir
    assert "too weak" in near_nadir
    assert "near grazing" in near_grazing
    assert "too strong" in near_grazing


def test_a_span_or_material_that_is_none_is_refused():
    scenario = load_scenario("materials")
    with pytest.raises(ScenarioError, match="not a span"):
        fit_material(scenario, "dry_soil", 50.0, 40.0)
    with pytest.raises(ScenarioError, match=r"not a material of the scenario; use one of .*dry_soil"):
        fit_material(scenario, "moss")
    crossed = load_scenario("materials", {"radar.antenna.receive_polarization": "cross"})
    with pytest.raises(ScenarioError, match="scatters nothing"):
        fit_material(crossed, "concrete")


def test_the_command_reports_gamma_residuals_and_failures(cli):
    done = cli("fit", "materials", "--material", "concrete", "--from-deg", 30, "--to-deg", 60)
    fit = fit_material(load_scenario("materials"), "concrete", 30.0, 60.0)
    assert f"gamma = {fit.gamma_db:.2f} dB over 30 to 60 deg" in done.stdout
    assert f"{fit.residual_db[45]:+.2f}" in done.stdout
    assert "near nadir" in done.stdout
    assert "near grazing" in done.stdout
