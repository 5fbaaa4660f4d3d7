"""Errors of an instrument from its echoes over known ground: what they say, how well, and what they cannot say.

Each whole echo is predicted over the ground as in mapping (`echo_model.model`): the power of every part of the beam in
its range cell, Doppler by the velocity along that part included. An error theta of the instrument moves the antenna by
do, turns it by the small rotation phi, and changes its velocity by dv; the range read along the direction d of a part
of the beam, to ground of normal n at the range r, with D the Doppler shift of ranges, then changes by

    -n . (do + r phi x d) / n . d  -  D (dv . d + v . phi x d)  +  (bias and scale).

A change of range is one of the ground's height under that part, whose score and expected information the echo model
gives, with exponential speckle, a free level of each echo, and as many looks as speckle is new. So

    score = sum H^T F^T residual,   information = sum (F H)^T (F H)   (Fisher scoring)

with H the heights that stand for theta. With the prior of an instrument as it was mounted, the posterior's covariance
is the inverse of the information and the prior's. An error is told by a flight if its standard deviation falls to less
than `TOLD` of the one beforehand. One that is not stays at zero, and its uncertainty goes into that of the others
("consider" parameters: Schmidt 1966, "Application of state-space methods to navigation problems").

The model of the echoes errs as well, alike along stretches of the flight: over trees, by a coarse reference. Scores of
stretches then scatter by more than the information says, by a factor that all variances are multiplied with
(Huber 1967: the score's real covariance decides about the estimate's).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, InstrumentErrors
from sionna_radar.flight.pulses import Pose
from sionna_radar.mapping.echo_model.model import BeamFootprints, EchoModel, MeanRanges, Sightings, footprints, mean_ranges

# Share of its standard deviation beforehand to which that of an error must fall to be told: the echoes then hold eight
# times the information of the prior.
TOLD = 1 / 3
# Pulses that are predicted at once: it bounds the memory.
AT_ONCE = 2048
# Steps of scoring at most; they end below this share of the standard deviations.
MAX_STEPS, SETTLED = 12, 0.02
# An echo that fits this many times worse than usual counts less, in proportion.
OUTLYING = 4.0
# Stretches of the flight whose scores are compared, at most, and the pulses in each at least.
STRETCHES, MIN_STRETCH = 48, 24
# Probability of scores that scatter so, below which the model of the echoes is said to miss something.
SURPRISE = 1e-3
# Components of a direction that are named.
NAMED = 0.3


@dataclass(frozen=True, kw_only=True)
class Step:
    """What each pulse says of the errors at an estimate.

    score, information: of its likelihood. misfit: squared residuals over their expected sum.
    residual_m, sigma_m: by how much its range exceeds the predicted one, and the standard deviation of that.
    """

    score: Float[np.ndarray, "pulse error"]
    information: Float[np.ndarray, "pulse error error"]
    misfit: Float[np.ndarray, " pulse"]
    residual_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]

    @staticmethod
    def joined(steps: Sequence["Step"]) -> "Step":
        """Return what the pulses of several parts say."""
        names = Step.__dataclass_fields__
        return Step(**{name: np.concatenate([getattr(step, name) for step in steps]) for name in names})

    @cached_property
    def weight(self) -> Float[np.ndarray, " pulse"]:
        """Share that each pulse counts, less than one if it is outlying."""
        usual = float(np.nanmedian(self.misfit)) if np.isfinite(self.misfit).any() else 1.0
        return np.nan_to_num(np.minimum(1.0, OUTLYING * usual / np.maximum(self.misfit, 1e-12)))


@dataclass(frozen=True, kw_only=True)
class WholeEchoes:
    """Range profiles of some pulses, with the reported motion.

    sightings: with the reported poses. motion: of the same pulses. looks: see `EchoModel.linearise`.
    """

    sightings: Sightings
    motion: BelievedMotion
    looks: Float[np.ndarray, " pulse"]

    def __len__(self) -> int:
        return len(self.motion)

    @cached_property
    def usual_sigma_m(self) -> float:
        """Median standard deviation of the mean range of an echo."""
        return float(np.median(mean_ranges(self.sightings).sigma_m))

    def rows(self, kept: Bool[np.ndarray, " pulse"]) -> "WholeEchoes":
        """Return some of the echoes."""
        own = np.flatnonzero(kept)
        return WholeEchoes(sightings=self.sightings.rows(kept), motion=self.motion.rows(own), looks=self.looks[kept])

    def without(self, errors: InstrumentErrors) -> tuple[Sightings, BelievedMotion]:
        """Return the sightings and the motion without errors of the instrument."""
        motion = self.motion.without(errors)
        sightings = replace(
            self.sightings, pose=motion.pose, range_bias_m=errors.range_bias_m, range_scale=errors.range_scale
        )
        return sightings, motion

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        """Return what the whole echoes say of named errors over a surface, at an estimate of them."""
        return Step.joined([part._step(errors, surface, names) for part in self._parts()])

    def mean_step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        """Return what the mean ranges alone say: less, but from farther away."""
        return Step.joined([part._mean_step(errors, surface, names) for part in self._parts()])

    def _parts(self) -> list["WholeEchoes"]:
        number = np.arange(len(self)) // AT_ONCE
        return [self.rows(number == k) for k in range(int(number[-1]) + 1)]

    def _step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        sightings, motion = self.without(errors)
        model = EchoModel(sightings, surface)
        linear, feet = model.linearise(self.looks), model.footprints
        per_height = np.where(feet.range_per_height < 0, feet.range_per_height, -np.inf)[..., None]
        heights = range_per_error(sightings, motion, feet, surface, [*names, "range_bias"]) / per_height
        count, pulses = heights.shape[2], len(heights)
        score = np.einsum("pnk,pn->pk", heights, linear.score)
        information, misfit = np.zeros((pulses, count, count)), np.full(pulses, np.nan)
        for pulse in range(pulses):
            rows = linear.rows_of(pulse)
            if rows.start < rows.stop:
                said = linear.factor[rows] @ heights[pulse]
                information[pulse] = said.T @ said
                weight = linear.weight[rows].sum()
                misfit[pulse] = (linear.residual[rows] ** 2).sum() / weight if weight > 0 else np.nan
        return _split(score, information, misfit)

    def _mean_step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        sightings, motion = self.without(errors)
        echoes = mean_ranges(self.sightings)
        axis = self.sightings.pose.boresight[:, None]
        excess = echoes.range_m + self.sightings.shift_m(axis)[:, 0] - EchoModel(sightings, surface).centroid_m()
        sigma = np.maximum(echoes.sigma_m, 0.5 * self.usual_sigma_m)
        return mean_range_step(sightings, motion, surface, names, excess, sigma)


def _split(
    score: Float[np.ndarray, "pulse k"], information: Float[np.ndarray, "pulse k k"], misfit: Float[np.ndarray, " pulse"]
) -> Step:
    """Return a step whose last column, the range's bias, becomes its residual."""
    with np.errstate(divide="ignore", invalid="ignore"):
        residual, sigma = score[:, -1] / information[:, -1, -1], 1 / np.sqrt(information[:, -1, -1])
    return Step(
        score=score[:, :-1],
        information=information[:, :-1, :-1],
        misfit=misfit,
        residual_m=np.where(np.isfinite(sigma), residual, np.nan),
        sigma_m=np.where(np.isfinite(sigma), sigma, np.nan),
    )


