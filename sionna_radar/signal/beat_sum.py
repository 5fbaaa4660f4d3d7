"""Non-uniform FFT: sums of complex exponentials for a block of beat signals.

Each exponential of u cycles per sample is spread over a few points of a fine grid of frequencies, around its own; an
ordinary Fourier transform of the grid then gives the samples, after division by the transform of the spreading function
(Dutt and Rokhlin 1993, "Fast Fourier transforms for nonequispaced data"; the spreading function is that of Barnett,
Magland and af Klinteberg 2019, "A parallel nonuniform fast Fourier transform library based on an exponential of
semicircle kernel", whose library FINUFFT computes the same one signal at a time).

The constant part of a path's phase and its gain make its weight; the phase is that of `signal.beat`.
"""

from functools import cache
from typing import no_type_check

import numpy as np
from jaxtyping import Complex, Float, Int
from scipy.fft import ifft, next_fast_len

from sionna_radar.foundation.compiled import compiled, turned
from sionna_radar.foundation.numerics import gauss_legendre
from sionna_radar.foundation.threads import chunks_of_bytes, over_rows

# Oversampling of the frequency grid, and width of the spreading function in points.
OVERSAMPLING, WIDTH = 2.0, 10
# Shape parameter of the spreading function for this oversampling.
SHARPNESS = 2.30 * WIDTH
# Pieces of the spreading function between two points of the grid; in each it is a cubic polynomial.
PIECES = 128
NODES = 64


def exponential_sums(
    first: Int[np.ndarray, " row"],
    last: Int[np.ndarray, " row"],
    frequency: Float[np.ndarray, " path"],
    weight: Complex[np.ndarray, " path"],
    bend: Float[np.ndarray, " row"],
    samples: int,
) -> Complex[np.ndarray, "row {samples}"]:
    """Return sums over the paths of each row for n = -samples // 2, -samples // 2 + 1 and so on.

    A path adds weight exp(2 pi j (frequency n + bend n^2)).

    first, last: begin and end of the paths of each row.
    frequency: cycles per sample; whole cycles change nothing.
    weight: of each path.
    bend: cycles per sample squared, of all paths of a row.
    samples: number per row.
    """
    points = int(next_fast_len(int(np.ceil(OVERSAMPLING * samples))))
    pieces, correction = spreading_pieces(), sample_correction(samples, points)
    sums = np.empty((len(first), samples), dtype=np.complex128)

    def add(start: int, stop: int) -> None:
        """Write the sums of some rows."""
        bounds = chunks_of_bytes(stop - start, 16 * points)
        grid = np.empty((bounds[0][1], points), dtype=np.complex128)
        padded = np.empty((2, points + WIDTH))
        for low, high in bounds:
            rows, used = slice(start + low, start + high), grid[: high - low]
            _spread(first[rows], last[rows], frequency, weight, pieces, *padded, used)
            transform = ifft(used, axis=1, overwrite_x=True, norm="forward")
            _finish(transform, correction, bend[rows], sums[rows])

    over_rows(add, len(first))
    return sums


