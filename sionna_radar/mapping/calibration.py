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

The score's real covariance decides about that of the estimate (Huber 1967, "The behavior of maximum likelihood
estimates under nonstandard conditions"). Weak cells count less than the information assumes, and where the model errs, over trees or by a coarse reference, it errs alike along stretches of the flight. So all variances are multiplied
with the factor by which the scores of stretches scatter more than their information says. Speckle alone makes them
scatter as the scores of single pulses do, times the pulses over which it repeats; more than that, and more than chance
explains, says that the model misses something.

Where the reference lies beside its own datum is an error like the others: `datum_east` and so on, of the flight's
position minus the reference's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import chi2

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, InstrumentErrors
from sionna_radar.mapping.echo_model.model import BeamFootprints, EchoModel, Sightings, footprints, mean_ranges
from sionna_radar.mapping.echo_model.speckle import repeats

# Share of its standard deviation beforehand to which that of an error must fall to be told: the echoes then hold eight
# times the information of the prior.
TOLD = 1 / 3
# Pulses that are predicted at once: it bounds the memory.
AT_ONCE = 2048
MAX_STEPS = 12
# An echo that fits this many times worse than usual counts less, in proportion.
OUTLYING = 4.0
# Stretches of the flight whose scores are compared, at most, and the pulses in each at least.
STRETCHES, MIN_STRETCH = 48, 24
# Probability of scores that scatter so, below which the model of the echoes is said to miss something.
SURPRISE = 1e-3
# Squared residuals over those of speckle, on the average, above which echoes are not those of the modelled ground: its
# standard deviation over a survey is below 0.01.
MAX_MISFIT = 1.2
# Components of a direction that are named.
NAMED = 0.3


class Nearness(Enum):
    """How near an estimate is; steps at that end once they are shorter than so many standard deviations."""

    FAR = 1.0
    SETTLED = 0.02


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

    @property
    def total(self) -> Float[np.ndarray, "error error"]:
        """Information of all pulses."""
        return np.einsum("p,pkl->kl", self.weight, self.information)

    @cached_property
    def weight(self) -> Float[np.ndarray, " pulse"]:
        """Share that each pulse counts, less than one if it is outlying."""
        usual = float(np.nanmedian(self.misfit)) if np.isfinite(self.misfit).any() else 1.0
        return np.nan_to_num(np.minimum(1.0, OUTLYING * usual / np.maximum(self.misfit, 1e-12)))


