"""Mean range rates of the ground in frames of chirps, and what errors of the instrument change of them.

The mean range rate of a frame's ground needs no map: it is the phase of the mean product of successive chirps (pulse
pairs: Miller and Rochwarger 1972, "A covariance approach to spectral moment estimation", IEEE Trans. Inf. Theory 18).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Inexact, Int

from sionna_radar.detection.detector import Detector
from sionna_radar.flight.frames import MIN_GRAZING_SINE
from sionna_radar.flight.instrument import UNKNOWNS, BelievedMotion, InstrumentErrors, stretches
from sionna_radar.foundation.columns import Columns
from sionna_radar.foundation.threads import chunks_of_bytes

# Frames that are read at once: it bounds the memory.
# Power of range cells of the main lobe's echo, as a share of the strongest one's, at least.
MIN_POWER_SHARE = 0.01
# Combinations of errors that change range rates by a smaller share of the most influential one's are none.
MIN_SINGULAR_VALUE = 0.01
# Frames of a stretch of the flight, and degrees of freedom of the means of stretches that tell a variance, at least.
MIN_FRAMES_PER_STRETCH, MIN_FREEDOM = 8, 8


def pulse_pair_rates(
    detector: Detector,
    beats: Callable[[Int[np.ndarray, " chirp"]], Inexact[np.ndarray, "chirp sample"]],
    frames: Int[np.ndarray, "frame chirp"],
    interval_s: float,
) -> Float[np.ndarray, " frame"]:
    """Return the mean range rates of the echoes in frames of chirps, m/s, positive when receding.

    detector: its spectra, and ranges from which on there are echoes.
    beats: returns the beat signals of chirps by their numbers, which `frames` holds.
    interval_s: from chirp to chirp. Rates repeat after half a wavelength in it; those returned are the smallest ones.
    """
    found = []
    for low, high in chunks_of_bytes(len(frames), 16 * frames.shape[1] * len(detector.analyser.range_m)):
        some = frames[low:high]
        spectrum = detector.analyser.amplitude(beats(some.ravel())).reshape(*some.shape, -1)
        power = np.mean(spectrum.real**2 + spectrum.imag**2, axis=1) * (
            detector.analyser.range_m >= detector.min_range_m
        )
        strong = power > MIN_POWER_SHARE * power.max(axis=1, keepdims=True)
        pairs = np.sum(spectrum[:, :-1].conj() * spectrum[:, 1:], axis=1)
        found.append(np.angle(np.sum(pairs, axis=1, where=strong)))
    chirp = detector.analyser.chirp
    return chirp.direction * np.concatenate(found) / (4 * np.pi) * chirp.wavelength_m / interval_s


@dataclass(frozen=True, kw_only=True)
class RangeRates(Columns):
    """Mean range rates of the ground in frames, with the reported motion in their middle.

    With C the covariance of the two-way beam over directions, b its axis, e the direction across it toward the nadir
    and i the incidence on level ground, power comes from the mean direction

        u = (1 - tr C / 2) b + (2 tan i + k) C e:

    it falls with the square of the range, of which the logarithm grows by tan i, where gamma is constant, and k is the
    error `backscatter_slope`. The range rate is -v . u, whatever the height of the ground.

    rate_mps; sigma_mps: standard deviations of independent frames that would tell as much. spread: those of the beam's
    two-way power over azimuth and elevation, rad.
    """

    rate_mps: Float[np.ndarray, " frame"]
    sigma_mps: Float[np.ndarray, " frame"]
    spread: Float[np.ndarray, "frame 2"]
    motion: BelievedMotion

    @staticmethod
    def of_frames(
        rate_mps: Float[np.ndarray, " frame"], motion: BelievedMotion, spread: tuple[float, float], ambiguity_mps: float
    ) -> "RangeRates":
        """Return range rates that repeat after `ambiguity_mps` as those nearest to the reported motion.

        Frames share scatterers, and covers: the variance is that of the means of stretches of the flight, without what
        errors of the instrument explain. It is infinite if the flight is too short to tell it.
        """
        ones = np.ones(len(rate_mps))
        folded = RangeRates(rate_mps=rate_mps, sigma_mps=ones, spread=np.outer(ones, spread), motion=motion)
        names = tuple(UNKNOWNS)
        change, wrapped = folded.linearised(InstrumentErrors(), names)
        excess = (wrapped + ambiguity_mps / 2) % ambiguity_mps - ambiguity_mps / 2
        scaled = change * [UNKNOWNS[name].prior * UNKNOWNS[name].si for name in names]
        fitted, _, rank, _ = np.linalg.lstsq(scaled, excess, rcond=MIN_SINGULAR_VALUE)
        left, number = excess - scaled @ fitted, stretches(motion.line, MIN_FRAMES_PER_STRETCH)
        of_means = np.sum(np.bincount(number, left) ** 2 / np.bincount(number))
        # The variance of Student's t distribution, which few stretches leave.
        freedom = int(number.max()) + 1 - rank
        variance = max(float(np.mean(left**2)), of_means / (freedom - 2)) if freedom >= MIN_FREEDOM else np.inf
        return replace(folded, rate_mps=rate_mps + excess - wrapped, sigma_mps=np.sqrt(variance) * ones)

    def linearised(
        self, errors: InstrumentErrors, names: Sequence[str]
    ) -> tuple[Float[np.ndarray, "frame error"], Float[np.ndarray, " frame"]]:
        """Return the change of the rates per SI unit of each error, and their excess over those at given errors."""
        motion = self.motion.without(errors)
        toward, turned = self._toward(motion, errors.backscatter_slope)
        velocity = motion.pose.velocity_mps
        by = np.concatenate([-np.cross(toward, velocity), np.zeros_like(velocity), -toward], axis=1)
        change = np.einsum("fi,fik->fk", by, motion.per_error(names))
        for column, name in enumerate(names):
            if name == "backscatter_slope":
                change[:, column] = -np.sum(velocity * turned, axis=1)
        return change, self.rate_mps + np.sum(velocity * toward, axis=1)

    def _toward(
        self, motion: BelievedMotion, slope: float
    ) -> tuple[Float[np.ndarray, "frame 3"], Float[np.ndarray, "frame 3"]]:
        """Return the mean direction of the power, and by how much it turns for each unit of `backscatter_slope`."""
        axis, across = motion.pose.boresight, motion.pose.R_world_antenna[:, :, 1:]
        sine = np.maximum(np.linalg.norm(axis[:, :2], axis=1), 1e-9)[:, None]
        # The antenna's own axes are across the beam's: e has the components -z / sine in them.
        turned = -np.einsum("fij,fj->fi", across, self.spread**2 * across[:, 2]) / sine
        tangent = sine / np.maximum(-axis[:, 2:], MIN_GRAZING_SINE)
        toward = (1 - np.sum(self.spread**2, axis=1, keepdims=True) / 2) * axis + (2 * tangent + slope) * turned
        return toward, turned
