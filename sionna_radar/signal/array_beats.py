"""Beat signals of an array: one set of paths serves all chirps of a frame, all transmitters and all receivers.

Scatterers stand still between the chirps, or move along their rays; the radar moves. So the ways of each chirp follow
from the places of the scatterers and from the radar's true pose at that chirp, and those of each element from its
place: that of a transmitter exactly, that of a receiver to third order in its distance from the array's middle over the
range (an error of 1e-7 m at 0.1 m and 10 m; see `radar.mimo_array`).

The sum of the exponentials of a chirp is that of `beat_sum`. What differs between the receivers of a chirp is each
path's phase, and by little its frequency: a way longer by d moves an exponential by x = S d / c, a small part of a
point of the grid. Both kinds of spreading share one set of powers of x,

    w(t - x) = w - x w' + x^2 w'' / 2 - x^3 w''' / 6,

as many as the widest x asks for, so that a receiver costs a few multiplications a path and not another search and
evaluation; and transmitters that send at once are summed for all receivers. A sweep's own drift in frequency by motion
(the bend of `beat_sum`) is that of the power-weighted mean of its paths.
"""

from dataclasses import dataclass
from functools import partial
from typing import no_type_check

import numpy as np
from jaxtyping import Complex, Float
from scipy.constants import speed_of_light
from scipy.fft import ifft, next_fast_len

from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.compiled import compiled, turned
from sionna_radar.foundation.threads import cores, over_rows
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.signal.beat import sampled_band_hz
from sionna_radar.signal.beat_sum import OVERSAMPLING, PIECES, WIDTH, sample_correction, spreading_pieces
from sionna_radar.tracing.paths import Paths

# Largest error of the spreading function, relative to its peak; its n-th derivative is about one a point each.
SPREAD_ACCURACY = 1e-4
HIGHEST_ORDER = 3
# Chirps whose grids are held at once, in complex numbers.
GRID_NUMBERS = 2**21
LANES = 8


@dataclass(frozen=True, kw_only=True)
class FramePaths:
    """The paths of a frame, from the pose in its middle.

    place_m: of the scatterers; beyond_m: by how much a way is longer than twice the range (mirrors), one way.
    drift_mps: range rate beside that of the radar's motion. gain: see `Paths`.
    """

    place_m: Float[np.ndarray, "path 3"]
    beyond_m: Float[np.ndarray, " path"]
    drift_mps: Float[np.ndarray, " path"]
    gain: Complex[np.ndarray, " path"]

    @classmethod
    def of(cls, paths: Paths, middle: Pose) -> "FramePaths":
        """Return the paths of one frame, traced from its middle (a pose of one row), in the order of their ranges."""
        away = paths.hit_m - middle.position_m[0]
        range_m = np.maximum(np.linalg.norm(away, axis=1), 1e-9)
        rate_mps = -(away @ middle.velocity_mps[0]) / range_m
        order = np.argsort(paths.delay_s, kind="stable")
        return cls(
            place_m=np.ascontiguousarray(paths.hit_m[order], dtype=np.float64),
            beyond_m=(paths.delay_s * (speed_of_light / 2) - range_m)[order],
            drift_mps=(paths.range_rate_mps - rate_mps)[order],
            gain=paths.gain[order].astype(np.complex128),
        )


