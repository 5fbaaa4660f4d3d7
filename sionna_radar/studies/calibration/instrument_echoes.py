"""What echoes and readings of several recordings say of an instrument, and errors that drift from line to line.

An error may drift from line to line: on line l it is theta + d_l, with d_l of zero mean and a stated covariance S. With
s and J the score and information of a line, and D the errors that drift, d_l is eliminated line by line as a random
effect (Laird and Ware 1982, "Random-effects models for longitudinal data"), which leaves for theta

    J - J_D (J_DD + S^-1)^-1 J_D',   s - J_D (J_DD + S^-1)^-1 (s_D - S^-1 d_l).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.elevation.heightfield import Heightfield
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors
from sionna_radar.foundation.columns import Columns
from sionna_radar.inference.echo.likelihood import BeamFootprints
from sionna_radar.mapping.navigation.echo_errors import (
    Information,
    RangeProfiles,
    Stage,
    Step,
    mean_range_step,
    range_per_error,
)


@dataclass(frozen=True, kw_only=True)
class Readings(Columns):
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

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], stage: Stage) -> Step:
        """Return score and information of the readings on named errors over a surface, at an estimate of them."""
        del stage  # their model is linear
        motion = self.motion.without(errors)
        hit, change = self._change(motion, surface, [*names, "range_bias"])
        shift = self.doppler_m * motion.pose.boresight_range_rate_mps
        return mean_range_step(change, self.range_m - errors.read_m(hit) - shift, self.sigma_m)

    def expected(
        self,
        motion: BelievedMotion,
        errors: InstrumentErrors,
        surface: Heightfield,
        names: Sequence[str],
        sigma_m: float,
    ) -> Float[np.ndarray, "error error"]:
        """Return the information of readings of another motion, each range as good as `sigma_m`."""
        _, change = self._change(motion.without(errors), surface, names)
        return np.einsum("pk,pl->kl", change, change) / sigma_m**2

    def _change(
        self, motion: BelievedMotion, surface: Heightfield, names: Sequence[str]
    ) -> tuple[Float[np.ndarray, " pulse"], Float[np.ndarray, "pulse error"]]:
        """Return the range to the surface along each axis, and the change of the reading per unit of each error."""
        pose = motion.pose
        hit = surface.first_hit(pose.position_m, pose.boresight, self.reach_m)
        place = (pose.position_m + np.nan_to_num(hit)[:, None] * pose.boresight)[:, :2]
        east, north = surface.slope(*place.T)
        closing = pose.boresight[:, 2] - east * pose.boresight[:, 0] - north * pose.boresight[:, 1]
        per_height = 1 / np.minimum(closing, -MIN_GRAZING_SINE)
        feet = BeamFootprints(hit[:, None], place[:, None], per_height[:, None], np.zeros((len(hit), 1)))
        toward = pose.boresight[:, None]
        return hit, range_per_error(toward, motion, feet, surface, names, self.doppler_m)[:, 0]


@dataclass(frozen=True, kw_only=True)
class CombinedEchoes:
    """The echoes of several recordings."""

    parts: tuple[RangeProfiles | Readings, ...]

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
    def lines(self) -> tuple["CombinedEchoes", ...]:
        """The echoes of each flight line."""
        return tuple(
            CombinedEchoes(parts=(part.rows(part.motion.line == line),))
            for part in self.parts
            for line in np.unique(part.motion.line)
        )

    @property
    def repeated(self) -> float:
        """Mean number of pulses over which speckle repeats."""
        return float(np.average([part.repeated for part in self.parts], weights=list(map(len, self.parts))))

    @property
    def whole(self) -> bool:
        """Whether all are whole echoes, whose reduced_chi2 is known."""
        return all(isinstance(part, RangeProfiles) for part in self.parts)

    def step(self, errors: InstrumentErrors, surface: Heightfield, names: Sequence[str], stage: Stage) -> Step:
        """Return score and information of all echoes; see `RangeProfiles.step`."""
        return Step.concatenate([part.step(errors, surface, names, stage) for part in self.parts])

    def doppler_information(self, errors: InstrumentErrors, names: Sequence[str]) -> Information:
        """Return information and score of all range rates; see `RangeProfiles.doppler_information`."""
        said = [part.doppler_information(errors, names) for part in self.parts if isinstance(part, RangeProfiles)]
        count = len(names)
        return sum((i for i, _ in said), np.zeros((count, count))), sum((s for _, s in said), np.zeros(count))


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Errors that are constant on a line, and differ between lines.

    names: of the errors of the whole flight. between: standard deviations between lines, SI, by name.
    """

    names: tuple[str, ...]
    between: Mapping[str, float]

    @cached_property
    def all_names(self) -> tuple[str, ...]:
        """Names of the errors of the flight, and of those that only drift."""
        return (*self.names, *(name for name in self.between if name not in self.names))

    @cached_property
    def own(self) -> list[int]:
        """Which of `all_names` drift."""
        return [self.all_names.index(name) for name in self.between]

    @cached_property
    def sigma(self) -> Float[np.ndarray, " drift"]:
        """Standard deviations between lines."""
        return np.array([*self.between.values()])

    def errors(self, value: Float[np.ndarray, " error"], line_offsets: Float[np.ndarray, " drift"]) -> InstrumentErrors:
        """Return the errors of a line, given those of the flight, and what the line has apart from them."""
        at = dict(zip(self.names, map(float, value), strict=True))
        for name, more in zip(self.between, line_offsets, strict=True):
            at[name] = at.get(name, 0.0) + float(more)
        return InstrumentErrors.of(at)

    def eliminated(
        self,
        information: Float[np.ndarray, "every every"],
        score: Float[np.ndarray, " every"],
        line_offsets: Float[np.ndarray, " drift"],
    ) -> "Eliminated":
        """Return the information of a line on the errors of the flight, with its own errors eliminated."""
        count, own, root = len(self.names), self.own, self.sigma
        # In units of the standard deviations between lines, where the matrix is well conditioned.
        scaled = root[:, None] * information[np.ix_(own, own)] * root + np.eye(len(own))
        covariance = root[:, None] * np.linalg.inv(scaled) * root
        gain = covariance @ information[own, :count]
        moved = covariance @ (score[own] - line_offsets / root**2)
        return Eliminated(
            information=information[:count, :count] - information[:count, own] @ gain,
            score=score[:count] - information[:count, own] @ moved,
            covariance=covariance,
            gain=gain,
            moved=moved,
        )


@dataclass(frozen=True, kw_only=True)
class Eliminated:
    """A line without its own errors: information and score of those of the flight.

    covariance: of its own errors, if those of the flight were known. moved: their step, less `gain` times that of the
    flight's.
    """

    information: Float[np.ndarray, "error error"]
    score: Float[np.ndarray, " error"]
    covariance: Float[np.ndarray, "drift drift"]
    gain: Float[np.ndarray, "drift error"]
    moved: Float[np.ndarray, " drift"]
