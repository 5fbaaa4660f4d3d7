"""Parameters of materials from levels of backscatter: estimates, their uncertainty, and what trades off.

A level is the mean power of L independent looks at one cover, incidence and linear polarization, as a sigma0. Speckle
makes it a gamma variable of shape L about its mean (Ulaby, Moore and Fung 1982, "Microwave Remote Sensing" II,
section 7-2), so that its logarithm has the mean digamma(L) - log(L) about that of sigma0, and the variance
trigamma(L). These logarithms are fitted by weighted least squares, together with what was known of the parameters
beforehand and, of a radar that is not calibrated, a level that all rows share.

Heights, lengths, losses and permittivities (less that of air) are fitted as logarithms, levels as decibels. With the
covariance of the estimate it is known which parameters are observable (`studies.calibration.estimation.Posterior`),
which directions they leave open, and, with the information of rows that were not measured, which measurements would
make more parameters observable.

A constant gamma against another model's curve is the case of one parameter, equal weights and nothing known before.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.constants import speed_of_light
from scipy.optimize import least_squares
from scipy.special import digamma, gammaincc, polygamma

from sionna_radar.foundation.bounds import check_bounds
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.foundation.input_file import shown
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.numerics import is_number
from sionna_radar.scenario.bases import MaterialParameters
from sionna_radar.scenario.materials import (
    ConstantGamma,
    EmpiricalTable,
    IntegralEquation,
    Lambertian,
    PhysicalOptics,
    RoughTable,
    SurfaceTable,
)
from sionna_radar.scenario.parts import MATERIALS
from sionna_radar.studies.calibration.estimation import MIN_P_VALUE, Further, Posterior
from sionna_radar.surfaces.backscatter import Levels
from sionna_radar.surfaces.build import table_permittivity
from sionna_radar.surfaces.radar_material import TYPICAL_CROSS_POLAR_DB, as_radar_material
from sionna_radar.surfaces.rough_surface import MAX_RELATIVE_HEIGHT

NEPERS_PER_DB = math.log(10) / 10
# Known beforehand of a parameter unless stated: to a factor e, and levels to 10 dB.
PRIOR_NEPERS, PRIOR_DB = 1.0, 10.0
# Fitted as logarithms, above these values.
LOGARITHMIC = {"rms_height_m": 0.0, "correlation_length_m": 0.0, "permittivity": 1.0, "loss": 0.0}
CALIBRATION, CROSS = "calibration_db", "cross_polar_db"
# Step of difference quotients, in nepers or dB: rounding and curvature are both below 1e-8 of a derivative.
STEP = 1e-5
# Standard deviation that stands for one of a parameter of which nothing is known.
UNKNOWN = 1e6
# Heights and lengths that are tried as a start, from those believed, in standard deviations beforehand.
SCANNED = np.linspace(-3.0, 3.0, 13)
# Hypothetical measurements for the design table: amplitude sigma (dB) and incidence angles (deg).
CALIBRATED_DB = 0.5
WIDE_DEG = np.arange(5.0, 76.0, 10.0)
# Polarization angle up to which a level counts as VV, and complement from which it counts as HH.
POLARIZATION_LIMIT_RAD = math.pi / 6


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """A parameter to estimate.

    cover, key: of the material's table; `loss` is the imaginary part of its permittivity; no cover for the radar's.
    start, prior: its value beforehand and its standard deviation, both in nepers above `floor`, or as they are.
    floor: lower limit of a parameter fitted as logarithm; None for others. most: the largest fitted number.
    """

    cover: str
    key: str
    start: float
    prior: float
    floor: float | None
    most: float = math.inf

    @property
    def name(self) -> str:
        """The dotted name."""
        return f"{self.cover}.{self.key}" if self.cover else self.key

    @property
    def weight(self) -> float:
        """The inverse of the standard deviation beforehand."""
        return 1 / self.prior

    def value(self, scaled: float) -> float:
        """Return the parameter for its fitted number."""
        return scaled if self.floor is None else self.floor + math.exp(scaled)


@dataclass(frozen=True, kw_only=True)
class MaterialFit:
    """Estimated parameters of materials, and what the levels tell of them.

    scaled: estimates as they were fitted, in nepers, dB or the unit of the key. fitted: sigma0 of the rows, with the
    calibration's estimate. chi2: sum of squared residuals, over their variances; dof: its degrees of freedom.
    tables: materials with the estimates. measures: hypothetical further measurements.
    """

    levels: Levels
    unknowns: tuple[Unknown, ...]
    scaled: Float[np.ndarray, " unknown"]
    posterior: Posterior
    fitted: Float[np.ndarray, " row"]
    chi2: float
    dof: int
    tables: Mapping[str, MaterialParameters]
    measures: tuple[Further, ...]

    @cached_property
    def estimates(self) -> dict[str, float]:
        """Estimates in the units of their keys."""
        return {u.name: u.value(float(t)) for u, t in zip(self.unknowns, self.scaled, strict=True)}

    def intervals(self, sigmas: float) -> dict[str, tuple[float, float]]:
        """Return intervals of so many standard deviations to each side, of the fitted numbers, in the keys' units."""
        width = sigmas * self.posterior.sigma
        return {
            u.name: (u.value(float(t - w)), u.value(float(t + w)))
            for u, t, w in zip(self.unknowns, self.scaled, width, strict=True)
        }

    @property
    def p_value(self) -> float:
        """Probability of residuals as large by speckle and what is stated alone."""
        return float(gammaincc(self.dof / 2, self.chi2 / 2))

    @property
    def model_holds(self) -> bool:
        """Whether the models describe the levels."""
        return self.p_value >= MIN_P_VALUE


