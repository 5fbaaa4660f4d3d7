"""Physical optics over triangles, as machine code."""

from typing import no_type_check

import numpy as np

from sionna_radar.foundation.compiled import compiled

# Exponents nearer to each other than this are taken by the series about their mean.
NEAR = 0.5
TERMS = 12


@compiled
@no_type_check
def first_difference(a, b):
    """Return (exp(j b) - exp(j a)) / (j (b - a))."""
    half = (b - a) / 2
    share = 1.0 - half * half / 6 if abs(half) < 1e-4 else np.sin(half) / half
    middle = (a + b) / 2
    return complex(np.cos(middle), np.sin(middle)) * share


@compiled
@no_type_check
def second_difference(a, b, c):
    """Return the divided difference of the exponential at j a, j b and j c: 1 / 2 where they are all zero."""
    low, high = min(a, b, c), max(a, b, c)
    between = a + b + c - low - high
    if high - low > NEAR:
        return (first_difference(between, high) - first_difference(low, between)) / (1j * (high - low))
    # exp(j m) times the sum over n of h_n / (n + 2)!, h_n the complete symmetric polynomials of the distances.
    middle = (a + b + c) / 3
    x, y, z = 1j * (low - middle), 1j * (between - middle), 1j * (high - middle)
    one, two, three = 1.0 + 0j, 1.0 + 0j, 1.0 + 0j
    total, factorial = 0.5 + 0j, 2.0
    for n in range(1, TERMS):
        one *= x
        two = one + y * two
        three = two + z * three
        factorial *= n + 2
        total += three / factorial
    return total * complex(np.cos(middle), np.sin(middle))


@compiled
@no_type_check
def second_differences(phase):
    """Return the divided differences of the exponential at rows of three phases."""
    out = np.empty(len(phase), dtype=np.complex128)
    for row in range(len(phase)):
        out[row] = second_difference(phase[row, 0], phase[row, 1], phase[row, 2])
    return out


@compiled
@no_type_check
def face_amplitudes(radar, corner, middle, normal, wavelength, seen, out):
    """Write the amplitude of each face seen from each place, relative to the phase of its middle."""
    twice = 4.0 * np.pi / wavelength
    phase = np.empty(3)
    for place in range(len(radar)):
        for face in range(len(corner)):
            if not seen[place, face]:
                continue
            x, y, z = (
                middle[face, 0] - radar[place, 0],
                middle[face, 1] - radar[place, 1],
                middle[face, 2] - radar[place, 2],
            )
            distance = np.sqrt(x * x + y * y + z * z)
            x, y, z = x / distance, y / distance, z / distance
            for k in range(3):
                phase[k] = -twice * (
                    x * (corner[face, k, 0] - middle[face, 0])
                    + y * (corner[face, k, 1] - middle[face, 1])
                    + z * (corner[face, k, 2] - middle[face, 2])
                )
            across = abs(x * normal[face, 0] + y * normal[face, 1] + z * normal[face, 2])
            out[place, face] = (
                2.0 * np.sqrt(np.pi) / wavelength * across * 2.0 * second_difference(phase[0], phase[1], phase[2])
            )