def mean_range_step(
    sightings: Sightings,
    motion: BelievedMotion,
    surface: Heightfield,
    names: Sequence[str],
    excess_m: Float[np.ndarray, " pulse"],
    sigma_m: Float[np.ndarray, " pulse"],
) -> Step:
    """Return what mean ranges say that exceed the predicted ones, each by its own standard deviation."""
    feet = footprints(sightings, surface)
    share = sightings.beam.between.T @ sightings.beam.share
    met = np.isfinite(feet.range_m)
    share = np.where(met, share, 0.0)
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    slope = np.einsum("pn,pnk->pk", share, range_per_error(sightings, motion, feet, surface, [*names, "range_bias"]))
    known = np.isfinite(excess_m) & met.any(axis=1)
    precision = np.where(known, 1 / sigma_m**2, 0.0)
    excess = np.where(known, excess_m, 0.0)
    score = slope * (precision * excess)[:, None]
    information = slope[:, :, None] * slope[:, None] * precision[:, None, None]
    return _split(score, information, np.where(known, precision * excess**2, np.nan))


def range_per_error(
    sightings: Sightings,
    motion: BelievedMotion,
    feet: BeamFootprints,
    surface: Heightfield,
    names: Sequence[str],
) -> Float[np.ndarray, "pulse node error"]:
    """Return the change of the range that is read along each node of the beam, m, per SI unit of each error.

    Parameters
    ----------
    sightings, motion:
        Without the errors that are known already.
    feet:
        Where the nodes meet the surface; a node that meets nothing reads nothing.
    surface:
        The ground.
    names:
        Of the errors, in `UNKNOWNS`.

    """
    direction, pose = sightings.direction(), sightings.pose
    slope = surface.slope(*feet.place_m.reshape(-1, 2).T)
    shape = feet.range_m.shape
    normal = np.stack([-slope[0].reshape(shape), -slope[1].reshape(shape), np.ones(shape)], axis=2)
    range_m = np.nan_to_num(feet.range_m)
    per_height = -feet.range_per_height[..., None]
    shift = sightings.doppler * float(sightings.chirp.doppler_range_m(np.ones(1))[0])
    velocity = np.broadcast_to(pose.velocity_mps[:, None], direction.shape)
    turned = per_height * range_m[..., None] * np.cross(direction, normal) - shift * np.cross(direction, velocity)
    by = np.concatenate([turned, per_height * normal, -shift * direction], axis=2)
    change = by @ _moved(motion, names)
    for column, name in enumerate(names):
        if name == "range_bias":
            change[..., column] = 1.0
        elif name == "range_scale":
            change[..., column] = range_m
    return np.where(np.isfinite(feet.range_m)[..., None], change, 0.0)