@on_one_thread
def fit_materials(
    levels: Levels,
    tables: Mapping[str, MaterialParameters],
    carrier_hz: float,
    *,
    free: Sequence[str] = (),
    prior: Mapping[str, float] | None = None,
    calibration_sigma_db: float = 0.0,
    level_sigma_db: float = 0.0,
) -> MaterialFit:
    """Estimate parameters of materials from levels.

    Parameters
    ----------
    levels:
        Measured or simulated levels; their covers name materials.
    tables:
        Materials with the values that were believed beforehand.
    carrier_hz:
        Carrier, to which heights and lengths are compared.
    free:
        Parameters to estimate, `cover.key`: numbers of the tables, and `loss`. Without any: the level of a simple
        law; rms height, correlation length, permittivity and loss of a rough surface.
    prior:
        Standard deviation beforehand of a parameter: a factor above 1 for heights, lengths, permittivities and losses,
        the unit of the key for others. Infinite if nothing is known.
    calibration_sigma_db:
        Standard deviation of an unknown level that all rows share.
    level_sigma_db:
        Standard deviation of each level by itself, beside speckle.

    Returns
    -------
    The estimates in the units of their keys, with standard deviations and the goodness of the fit.

    Raises
    ------
    ScenarioError
        An unknown cover, parameter or prior, or levels that have neither looks nor a standard deviation.

    Examples
    --------
    >>> from sionna_radar.studies.material_fit import measure_levels
    >>> tables = load_scenario("two_fields").all_materials
    >>> levels = measure_levels(prepare(load_scenario("two_fields", {"tracing.paths_per_pulse": 64})), pulses=200)
    >>> fit = fit_materials(levels, {name: tables[name] for name in ("weak", "strong")}, 77e9)
    >>> low, high = fit.intervals(4.0)["weak.gamma_db"]
    >>> low < -28 < high
    True

    """
    sigmas_db = {"calibration-sigma-db": calibration_sigma_db, "level-sigma-db": level_sigma_db}
    check_bounds((name, value, 0.0, 1e3) for name, value in sigmas_db.items())
    tables = {name: _with_cross_polar(table) for name, table in tables.items()} if levels.cross.any() else tables
    unknowns = _unknowns(levels, tables, carrier_hz, free, prior or {}, calibration_sigma_db)
    sigma = _sigma(levels.looks, level_sigma_db)
    if not (sigma > 0).all():
        message = f"{level_sigma_db:g} dB, and the levels have no looks; add a column looks, or state a deviation"
        raise ScenarioError.of_option("--level-sigma-db", message)
    with np.errstate(invalid="ignore"):
        bias = np.where(np.isinf(levels.looks), 0.0, digamma(levels.looks) - np.log(levels.looks))
    model = _Model(levels=levels, unknowns=unknowns, tables=tables, carrier_hz=carrier_hz)
    problem = _Problem(model=model, measured=np.log(levels.sigma0) - bias, sigma=sigma)
    scaled, chi2 = problem.solve(np.array([u.start for u in unknowns]))
    dof = len(levels) - sum(math.isinf(u.prior) for u in unknowns)
    if chi2 > dof:
        scaled, chi2 = min((scaled, chi2), problem.solve(problem.scanned()), key=lambda found: found[1])
    rates = model.rates(scaled) / sigma[:, None]
    prior_known = np.minimum([u.prior for u in unknowns], UNKNOWN)
    posterior = Posterior(names=tuple(u.name for u in unknowns), prior=prior_known, information=rates.T @ rates)
    return MaterialFit(
        levels=levels,
        unknowns=unknowns,
        scaled=scaled,
        posterior=posterior,
        fitted=np.exp(model.predict(scaled)),
        chi2=chi2,
        dof=dof,
        tables={name: model.table(name, scaled) for name in dict.fromkeys(levels.cover)},
        measures=_measures(model, scaled, posterior, level_sigma_db, calibration_sigma_db),
    )


