"""Back-projection as machine code: every pixel of a chunk sums the pulses that light it, in their order."""

import math
from typing import no_type_check

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
    pose: tuple[Float[ndarray, "pulse 3"], Float[ndarray, "pulse 3"], Float[ndarray, "pulse 3 3"]],
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
        Measured positions, velocities and R_world_antenna of all pulses.
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
    position_m, velocity_mps, R_world_antenna = pose
    total, weight_sum, count = image
    carrier_hz, slope_hz_s, direction, bins_per_hz = sweep
    reach, taper, voltage, flat = weighting
    bins = spectra.shape[1]
    for pixel in range(low, high):
        for k in row:
            x = pixel_m[pixel, 0] - position_m[k, 0]
            y = pixel_m[pixel, 1] - position_m[k, 1]
            z = pixel_m[pixel, 2] - position_m[k, 2]
            R = R_world_antenna[k]
            left = x * R[0, 1] + y * R[1, 1] + z * R[2, 1]
            range_m = math.sqrt(x * x + y * y + z * z)
            ahead = x * R[0, 0] + y * R[1, 0] + z * R[2, 0]
            if abs(left) > reach * range_m or ahead <= 0:
                continue
            v = velocity_mps[k]
            per_range = 1 / range_m
            # As `phase_polynomial`.
            delay_s, stretch = S_PER_M * range_m, -S_PER_M * per_range * (x * v[0] + y * v[1] + z * v[2])
            turns = direction * (carrier_hz * delay_s - slope_hz_s * delay_s**2 / 2)
            shift_hz = carrier_hz * stretch - slope_hz_s * delay_s * stretch
            place = direction * (shift_hz + slope_hz_s * delay_s) * bins_per_hz
            if place < 0 or place >= bins - 1:
                continue
            below = int(place)
            share = place - below
            value = spectra[k, below] * (1 - share) + spectra[k, below + 1] * share
            u = left * per_range
            two_way = _on_equal_steps(voltage, 1.0, u) ** 2
            weight = _on_equal_steps(taper, reach, u)
            if flat:
                weight /= two_way
            cosine, sine = turned(turns)
            total[pixel] += weight * value * complex(cosine, -sine)
            weight_sum[pixel] += weight * two_way
            count[pixel] += 1


@compiled
@no_type_check
def _on_equal_steps(value: Float[ndarray, " n"], end: float, at: float) -> float:
    """Return a function, given on equal steps from -end to end, between its samples."""
    last = len(value) - 1
    place = (min(max(at, -end), end) + end) * (last / (2 * end))
    below = min(int(place), last - 1)
    share = place - below
    return value[below] * (1 - share) + value[below + 1] * share