@dataclass(frozen=True, kw_only=True)
class WholeEchoes:
    """Range profiles of some pulses, with the reported motion.

    sightings: with the reported poses. motion: of the same pulses.
    reach: over how many pulses the speckle of each repeats.
    """

    sightings: Sightings
    motion: BelievedMotion
    reach: Float[np.ndarray, " pulse"]

    def __len__(self) -> int:
        return len(self.motion)

    @cached_property
    def usual_sigma_m(self) -> float:
        """Median standard deviation of the mean range of an echo."""
        return float(np.median(mean_ranges(self.sightings).sigma_m))

    def rows(self, kept: Bool[np.ndarray, " pulse"]) -> "WholeEchoes":
        """Return some of the echoes."""
        own = np.flatnonzero(kept)
        return WholeEchoes(sightings=self.sightings.rows(kept), motion=self.motion.rows(own), reach=self.reach[kept])

    @property
    def repeated(self) -> float:
        """Mean number of pulses over which speckle repeats."""
        return float(repeats(self.reach).mean())

    @property
    def looks(self) -> Float[np.ndarray, " pulse"]:
        """Independent looks in a cell of each pulse."""
        return self.sightings.looks_per_cell / repeats(self.reach)

    def without(self, errors: InstrumentErrors) -> tuple[Sightings, BelievedMotion]:
        """Return the sightings and the motion without errors of the instrument."""
        motion = self.motion.without(errors)
        sightings = replace(
            self.sightings, pose=motion.pose, range_bias_m=errors.range_bias_m, range_scale=errors.range_scale
        )
        return sightings, motion

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], near: Nearness) -> Step:
        """Return what the echoes say of named errors over a surface, at an estimate of them.

        near: mean ranges say less than whole echoes, but from farther away.
        """
        whole = near is Nearness.SETTLED
        steps = [(part._step if whole else part._mean_step)(errors, surface, names) for part in self._parts()]
        return Step.joined(steps)

    def _parts(self) -> list["WholeEchoes"]:
        number = np.arange(len(self)) // AT_ONCE
        return [self.rows(number == k) for k in range(int(number[-1]) + 1)]

    def _step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        sightings, motion = self.without(errors)
        model = EchoModel(sightings, surface)
        linear, feet = model.linearise(self.looks), model.footprints
        per_height = np.where(feet.range_per_height < 0, feet.range_per_height, -np.inf)[..., None]
        toward, shift = sightings.direction(), _shift_per_rate(sightings)
        heights = range_per_error(toward, motion, feet, surface, [*names, "range_bias"], shift) / per_height
        count, pulses = heights.shape[2], len(heights)
        score = np.einsum("pnk,pn->pk", heights, linear.score)
        information, misfit = np.zeros((pulses, count, count)), np.full(pulses, np.nan)
        for pulse in range(pulses):
            rows = linear.rows_of(pulse)
            if rows.start < rows.stop:
                said = linear.factor[rows] @ heights[pulse]
                information[pulse] = said.T @ said
                weight = linear.weight[rows].sum() * self.looks[pulse]
                misfit[pulse] = (linear.residual[rows] ** 2).sum() / weight if weight > 0 else np.nan
        return _split(score, information, misfit)

    def _mean_step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        sightings, motion = self.without(errors)
        echoes = mean_ranges(self.sightings)
        axis = self.sightings.pose.boresight[:, None]
        excess = echoes.range_m + self.sightings.shift_m(axis)[:, 0] - EchoModel(sightings, surface).centroid_m()
        sigma = np.maximum(echoes.sigma_m, self.usual_sigma_m / 2) * np.sqrt(repeats(self.reach))
        feet, beam = footprints(sightings, surface), sightings.beam
        share = np.where(np.isfinite(feet.range_m), beam.between.T @ beam.share, 0.0)
        toward, shift = sightings.direction(), _shift_per_rate(sightings)
        change = range_per_error(toward, motion, feet, surface, [*names, "range_bias"], shift)
        slope = np.einsum("pn,pnk->pk", share / np.maximum(share.sum(axis=1, keepdims=True), 1e-12), change)
        return _mean_range_step(slope, excess, sigma)


def _shift_per_rate(sightings: Sightings) -> float:
    """Return the Doppler shift of the range, m, per m/s of range rate."""
    return sightings.doppler * float(sightings.chirp.doppler_range_m(np.ones(1))[0])


@dataclass(frozen=True, kw_only=True)
class Readings:
    """Ranges that were read along the axes of the beams, with the reported motion.

    range_m, sigma_m: as read, and their standard deviation. motion: of the same pulses.
    doppler_m: Doppler shift of the range, m, per m/s of range rate; 0 for ranges that have none.
    """

    range_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]
    motion: BelievedMotion
    reach_m: float
    doppler_m: float = 0.0
    repeated: float = 1.0

    def __len__(self) -> int:
        return len(self.motion)

    def rows(self, kept: Bool[np.ndarray, " pulse"]) -> "Readings":
        """Return some of the readings."""
        own = self.motion.rows(np.flatnonzero(kept))
        return replace(self, range_m=self.range_m[kept], sigma_m=self.sigma_m[kept], motion=own)

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], near: Nearness) -> Step:
        """Return what the readings say of named errors over a surface, at an estimate of them."""
        del near  # their model is linear
        motion = self.motion.without(errors)
        pose = motion.pose
        hit = surface.first_hit(pose.position_m, pose.boresight, self.reach_m)
        place = (pose.position_m + np.nan_to_num(hit)[:, None] * pose.boresight)[:, :2]
        east, north = surface.slope(*place.T)
        closing = np.minimum(pose.boresight[:, 2] - east * pose.boresight[:, 0] - north * pose.boresight[:, 1], -0.05)
        feet = BeamFootprints(hit[:, None], place[:, None], (1 / closing)[:, None], np.zeros((len(hit), 1)))
        toward = pose.boresight[:, None]
        change = range_per_error(toward, motion, feet, surface, [*names, "range_bias"], self.doppler_m)[:, 0]
        shift = self.doppler_m * pose.boresight_range_rate_mps
        return _mean_range_step(change, self.range_m - errors.read_m(hit) - shift, self.sigma_m)