def _with_cross_polar(table: MaterialParameters) -> MaterialParameters:
    """Return a material that has a cross-polar ratio: a typical one unless it is given."""
    if isinstance(table, SurfaceTable) and table.cross_polar_db is None:
        return table.model_copy(update={"cross_polar_db": TYPICAL_CROSS_POLAR_DB})
    return table


def _sigma(looks: Float[np.ndarray, " row"], level_sigma_db: float) -> Float[np.ndarray, " row"]:
    """Return standard deviations of logarithms of levels."""
    speckle = np.where(np.isinf(looks), 0.0, polygamma(1, np.where(np.isinf(looks), 1.0, looks)))
    return np.sqrt(speckle + (NEPERS_PER_DB * level_sigma_db) ** 2)


# -------------------------------------------------------------------------------------------------------- parameters
def _unknowns(
    levels: Levels,
    tables: Mapping[str, MaterialParameters],
    carrier_hz: float,
    free: Sequence[str],
    prior: Mapping[str, float],
    calibration_sigma_db: float,
) -> tuple[Unknown, ...]:
    covers = list(dict.fromkeys(levels.cover))
    if strange := [name for name in covers if name not in tables]:
        message = f"has the cover {shown(strange[0])}, which is no material; use {', '.join(sorted(tables))}"
        raise ScenarioError.of_option("--levels", message)
    usual = {cover: _usual(tables[cover]) for cover in covers}
    usual |= {cover: (*keys, CROSS) for cover, keys in usual.items() if levels.cross[levels.of(cover)].any()}
    names = list(dict.fromkeys(free)) or [f"{cover}.{key}" for cover, keys in usual.items() for key in keys]
    if not names:
        message = f"is needed: nothing is estimated by default of {', '.join(covers)}; name COVER.KEY"
        raise ScenarioError.of_option("--free", message)
    if strange := [name for name in prior if name not in names]:
        message = f"{shown(strange[0])} is not estimated; give one of {', '.join(names)}"
        raise ScenarioError.of_option("--prior", message)
    found = []
    for name in names:
        cover, _, key = name.partition(".")
        value = _values(tables[cover], carrier_hz).get(key) if cover in covers else None
        if value is None:
            known = [f"{cover}.{key}" for cover in covers for key in _values(tables[cover], carrier_hz)]
            message = f"{shown(name)} is no parameter of a cover of the levels; give some of {', '.join(known)}"
            raise ScenarioError.of_option("--free", message)
        found.append(_unknown(tables[cover], name, value, prior.get(name), carrier_hz))
    if calibration_sigma_db > 0:
        found.append(Unknown(cover="", key=CALIBRATION, start=0.0, prior=calibration_sigma_db, floor=None))
    return tuple(found)


def _usual(table: MaterialParameters) -> tuple[str, ...]:
    """Return the parameters of a material that are estimated unless others are named."""
    match table:
        case ConstantGamma():
            return ("gamma_db",)
        case Lambertian():
            return ("nadir_sigma0_db",)
        case RoughTable():
            return ("rms_height_m", "correlation_length_m", "permittivity", "loss")
    return ()


def _values(table: MaterialParameters, carrier_hz: float) -> dict[str, float]:
    """Return the numbers of a material that its backscatter may depend on."""
    found = {key: float(value) for key, value in table if is_number(value) and key != "fetch_m"}
    if isinstance(table, ConstantGamma):
        found["gamma_db"] = 10 * math.log10(table.gamma)
    if isinstance(table, RoughTable):
        permittivity = table_permittivity(table, carrier_hz)
        assert permittivity is not None  # checked with the scenario
        found |= {"permittivity": permittivity.real, "loss": -permittivity.imag}
    if isinstance(table, EmpiricalTable):
        found.pop("rms_height_m", None)  # of the mirror alone
    return found