def _spreading(offset: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Return the exponential of a semicircle, at offsets in units of the grid."""
    semicircle = np.maximum(1 - (2 * offset / WIDTH) ** 2, 0.0)
    return np.exp(SHARPNESS * (np.sqrt(semicircle) - 1))


@cache
def sample_correction(samples: int, points: int) -> Float[np.ndarray, " {samples}"]:
    """Return the inverse of the spreading function's transform at each sample, by Gaussian quadrature."""
    node, weight = gauss_legendre(NODES)
    offset = node * WIDTH / 2
    sample = np.arange(samples) - samples // 2
    wave = np.cos(2 * np.pi * np.outer(sample / points, offset))
    return 1 / (wave @ (weight * WIDTH / 2 * _spreading(offset)))


@cache
def spreading_pieces() -> Float[np.ndarray, "piece 4 point"]:
    """Return the cubic polynomials of the spreading function at each point, in the fraction of a piece.

    The first point lies t - WIDTH / 2 from the exponential, with t from 0 to 1 in all pieces. Each polynomial
    interpolates the function at the Chebyshev nodes of its piece.
    """
    fraction = 0.5 - 0.5 * np.cos(np.pi * (np.arange(4) + 0.5) / 4)
    offset = (np.arange(PIECES)[:, None] + fraction) / PIECES
    value = _spreading(offset[..., None] - WIDTH / 2 + np.arange(WIDTH))
    return np.ascontiguousarray(np.einsum("kn,pnj->pkj", np.linalg.inv(np.vander(fraction, 4, increasing=True)), value))


@compiled
@no_type_check
def _spread(first, last, frequency, weight, pieces, real, imaginary, grid):
    points = grid.shape[1]
    for row in range(len(grid)):
        for k in range(points + WIDTH):
            real[k] = imaginary[k] = 0.0
        for path in range(first[row], last[row]):
            a, b = weight[path].real, weight[path].imag
            if a == 0.0 and b == 0.0:
                continue
            u = frequency[path]
            # From here on the grid is shifted by half the width, so that no index is negative.
            x = (u - np.floor(u)) * points
            begin = np.ceil(x)
            t = (begin - x) * PIECES
            piece = min(int(t), PIECES - 1)
            t -= piece
            index = min(int(begin), points)
            c = pieces[piece]
            for j in range(WIDTH):
                value = ((c[3, j] * t + c[2, j]) * t + c[1, j]) * t + c[0, j]
                real[index + j] += a * value
                imaginary[index + j] += b * value
        half_width = WIDTH // 2
        for k in range(points):
            grid[row, k] = complex(real[k + half_width], imaginary[k + half_width])
        # The frequency axis is periodic: wrap the margins.
        for k in range(half_width):
            grid[row, points - half_width + k] += complex(real[k], imaginary[k])
            grid[row, k] += complex(real[points + half_width + k], imaginary[points + half_width + k])


@compiled
@no_type_check
def _finish(transform, correction, bend, sums):
    points, samples = transform.shape[1], sums.shape[1]
    half = samples // 2
    for row in range(len(sums)):
        # The phase's second difference is constant: exp(j bend n^2) by two products per sample.
        angle = 2.0 * np.pi * bend[row]
        start = angle * half * half
        turn = complex(np.cos(start), np.sin(start))
        slope = angle * (1 - 2 * half)
        step = complex(np.cos(slope), np.sin(slope))
        twist = complex(np.cos(2.0 * angle), np.sin(2.0 * angle))
        for n in range(samples):
            k = n - half
            if k < 0:
                k += points
            sums[row, n] = transform[row, k] * (correction[n] * turn)
            turn = turn * step
            step = step * twist


@compiled
@no_type_check
def weigh(low, high, first, last, delay_s, range_rate_mps, gain, sweep, columns):
    """Write the frequency and weight of each path, and the difference of its drift from the mean of its row.

    sweep: carrier, slope and direction of the chirp, time of its middle after the pose, lowest and highest beat that
        passes, sampling rate, speed of light.
    columns: of each path cycles per sample, weight, and difference in drift from the mean of its row, cycles per square
        second; of each row that mean, weighted by power, the power, and that of the differences.
    """
    carrier, slope, sign, centre_s, least_hz, most_hz, rate_hz, c = sweep
    frequency, weight, excess, mean, total, scattered = columns
    for row in range(low, high):
        # Vectorised: no dependence on the previous path, and views, whose indices are known not to be negative.
        paths_of_row = slice(first[row], last[row])
        f, w, x, tau, rate, amplitude = (
            frequency[paths_of_row],
            weight[paths_of_row],
            excess[paths_of_row],
            delay_s[paths_of_row],
            range_rate_mps[paths_of_row],
            gain[paths_of_row],
        )
        for n in range(len(f)):
            stretch = 2.0 * rate[n] / c
            delay = tau[n] + centre_s * stretch
            beat = sign * (carrier * stretch + slope * delay - slope * delay * stretch)
            f[n] = beat / rate_hz
            x[n] = sign * (slope * stretch - slope * stretch * stretch / 2.0)
            cosine, sine = turned(sign * (carrier * delay - slope * delay * delay / 2.0))
            passes = 1.0 if beat >= least_hz and beat < most_hz else 0.0
            a, b = passes * amplitude[n].real, -sign * passes * amplitude[n].imag
            w[n] = complex(a * cosine - b * sine, a * sine + b * cosine)
        power = moment = 0.0
        for path in range(first[row], last[row]):
            p = weight[path].real ** 2 + weight[path].imag ** 2
            power += p
            moment += p * excess[path]
        mean[row] = moment / power if power > 0.0 else 0.0
        total[row] = power
        square = 0.0
        for path in range(first[row], last[row]):
            excess[path] -= mean[row]
            p = weight[path].real ** 2 + weight[path].imag ** 2
            square += p * excess[path] * excess[path]
        scattered[row] = square
