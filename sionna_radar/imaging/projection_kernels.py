"""Back-projection as machine code: every pixel of a chunk sums the pulses that light it, in their order."""

import math
from typing import no_type_check

import numpy as np
from jaxtyping import Complex, Float, Int
from numpy import ndarray
from scipy.constants import speed_of_light

from sionna_radar.foundation.compiled import compiled
from sionna_radar.foundation.turns import turned

# Of range, there and back.
S_PER_M = 2 / speed_of_light


@compiled
@no_type_check
def project(
    low: int,
    high: int,
    pixel_m: Float[ndarray, "pixel 3"],
    row: Int[ndarray, " lit"],
    pose: tuple[Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"]],
    spectra: Complex[ndarray, "pulse bin"],
    sweep: tuple[float, float, float, float],
    weighting: tuple[float, Float[ndarray, " node"], Float[ndarray, " n"], bool],
    image: tuple[Complex[ndarray, " pixel"], Float[ndarray, " pixel"], Int[ndarray, " pixel"]],
) -> None:
    """Add pulses to the pixels from low to high: their values, their weights and their number.

    Parameters
    ----------
    low, high:
        Which pixels.
    pixel_m:
        Their positions.
    row:
        Pulses that light some of them.
    pose:
        Measured positions and velocities of these, and the directions ahead and to the left of their antennas.
    spectra:
        Range spectra of all pulses.
    sweep:
        Its carrier in hertz, slope in hertz per second, direction, and the spectrum bins for each hertz of beat.
    weighting:
        What a pulse counts by the direction cosine u of a pixel: the reach; the taper on equal steps from -reach to
        reach; the one-way voltage of the beam from -1 to 1; whether the beam is divided out.
    image:
        Sums of weighted values, sums of weights times two-way beam, and numbers of pulses.

    """
    total, weight_sum, count = image
    reach, taper, voltage, flat = weighting
    last = spectra.shape[1] - 1
    # By pulse: place in the spectrum, -1 where the pixel is not lit; cosine and sine of its phase; direction cosine.
    seen = np.empty((4, len(row)))
    for pixel in range(low, high):
        _look(pixel_m[pixel], pose, sweep, reach, seen[0], seen[1], seen[2], seen[3])
        # The sums go on where they were, so that they do not depend on how many pulses are added at once.
        real, imaginary, weights = total[pixel].real, total[pixel].imag, weight_sum[pixel]
        for n in range(len(row)):
            place = seen[0, n]
            if place < 0 or place >= last:
                continue
            below = int(place)
            share = place - below
            spectrum = spectra[row[n]]
            value = spectrum[below] * (1 - share) + spectrum[below + 1] * share
            u = seen[3, n]
            two_way = _on_equal_steps(voltage, 1.0, u) ** 2
            weight = _on_equal_steps(taper, reach, u)
            if flat:
                weight /= two_way
            cosine, sine = weight * seen[1, n], weight * seen[2, n]
            real += value.real * cosine + value.imag * sine
            imaginary += value.imag * cosine - value.real * sine
            weights += weight * two_way
            count[pixel] += 1
        total[pixel], weight_sum[pixel] = complex(real, imaginary), weights


@compiled
@no_type_check
def _look(
    pixel_m: Float[ndarray, " 3"],
    pose: tuple[Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"], Float[ndarray, "3 lit"]],
    sweep: tuple[float, float, float, float],
    reach: float,
    place: Float[ndarray, " lit"],
    cosine: Float[ndarray, " lit"],
    sine: Float[ndarray, " lit"],
    u: Float[ndarray, " lit"],
) -> None:
    """Write where the echo of a pixel lies in the spectra of pulses, -1 for those that do not light it, and its phase.

    Without a branch and pulse after pulse in memory, so that several are worked out at once.
    """
    position_m, velocity_mps, axis, side = pose
    carrier_hz, slope_hz_s, direction, bins_per_hz = sweep
    px, py, pz = pixel_m[0], pixel_m[1], pixel_m[2]
    for n in range(len(place)):
        x, y, z = px - position_m[0, n], py - position_m[1, n], pz - position_m[2, n]
        left = x * side[0, n] + y * side[1, n] + z * side[2, n]
        ahead = x * axis[0, n] + y * axis[1, n] + z * axis[2, n]
        range_m = math.sqrt(x * x + y * y + z * z)
        per_range = 1 / range_m
        approach = x * velocity_mps[0, n] + y * velocity_mps[1, n] + z * velocity_mps[2, n]
        # As `phase_polynomial`.
        delay_s, stretch = S_PER_M * range_m, -S_PER_M * per_range * approach
        shift_hz = carrier_hz * stretch - slope_hz_s * delay_s * stretch
        at = direction * (shift_hz + slope_hz_s * delay_s) * bins_per_hz
        place[n] = at if (abs(left) <= reach * range_m) & (ahead > 0) else -1.0
        cosine[n], sine[n] = turned(direction * (carrier_hz * delay_s - slope_hz_s * delay_s**2 / 2))
        u[n] = left * per_range


@compiled
@no_type_check
def _on_equal_steps(value: Float[ndarray, " n"], end: float, at: float) -> float:
    """Return a function, given on equal steps from -end to end, between its samples."""
    last = len(value) - 1
    place = (min(max(at, -end), end) + end) * (last / (2 * end))
    below = min(int(place), last - 1)
    share = place - below
    return value[below] * (1 - share) + value[below + 1] * share
