"""Estimates of errors of an instrument: which of them a flight makes observable, and how well.

With the prior of an instrument as it was mounted, the posterior's covariance is the inverse of the information of its
echoes (`instrument_echoes`) and the prior's. An error is observable if its posterior sigma is less than
`MAX_POSTERIOR_RATIO` of its prior sigma. One that is not stays at zero, and its uncertainty goes into that of the
others ("consider" parameters: Schmidt 1966, "Application of state-space methods to navigation problems").

The score's real covariance decides about that of the estimate (Huber 1967, "The behavior of maximum likelihood
estimates under nonstandard conditions"). Weak cells count less than the information assumes, and where the model errs,
over trees or by a coarse reference, it errs alike along stretches of the flight. So all variances are multiplied with
the factor by which the scores of stretches scatter more than their information says. What speckle alone makes of it
follows from its covariance between cells and pulses; more than that, and more than chance explains, says that the model
misses something.

Where the reference lies beside its own datum is an error like the others: `datum_east` and so on, of the flight's
position minus the reference's.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors, stretches
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.navigation.echo_errors import ErrorsLinearised, RangeProfiles, Stage, Step
from sionna_radar.mapping.navigation.joint import FirstGround, MeasuredPlaces, Varying, joint_system
from sionna_radar.mapping.navigation.refinement import MAX_POSTERIOR_RATIO, MAX_REDUCED_CHI2
from sionna_radar.studies.calibration.instrument_echoes import CombinedEchoes, Drift

# Steps of scoring at most.
MAX_STEPS = 12
# p-value below which a model of echoes or of their levels is rejected.
MIN_P_VALUE = 1e-3
# Scatter of stretches over that of speckle above which errors of the model decide, not the instrument's. By choice:
# over woods of 8 m it was 79, of a flown altimeter 70, and of one over open country whose bias wanders 6.
MAX_EXCESS = 10.0
# Components of a direction that are named.
NAMED = 0.3


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Posterior of errors with a Gaussian prior, given the Fisher information of a flight.

    names: of the errors; prior: their prior sigmas; information: of the echoes. All SI.
    """

    names: tuple[str, ...]
    prior: Float[np.ndarray, " error"]
    information: Float[np.ndarray, "error error"]

    @cached_property
    def covariance(self) -> Float[np.ndarray, "error error"]:
        """Covariance of the errors after the flight."""
        # In units of the prior, where the matrix is well conditioned.
        scaled = self.prior[:, None] * self.information * self.prior + np.eye(len(self.prior))
        return self.prior[:, None] * np.linalg.inv(scaled) * self.prior

    @property
    def sigma(self) -> Float[np.ndarray, " error"]:
        """Standard deviations of the errors after the flight."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Float[np.ndarray, "error error"]:
        """Correlations of the errors after the flight."""
        return self.covariance / np.outer(self.sigma, self.sigma)

    @cached_property
    def observable(self) -> Bool[np.ndarray, " error"]:
        """Which errors are observable: what is left once the others, the least known first, are held at zero.

        One that is held keeps its prior sigma, which adds to that of the others.
        """
        observable = np.ones(len(self.names), dtype=bool)
        while observable.any():
            sigma = np.sqrt(np.diag(self.considered(observable)))
            share = np.where(observable, sigma / self.prior, 0.0)
            if share.max() <= MAX_POSTERIOR_RATIO:
                break
            observable[int(np.argmax(share))] = False
        return observable

    def considered(self, free: Bool[np.ndarray, " error"]) -> Float[np.ndarray, "error error"]:
        """Return the covariance if some errors are estimated, and the others are held at zero."""
        known = Posterior(
            names=tuple(n for n, is_free in zip(self.names, free, strict=True) if is_free),
            prior=self.prior[free],
            information=self.information[np.ix_(free, free)],
        )
        result = np.diag(self.prior**2)
        if free.any():
            gain = -known.covariance @ self.information[np.ix_(free, ~free)]
            cross = gain * self.prior[~free] ** 2
            result[np.ix_(free, free)] = known.covariance + cross @ gain.T
            result[np.ix_(free, ~free)], result[np.ix_(~free, free)] = cross, cross.T
        return result

    @property
    def null_space(self) -> list[dict[str, float]]:
        """Null space of the information: how much of each error (SI) leaves the echoes nearly as they are.

        Directions along which the ratio of posterior to prior sigma stays above `MAX_POSTERIOR_RATIO`, worst first; of
        each the parts that are more than `NAMED` of the greatest, in units of the prior.
        """
        value, vector = np.linalg.eigh(self.prior[:, None] * self.information * self.prior)
        found = []
        for k in np.flatnonzero(1 / (1 + np.maximum(value, 0.0)) > MAX_POSTERIOR_RATIO**2):
            part = vector[:, k] / np.abs(vector[:, k]).max()
            part *= np.sign(part[int(np.argmax(np.abs(part)))])
            found.append(
                {n: float(p * s) for n, p, s in zip(self.names, part, self.prior, strict=True) if abs(p) > NAMED}
            )
        return found

    def with_more(self, information: Float[np.ndarray, "error error"]) -> "Posterior":
        """Return the posterior with the information of another flight added."""
        return replace(self, information=self.information + information)


@dataclass(frozen=True, kw_only=True)
class Further:
    """What is known with a further measurement, such as one more flight line: its name, and the posterior with it."""

    name: str
    posterior: Posterior


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Estimated errors.

    before: the posterior at the reported poses, before anything is estimated.
    posterior: at the estimate, with the information divided by `scatter`.
    observable: which errors are estimated; the others are held at zero.
    value, covariance: of all of them, SI.
    scatter: factor on the variances; excess: it over that of speckle; p_value: the probability of such an excess.
    reduced_chi2: squared residuals of the echoes over those of speckle.
    step: what each pulse says at the estimate.
    drift: what differs between lines; line_offsets, line_offsets_sigma: by how much on each, and sigmas.
    """

    before: Posterior
    posterior: Posterior
    observable: Bool[np.ndarray, " error"]
    value: Float[np.ndarray, " error"]
    covariance: Float[np.ndarray, "error error"]
    scatter: float
    excess: float
    p_value: float
    reduced_chi2: float
    step: Step
    drift: Drift
    line_offsets: Float[np.ndarray, "line drift"]
    line_offsets_sigma: Float[np.ndarray, "line drift"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the errors."""
        return self.posterior.names

    @property
    def model_holds(self) -> bool:
        """Whether the echoes are no farther from the model than speckle and chance explain."""
        return self.p_value >= MIN_P_VALUE and self.reduced_chi2 <= MAX_REDUCED_CHI2

    @property
    def rejected_by_chi2(self) -> bool:
        """Whether the echoes are too far from the model for an estimate."""
        return self.reduced_chi2 > MAX_REDUCED_CHI2 or (self.p_value < MIN_P_VALUE and self.excess > MAX_EXCESS)

    def prior_only(self) -> "Solution":
        """Return the prior without an estimate: all errors are as uncertain as before."""
        return replace(
            self,
            observable=np.zeros_like(self.observable),
            value=np.zeros_like(self.value),
            covariance=np.diag(self.posterior.prior**2),
        )

    def next_range_bias(self, line: Int[np.ndarray, " pulse"]) -> tuple[float, float] | None:
        """Return the range bias of another flight as long, and its sigma, SI; None if it is not observable.

        line: number of the flight line of each pulse. The bias wanders with the residuals; see `continued`.
        """
        step, name = self.step, "range_bias"
        if name not in self.names or not self.observable[self.names.index(name)]:
            return None
        weight = np.nan_to_num(step.weight / step.sigma_m**2)
        number = stretches(line)
        total = np.bincount(number, weight)
        means = (np.bincount(number, weight * np.nan_to_num(step.residual_m)) / np.maximum(total, 1e-300))[total > 0]
        if len(means) < FEWEST_STRETCHES:
            return None
        mean, sigma = continued(means)
        return mean + float(self.value[self.names.index(name)]), sigma

    @property
    def errors(self) -> InstrumentErrors:
        """The estimate."""
        return InstrumentErrors.of(dict(zip(self.posterior.names, map(float, self.value), strict=True)))

    @property
    def sigma(self) -> Float[np.ndarray, " error"]:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def solve(
    echoes: CombinedEchoes,
    surface: Heightfield,
    names: Sequence[str],
    prior: Mapping[str, float] | None = None,
    between: Mapping[str, float] | None = None,
) -> Solution:
    """Estimate errors of an instrument over known ground.

    names: of the errors, in `UNKNOWNS`.
    prior, between: standard deviations beforehand, SI, for those of `UNKNOWNS`, and between lines of those that drift.
    """
    sigma0 = np.array([(prior or {}).get(name, UNKNOWNS[name].prior * UNKNOWNS[name].si) for name in names])
    value, before, step, observable = np.zeros(len(names)), None, None, np.ones(len(names), dtype=bool)
    drift = Drift(names=tuple(names), between=between or {})
    lines = echoes.lines if between else (echoes,)
    bounds = np.cumsum([0, *map(len, lines)])
    line_offsets = np.zeros((len(lines), len(drift.own)))
    for stage in Stage:
        for _ in range(MAX_STEPS):
            at = [drift.errors(value, own) for own in line_offsets]
            steps = [line.step(e, surface, drift.all_names, stage) for line, e in zip(lines, at, strict=True)]
            step = Step.concatenate(steps)
            said = [step.summed(slice(*ends)) for ends in itertools.pairwise(bounds)]
            rates = [line.doppler_information(e, drift.all_names) for line, e in zip(lines, at, strict=True)]
            # Range rates have the weight of their variance: that of echoes is greater than the information says.
            # Where no echo meets the surface it is unknown, and they have none.
            heard = bool(np.isfinite(step.spread).any())
            usual = float(np.nanmean(step.spread)) * echoes.repeated if heard else 0.0
            each = [
                drift.eliminated(i + usual * more, s + usual * of, d)
                for (i, s), (more, of), d in zip(said, rates, line_offsets, strict=True)
            ]
            information = np.sum([line.information for line in each], axis=0)
            known = Posterior(names=tuple(names), prior=sigma0, information=information)
            before, observable = before or known, known.observable
            moved = _next(known, observable, np.sum([line.score for line in each], axis=0), value) - value
            value = value + moved
            change = np.array([line.moved - line.gain @ moved for line in each])
            line_offsets = line_offsets + change
            farthest = np.abs(moved / np.sqrt(np.diag(known.considered(observable)))).max(initial=0.0)
            for line, own in zip(each, change, strict=True):
                farthest = np.abs(own / np.sqrt(np.diag(line.covariance))).max(initial=farthest)
            if farthest < stage.value:
                break
    assert before is not None
    assert step is not None
    dof = float(sum(len(drift.own) - np.trace(line.covariance / drift.sigma**2) for line in each))
    scatter, expected, p_value = _scatter(step, echoes, observable, dof)
    both = zip(said, rates, line_offsets, strict=True)
    each = [drift.eliminated(line[0] / scatter + more, line[1], d) for line, (more, _), d in both]
    known = replace(known, information=np.sum([line.information for line in each], axis=0))
    covariance = known.considered(observable)
    return Solution(
        before=before,
        posterior=known,
        observable=observable,
        value=value,
        covariance=covariance,
        scatter=scatter,
        excess=scatter / expected,
        p_value=p_value,
        reduced_chi2=float(np.nanmean(step.reduced_chi2)) if echoes.whole else 1.0,
        step=step,
        drift=drift,
        line_offsets=line_offsets,
        line_offsets_sigma=np.array([np.sqrt(np.diag(e.covariance + e.gain @ covariance @ e.gain.T)) for e in each]),
    )


def _next(
    known: Posterior,
    observable: Bool[np.ndarray, " error"],
    score: Float[np.ndarray, " error"],
    value: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " error"]:
    """Return the estimate after a step of scoring, those that are not observable being zero."""
    following = np.zeros(len(value))
    if observable.any():
        own = np.ix_(observable, observable)
        right = score[observable] + known.information[observable] @ value
        scaled = known.prior[observable][:, None] * known.information[own] * known.prior[observable] + np.eye(
            int(observable.sum())
        )
        following[observable] = known.prior[observable] * np.linalg.solve(scaled, known.prior[observable] * right)
    return following


# Ratios of the standard deviations of steps and noise, as angles, over which a walk is averaged.
ANGLES = 64
# Stretches without which the posterior of a walk has no variance.
FEWEST_STRETCHES = 4


def continued(means: Float[np.ndarray, " stretch"]) -> tuple[float, float]:
    """Return the mean of as many further stretches, and its standard deviation, if they go on as a random walk.

    The means of stretches are noise of variance s^2 about a level that steps by q^2 from one to the next (the local
    level model: Durbin and Koopman 2012, "Time Series Analysis by State Space Methods", section 2.1). A flight says
    little of steps that add up over its own length, so that q / s = tan(angle) is not estimated but averaged over:
    every angle alike beforehand, the scale by 1 / scale, any level.
    """
    count = len(means)
    number, ones = np.arange(1.0, count + 1), np.ones(count)
    found = []
    for angle in (np.arange(ANGLES) + 0.5) * np.pi / 2 / ANGLES:
        noise, steps = np.cos(angle) ** 2, np.sin(angle) ** 2
        system = cho_factor(noise * np.eye(count) + steps * np.minimum(number[:, None], number))
        inverse = cho_solve(system, ones)
        variance = 1 / inverse.sum()
        level = variance * (inverse @ means)
        residual = cho_solve(system, means - level)
        squares = max(float((means - level) @ residual), np.finfo(float).tiny)
        log = -np.log(np.diag(system[0])).sum() + np.log(variance) / 2 - (count - 1) / 2 * np.log(squares)
        # With the level at the last stretch the further ones begin: its covariance with each mean is that of the walk.
        last = steps * number
        spread = steps * count - last @ cho_solve(system, last) + (1 - last @ inverse) ** 2 * variance
        further = steps * (count + 1) * (2 * count + 1) / (6 * count) + noise / count
        found.append((log, level + last @ residual, squares / (count - 3) * (spread + further)))
    log, mean, variances = np.array(found).T
    weight = np.exp(log - log.max())
    middle = np.average(mean, weights=weight)
    return float(middle), float(np.sqrt(np.average(variances + (mean - middle) ** 2, weights=weight)))


def _scatter(
    step: Step, echoes: CombinedEchoes, observable: Bool[np.ndarray, " error"], drifting: float
) -> tuple[float, float, float]:
    """Return the factor by which scores of stretches scatter, that of speckle, and the probability of the excess."""
    number, count = stretches(echoes.line), int(observable.sum())
    score, information = np.zeros((number.max() + 1, count)), np.zeros((number.max() + 1, count, count))
    own = np.flatnonzero(observable)
    np.add.at(score, number, step.weight[:, None] * step.score[:, own])
    np.add.at(information, number, step.weight[:, None, None] * step.information[:, own][:, :, own])
    total, dof = 0.0, -count - drifting
    for s, i in zip(score, information, strict=True):
        value, vector = np.linalg.eigh(i)
        kept = value > 1e-9 * max(value.max(initial=0.0), 1e-300)
        total += float(np.sum((vector[:, kept].T @ s) ** 2 / value[kept]))
        dof += int(kept.sum())
    if dof <= 0:
        return 1.0, 1.0, 1.0
    usual = float(np.nanmean(step.spread)) * echoes.repeated
    return total / dof, usual, float(chi2.sf(total / usual, dof))


STEPS = 6
# Steps end when all are below this fraction of the standard deviations.
CONVERGED_SIGMAS = 0.05


def solve_over_unknown_ground(
    echoes: RangeProfiles,
    grid: Grid,
    names: Sequence[str],
    prior: Mapping[str, float] | None = None,
    places: MeasuredPlaces | None = None,
    between: Mapping[str, float] | None = None,
) -> tuple[Solution, Heightfield]:
    """Estimate errors of an instrument together with the heights of the ground (`navigation.joint`), and return both.

    grid: cells of the ground; it need not reach all footprints.
    names, prior, between: as for `solve`.
    places: heights that are known otherwise.
    """
    sigma0 = np.array([(prior or {}).get(name, UNKNOWNS[name].prior * UNKNOWNS[name].si) for name in names])
    value, before, line = np.zeros(len(names)), None, echoes.motion.line
    drift = Drift(names=tuple(names), between=between or {})
    flown = np.unique(line)
    lines = [echoes.rows(line == k) for k in flown] if between else [echoes]
    line_offsets = np.zeros((len(lines), len(drift.own)))
    of_line = (line[:, None] == flown).astype(float)
    varying = [Varying(name=name, basis=sigma * of_line) for name, sigma in drift.between.items()]
    for free in (np.ones(len(names), dtype=bool), None):
        # Lines agree once their common errors are taken out, unless they have errors of their own.
        errors, agree = drift.errors(value, np.zeros(len(drift.own))), free is None and not drift.between
        begin = FirstGround.of(echoes, grid, errors=errors, lines_agree=agree)
        waves, ground, speckle_scatter = begin.waves, begin.ground, begin.speckle_scatter
        for _ in range(STEPS):
            surface = waves.surface(ground)
            at = zip(lines, line_offsets, strict=True)
            linear = ErrorsLinearised.joined(
                [
                    each.linearise(drift.errors(value, own), surface, drift.all_names, speckle_scatter)
                    for each, own in at
                ]
            )
            reached = list((line_offsets / drift.sigma).T)
            system = joint_system(linear, surface, waves, ground, drift.all_names, varying, reached, len(names), places)
            explained, solved = system.solved(system.right), system.solved(system.coupled)
            information = system.information - system.coupled.T @ solved
            known = Posterior(names=drift.names, prior=sigma0, information=(information + information.T) / 2)
            observable = known.observable if free is None else free
            moved = _next(known, observable, system.score - system.coupled.T @ explained, value) - value
            change = explained - solved @ moved
            before = before or known
            value, ground = value + moved, ground + change[: len(ground)]
            line_offsets = line_offsets + drift.sigma * change[len(ground) :].reshape(line_offsets.T.shape).T
            if np.abs(moved / known.sigma).max(initial=0.0) < CONVERGED_SIGMAS:
                break
    by_error = solved[len(ground) :]
    own = np.eye(len(system.right))[:, len(ground) :]
    covariance = system.solved(own)[len(ground) :] + by_error @ known.considered(known.observable) @ by_error.T
    own_sigma = drift.sigma * np.sqrt(np.diag(covariance)).reshape(line_offsets.T.shape).T
    surface = waves.surface(ground)
    at = zip(lines, line_offsets, strict=True)
    steps = [each.step(drift.errors(value, own), surface, drift.all_names, Stage.FINE) for each, own in at]
    step = Step.concatenate(steps)
    assert before is not None
    solution = Solution(
        before=before,
        posterior=known,
        observable=known.observable,
        value=value,
        covariance=known.considered(known.observable),
        scatter=speckle_scatter,
        excess=1.0,
        p_value=1.0,
        reduced_chi2=float(np.nanmean(step.reduced_chi2)),
        step=step,
        drift=drift,
        line_offsets=line_offsets,
        line_offsets_sigma=own_sigma,
    )
    return solution, surface
