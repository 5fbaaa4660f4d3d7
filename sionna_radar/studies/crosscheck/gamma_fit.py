"""Fit of a constant gamma to the backscatter of a material."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario import Scenario
from sionna_radar.surfaces.backscatter import Backscatter
from sionna_radar.surfaces.build import build_materials

STEP_DEG = 1.0
TOLERANCE_DB = 1.5
# Limits of angles described as near nadir and near grazing.
NEAR_NADIR_DEG, NEAR_GRAZING_DEG = 20.0, 70.0


@dataclass(frozen=True, kw_only=True)
class GammaFit:
    """A fitted constant gamma and its residuals.

    gamma_db: the mean of sigma0 over cos, both in dB, over the span: least squares in dB.
    incidence_deg, sigma0_db: the material at whole degrees from 0 to 89; -inf without backscatter.
    residual_db: material minus gamma cos at these angles.
    fitted: mask of the angles in the span.
    """

    gamma_db: float
    incidence_deg: Float[np.ndarray, " n"]
    sigma0_db: Float[np.ndarray, " n"]
    residual_db: Float[np.ndarray, " n"]
    fitted: Bool[np.ndarray, " n"]

    @property
    def rms_db(self) -> float:
        """Root mean square of the residual over the span."""
        return float(np.sqrt(np.mean(self.residual_db[self.fitted] ** 2)))

    @property
    def failures(self) -> list[str]:
        """Intervals of residuals beyond the tolerance, in words."""
        wrong = np.abs(self.residual_db) > TOLERANCE_DB
        starts = np.flatnonzero(wrong & ~np.concatenate([[False], wrong[:-1]]))
        ends = np.flatnonzero(wrong & ~np.concatenate([wrong[1:], [False]]))
        return [self._describe(slice(a, b + 1)) for a, b in zip(starts, ends, strict=True)]

    def _describe(self, run: slice) -> str:
        low_deg, high_deg = self.incidence_deg[run][[0, -1]]
        residual = self.residual_db[run]
        worst = residual[np.argmax(np.abs(residual))]
        place = (
            "near nadir" if low_deg < NEAR_NADIR_DEG else "near grazing" if high_deg > NEAR_GRAZING_DEG else "between"
        )
        deviation = "too weak" if worst > 0 else "too strong"
        return f"{low_deg:g} to {high_deg:g} deg ({place}): constant gamma is {deviation}, by up to {abs(worst):.1f} dB"


def fit_gamma(material: Backscatter, from_deg: float = 20.0, to_deg: float = 70.0) -> GammaFit:
    """Return the constant gamma that fits a material best over a span of incidence; ScenarioError for a wrong one."""
    if not 0 <= from_deg < to_deg < 90:
        message = f"{from_deg:g} to {to_deg:g} deg is not a span of incidence; give 0 <= from < to < 90"
        raise ScenarioError.of_option("--from-deg", message)
    angle_deg = np.arange(0.0, 90.0, STEP_DEG)
    with np.errstate(divide="ignore"):
        sigma0_db = 10 * np.log10(material.sigma0(np.deg2rad(angle_deg)))
    over_cosine_db = sigma0_db - 10 * np.log10(np.cos(np.deg2rad(angle_deg)))
    fitted = (angle_deg >= from_deg) & (angle_deg <= to_deg) & np.isfinite(sigma0_db)
    if not fitted.any():
        message = f"the material scatters nothing back from {from_deg:g} to {to_deg:g} deg in this channel"
        raise ScenarioError.of_option("--material", message)
    gamma_db = float(over_cosine_db[fitted].mean())
    return GammaFit(
        gamma_db=gamma_db,
        incidence_deg=angle_deg,
        sigma0_db=sigma0_db,
        residual_db=over_cosine_db - gamma_db,
        fitted=fitted,
    )


def fit_material(scenario: Scenario, name: str, from_deg: float = 20.0, to_deg: float = 70.0) -> GammaFit:
    """Return the constant gamma that fits a material of a scenario best; ScenarioError for none, and as `fit_gamma`."""
    tables = scenario.all_materials
    if name not in tables:
        message = f"{name!r} is not a material of the scenario; use one of {', '.join(sorted(tables))}"
        raise ScenarioError.of_option("--material", message)
    return fit_gamma(build_materials({name: tables[name]}, scenario.radar)[name], from_deg, to_deg)