def _unknown(table: MaterialParameters, name: str, value: float, prior: float | None, carrier_hz: float) -> Unknown:
    cover, _, key = name.partition(".")
    floor = LOGARITHMIC.get(key)
    if floor is not None:
        if value <= floor:
            message = f"is {value:g} in the scenario; give a value above {floor:g} to begin from"
            raise ScenarioError.of(f"materials.{name}", message)
        if prior is not None and not prior > 1:
            raise ScenarioError.of_option("--prior", f"{name}={prior:g} is no factor; give one above 1, e.g. {name}=2")
        # Beyond it the series of these models ends.
        highest_m = MAX_RELATIVE_HEIGHT * speed_of_light / (2 * math.pi * carrier_hz)
        bounded = key == "rms_height_m" and isinstance(table, PhysicalOptics | IntegralEquation)
        return Unknown(
            cover=cover,
            key=key,
            start=math.log(value - floor),
            prior=PRIOR_NEPERS if prior is None else math.log(prior),
            floor=floor,
            most=math.log(highest_m) if bounded else math.inf,
        )
    if prior is None and not key.endswith("_db"):
        message = f"{name} has no usual standard deviation; state one, {name}=VALUE in its unit"
        raise ScenarioError.of_option("--prior", message)
    if prior is not None and not prior > 0:
        raise ScenarioError.of_option("--prior", f"{name}={prior:g} is no standard deviation; give a positive one")
    return Unknown(cover=cover, key=key, start=value, prior=PRIOR_DB if prior is None else prior, floor=None)


# ------------------------------------------------------------------------------------------------------ model and fit
@dataclass(frozen=True, kw_only=True)
class _Model:
    """Logarithm of sigma0 of rows as a function of the fitted numbers."""

    levels: Levels
    unknowns: tuple[Unknown, ...]
    tables: Mapping[str, MaterialParameters]
    carrier_hz: float

    def table(self, cover: str, scaled: Float[np.ndarray, " unknown"]) -> MaterialParameters:
        """Return a material with the parameters."""
        table = self.tables[cover]
        values = {u.key: u.value(float(t)) for u, t in zip(self.unknowns, scaled, strict=True) if u.cover == cover}
        if {"permittivity", "loss"} & values.keys():
            beforehand = _values(table, self.carrier_hz)
            real, loss = (values.pop(key, beforehand[key]) for key in ("permittivity", "loss"))
            values |= {"permittivity": (real, loss), "medium": None}  # type: ignore[dict-item]
        if "gamma_db" in values:
            values["terrain_class"] = None  # type: ignore[assignment]
        return table.model_copy(update=values)

    def of_cover(self, cover: str, scaled: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " own"]:
        """Return the logarithm of sigma0 of the rows of a cover."""
        table, levels, own = self.table(cover, scaled), self.levels, self.levels.of(cover)
        material = as_radar_material(MATERIALS.entry(table.model)(table, self.carrier_hz, "VV"))
        sigma0 = material.linear_sigma0(levels.incidence_rad[own], levels.polarization_rad[own], levels.cross[own])
        return np.log(np.maximum(sigma0, np.finfo(float).tiny))

    def predict(self, scaled: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " row"]:
        """Return the logarithm of sigma0 of every row, with the calibration's level."""
        level_db = sum(float(t) for u, t in zip(self.unknowns, scaled, strict=True) if not u.cover)
        found = np.full(len(self.levels), NEPERS_PER_DB * level_db)
        for cover in dict.fromkeys(self.levels.cover):
            found[self.levels.of(cover)] += self.of_cover(cover, scaled)
        return found

    def rates(self, scaled: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, "row unknown"]:
        """Return the derivatives of `predict`: central difference quotients over the rows of each cover."""
        found = np.zeros((len(self.levels), len(scaled)))
        for k, (unknown, shift) in enumerate(zip(self.unknowns, STEP * np.eye(len(scaled)), strict=True)):
            if not unknown.cover:
                found[:, k] = NEPERS_PER_DB
                continue
            above, below = (self.of_cover(unknown.cover, scaled + sign * shift) for sign in (1, -1))
            found[self.levels.of(unknown.cover), k] = (above - below) / (2 * STEP)
        return found


