"""Beat signals of a MIMO array: one set of paths serves all chirps, transmitters and receivers of a frame.

Scatterers stand still between the chirps, or move along their rays; the radar moves. So the ways of each chirp follow
from the places of the scatterers and from the radar's true pose at that chirp, and those of each element from its
place, exactly.

The sum of the exponentials of a chirp is that of `beat_sum`. What differs between the receivers of a chirp is each
path's phase, and slightly its frequency: a path longer by d shifts it by S d / c, S being the slope of the sweep, which
is x = S d N / (c f_s), a small part of a point, on the grid of N points. All share one set of powers of x,

    w(t - x) = w - x w' + x^2 w'' / 2 - x^3 w''' / 6,

as many as the largest x requires, so that a receiver costs a few multiplications a path and not another search and
evaluation. Transmitters that send at once are summed for all receivers: x is the sum of a transmitter's and a
receiver's part, and its powers are sums of products of both. A sweep's own drift in frequency by motion (the bend of
`beat_sum`) is that of the power-weighted mean of its paths.
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
from sionna_radar.signal.beat_sum import OVERSAMPLING, PIECES, WIDTH, sample_correction, spreading_pieces, weigh
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

    paths: of the frame.
    chirps: true poses of the radar in the middle of each of its chirps.
    array, chirp: the array and its sweep. Real samples are the real part of these times the square root of 2.
    """
    count, samples = len(chirps.position_m), chirp.samples
    points = int(next_fast_len(int(np.ceil(OVERSAMPLING * samples))))
    pieces, correction = spreading_pieces(), sample_correction(samples, points)
    receivers = len(array.receiver_m)
    # Receivers are padded to whole SIMD vectors: computing the padding is faster than a scalar remainder.
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
        grid, bend = np.zeros((some, points + WIDTH, 2 * lanes)), np.zeros(some)
        poses = chirps.position_m[rows], chirps.velocity_mps[rows], tx_m[rows], rx_m[rows], time_s[rows], code[rows]
        over_rows(partial(_spread_chirps, table, poses, (*sweep, *sampled), pieces, order, grid, bend), some)
        folded = grid[:, half : half + points]
        folded[:, points - half :] += grid[:, :half]  # the frequency axis is periodic
        folded[:, :half] += grid[:, points + half :]
        folded = folded[..., :receivers] + 1j * folded[..., lanes : lanes + receivers]
        transform = ifft(folded, axis=1, overwrite_x=True, norm="forward", workers=cores())
        turn = correction * np.exp(2j * np.pi * np.outer(bend / chirp.sampling_rate_hz**2, n.astype(float) ** 2))
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
def _spread_chirps(table, poses, sweep, pieces, order, grid, bend, begin, end):
    """Spread the paths of some chirps onto the grids of all receivers, and write the bend of each chirp."""
    gain, (tx, rx, code) = table[3], (poses[2], poses[3], poses[5])
    paths = len(gain)
    first, last = np.zeros(1, dtype=np.int64), np.full(1, paths)
    ray, columns = np.empty((6, paths)), (np.empty(paths), np.empty(paths, dtype=np.complex128), np.empty(paths))
    for row in range(begin, end):
        sent = np.flatnonzero(code[row])
        if len(sent) == 0:
            continue
        # One sender is where ways begin; several are seen from the array's middle.
        alone = len(sent) == 1
        sender = tx[row, sent[0]] if alone else np.zeros(3)
        senders = np.zeros((1, 3)) if alone else tx[row][sent]
        _ways(row, sender, table, poses, sweep[-1], ray)
        drift = (bend[row : row + 1], np.empty(1), np.empty(1))
        weigh(0, 1, first, last, ray[4], ray[5], gain, sweep, columns + drift)
        _spread(
            senders, code[row][sent], rx[row], sweep, ray, columns, pieces, order if alone else HIGHEST_ORDER, grid[row]
        )


@compiled
@no_type_check
def _ways(row, sender, table, poses, c, ray):
    """Write each path's direction, inverse distance, delay from a sender to the array's middle, and range rate."""
    place, beyond, drifting = table[0], table[1], table[2]
    position, velocity, later_s = poses[0], poses[1], poses[4][row]
    px, py, pz = position[row, 0], position[row, 1], position[row, 2]
    vx, vy, vz = velocity[row, 0], velocity[row, 1], velocity[row, 2]
    ex, ey, ez = sender[0], sender[1], sender[2]
    # No dependence on the previous path, so that the loop vectorises.
    for p in range(len(place)):
        x, y, z = place[p, 0] - px, place[p, 1] - py, place[p, 2] - pz
        distance = np.sqrt(x * x + y * y + z * z)
        fx, fy, fz = x - ex, y - ey, z - ez
        way = distance + 2.0 * (beyond[p] + drifting[p] * later_s) + np.sqrt(fx * fx + fy * fy + fz * fz)
        inverse = 1.0 / distance
        x, y, z = x * inverse, y * inverse, z * inverse
        ray[0, p], ray[1, p], ray[2, p], ray[3, p] = x, y, z, inverse
        ray[4, p], ray[5, p] = way / c, drifting[p] - (x * vx + y * vy + z * vz)


