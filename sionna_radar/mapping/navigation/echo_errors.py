"""What echoes over known ground say of errors of the instrument, pulse by pulse: scores and information.

Each whole echo is predicted over the ground as in mapping (`echo.likelihood`): the power of every part of the beam in
its range cell, Doppler by the velocity along that part included. An error theta of the instrument moves the antenna by
do, turns it by the small rotation phi, and changes its velocity by dv; the range read along the direction d of a part
of the beam, to ground of normal n at the range r, with D the Doppler shift of ranges, then changes by

    -n . (do + r phi x d) / n . d  -  D (dv . d + v . phi x d)  +  (bias and scale).

A change of range is one of the ground's height under that part, whose score and expected information the echo model
gives, with exponential speckle, a free level of each echo, and as many looks as speckle is new. So

    score = sum H^T F^T residual,   information = sum (F H)^T (F H)   (Fisher scoring)

with H the heights that stand for theta. The level of an echo is fitted to the same few cells: with speckle e_c of the
covariance C in cells of the weights w_c, (1 + e_c) / (1 + sum w e / sum w) has the mean 1 - (C w)_c / sum w, but for a
constant. To this order the score's mean is not zero, and is subtracted (Cox and Snell 1968, "A general definition of
residuals": the bias of order 1/n). The weights follow the fitted level, too, and the level that they fade at: w =
(s / (s + f))^2 of a cell of the power s changes by the factor 1 + 2 (1 - sqrt(w)) (change of log s - change of log f),
with f as sum P^2 / sum P, so that (C w)_c / sum w is less 2 (1 - sqrt(w)) times itself minus the covariance of e_c with
log f. However long the flight, all of it is 0.05 deg of pitch and 4 cm of range of a beam of 2 deg from 30 m, where
these are hardly told apart, and 0.006 deg and 8 mm where they are. Mean ranges, of whole echoes or as an instrument
reads them, say less.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.detection.echoes import Profiles
from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.threads import chunks_of_bytes
from sionna_radar.inference.echo.likelihood import (
    BeamFootprints,
    EchoLikelihood,
    Linearised,
    Sightings,
    footprints,
    mean_ranges,
    predicted_means,
)
from sionna_radar.inference.echo.speckle import repeats
from sionna_radar.mapping.navigation.range_rates import RangeRates

# An echo that fits this many times worse than usual counts less, in proportion.
OUTLYING = 4.0


class Stage(Enum):
    """Stage of an estimate; its steps end once they are shorter than so many standard deviations."""

    COARSE = 1.0
    FINE = 0.02


@dataclass(frozen=True, kw_only=True)
class Step(Columns):
    """What each pulse says of the errors at an estimate.

    score, information: of its likelihood. reduced_chi2: squared residuals over their expected sum.
    spread: variance of the score of speckle over the information: less than one, since weak cells count less.
    residual_m, sigma_m: by how much its range exceeds the predicted one, and the standard deviation of that.
    """

    score: Float[np.ndarray, "pulse error"]
    information: Float[np.ndarray, "pulse error error"]
    reduced_chi2: Float[np.ndarray, " pulse"]
    spread: Float[np.ndarray, " pulse"]
    residual_m: Float[np.ndarray, " pulse"]
    sigma_m: Float[np.ndarray, " pulse"]

    def summed(self, own: slice = slice(None)) -> tuple[Float[np.ndarray, "error error"], Float[np.ndarray, " error"]]:
        """Return information and score of all pulses, or of some."""
        weight = self.weight[own]
        return np.einsum("p,pkl->kl", weight, self.information[own]), weight @ self.score[own]

    @cached_property
    def weight(self) -> Float[np.ndarray, " pulse"]:
        """Share that each pulse counts, less than one if it is outlying."""
        usual = float(np.nanmedian(self.reduced_chi2)) if np.isfinite(self.reduced_chi2).any() else 1.0
        return np.nan_to_num(np.minimum(1.0, OUTLYING * usual / np.maximum(self.reduced_chi2, 1e-12)))


@dataclass(frozen=True, kw_only=True)
class ErrorsLinearised:
    """The likelihood of whole echoes, linearised in heights and in errors.

    heights: in the heights under the nodes of the beams; node_score: its score, without its mean.
    per_error: heights under the nodes that stand for errors.
    score, information: of the errors. reduced_chi2, spread: see `Step`.
    doppler: see `RangeProfiles.doppler_information`.
    """

    heights: Linearised
    node_score: Float[np.ndarray, "pulse node"]
    score: Float[np.ndarray, "pulse error"]
    information: Float[np.ndarray, "pulse error error"]
    per_error: Float[np.ndarray, "pulse node error"]
    reduced_chi2: Float[np.ndarray, " pulse"]
    spread: Float[np.ndarray, " pulse"]
    doppler: "Information"

    @staticmethod
    def joined(parts: Sequence["ErrorsLinearised"]) -> "ErrorsLinearised":
        """Return the likelihood of several parts; the range rates of each count with its first pulse."""
        first = np.cumsum([0, *(len(part.heights.factor) for part in parts)])
        heights = Linearised(
            **{
                name: np.concatenate([getattr(part.heights, name) for part in parts])
                for name in ("place_m", "score", "factor", "residual", "weight")
            },
            first=np.concatenate([part.heights.first + own for part, own in zip(parts, first[:-1], strict=True)]),
            last=np.concatenate([part.heights.last + own for part, own in zip(parts, first[:-1], strict=True)]),
        )
        names = ("node_score", "score", "information", "per_error", "reduced_chi2", "spread")
        joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        at = np.cumsum([0, *(len(part.score) for part in parts)])[:-1]
        joined["information"][at] += [part.doppler[0] for part in parts]
        joined["score"][at] += [part.doppler[1] for part in parts]
        none = np.zeros_like(parts[0].doppler[0]), np.zeros_like(parts[0].doppler[1])
        return ErrorsLinearised(heights=heights, doppler=none, **joined)

    def weighted(self, weight: Float[np.ndarray, " pulse"]) -> "ErrorsLinearised":
        """Return the likelihood of echoes that count less: of each the information times a weight from 0 to 1."""
        heights = self.heights
        of_row = np.zeros(len(heights.factor))
        for pulse, own in enumerate(weight):
            of_row[heights.rows_of(pulse)] = own
        factor = (heights.factor * np.sqrt(of_row)[:, None]).astype(np.float32)
        return replace(
            self,
            heights=replace(heights, factor=factor, score=heights.score * weight[:, None]),
            node_score=self.node_score * weight[:, None],
            score=self.score * weight[:, None],
            information=self.information * weight[:, None, None],
        )


# Fisher information of errors, and the score.
Information = tuple[Float[np.ndarray, "error error"], Float[np.ndarray, " error"]]


@dataclass(frozen=True, kw_only=True)
class RangeProfiles:
    """Range profiles of some pulses, with the reported motion.

    sightings: with the reported poses. motion: of the same pulses.
    reach: over how many pulses the speckle of each repeats.
    rates: range rates of the ground in frames of the same lines, if it was measured.
    """

    sightings: Sightings
    motion: BelievedMotion
    reach: Float[np.ndarray, " pulse"]
    rates: RangeRates | None = None

    def __len__(self) -> int:
        return len(self.motion)

    def rows(self, kept: Bool[np.ndarray, " pulse"]) -> "RangeProfiles":
        """Return some of the echoes."""
        motion, rates = self.motion.rows(np.flatnonzero(kept)), self.rates
        if rates is not None:
            rates = rates.rows(np.isin(rates.motion.line, motion.line))
        return RangeProfiles(sightings=self.sightings.rows(kept), motion=motion, reach=self.reach[kept], rates=rates)

    def doppler_information(self, errors: InstrumentErrors, names: Sequence[str]) -> Information:
        """Return information and score of the range rates at an estimate; zero where there are none."""
        if self.rates is None:
            return np.zeros((len(names), len(names))), np.zeros(len(names))
        change, excess = self.rates.linearised(errors, names)
        weighted = change / self.rates.sigma_mps[:, None] ** 2
        return change.T @ weighted, excess @ weighted

    @staticmethod
    def joined(parts: Sequence["RangeProfiles"]) -> "RangeProfiles":
        """Return the echoes of several recordings of one radar; pulses and lines are counted on."""
        if len(parts) == 1:
            return parts[0]
        profiles, lines, rates, pulse, line = [], [], [], 0, 0
        for part in parts:
            own = part.sightings.profiles
            profiles.append(replace(own, pulse=own.pulse + pulse))
            lines.append(part.motion.line + line)
            if part.rates is not None:
                of_frames = part.rates.motion
                rates.append(replace(part.rates, motion=replace(of_frames, line=of_frames.line + line)))
            # No pulse follows the last one of another recording.
            pulse, line = int(profiles[-1].pulse[-1]) + 2, int(lines[-1].max()) + 1
        sightings = replace(
            parts[0].sightings,
            profiles=Profiles.concatenate(profiles),
            pose=Pose.concatenate([part.sightings.pose for part in parts]),
        )
        motion = BelievedMotion.concatenate([part.motion for part in parts])
        return RangeProfiles(
            sightings=sightings,
            motion=replace(motion, line=np.concatenate(lines)),
            reach=np.concatenate([part.reach for part in parts]),
            rates=RangeRates.concatenate(rates) if rates else None,
        )

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

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], stage: Stage) -> Step:
        """Return score and information of named errors over a surface, at an estimate of them.

        stage: mean ranges say less than whole echoes, but from farther away.
        """
        whole = stage is Stage.FINE
        steps = [(part._step if whole else part._mean_step)(errors, surface, names) for part in self._parts()]
        return Step.concatenate(steps)

    def expected(
        self,
        motion: BelievedMotion,
        errors: InstrumentErrors,
        surface: Heightfield,
        names: Sequence[str],
        sigma_m: float,
    ) -> Float[np.ndarray, "error error"]:
        """Return the information of echoes of another motion, each range as good as `sigma_m` at the usual range."""
        moved = motion.without(errors)
        sightings = replace(self.sightings, pose=moved.pose)
        change = self._change(sightings, moved, surface, names)
        here = footprints(self.without(errors)[0], surface).range_m
        there = footprints(sightings, surface).range_m
        longer = float(np.nanmedian(there) / np.nanmedian(here))
        # The echo of a beam is as much longer as its range.
        return np.einsum("pk,pl->kl", change, change) / (sigma_m * longer) ** 2

    def _change(
        self, sightings: Sightings, motion: BelievedMotion, surface: Heightfield, names: Sequence[str]
    ) -> Float[np.ndarray, "pulse error"]:
        """Return the change of the mean range of each echo per unit of each error."""
        feet, beam = footprints(sightings, surface), sightings.beam
        share = np.where(np.isfinite(feet.range_m), beam.between.T @ beam.power, 0.0)
        change = range_per_error(sightings.direction(), motion, feet, surface, names, sightings.doppler_s)
        return np.einsum("pn,pnk->pk", share / np.maximum(share.sum(axis=1, keepdims=True), 1e-12), change)

    def _parts(self) -> list["RangeProfiles"]:
        row = np.arange(len(self))
        bounds = chunks_of_bytes(len(self), 8 * len(self.sightings.beam.power))
        return [self.rows((row >= low) & (row < high)) for low, high in bounds]

    def _step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        linear = self.linearise(errors, surface, [*names, "range_bias"])
        return split_step(linear.score, linear.information, linear.reduced_chi2, linear.spread)

    def linearise(
        self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], speckle_scatter: float = 1.0
    ) -> ErrorsLinearised:
        """Return the likelihood linearised in the heights under the nodes, and in the heights that stand for errors.

        speckle_scatter: divides the looks; see `joint`.
        """
        sightings, motion = self.without(errors)
        model, looks = EchoLikelihood(sightings, surface), self.looks / speckle_scatter
        linear, feet = model.linearise(looks), model.footprints
        per_height = np.where(feet.range_per_height < 0, feet.range_per_height, -np.inf)[..., None]
        toward, shift = sightings.direction(), sightings.doppler_s
        heights = range_per_error(toward, motion, feet, surface, names, shift) / per_height
        score = np.einsum("pnk,pn->pk", heights, linear.score)
        pulses, _, count = heights.shape
        common = _common_speckle(sightings)
        information, reduced_chi2, spread = np.zeros((pulses, count, count)), *np.full((2, pulses), np.nan)
        node_score = linear.score.copy()
        for pulse in range(pulses):
            rows = linear.rows_of(pulse)
            if rows.start == rows.stop:
                continue
            factor, own = linear.factor[rows], linear.weight[rows]
            said = factor @ heights[pulse]
            information[pulse] = said.T @ said
            reduced_chi2[pulse] = (linear.residual[rows] ** 2).sum() / (own.sum() * looks[pulse])
            taken = np.sqrt(looks[pulse] * own) * _taken_by_level(own, common)
            score[pulse] += said.T @ taken
            node_score[pulse] += factor.T @ taken
            counted = np.sqrt(looks[pulse] * own) * said[:, -1]
            lags = np.correlate(counted, counted, "full")[len(own) - 1 :]
            half = common[len(common) // 2 :][: len(lags)]
            variance = 2 * lags[: len(half)] @ half - lags[0] * half[0]
            spread[pulse] = variance / max(information[pulse, -1, -1], 1e-300)
        return ErrorsLinearised(
            heights=linear,
            score=score,
            information=information,
            reduced_chi2=reduced_chi2,
            spread=spread,
            per_error=heights,
            node_score=node_score,
            doppler=self.doppler_information(errors, names),
        )

    def _mean_step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str]) -> Step:
        sightings, motion = self.without(errors)
        echoes = mean_ranges(self.sightings)
        toward = self.sightings.echo_direction()[:, None]
        excess = echoes.range_m + self.sightings.shift_m(toward)[:, 0] - predicted_means(sightings, surface)[0]
        sigma = np.maximum(echoes.sigma_m, float(np.median(echoes.sigma_m)) / 2) * np.sqrt(repeats(self.reach))
        slope = self._change(sightings, motion, surface, [*names, "range_bias"])
        return mean_range_step(slope, excess, sigma)


def _common_speckle(sightings: Sightings) -> Float[np.ndarray, " lag"]:
    """Return the covariance of the speckle of a cell and of those around it, relative to the square of its mean."""
    field = np.sqrt(sightings.response)
    correlation = np.convolve(field, field[::-1])
    power = (correlation / correlation.max()) ** 2
    # Powers averaged over chirps have as much less variance as they have more looks.
    return power / (sightings.looks_per_cell * power.sum())


def _taken_by_level(
    weight: Float[np.ndarray, " cell"], common: Float[np.ndarray, " lag"]
) -> Float[np.ndarray, " cell"]:
    """Return the part of the cells' relative powers that the level, fitted to them, takes on the average."""
    fading = 1 - np.sqrt(weight)
    power = np.sqrt(weight) / np.maximum(fading, np.finfo(float).eps)
    square = power**2
    level, faded_at = (
        np.convolve(share, common)[len(common) // 2 :][: len(weight)]
        for share in (weight / weight.sum(), 2 * square / square.sum() - power / power.sum())
    )
    return level - 2 * fading * (level - faded_at)


def split_step(
    score: Float[np.ndarray, "pulse k"],
    information: Float[np.ndarray, "pulse k k"],
    reduced_chi2: Float[np.ndarray, " pulse"],
    spread: Float[np.ndarray, " pulse"],
) -> Step:
    """Return a step whose last column, the range's bias, becomes its residual."""
    with np.errstate(divide="ignore", invalid="ignore"):
        residual, sigma = score[:, -1] / information[:, -1, -1], 1 / np.sqrt(information[:, -1, -1])
    return Step(
        score=score[:, :-1],
        information=information[:, :-1, :-1],
        reduced_chi2=reduced_chi2,
        spread=spread,
        residual_m=np.where(np.isfinite(sigma), residual, np.nan),
        sigma_m=np.where(np.isfinite(sigma), sigma, np.nan),
    )


def mean_range_step(
    slope: Float[np.ndarray, "pulse k"], excess_m: Float[np.ndarray, " pulse"], sigma_m: Float[np.ndarray, " pulse"]
) -> Step:
    """Return score and information of mean ranges from their excess over the predicted ones and its derivatives."""
    known = np.isfinite(excess_m)
    precision, excess = np.where(known, 1 / sigma_m**2, 0.0), np.where(known, excess_m, 0.0)
    score = slope * (precision * excess)[:, None]
    information = slope[:, :, None] * slope[:, None] * precision[:, None, None]
    return split_step(score, information, np.where(known, precision * excess**2, np.nan), np.ones(len(excess)))


def range_per_error(
    direction: Float[np.ndarray, "pulse node 3"],
    motion: BelievedMotion,
    feet: BeamFootprints,
    surface: Heightfield,
    names: Sequence[str],
    doppler_m: float,
) -> Float[np.ndarray, "pulse node error"]:
    """Return the change of the range that is read along each node of the beam, m, per SI unit of each error.

    direction: unit vectors toward the nodes, world frame.
    motion: without the errors that are known already.
    feet: where the nodes meet the surface; a node that meets nothing reads nothing.
    surface: the ground.
    names: of the errors, in `UNKNOWNS`.
    doppler_m: Doppler shift of the range per m/s of range rate.
    """
    slope = surface.slope(*feet.place_m.reshape(-1, 2).T)
    shape = feet.range_m.shape
    normal = np.stack([-slope[0].reshape(shape), -slope[1].reshape(shape), np.ones(shape)], axis=2)
    range_m = np.nan_to_num(feet.range_m)
    per_height = -feet.range_per_height[..., None]
    velocity = np.broadcast_to(motion.pose.velocity_mps[:, None], direction.shape)
    turned = per_height * range_m[..., None] * np.cross(direction, normal) - doppler_m * np.cross(direction, velocity)
    by = np.concatenate([turned, per_height * normal, -doppler_m * direction], axis=2)
    change = by @ motion.per_error(names)
    for column, name in enumerate(names):
        if name == "range_bias":
            change[..., column] = 1.0
        elif name == "range_scale":
            change[..., column] = range_m
    return np.where(np.isfinite(feet.range_m)[..., None], change, 0.0)
