"""Echoes of wires, poles and fences: the field of thin cylinders, summed along their curves.

An element dl of a conducting cylinder of radius a, met under the angle t to the plane across it, returns by the radar
equation with the amplitude

    d sqrt(sigma) = 2 / sqrt(pi) S(k a cos t) exp(-2 j k r) dl,      S = -sum e_n (-1)^n J_n(x) / H_n(x)   (field along)
                                                                     S = +sum e_n (-1)^n J'_n(x) / H'_n(x) (across)

with e_0 = 1, e_n = 2 and Hankel functions of the second kind: the series of an endless cylinder (Ruck and others 1970,
"Radar Cross Section Handbook", chapter 4; at slant incidence k becomes k cos t, and the cosines of the field along the
axis and of the current's radiation cancel it). For large x both tend to sqrt(pi x) / 2 exp(j (2 x + 3 pi / 4)),
physical optics. Over a straight length L this gives sigma = 4 L^2 / pi |S|^2 (sin(k L sin t) / (k L sin t))^2, at
broadside k a L^2 for a thick wire; close to a long one pi a r, of its first Fresnel zone.

The elements are so short that the phase along each is linear, as is the amplitude: the integral over each is exact.

A stranded conductor repeats itself along its axis after lay / strands. Each order m of that grating returns a lobe of
its own, at sin t = -m wavelength / (2 period): the amplitude is that of a smooth one times a ratio of integrals by
physical optics (Al-Khatib 1979, "Wave scattering by braided metallic cables"; Sarabandi and Park 1999, IEEE Trans.
Antennas Propag. 47, 1799, found such lobes of power lines at 94 GHz).
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Complex, Float, Inexact, Int
from scipy.constants import speed_of_light
from scipy.special import hankel2, jv

from sionna_radar.flight.pulses import Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.wires import Strands, ThinObstacle, Wire, pieces
from sionna_radar.tracing.effects.bodies import STEP_CELLS
from sionna_radar.tracing.paths import FIRST_OBSTACLE, Paths

# Wires are looked up in straight pieces of this length, m; each is hidden or seen in steps of range within it.
PIECE_M = 4.0
# Elements are this share of sqrt(wavelength r): their phase leaves a straight line by 0.1 rad, the same in each. They
# are also no longer than a tenth of the beam's width.
ELEMENT_ZONES, ELEMENT_BEAMS = 0.25, 0.1
# Two-way power over that of the nearest wire on the beam's axis below which a piece is left out, and over the strongest
# echo of a pulse below which echoes are: -50 dB, which few receivers hear beside it.
MIN_POWER = 1e-5
# Cosine of the slant at which a wire is seen nearly end on; beyond, it returns what it does here.
MIN_COSINE = 0.02
# Elements of all pulses that are handled at once.
AT_ONCE = 1_000_000
# Wires touch the ground, or what carries them: rays end this far before them.
TOUCHING_M = 0.1


def cylinder_amplitudes(x: Float[np.ndarray, " n"]) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
    """Return the backscattered amplitudes S of a conducting cylinder, for fields along its axis and across it.

    x: its circumference in wavelengths, k a times the cosine of the slant.
    """
    along, across = np.zeros(len(x), dtype=np.complex128), np.zeros(len(x), dtype=np.complex128)
    # Higher orders do not reach the cylinder; each x keeps to its own, beyond which the ratios underflow.
    orders = np.ceil(x + 4 * np.cbrt(x) + 6).astype(int)
    below, inside = (jv(-1, x), hankel2(-1, x)), np.arange(len(x))
    for n in range(int(orders.max()) + 1 if len(x) else 0):
        rows = orders >= n
        x, orders, inside, below = x[rows], orders[rows], inside[rows], (below[0][rows], below[1][rows])
        here = jv(n, x), hankel2(n, x)
        slope = [lower - n / x * same for lower, same in zip(below, here, strict=True)]
        factor, below = (1 if n == 0 else 2) * (-1) ** n, here
        along[inside] -= factor * here[0] / here[1]
        across[inside] += factor * slope[0] / slope[1]
    return along, across


def rcs_of_wire(diameter_m: float, carrier_hz: float, range_m: float) -> tuple[float, float]:
    """Return the cross-section of a long smooth wire seen square on: its first Fresnel zone.

    sigma = 4 / pi |S|^2 wavelength r / 2, of a thick wire pi a r; it grows with the range, so that the echo falls with
    its third power.

    Parameters
    ----------
    diameter_m, carrier_hz:
        Of the wire, m, and of the radar, Hz.
    range_m:
        Distance of the wire, m; the wire is longer than the zone, sqrt(2 wavelength r).

    Returns
    -------
    Radar cross-sections in m2, for the field along the wire and across it.

    Examples
    --------
    >>> along, across = rcs_of_wire(0.02, 77e9, 100.0)
    >>> bool(abs(along / (3.1416 * 0.01 * 100.0) - 1) < 0.02)
    True
    """
    wavelength_m = speed_of_light / carrier_hz
    along, across = cylinder_amplitudes(np.array([np.pi * diameter_m / wavelength_m]))
    zone_m2 = 4 / np.pi * wavelength_m * range_m / 2
    return float(zone_m2 * abs(along[0]) ** 2), float(zone_m2 * abs(across[0]) ** 2)


# The series serves to this k a cos t, beyond which physical optics is within 0.02 dB and half a degree of it.
SERIES_TO, STEPS_PER_UNIT = 40.0, 40


@lru_cache(maxsize=1)
def _series() -> tuple[Complex[np.ndarray, " x"], Complex[np.ndarray, " x"]]:
    """Return the amplitudes of both fields in equal steps of k a cos t, without the phase 2 x of their fronts."""
    x = np.arange(int(SERIES_TO * STEPS_PER_UNIT) + 1) / STEPS_PER_UNIT
    x[0] = MIN_COSINE / STEPS_PER_UNIT
    along, across = (amplitude * np.exp(-2j * x) for amplitude in cylinder_amplitudes(x))
    return along, across


def _amplitudes_at(x: Float[np.ndarray, " n"]) -> tuple[Complex[np.ndarray, " n"], Complex[np.ndarray, " n"]]:
    """Return `cylinder_amplitudes` between the steps of a table, and physical optics beyond it."""
    place = np.minimum(x, SERIES_TO) * STEPS_PER_UNIT
    low = np.minimum(place.astype(np.int64), int(SERIES_TO * STEPS_PER_UNIT) - 1)
    part = place - low
    optics = np.sqrt(np.pi * x) / 2 * np.exp(0.75j * np.pi)
    along, across = (
        turned(np.where(x < SERIES_TO, table[low] * (1 - part) + table[low + 1] * part, optics), 2 * x)
        for table in _series()
    )
    return along, across


def turned(field: Inexact[np.ndarray, "*n"], phase: Float[np.ndarray, "*n"]) -> Complex[np.ndarray, "*n"]:
    """Return a field times exp(j phase).

    NumPy's product of complex arrays rounds by the place in the array, so that blocks of pulses would differ; products
    of their parts do not.
    """
    cosine, sine = np.cos(phase), np.sin(phase)
    real, imaginary = np.real(field), np.imag(field)
    turned_field: Complex[np.ndarray, "*n"] = real * cosine - imaginary * sine + 1j * (real * sine + imaginary * cosine)
    return turned_field


# Samples across a stranded conductor and along its period, by wavelength of phase.
SAMPLES_PER_WAVE = 16


@lru_cache(maxsize=16)
def grating_orders(
    radius_m: float, strands: Strands, wavelength_m: float
) -> tuple[Int[np.ndarray, " order"], Complex[np.ndarray, " order"]]:
    """Return the orders of a stranded conductor, and each one's amplitude over that of a smooth one, at its lobe.

    The surface that the radar sees is the farthest of the strands toward it, h(y, z) at the place y across and z along.
    Physical optics over it is the integral of (c - s dh/dz) exp(2 j k (c h + s z)), c and s the cosine and the sine of
    the slant; in parts over z, order m is the integral over y and the mean over a period of

        1 / c exp(2 j k c h - 2 pi j m z / period).
    """
    k, count, period_m = 2 * np.pi / wavelength_m, strands.count, strands.period_m
    highest = int(np.floor(2 * period_m / wavelength_m * np.sqrt(1 - MIN_COSINE**2)))
    orders = np.arange(-highest, highest + 1)
    # Strands of radius b side by side on a circle of radius R - b: b = (R - b) sin(pi / N).
    sine = np.sin(np.pi / count)
    strand_m = radius_m * sine / (1 + sine)
    centre_m = radius_m - strand_m
    across = int(SAMPLES_PER_WAVE * (count + 4 * k * radius_m))
    y = ((np.arange(across) + 0.5) / across * 2 - 1) * radius_m
    along = int(SAMPLES_PER_WAVE * (2 + 2 * k * strand_m + highest))
    z = (np.arange(along) + 0.5) / along
    height = np.full((along, across), -np.inf)
    for number in range(count):
        angle = 2 * np.pi * (number + z[:, None]) / count
        within = strand_m**2 - (y - centre_m * np.sin(angle)) ** 2
        top = np.where(within >= 0, centre_m * np.cos(angle) + np.sqrt(np.maximum(within, 0.0)), -np.inf)
        height = np.maximum(height, top)
    seen = np.isfinite(height)
    height[~seen] = 0.0
    ratio = np.zeros(len(orders), dtype=np.complex128)
    for row, order in enumerate(orders):
        c = np.sqrt(1 - (order * wavelength_m / (2 * period_m)) ** 2)
        smooth = np.mean(np.exp(2j * k * c * np.sqrt(radius_m**2 - y**2)))
        turn = np.exp(-2j * np.pi * order * z)[:, None]
        ratio[row] = np.mean(seen * turn * np.exp(2j * k * c * height)) / (c**2 * smooth)
    return orders, ratio


def two_way_envelope(antenna: Antenna) -> tuple[Float[np.ndarray, " angle"], Float[np.ndarray, " angle"]]:
    """Return angles from boresight, and the highest two-way power over the peak's in any direction beyond each."""
    angle, roll = np.pi * np.linspace(0.0, 1.0, 721) ** 2, np.linspace(0.0, 2 * np.pi, 144, endpoint=False)
    sine = np.sin(angle)[:, None]
    axes = np.broadcast_arrays(np.cos(angle)[:, None], sine * np.cos(roll), sine * np.sin(roll))
    gain = antenna.gain(np.stack(axes, axis=-1).reshape(-1, 3)).reshape(axes[0].shape).max(axis=1)
    return angle, np.maximum.accumulate((gain / antenna.peak_gain)[::-1])[::-1] ** 2


