"""Estimates of errors of an instrument: what a flight tells of them, and how well.

With the prior of an instrument as it was mounted, the posterior's covariance is the inverse of the information of its
echoes (`instrument_echoes`) and the prior's. An error is told by a flight if its standard deviation falls to less than
`TOLD` of the one beforehand. One that is not stays at zero, and its uncertainty goes into that of the others
("consider" parameters: Schmidt 1966, "Application of state-space methods to navigation problems").

The score's real covariance decides about that of the estimate (Huber 1967, "The behavior of maximum likelihood
estimates under nonstandard conditions"). Weak cells count less than the information assumes, and where the model errs,
over trees or by a coarse reference, it errs alike along stretches of the flight. So all variances are multiplied with
the factor by which the scores of stretches scatter more than their information says. What speckle alone makes of it
follows from its covariance between cells and pulses; more than that, and more than chance explains, says that the model
misses something.

Where the reference lies beside its own datum is an error like the others: `datum_east` and so on, of the flight's
position minus the reference's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, InstrumentErrors
from sionna_radar.mapping.instrument_echoes import Nearness, Step, Together

# Share of its standard deviation beforehand to which that of an error must fall to be told: the echoes then hold eight
# times the information of the prior.
TOLD = 1 / 3
# Steps of scoring at most.
MAX_STEPS = 12
# Stretches of the flight whose scores are compared, at most, and the pulses in each at least.
STRETCHES, MIN_STRETCH = 48, 24
# Probability of scores that scatter so, below which the model of the echoes is said to miss something.
SURPRISE = 1e-3
# Squared residuals over those of speckle, on the average, above which echoes are not those of the modelled ground: its
# standard deviation over a survey is below 0.01.
MAX_MISFIT = 1.2
# Scatter of stretches over that of speckle above which errors of the model decide, not the instrument's. By choice:
# over woods of 8 m it was 79, of a flown altimeter 70, and of one over open country whose bias wanders 6.
MAX_EXCESS = 10.0
# Components of a direction that are named.
NAMED = 0.3


@dataclass(frozen=True, kw_only=True)
class Knowledge:
    """What a flight tells of errors whose standard deviations are known beforehand.

    names: of the errors; prior: their standard deviations beforehand; information: of the echoes. All SI.
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
    def told(self) -> Bool[np.ndarray, " error"]:
        """Which errors the flight tells: what is left once the others, the least known first, are held.

        One that is held keeps its uncertainty beforehand, and adds to that of the others.
        """
        told = np.ones(len(self.names), dtype=bool)
        while told.any():
            sigma = np.sqrt(np.diag(self.considered(told)))
            share = np.where(told, sigma / self.prior, 0.0)
            if share.max() <= TOLD:
                break
            told[int(np.argmax(share))] = False
        return told

    def considered(self, free: Bool[np.ndarray, " error"]) -> Float[np.ndarray, "error error"]:
        """Return the covariance if some errors are estimated, and the others are held at zero."""
        known = Knowledge(
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
    def unseen(self) -> list[dict[str, float]]:
        """Directions in which errors trade off, as how much of each (SI) leaves the echoes as they are.

        Those along which the standard deviation stays above `TOLD` of the one beforehand, worst first; of each the
        parts that are more than `NAMED` of the greatest, in units of the prior.
        """
        value, vector = np.linalg.eigh(self.prior[:, None] * self.information * self.prior)
        found = []
        for k in np.flatnonzero(1 / (1 + np.maximum(value, 0.0)) > TOLD**2):
            part = vector[:, k] / np.abs(vector[:, k]).max()
            part *= np.sign(part[int(np.argmax(np.abs(part)))])
            found.append(
                {n: float(p * s) for n, p, s in zip(self.names, part, self.prior, strict=True) if abs(p) > NAMED}
            )
        return found

    def with_more(self, information: Float[np.ndarray, "error error"]) -> "Knowledge":
        """Return what is known with the echoes of another flight as well."""
        return replace(self, information=self.information + information)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Estimated errors.

    before: what the flight tells by the poses as they were believed, before anything is estimated.
    knowledge: what it tells at the estimate, with the information divided by `scatter`.
    told: which errors are estimated; the others are held at zero.
    value, covariance: of all of them, SI.
    scatter: factor on the variances; excess: it over that of speckle; surprise: the probability of such an excess.
    misfit: squared residuals of the echoes over those of speckle.
    step: what each pulse says at the estimate.
    """

    before: Knowledge

    knowledge: Knowledge
    told: Bool[np.ndarray, " error"]
    value: Float[np.ndarray, " error"]
    covariance: Float[np.ndarray, "error error"]
    scatter: float
    excess: float
    surprise: float
    misfit: float
    step: Step

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the errors."""
        return self.knowledge.names

    @property
    def model_holds(self) -> bool:
        """Whether the echoes are no farther from the model than speckle and chance explain."""
        return self.surprise >= SURPRISE and self.misfit <= MAX_MISFIT

    @property
    def of_other_ground(self) -> bool:
        """Whether the echoes are so far from the model that an estimate from them would be none."""
        return self.misfit > MAX_MISFIT or (self.surprise < SURPRISE and self.excess > MAX_EXCESS)

    def held(self) -> "Solution":
        """Return no estimate: all errors are as uncertain as beforehand."""
        return replace(
            self,
            told=np.zeros_like(self.told),
            value=np.zeros_like(self.value),
            covariance=np.diag(self.knowledge.prior**2),
        )

    @property
    def errors(self) -> InstrumentErrors:
        """The estimate."""
        return InstrumentErrors.of(dict(zip(self.knowledge.names, map(float, self.value), strict=True)))

    @property
    def sigma(self) -> Float[np.ndarray, " error"]:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def solve(
    echoes: Together,
    surface: Heightfield,
    names: Sequence[str],
    prior: Mapping[str, float] | None = None,
) -> Solution:
    """Estimate errors of an instrument over known ground.

    Parameters
    ----------
    echoes:
        Whole echoes with the reported motion.
    surface:
        The ground.
    names:
        Of the errors, in `UNKNOWNS`.
    prior:
        Standard deviations beforehand, SI, for those of `UNKNOWNS`.

    """
    sigma0 = np.array([(prior or {}).get(name, UNKNOWNS[name].prior * UNKNOWNS[name].si) for name in names])
    value, before, step, told = np.zeros(len(names)), None, None, np.ones(len(names), dtype=bool)
    for near in Nearness:
        for _ in range(MAX_STEPS):
            errors = InstrumentErrors.of(dict(zip(names, map(float, value), strict=True)))
            step = echoes.step(errors, surface, names, near)
            known = Knowledge(names=tuple(names), prior=sigma0, information=step.total)
            before, told = before or known, known.told
            moved = _next(known, told, step.weight @ step.score, value) - value
            value = value + moved
            if np.abs(moved / np.sqrt(np.diag(known.considered(told)))).max(initial=0.0) < near.value:
                break
    assert before is not None
    assert step is not None
    scatter, expected, surprise = _scatter(step, echoes, told)
    known = replace(known, information=known.information / scatter)
    return Solution(
        before=before,
        knowledge=known,
        told=told,
        value=value,
        covariance=known.considered(told),
        scatter=scatter,
        excess=scatter / expected,
        surprise=surprise,
        misfit=float(np.nanmean(step.misfit)) if echoes.whole else 1.0,
        step=step,
    )


def _next(
    known: Knowledge,
    told: Bool[np.ndarray, " error"],
    score: Float[np.ndarray, " error"],
    value: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " error"]:
    """Return the estimate after a step of scoring, those that are not told being zero."""
    following = np.zeros(len(value))
    if told.any():
        own = np.ix_(told, told)
        right = score[told] + known.information[told] @ value
        scaled = known.prior[told][:, None] * known.information[own] * known.prior[told] + np.eye(int(told.sum()))
        following[told] = known.prior[told] * np.linalg.solve(scaled, known.prior[told] * right)
    return following


def stretches(line: Int[np.ndarray, " pulse"]) -> Int[np.ndarray, " pulse"]:
    """Return the stretch of the flight that each pulse is in: parts of lines, alike in their numbers of pulses."""
    length = max(MIN_STRETCH, -(-len(line) // STRETCHES))
    within = np.arange(len(line)) - np.searchsorted(line, line)
    _, number = np.unique(line * len(line) + within // length, return_inverse=True)
    return number


def _scatter(step: Step, echoes: Together, told: Bool[np.ndarray, " error"]) -> tuple[float, float, float]:
    """Return the factor by which scores of stretches scatter, that of speckle, and the probability of the excess."""
    number, count = stretches(echoes.line), int(told.sum())
    score, information = np.zeros((number.max() + 1, count)), np.zeros((number.max() + 1, count, count))
    np.add.at(score, number, step.weight[:, None] * step.score[:, told])
    np.add.at(information, number, step.weight[:, None, None] * step.information[:, told][:, :, told])
    total, freedom = 0.0, -count
    for s, i in zip(score, information, strict=True):
        value, vector = np.linalg.eigh(i)
        kept = value > 1e-9 * max(value.max(initial=0.0), 1e-300)
        total += float(np.sum((vector[:, kept].T @ s) ** 2 / value[kept]))
        freedom += int(kept.sum())
    if freedom <= 0:
        return 1.0, 1.0, 1.0
    usual = float(np.nanmean(step.spread)) * echoes.repeated
    return total / freedom, usual, float(chi2.sf(total / usual, freedom))