@dataclass(frozen=True, kw_only=True)
class _Problem:
    """The least squares: residuals of rows over their standard deviations, and of what was known beforehand."""

    model: _Model
    measured: Float[np.ndarray, " row"]
    sigma: Float[np.ndarray, " row"]

    def solve(self, start: Float[np.ndarray, " unknown"]) -> tuple[Float[np.ndarray, " unknown"], float]:
        """Return the estimate, and the sum of squared residuals."""
        unknowns = self.model.unknowns
        beforehand, weight, most = np.array([(u.start, u.weight, u.most) for u in unknowns]).T

        def residuals(scaled: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, " residual"]:
            rows = (self.model.predict(scaled) - self.measured) / self.sigma
            return np.concatenate([rows, (scaled - beforehand) * weight])

        def jacobian(scaled: Float[np.ndarray, " unknown"]) -> Float[np.ndarray, "residual unknown"]:
            return np.concatenate([self.model.rates(scaled) / self.sigma[:, None], np.diag(weight)])

        # A quotient's step stays within the models' range.
        limits, first, tight = (-np.inf, most - 2 * STEP), np.minimum(start, most - 3 * STEP), 1e-12
        found = least_squares(residuals, first, jacobian, limits, x_scale="jac", xtol=tight, ftol=tight, gtol=tight)
        return found.x, float(2 * found.cost)

    def scanned(self) -> Float[np.ndarray, " unknown"]:
        """Return a start: the belief, with the heights and lengths near it that fit the levels of each cover best."""
        # The chi2 of a rough surface has several valleys: rougher or smoother, of longer or shorter waves.
        model, place = self.model, {u.name: k for k, u in enumerate(self.model.unknowns)}
        believed, weight, most = np.array([(u.start, u.weight, u.most) for u in model.unknowns]).T
        start, width = believed.copy(), np.minimum(1 / np.maximum(weight, 1e-9), PRIOR_NEPERS)
        for cover in dict.fromkeys(model.levels.cover):
            pair = [place.get(f"{cover}.{key}", -1) for key in ("rms_height_m", "correlation_length_m")]
            tried, own = [], model.levels.of(cover)
            for shift in itertools.product(SCANNED, SCANNED) if min(pair) >= 0 else ():
                at = believed.copy()
                at[pair] = np.minimum(at[pair] + shift * width[pair], most[pair] - 3 * STEP)
                rows = (model.of_cover(cover, at) - self.measured[own]) / self.sigma[own]
                tried.append((float(rows @ rows + np.sum(((at - believed) * weight) ** 2)), at[pair]))
            start[pair] = min(tried, key=lambda found: found[0])[1] if tried else start[pair]
        return start


def _measures(
    model: _Model,
    scaled: Float[np.ndarray, " unknown"],
    posterior: Posterior,
    level_sigma_db: float,
    calibration_sigma_db: float,
) -> tuple[Further, ...]:
    """Return measurements that were not made, each with the Fisher information that it would add."""
    levels, found = model.levels, []
    if calibration_sigma_db > CALIBRATED_DB:
        known = np.zeros_like(posterior.information)
        known[-1, -1] = 1 / CALIBRATED_DB**2
        name = f"a radar calibrated to {CALIBRATED_DB:g} dB, as by a reflector of known cross-section,"
        found.append(Further(name=name, posterior=posterior.with_more(known)))
    series = dict.fromkeys(
        zip(levels.cover, np.round(levels.polarization_rad, 6), map(bool, levels.cross), strict=True)
    )
    rows = [(*each, incidence) for each in series for incidence in np.deg2rad(WIDE_DEG)]
    both = (
        levels.polarization_rad.min() < POLARIZATION_LIMIT_RAD
        and levels.polarization_rad.max() > math.pi / 2 - POLARIZATION_LIMIT_RAD
    )
    turned = replace(levels, polarization_rad=math.pi / 2 - levels.polarization_rad)
    further = ({} if both else {"the other linear polarization": turned}) | {
        f"incidence from {WIDE_DEG[0]:g} to {WIDE_DEG[-1]:g} deg": Levels(
            cover=tuple(cover for cover, *_ in rows),
            incidence_rad=np.array([incidence for *_, incidence in rows]),
            polarization_rad=np.array([polarization for _, polarization, _, _ in rows]),
            cross=np.array([cross for _, _, cross, _ in rows]),
            sigma0=np.ones(len(rows)),
            looks=np.full(len(rows), float(np.median(levels.looks))),
        )
    }
    for name, added in further.items():
        rates = replace(model, levels=added).rates(scaled) / _sigma(added.looks, level_sigma_db)[:, None]
        found.append(Further(name=name, posterior=posterior.with_more(rates.T @ rates)))
    return tuple(found)