class ThinTracer:
    """Traces the echoes of thin obstacles.

    first: number of the first of them among the obstacles of the scene.
    """

    def __init__(
        self, obstacles: Sequence[ThinObstacle], antenna: Antenna, chirp: Chirp, caster: RayCaster, first: int = 0
    ) -> None:
        self._antenna, self._caster, self._wavelength_m = antenna, caster, chirp.wavelength_m
        self._bin_m, self._reach_m = STEP_CELLS * chirp.range_resolution_m, 2 * chirp.max_range_m
        self._wires: list[Wire] = [wire for one in obstacles for wire in one.wires]
        number = [first + n for n, one in enumerate(obstacles) for _ in one.wires]
        self._envelope = two_way_envelope(antenna)
        parts = [pieces(one, PIECE_M) for one in self._wires]
        none = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0))
        self._start_m, self._step_m, self._sag_m, self._before_m = (
            np.concatenate(columns) for columns in zip(none, *parts, strict=True)
        )
        self._wire = np.repeat(np.arange(len(parts)), [len(part[0]) for part in parts])
        self._number = np.array(number, dtype=np.int64)[self._wire]
        self._middle_m = self._start_m + self._step_m / 2
        self._half_m = np.linalg.norm(self._step_m, axis=1) / 2

    def __len__(self) -> int:
        return len(self._start_m)

    def trace(self, pulses: Pulses) -> Paths:
        """Return the visible echoes of a block of pulses, sorted by pulse."""
        position = pulses.true.position_m
        centre = (position.min(axis=0) + position.max(axis=0)) / 2
        around_m = float(np.linalg.norm(position - centre, axis=1).max())
        away_m = np.linalg.norm(self._middle_m - centre, axis=1)
        near = np.flatnonzero(away_m < around_m + self._reach_m + self._half_m)
        row, piece = self._lit(pulses, near)
        parts = [Paths.none()]
        for one in np.unique(self._wire[piece]):
            chosen = self._wire[piece] == one
            parts += self._of_wire(self._wires[one], pulses, row[chosen], piece[chosen])
        paths = Paths.concatenate(parts)
        power = np.abs(paths.gain) ** 2
        strongest = np.zeros(len(pulses))
        np.maximum.at(strongest, pulses.row_of(paths.pulse), power)
        paths = paths.rows(np.flatnonzero(power >= MIN_POWER * strongest[pulses.row_of(paths.pulse)]))
        seen = self._caster.visible(position[pulses.row_of(paths.pulse)], paths.hit_m, TOUCHING_M)
        return paths.rows(np.flatnonzero(seen))

    def _lit(self, pulses: Pulses, near: Int[np.ndarray, " n"]) -> tuple[np.ndarray, np.ndarray]:
        """Return pairs of pulses (rows of the block) and pieces whose echo may count."""
        pose, middle_m, half_m = pulses.true, self._middle_m[near], self._half_m[near]
        rows, pieces = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
        few = max(1, AT_ONCE // max(len(near), 1))
        for low in range(0, len(pulses) if len(near) else 0, few):
            block = slice(low, low + few)
            away = middle_m - pose.position_m[block, None]
            centre_m = np.linalg.norm(away, axis=2)
            range_m = np.maximum(centre_m - half_m, self._wavelength_m)
            ahead = np.einsum("pni,pi->pn", away, pose.boresight[block]) / np.maximum(centre_m, 1e-9)
            beside = np.arccos(np.clip(ahead, -1.0, 1.0)) - np.arcsin(
                np.minimum(half_m / np.maximum(centre_m, 1e-9), 1.0)
            )
            # Of a wire so long that its Fresnel zone decides, the echo falls with the third power of the range.
            power = np.interp(beside, *self._envelope) * (range_m.min(axis=1, keepdims=True) / range_m) ** 3
            row, piece = np.nonzero((power > MIN_POWER) & (range_m < self._reach_m))
            rows.append(row + low)
            pieces.append(near[piece])
        return np.concatenate(rows), np.concatenate(pieces)

    def _of_wire(self, wire: Wire, pulses: Pulses, row: np.ndarray, piece: np.ndarray) -> list[Paths]:
        """Return the echoes of some pieces of one wire, each in the pulses of `row`."""
        nearest_m = np.linalg.norm(self._middle_m[piece] - pulses.true.position_m[row], axis=1) - self._half_m[piece]
        nearest_m = np.maximum(nearest_m, self._wavelength_m)
        beam_rad = min(self._antenna.beamwidths_rad)
        longest_m = np.minimum(
            ELEMENT_ZONES * np.sqrt(self._wavelength_m * nearest_m), ELEMENT_BEAMS * beam_rad * nearest_m
        )
        # The same number of elements, a power of two, for pieces at alike ranges.
        elements = 2 ** np.ceil(np.log2(np.maximum(2 * self._half_m[piece] / longest_m, 1.0))).astype(np.int64)
        parts = []
        for count in np.unique(elements):
            chosen = np.flatnonzero(elements == count)
            few = max(1, AT_ONCE // int(count))
            for low in range(0, len(chosen), few):
                some = chosen[low : low + few]
                parts.append(self._echoes(wire, pulses, row[some], piece[some], int(count)))
        return parts

    def _echoes(self, wire: Wire, pulses: Pulses, row: np.ndarray, piece: np.ndarray, count: int) -> Paths:
        pose, wavelength_m = pulses.true, self._wavelength_m
        part = np.linspace(0.0, 1.0, count + 1)[:, None]
        length_m, sag_m = 2 * self._half_m[piece], self._sag_m[piece]
        place = self._start_m[piece, None] + part * self._step_m[piece, None]
        place[..., 2] -= 4 * sag_m[:, None] * (part * (1 - part))[:, 0]
        axis = np.repeat(self._step_m[piece, None], count + 1, axis=1)
        axis[..., 2] -= 4 * sag_m[:, None] * (1 - 2 * part[:, 0])
        axis /= np.linalg.norm(axis, axis=2)[..., None]
        away = place - pose.position_m[row, None]
        range_m = np.linalg.norm(away, axis=2)
        toward = away / range_m[..., None]
        sine = np.einsum("nki,nki->nk", toward, axis)
        cosine = np.sqrt(np.maximum(1 - sine**2, MIN_COSINE**2))
        amplitude = self._amplitude(wire, pulses, row, toward, axis, cosine)
        amplitude *= (
            np.sqrt(wire.reflectivity) * wavelength_m / ((4 * np.pi) ** 1.5 * range_m**2) * (2 / np.sqrt(np.pi))
        )
        phase = -4 * np.pi / wavelength_m * range_m
        field = np.zeros((len(piece), count), dtype=np.complex128)
        if wire.strands is None:
            field += _over_elements(amplitude, phase)
        else:
            at_m = self._before_m[piece, None] + part[:, 0] * length_m[:, None]
            for order, ratio in zip(*grating_orders(wire.radius_m, wire.strands, wavelength_m), strict=True):
                turn = 2 * np.pi * order * at_m / wire.strands.period_m + np.angle(ratio)
                field += np.abs(ratio) * _over_elements(amplitude, phase + turn)
        field *= (length_m / count)[:, None]
        return self._binned(pulses, row, piece, (place[:, 1:] + place[:, :-1]) / 2, field)

    def _amplitude(
        self,
        wire: Wire,
        pulses: Pulses,
        row: np.ndarray,
        toward: Float[np.ndarray, "n node 3"],
        axis: Float[np.ndarray, "n node 3"],
        cosine: Float[np.ndarray, "n node"],
    ) -> Complex[np.ndarray, "n node"]:
        """Return the antenna's gain times the cylinder's amplitudes, by the fields that are sent and received."""
        turn = pulses.true.R_world_antenna[row]
        inside = np.einsum("nij,nki->nkj", turn, toward).reshape(-1, 3)
        gain = self._antenna.gain(inside).reshape(cosine.shape)
        across = np.cross(inside, np.einsum("nij,nki->nkj", turn, axis).reshape(-1, 3))
        across /= np.maximum(np.linalg.norm(across, axis=1), 1e-9)[:, None]
        beside = np.cross(across, inside)
        sent, received = self._antenna.fields(inside)
        s_along, s_across = _amplitudes_at(2 * np.pi / self._wavelength_m * wire.radius_m * cosine.ravel())
        total = np.zeros(len(inside), dtype=np.complex128)
        for amplitude, way in ((s_along, beside), (s_across, across)):
            for field in (sent, received):
                part = np.einsum("ni,ni->n", field, way)
                # Circular waves have complex parts.
                amplitude = turned(amplitude * np.abs(part), np.angle(part))
            total += amplitude
        return gain * total.reshape(cosine.shape)

    def _binned(
        self,
        pulses: Pulses,
        row: np.ndarray,
        piece: np.ndarray,
        place_m: Float[np.ndarray, "n element 3"],
        field: Complex[np.ndarray, "n element"],
    ) -> Paths:
        """Return a path for each step of range of each piece."""
        range_m = np.linalg.norm(place_m - pulses.true.position_m[row, None], axis=2)
        step = np.floor(range_m / self._bin_m).astype(np.int64)
        pair = np.repeat(np.arange(len(row)), field.shape[1])
        key = pair * (int(step.max()) + 1) + step.ravel() if step.size else pair
        group, member = np.unique(key, return_inverse=True)
        count = np.bincount(member, minlength=len(group))
        flat = field.ravel()
        middle_m = (group % (int(step.max()) + 1) + 0.5) * self._bin_m if step.size else np.zeros(0)
        gain = np.bincount(member, flat.real, len(group)) + 1j * np.bincount(member, flat.imag, len(group))
        gain = turned(gain, 4 * np.pi / self._wavelength_m * middle_m)
        hit_m = np.stack([np.bincount(member, c, len(group)) / count for c in place_m.reshape(-1, 3).T], axis=1)
        of_pair = pair[np.unique(member, return_index=True)[1]] if len(group) else pair
        paths = Paths.to_points(
            pulses,
            row[of_pair],
            hit_m,
            gain=gain,
            incidence_rad=np.full(len(group), np.nan),
            surface=FIRST_OBSTACLE - self._number[piece[of_pair]],
        )
        return replace(paths, delay_s=2 / speed_of_light * middle_m)


def _over_elements(
    amplitude: Complex[np.ndarray, "n node"], phase: Float[np.ndarray, "n node"]
) -> Complex[np.ndarray, "n element"]:
    """Return the means over elements of an amplitude and a phase that are linear between their ends."""
    low, high = amplitude[:, :-1], amplitude[:, 1:]
    middle, half = (phase[:, 1:] + phase[:, :-1]) / 2, np.diff(phase, axis=1) / 2
    small = np.abs(half) < 1e-3
    safe = np.where(small, 1.0, half)
    even = np.where(small, 1 - half**2 / 6, np.sin(safe) / safe)
    odd = np.where(small, half / 3, (np.sin(safe) / safe - np.cos(safe)) / safe)
    return turned((low + high) / 2 * even + 1j * (high - low) / 2 * odd, middle)