def array_beats(
    paths: FramePaths, chirps: Pose, array: MimoArray, chirp: Chirp
) -> Complex[np.ndarray, "chirp rx sample"]:
    """Return the beat signals of a frame in each receiver, sqrt(W) for a unit transmitted power, without noise.

    Parameters
    ----------
    paths:
        Of the frame.
    chirps:
        True poses of the radar in the middle of each of its chirps.
    array, chirp:
        The array and its sweep. Real samples are the real part of these times the square root of 2.

    """
    count, samples = len(chirps.position_m), chirp.samples
    points = int(next_fast_len(int(np.ceil(OVERSAMPLING * samples))))
    pieces, correction = spreading_pieces(), sample_correction(samples, points)
    receivers = len(array.receiver_m)
    # Processors handle several at once; others are computed for nothing, in less time than one by one.
    lanes = receivers if receivers == 1 else -(-receivers // LANES) * LANES
    beats = np.empty((count, receivers, samples), dtype=np.complex128)
    time_s = (np.arange(count) - (count - 1) / 2) * array.period_s
    code = np.tile(array.sent_code, (array.blocks, 1))
    tx_m, rx_m = (
        np.ascontiguousarray(np.einsum("mij,ej->mei", chirps.R_world_antenna, e))
        for e in (array.transmitter_m, np.pad(array.receiver_m, ((0, lanes - receivers), (0, 0))))
    )
    widest_m = float(np.linalg.norm(array.receiver_m, axis=1).max())
    order = _order(widest_m * abs(chirp.slope_hz_s) / speed_of_light / chirp.sampling_rate_hz * points)
    sweep = (chirp.carrier_hz, chirp.slope_hz_s, float(chirp.direction), chirp.centre_s)
    sampled = (*sampled_band_hz(chirp), chirp.sampling_rate_hz, speed_of_light)
    table = (paths.place_m, paths.beyond_m, paths.drift_mps, paths.gain)
    at_once = max(1, GRID_NUMBERS // (points * lanes))
    n, half = np.arange(samples) - samples // 2, WIDTH // 2
    for first in range(0, count, at_once):
        rows = slice(first, min(first + at_once, count))
        some = rows.stop - rows.start
        grid, drift = np.zeros((some, points + WIDTH, 2 * lanes)), np.zeros((some, 2))
        poses = chirps.position_m[rows], chirps.velocity_mps[rows], tx_m[rows], rx_m[rows], time_s[rows], code[rows]
        over_rows(partial(_spread_chirps, table, poses, (*sweep, *sampled), pieces, order, grid, drift), some)
        folded = grid[:, half : half + points]
        folded[:, points - half :] += grid[:, :half]  # the frequency axis is periodic
        folded[:, :half] += grid[:, points + half :]
        folded = folded[..., :receivers] + 1j * folded[..., lanes : lanes + receivers]
        transform = ifft(folded, axis=1, overwrite_x=True, norm="forward", workers=cores())
        bend = drift[:, 0] / np.maximum(drift[:, 1], 1e-300) / chirp.sampling_rate_hz**2
        turn = correction * np.exp(2j * np.pi * np.outer(bend, n.astype(float) ** 2))
        beats[rows] = transform[:, n].transpose(0, 2, 1) * turn[:, None]
    if array.mixing is not None:
        beats = np.einsum("kl,mls->mks", array.mixing, beats)
    return beats


def _order(shift_points: float) -> int:
    """Return the powers of a shift of the spreading function that its accuracy needs."""
    error = shift_points
    for order in range(HIGHEST_ORDER):
        if error < SPREAD_ACCURACY:
            return order
        error *= shift_points / (order + 2)
    return HIGHEST_ORDER


@compiled
@no_type_check
def _spread_chirps(table, poses, sweep, pieces, order, grid, drift, begin, end):
    """Spread the paths of some chirps onto the grids of all receivers."""
    code, tx = poses[5], poses[2]
    paths = len(table[0])
    # Of each path: direction over the distance and over c, frequency, turns, turns per second of way, amplitude.
    columns = np.empty((9, paths))
    middle = np.zeros(3)
    for row in range(begin, end):
        sending, last = 0, 0
        for i in range(tx.shape[1]):
            if code[row, i].real != 0.0 or code[row, i].imag != 0.0:
                sending, last = sending + 1, i
        if sending == 1:
            _weigh(row, tx[row, last], code[row, last], table, poses, sweep, columns, drift)
            _spread(poses[3][row], sweep, columns, pieces, order, grid[row])
        elif sending > 1:
            _weigh(row, middle, code[row, last] / code[row, last], table, poses, sweep, columns, drift)
            _spread_together(tx[row], code[row], poses[3][row], sweep, columns, pieces, grid[row])


@compiled
@no_type_check
def _weigh(row, sender, factor, table, poses, sweep, columns, drift):
    """Write the columns of all paths of a chirp from a transmitter at a place."""
    place, beyond, drifting, gain = table
    position, velocity, time_s = poses[0], poses[1], poses[4]
    carrier, slope, sign, centre_s, least_hz, most_hz, rate_hz, c = sweep
    px, py, pz = position[row, 0], position[row, 1], position[row, 2]
    vx, vy, vz = velocity[row, 0], velocity[row, 1], velocity[row, 2]
    ex, ey, ez = sender[0], sender[1], sender[2]
    later_s = time_s[row]
    # No dependence on the previous path, so that the loop vectorises.
    for p in range(len(place)):
        x, y, z = place[p, 0] - px, place[p, 1] - py, place[p, 2] - pz
        distance = np.sqrt(x * x + y * y + z * z)
        inverse = 1.0 / distance
        x, y, z = x * inverse, y * inverse, z * inverse
        stretch = 2.0 * (drifting[p] - (x * vx + y * vy + z * vz)) / c
        fx, fy, fz = x * distance - ex, y * distance - ey, z * distance - ez
        way = distance + 2.0 * (beyond[p] + drifting[p] * later_s) + np.sqrt(fx * fx + fy * fy + fz * fz)
        delay = way / c + centre_s * stretch
        f = sign * (carrier * stretch + slope * delay - slope * delay * stretch)
        passes = 1.0 if f >= least_hz and f < most_hz else 0.0
        a, b = passes * gain[p].real, -sign * passes * gain[p].imag
        columns[0, p], columns[1, p], columns[2, p], columns[3, p] = x, y, z, inverse
        columns[4, p] = f / rate_hz
        columns[5, p] = sign * (carrier * delay - slope * delay * delay / 2.0)
        columns[6, p] = sign * (carrier - slope * delay)
        columns[7, p] = a * factor.real - b * factor.imag
        columns[8, p] = a * factor.imag + b * factor.real
    for p in range(len(place)):
        x, y, z = columns[0, p], columns[1, p], columns[2, p]
        stretch = 2.0 * (drifting[p] - (x * vx + y * vy + z * vz)) / c
        size = columns[7, p] ** 2 + columns[8, p] ** 2
        drift[row, 0] += size * sign * (slope * stretch - slope * stretch * stretch / 2.0)
        drift[row, 1] += size


@compiled
@no_type_check
def _spread(rx, sweep, columns, pieces, order, grid):
    """Spread weighed paths onto the grids of the receivers at places `rx` of one chirp."""
    slope, sign, rate_hz, c = sweep[1], sweep[2], sweep[6], sweep[7]
    receivers, points = len(rx), len(grid) - WIDTH
    # Real parts of all receivers, then imaginary ones: one loop over both.
    numbers = 2 * receivers
    wave, shift, along = np.empty(numbers), np.empty(numbers), np.empty(receivers)
    ex, ey, ez, square = np.empty(receivers), np.empty(receivers), np.empty(receivers), np.empty(receivers)
    for k in range(receivers):
        ex[k], ey[k], ez[k] = rx[k, 0], rx[k, 1], rx[k, 2]
        square[k] = ex[k] * ex[k] + ey[k] * ey[k] + ez[k] * ez[k]
    per_second, per_metre = sign * slope / rate_hz * points, 1.0 / c
    for p in range(columns.shape[1]):
        zr, zi = columns[7, p], columns[8, p]
        if zr == 0.0 and zi == 0.0:
            continue
        x, y, z, inverse = columns[0, p], columns[1, p], columns[2, p], columns[3, p]
        turns, per_way, half = columns[5, p], columns[6, p], 0.5 * inverse
        for k in range(receivers):
            a = x * ex[k] + y * ey[k] + z * ez[k]
            along[k] = per_metre * ((square[k] - a * a) * half * (1.0 + a * inverse) - a)
        for k in range(receivers):
            cosine, sine = turned(turns + per_way * along[k])
            wave[k] = zr * cosine - zi * sine
            wave[receivers + k] = zr * sine + zi * cosine
            shift[k] = shift[receivers + k] = per_second * along[k]
        u = columns[4, p]
        at = (u - np.floor(u)) * points
        first = np.ceil(at)
        t = (first - at) * PIECES
        piece = min(int(t), PIECES - 1)
        t -= piece
        index = min(int(first), points)
        for j in range(WIDTH):
            c0, c1 = pieces[piece, 0, j], pieces[piece, 1, j]
            c2, c3 = pieces[piece, 2, j], pieces[piece, 3, j]
            w = ((c3 * t + c2) * t + c1) * t + c0
            w1 = -PIECES * ((3.0 * c3 * t + 2.0 * c2) * t + c1)
            out = grid[index + j]
            if order < 2:
                for k in range(numbers):
                    out[k] += wave[k] * (w1 * shift[k] + w)
                continue
            w2 = PIECES * PIECES * (3.0 * c3 * t + c2)
            w3 = -PIECES * PIECES * PIECES * c3
            for k in range(numbers):
                out[k] += wave[k] * (((w3 * shift[k] + w2) * shift[k] + w1) * shift[k] + w)


@compiled
@no_type_check
def _spread_together(tx, code, rx, sweep, columns, pieces, grid):
    """Spread weighed paths from the array's middle onto the grids, with the sum of all transmitters of one chirp.

    A shift of the spreading function is the sum of a transmitter's and a receiver's; powers of it are sums of products
    of both, so that the transmitters add up once for all receivers.
    """
    slope, sign, rate_hz, c = sweep[1], sweep[2], sweep[6], sweep[7]
    receivers, points = len(rx), len(grid) - WIDTH
    numbers = 2 * receivers
    waves, moments = np.empty((4, numbers)), np.empty((2, 4))
    per_second, per_metre = sign * slope / rate_hz * points, 1.0 / c
    for p in range(columns.shape[1]):
        zr, zi = columns[7, p], columns[8, p]
        if zr == 0.0 and zi == 0.0:
            continue
        x, y, z, inverse = columns[0, p], columns[1, p], columns[2, p], columns[3, p]
        turns, per_way, half = columns[5, p], columns[6, p], 0.5 * inverse
        for q in range(4):
            moments[0, q] = moments[1, q] = 0.0
        for i in range(len(tx)):
            a = x * tx[i, 0] + y * tx[i, 1] + z * tx[i, 2]
            square = tx[i, 0] * tx[i, 0] + tx[i, 1] * tx[i, 1] + tx[i, 2] * tx[i, 2]
            along = per_metre * ((square - a * a) * half * (1.0 + a * inverse) - a)
            cosine, sine = turned(per_way * along)
            re = code[i].real * cosine - code[i].imag * sine
            im = code[i].real * sine + code[i].imag * cosine
            for q in range(4):
                moments[0, q] += re
                moments[1, q] += im
                re *= per_second * along
                im *= per_second * along
        for k in range(receivers):
            a = x * rx[k, 0] + y * rx[k, 1] + z * rx[k, 2]
            square = rx[k, 0] * rx[k, 0] + rx[k, 1] * rx[k, 1] + rx[k, 2] * rx[k, 2]
            along = per_metre * ((square - a * a) * half * (1.0 + a * inverse) - a)
            cosine, sine = turned(turns + per_way * along)
            wr, wi = zr * cosine - zi * sine, zr * sine + zi * cosine
            d = per_second * along
            for q in range(4):
                re, im = moments[0, q], moments[1, q]
                if q == 1:
                    re, im = re + d * moments[0, 0], im + d * moments[1, 0]
                elif q == 2:
                    re += d * (2.0 * moments[0, 1] + d * moments[0, 0])
                    im += d * (2.0 * moments[1, 1] + d * moments[1, 0])
                elif q == 3:
                    re += d * (3.0 * moments[0, 2] + d * (3.0 * moments[0, 1] + d * moments[0, 0]))
                    im += d * (3.0 * moments[1, 2] + d * (3.0 * moments[1, 1] + d * moments[1, 0]))
                waves[q, k] = wr * re - wi * im
                waves[q, receivers + k] = wr * im + wi * re
        u = columns[4, p]
        at = (u - np.floor(u)) * points
        first = np.ceil(at)
        t = (first - at) * PIECES
        piece = min(int(t), PIECES - 1)
        t -= piece
        index = min(int(first), points)
        for j in range(WIDTH):
            c0, c1 = pieces[piece, 0, j], pieces[piece, 1, j]
            c2, c3 = pieces[piece, 2, j], pieces[piece, 3, j]
            w = ((c3 * t + c2) * t + c1) * t + c0
            w1 = -PIECES * ((3.0 * c3 * t + 2.0 * c2) * t + c1)
            w2 = PIECES * PIECES * (3.0 * c3 * t + c2)
            w3 = -PIECES * PIECES * PIECES * c3
            out = grid[index + j]
            for k in range(numbers):
                out[k] += w * waves[0, k] + w1 * waves[1, k] + w2 * waves[2, k] + w3 * waves[3, k]