@dataclass(frozen=True, kw_only=True)
class Together:
    """The echoes of several recordings."""

    parts: tuple[WholeEchoes | Readings, ...]

    def __len__(self) -> int:
        return sum(map(len, self.parts))

    @property
    def line(self) -> Int[np.ndarray, " pulse"]:
        """Number of the flight line of each pulse."""
        lines, first = [], 0
        for part in self.parts:
            lines.append(part.motion.line + first)
            first = int(lines[-1].max(initial=first)) + 1
        return np.concatenate(lines)

    @property
    def repeated(self) -> float:
        """Mean number of pulses over which speckle repeats."""
        return float(np.average([part.repeated for part in self.parts], weights=list(map(len, self.parts))))

    @property
    def whole(self) -> bool:
        """Whether all are whole echoes, whose misfit is known."""
        return all(isinstance(part, WholeEchoes) for part in self.parts)

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], near: Nearness) -> Step:
        """Return what all echoes say; see `WholeEchoes.step`."""
        return Step.joined([part.step(errors, surface, names, near) for part in self.parts])


def _split(
    score: Float[np.ndarray, "pulse k"],
    information: Float[np.ndarray, "pulse k k"],
    misfit: Float[np.ndarray, " pulse"],
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


def _mean_range_step(
    slope: Float[np.ndarray, "pulse k"], excess_m: Float[np.ndarray, " pulse"], sigma_m: Float[np.ndarray, " pulse"]
) -> Step:
    """Return what mean ranges say that exceed the predicted ones, whose changes per unit of each error are known."""
    known = np.isfinite(excess_m)
    precision, excess = np.where(known, 1 / sigma_m**2, 0.0), np.where(known, excess_m, 0.0)
    score = slope * (precision * excess)[:, None]
    information = slope[:, :, None] * slope[:, None] * precision[:, None, None]
    return _split(score, information, np.where(known, precision * excess**2, np.nan))


def range_per_error(
    direction: Float[np.ndarray, "pulse node 3"],
    motion: BelievedMotion,
    feet: BeamFootprints,
    surface: Heightfield,
    names: Sequence[str],
    doppler_m: float,
) -> Float[np.ndarray, "pulse node error"]:
    """Return the change of the range that is read along each node of the beam, m, per SI unit of each error.

    Parameters
    ----------
    direction:
        Unit vectors toward the nodes, world frame.
    motion:
        Without the errors that are known already.
    feet:
        Where the nodes meet the surface; a node that meets nothing reads nothing.
    surface:
        The ground.
    names:
        Of the errors, in `UNKNOWNS`.
    doppler_m:
        Doppler shift of the range per m/s of range rate.

    """
    slope = surface.slope(*feet.place_m.reshape(-1, 2).T)
    shape = feet.range_m.shape
    normal = np.stack([-slope[0].reshape(shape), -slope[1].reshape(shape), np.ones(shape)], axis=2)
    range_m = np.nan_to_num(feet.range_m)
    per_height = -feet.range_per_height[..., None]
    velocity = np.broadcast_to(motion.pose.velocity_mps[:, None], direction.shape)
    turned = per_height * range_m[..., None] * np.cross(direction, normal) - doppler_m * np.cross(direction, velocity)
    by = np.concatenate([turned, per_height * normal, -doppler_m * direction], axis=2)
    change = by @ _moved(motion, names)
    for column, name in enumerate(names):
        if name == "range_bias":
            change[..., column] = 1.0
        elif name == "range_scale":
            change[..., column] = range_m
    return np.where(np.isfinite(feet.range_m)[..., None], change, 0.0)


WAYS = ("east", "north", "up")
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
        elif name.startswith("datum"):
            change[:, 3 + WAYS.index(name.removeprefix("datum_")), column] = -1.0
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
    usual = float(np.nanmean(step.weight * (step.residual_m / step.sigma_m) ** 2)) * echoes.repeated
    return total / freedom, usual, float(chi2.sf(total / usual, freedom))