SIDES = ("nose", "right", "down")
ANGLES = ("roll", "pitch", "heading")


def _moved(motion: BelievedMotion, names: Sequence[str]) -> Float[np.ndarray, "pulse 9 error"]:
    """Return how the antenna turns, moves and speeds up (rotation vector, m, m/s) per unit of each believed error."""
    body, pose = motion.R_world_mount, motion.pose
    change = np.zeros((len(motion), 9, len(names)))
    for column, name in enumerate(names):
        if name in ANGLES:
            change[:, :3, column] = -body[:, :, ANGLES.index(name)]
        elif name == "squint":
            change[:, :3, column] = -pose.R_world_antenna[:, :, 2]
        elif name.startswith("lever"):
            side = body[:, :, SIDES.index(name.removeprefix("lever_"))]
            change[:, 3:6, column] = -side
            change[:, 6:, column] = -np.cross(motion.turn_rad_s, side)
        elif name == "time_offset":
            change[:, :3, column] = motion.turn_rad_s
            change[:, 3:6, column] = pose.velocity_mps
            change[:, 6:, column] = motion.acceleration_mps2
    return change


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

        Those along which the standard deviation stays above `TOLD` of the one beforehand, worst first; of each the parts
        that are more than `NAMED` of the greatest, in units of the prior.
        """
        value, vector = np.linalg.eigh(self.prior[:, None] * self.information * self.prior)
        found = []
        for k in np.flatnonzero(1 / (1 + np.maximum(value, 0.0)) > TOLD**2):
            part = vector[:, k] / np.abs(vector[:, k]).max()
            part *= np.sign(part[int(np.argmax(np.abs(part)))])
            found.append({n: float(p * s) for n, p, s in zip(self.names, part, self.prior, strict=True) if abs(p) > NAMED})
        return found

    def with_more(self, information: Float[np.ndarray, "error error"]) -> "Knowledge":
        """Return what is known with the echoes of another flight as well."""
        return replace(self, information=self.information + information)


@dataclass(frozen=True, kw_only=True)
class Solution:
    """Estimated errors.

    knowledge: what the flight tells, with the information divided by `excess`.
    told: which errors are estimated; the others are held at zero.
    value, covariance: of all of them, SI. excess: see the module; surprise: probability of it or a greater one.
    step: what each pulse says at the estimate.
    """

    knowledge: Knowledge
    told: Bool[np.ndarray, " error"]
    value: Float[np.ndarray, " error"]
    covariance: Float[np.ndarray, "error error"]
    excess: float
    surprise: float
    steps: int
    step: Step

    @property
    def errors(self) -> InstrumentErrors:
        """The estimate."""
        return InstrumentErrors.of(dict(zip(self.knowledge.names, map(float, self.value), strict=True)))

    @property
    def sigma(self) -> Float[np.ndarray, " error"]:
        """Standard deviations."""
        return np.sqrt(np.diag(self.covariance))


def solve(
    echoes: WholeEchoes,
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
    value, told = np.zeros(len(names)), np.ones(len(names), dtype=bool)
    steps = 0
    for whole in (False, True):
        for _ in range(MAX_STEPS):
            errors = InstrumentErrors.of(dict(zip(names, map(float, value), strict=True)))
            step = echoes.step(errors, surface, names) if whole else echoes.mean_step(errors, surface, names)
            information = np.einsum("p,pkl->kl", step.weight, step.information)
            known = Knowledge(names=tuple(names), prior=sigma0, information=information)
            told = known.told
            moved = _next(known, told, step.weight @ step.score, value) - value
            value, steps = value + moved, steps + 1
            sigma = np.sqrt(np.diag(known.considered(told)))
            if np.abs(moved / sigma).max(initial=0.0) < (SETTLED if whole else 1.0):
                break
    excess, surprise = _excess(step, echoes.motion.line, told)
    known = replace(known, information=information / excess)
    return Solution(
        knowledge=known,
        told=told,
        value=value,
        covariance=known.considered(told),
        excess=excess,
        surprise=surprise,
        steps=steps,
        step=step,
    )


def _next(
    known: Knowledge, told: Bool[np.ndarray, " error"], score: Float[np.ndarray, " error"], value: Float[np.ndarray, " k"]
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


def _excess(step: Step, line: Int[np.ndarray, " pulse"], told: Bool[np.ndarray, " error"]) -> tuple[float, float]:
    """Return by how much more the scores of stretches scatter than their information says, if that is no chance."""
    number = stretches(line)
    count = int(number.max()) + 1
    score, information = np.zeros((count, int(told.sum()))), np.zeros((count, int(told.sum()), int(told.sum())))
    np.add.at(score, number, step.weight[:, None] * step.score[:, told])
    np.add.at(information, number, step.weight[:, None, None] * step.information[:, told][:, :, told])
    total, freedom = 0.0, 0
    for s, i in zip(score, information, strict=True):
        value, vector = np.linalg.eigh(i)
        kept = value > 1e-9 * max(value.max(initial=0.0), 1e-300)
        total += float(np.sum((vector[:, kept].T @ s) ** 2 / value[kept]))
        freedom += int(kept.sum())
    freedom -= int(told.sum())
    if freedom <= 0:
        return 1.0, 1.0
    surprise = float(chi2.sf(total, freedom))
    return (max(total / freedom, 1.0) if surprise < SURPRISE else 1.0), surprise