@compiled
@no_type_check
def _spread(tx, code, rx, sweep, ray, columns, pieces, order, grid):
    """Spread the weighed paths of a chirp onto the grids of its receivers, summed over the transmitters beside it."""
    carrier, slope, sign, rate_hz, c = sweep[0], sweep[1], sweep[2], sweep[6], sweep[7]
    frequency, weight = columns[0], columns[1]
    receivers, points = len(rx), len(grid) - WIDTH
    # Real parts of all receivers, then imaginary ones: one loop over both.
    numbers = 2 * receivers
    waves, moments, place = np.empty((4, numbers)), np.empty((2, 4)), np.ascontiguousarray(rx.T)
    per_metre = sign * slope / rate_hz * points / c
    for p in range(len(weight)):
        if weight[p] == 0.0:
            continue
        x, y, z, inverse = ray[0, p], ray[1, p], ray[2, p], ray[3, p]
        turns = sign * (carrier - slope * ray[4, p]) / c
        moments[:] = 0.0
        if len(tx) == 1:  # where the ways begin
            moments[0, 0], moments[1, 0] = (weight[p] * code[0]).real, (weight[p] * code[0]).imag
        for i in range(len(tx) if len(tx) > 1 else 0):
            ex, ey, ez = tx[i, 0], tx[i, 1], tx[i, 2]
            step = (ex * ex + ey * ey + ez * ez) * inverse - 2.0 * (x * ex + y * ey + z * ez)
            later = step / (1.0 + np.sqrt(1.0 + inverse * step))
            cosine, sine = turned(turns * later)
            term = weight[p] * code[i] * complex(cosine, sine)
            for q in range(4):
                moments[0, q] += term.real
                moments[1, q] += term.imag
                term *= per_metre * later
        r0, r1, r2, r3 = moments[0, 0], moments[0, 1], moments[0, 2], moments[0, 3]
        i0, i1, i2, i3 = moments[1, 0], moments[1, 1], moments[1, 2], moments[1, 3]
        for k in range(receivers):
            ex, ey, ez = place[0, k], place[1, k], place[2, k]
            step = (ex * ex + ey * ey + ez * ez) * inverse - 2.0 * (x * ex + y * ey + z * ez)
            later = step / (1.0 + np.sqrt(1.0 + inverse * step))
            cosine, sine = turned(turns * later)
            d = per_metre * later
            # Moments of the sums of both shifts.
            s1, t1 = r1 + d * r0, i1 + d * i0
            s2, t2 = r2 + d * (2.0 * r1 + d * r0), i2 + d * (2.0 * i1 + d * i0)
            s3, t3 = r3 + d * (3.0 * r2 + d * (3.0 * r1 + d * r0)), i3 + d * (3.0 * i2 + d * (3.0 * i1 + d * i0))
            waves[0, k], waves[0, receivers + k] = cosine * r0 - sine * i0, cosine * i0 + sine * r0
            waves[1, k], waves[1, receivers + k] = cosine * s1 - sine * t1, cosine * t1 + sine * s1
            waves[2, k], waves[2, receivers + k] = cosine * s2 - sine * t2, cosine * t2 + sine * s2
            waves[3, k], waves[3, receivers + k] = cosine * s3 - sine * t3, cosine * t3 + sine * s3
        at = (frequency[p] - np.floor(frequency[p])) * points
        begin = np.ceil(at)
        t = (begin - at) * PIECES
        piece = min(int(t), PIECES - 1)
        t -= piece
        index = min(int(begin), points)
        for j in range(WIDTH):
            c0, c1, c2, c3 = pieces[piece, 0, j], pieces[piece, 1, j], pieces[piece, 2, j], pieces[piece, 3, j]
            w = ((c3 * t + c2) * t + c1) * t + c0
            w1 = -PIECES * ((3.0 * c3 * t + 2.0 * c2) * t + c1)
            out = grid[index + j]
            if order < 2:
                for k in range(numbers):
                    out[k] += w * waves[0, k] + w1 * waves[1, k]
                continue
            w2 = PIECES * PIECES * (3.0 * c3 * t + c2)
            w3 = -PIECES * PIECES * PIECES * c3
            for k in range(numbers):
                out[k] += w * waves[0, k] + w1 * waves[1, k] + w2 * waves[2, k] + w3 * waves[3, k]
