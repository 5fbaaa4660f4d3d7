"""MIMO arrays: virtual elements, multiplexing codes, calibration, steering vectors, monopulse difference patterns.

A path from transmitter i over a scatterer to receiver k is as long as twice that of an element halfway between both,
so that N transmitters and K receivers act as N K virtual elements at the sums of their places (Li and Stoica 2007,
"MIMO radar with colocated antennas", IEEE Signal Process. Mag. 24). For a scatterer at range r in direction u an
element at e makes the way longer by |r u - e| - r, or by -u.e where wavefronts are plane.

Transmitters are told apart over blocks of as many chirps as there are codes: in chirp c of a block transmitter i sends
with the factor H_ci. With H the unit matrix they take turns (TDM); with that of Hadamard all transmit at once with
binary phases (BPM); with that of a Fourier transform each has a Doppler frequency of its own (DDM). In a block the
scatterer moves; in chirp c, at time t_c from the middle of the block, receiver k gets

    a_ck = exp(j 4 pi v t_c / wavelength) (H a_tx(u))_c a_rx,k(u)

of a scatterer of range rate v. This is the steering vector of all codes alike: the chirps of a block are not separated
into transmitters first, which is possible only for known motion, but compared with what a direction with its own range
rate would give. The array is unambiguous in range rate over a quarter of a wavelength a block, to either side.

A radar with receivers beside its first one is an array of one transmitter, at the place of the first receiver.

A phase-comparison monopulse antenna is one aperture with its halves subtracted (Sherman and Barton 2011, "Monopulse
Principles and Techniques", ch. 5): a receiver at the place of the first with another pattern. With the aperture's
distribution a(x) the sum pattern is the Fourier transform of a(x) and the difference pattern that of sgn(x) a(x), less
a quarter of a turn, which is the Hilbert transform of the sum pattern over the direction cosine: for a uniform aperture
D of pattern sin(x) / x, x = k D u / 2, the ratio of both is tan(x / 2).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.fft
import scipy.linalg
from jaxtyping import Complex, Float, Int

from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import Cut, lobe_samples

# Elements closer than this share of a wavelength are one: 1 deg of phase is 0.003.
SAME_WAVELENGTHS = 1e-3
# Two-way power of the main lobe in which the phase between receivers must not wrap.
UNAMBIGUOUS = 1e-2
# Zeros beyond the visible cosines, in lengths of the cut, so that the transform does not wrap around.
PADDED = 8
LARGEST_RATIO = 1e6


@dataclass(frozen=True, kw_only=True)
class DifferencePattern:
    """Difference over sum of the antenna's halves along one axis, real after removal of its quarter-cycle phase.

    axis: of the antenna's frame, 1 for left (azimuth), 2 for up (elevation).
    cosine, ratio: samples over all directions; lobe: those around the peak, where the ratio increases.
    """

    axis: int
    cosine: Float[np.ndarray, " n"]
    ratio: Float[np.ndarray, " n"]
    lobe: slice

    def at(self, cosine: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the ratio at direction cosines, linear between the samples."""
        return np.interp(cosine, self.cosine, self.ratio)

    def cosine_of(self, ratio: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Return the direction cosine inside the main lobe for a ratio; the lobe's edge for larger ratios."""
        return np.interp(ratio, self.ratio[self.lobe], self.cosine[self.lobe])

    @property
    def slope(self) -> float:
        """Derivative of the ratio on boresight, per unit of the direction cosine."""
        middle = len(self.cosine) // 2
        step = self.cosine[middle + 1] - self.cosine[middle - 1]
        return float((self.ratio[middle + 1] - self.ratio[middle - 1]) / step)


@dataclass(frozen=True, kw_only=True)
class MimoArray:
    """Transmitters and receivers of a radar, their codes, and their errors.

    transmitter_m, receiver_m: places in the antenna's frame (boresight, left, up), m.
    code: factor of each transmitter in each chirp of a block.
    blocks: of a frame. period_s: from chirp to chirp.
    wavelength_m: of the carrier; direction: of the sweep, which the beat's phases follow.
    true_code, true_receiver_m: what the transmitters truly send, and where the receivers truly are; as assumed by
        default.
    mixing: true receiver signals from ideal ones (gain, phase, coupling): none by default.
    difference: patterns of the receivers after the first, over its own; none for receivers alike.
    """

    transmitter_m: Float[np.ndarray, "tx 3"]
    receiver_m: Float[np.ndarray, "rx 3"]
    code: Complex[np.ndarray, "code tx"]
    blocks: int
    period_s: float
    wavelength_m: float
    direction: int = 1
    true_code: Complex[np.ndarray, "code tx"] | None = None
    true_receiver_m: Float[np.ndarray, "rx 3"] | None = None
    mixing: Complex[np.ndarray, "rx rx"] | None = None
    difference: tuple[DifferencePattern, ...] = ()

    @property
    def calibrated(self) -> "MimoArray":
        """The array as processing assumes it."""
        return replace(self, true_code=None, true_receiver_m=None, mixing=None)

    @property
    def phase_per_cosine(self) -> Float[np.ndarray, "rx 2"]:
        """Phase of each receiver's beats, rad, per direction cosine left and up, on plane wavefronts."""
        return -self.direction * 2 * np.pi / self.wavelength_m * self.receiver_m[:, 1:]

    @property
    def chirps(self) -> int:
        """Chirps of a frame."""
        return self.blocks * len(self.code)

    @property
    def duration_s(self) -> float:
        """Duration of a frame."""
        return self.chirps * self.period_s

    @property
    def channels(self) -> int:
        """Virtual elements, those at one place counted apart."""
        return len(self.transmitter_m) * len(self.receiver_m)

    @property
    def gain(self) -> float:
        """Signal-to-noise ratio of a beam over that of one channel with one transmitter: squared length of `steering`.

        The number of virtual elements, times that of the transmitters where all send at once.
        """
        return float(np.sum(np.abs(self.code) ** 2)) * len(self.receiver_m)

    @property
    def sent_code(self) -> Complex[np.ndarray, "code tx"]:
        """Factors that the transmitters truly have."""
        return self.code if self.true_code is None else self.true_code

    @property
    def block_s(self) -> float:
        """Duration of a block."""
        return len(self.code) * self.period_s

    @property
    def highest_rate_mps(self) -> float:
        """Greatest unambiguous range rate of either sign: a quarter of a wavelength a block."""
        return self.wavelength_m / (4 * self.block_s)

    @property
    def rate_cell_mps(self) -> float:
        """Range rate of one cell: half a wavelength over the frame's duration."""
        return self.wavelength_m / (2 * self.duration_s)

    @cached_property
    def chirp_in_block_s(self) -> Float[np.ndarray, " code"]:
        """Time of each chirp from the middle of its block."""
        return (np.arange(len(self.code)) - (len(self.code) - 1) / 2) * self.period_s

    @cached_property
    def virtual_m(self) -> Float[np.ndarray, "channel 3"]:
        """Places of the virtual elements, transmitter by transmitter."""
        return (self.transmitter_m[:, None] + self.receiver_m[None]).reshape(-1, 3)

    @property
    def size_m(self) -> Float[np.ndarray, "3"]:
        """Extent of the virtual array along boresight, left and up."""
        return np.ptp(self.virtual_m, axis=0)

    @cached_property
    def duplicates(self) -> Int[np.ndarray, " place"]:
        """Number of virtual elements at each place."""
        step = SAME_WAVELENGTHS * self.wavelength_m
        _, count = np.unique(np.round(self.virtual_m / step).astype(np.int64), axis=0, return_counts=True)
        return count

    @property
    def widest_gap_wavelengths(self) -> float:
        """Widest gap between neighbouring virtual elements along the left axis; 0 for a point."""
        places = np.unique(np.round(self.virtual_m[:, 1] / self.wavelength_m / SAME_WAVELENGTHS))
        return float(np.diff(places).max() * SAME_WAVELENGTHS) if len(places) > 1 else 0.0

    def steps_m(
        self,
        place_m: Float[np.ndarray, "element 3"],
        direction: Float[np.ndarray, "n 3"],
        range_m: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n element"]:
        """Return the excess path lengths from scatterers to elements over those to the array's middle."""
        bent = 1 / range_m[:, None]
        step = np.sum(place_m**2, axis=1) * bent - 2 * (direction @ place_m.T)
        return step / (1 + np.sqrt(1 + bent * step))

    def steering(
        self,
        direction: Float[np.ndarray, "n 3"],
        range_rate_mps: Float[np.ndarray, " n"],
        range_m: Float[np.ndarray, " n"] | float = np.inf,
    ) -> Complex[np.ndarray, "n channel"]:
        """Return the signals of a block, chirp by chirp and receiver by receiver, from scatterers of unit amplitude.

        direction: unit vectors in the antenna's frame.
        range_rate_mps: of the scatterers in these directions.
        range_m: their ranges; wavefronts are plane by default.
        """
        sent, got = self.responses(direction, range_rate_mps, range_m)
        return (sent[:, :, None] * got[:, None, :]).reshape(len(direction), sent.shape[1] * got.shape[1])

    def responses(
        self,
        direction: Float[np.ndarray, "n 3"],
        range_rate_mps: Float[np.ndarray, " n"],
        range_m: Float[np.ndarray, " n"] | float = np.inf,
    ) -> tuple[Complex[np.ndarray, "n code"], Complex[np.ndarray, "n rx"]]:
        """Return the factors of `steering`: of the chirps of a block, and of the receivers."""
        turn = 2j * np.pi * self.direction / self.wavelength_m
        away_m = np.broadcast_to(np.asarray(range_m, dtype=np.float64), len(direction))
        sent = np.exp(turn * self.steps_m(self.transmitter_m, direction, away_m)) @ self.code.T
        sent = sent * np.exp(2 * turn * np.outer(range_rate_mps, self.chirp_in_block_s))
        return sent, np.exp(turn * self.steps_m(self.receiver_m, direction, away_m))


def code_of(multiplexing: str, transmitters: int) -> Complex[np.ndarray, "code tx"]:
    """Return the factors of transmitters that are told apart by time ("tdm"), Doppler ("ddm") or phase ("bpm").

    Binary phases take the smallest Hadamard matrix that has a column for each; its order is a power of two.
    """
    if multiplexing == "tdm":
        return np.eye(transmitters, dtype=np.complex128)
    if multiplexing == "ddm":
        turn = np.outer(np.arange(transmitters), np.arange(transmitters)) / transmitters
        return np.exp(2j * np.pi * turn)
    order = 1 << (transmitters - 1).bit_length()
    return scipy.linalg.hadamard(order)[:, :transmitters].astype(np.complex128)


def channel_response(
    gain_db: Sequence[Sequence[float]], phase_deg: Sequence[Sequence[float]], turns: int, chirps: int, receivers: int
) -> Complex[np.ndarray, "chirp rx 1"]:
    """Return the measured response of the receivers in each chirp of a frame.

    gain_db, phase_deg: a row of receivers for each transmitter in turn, or one row for all; empty where they are 0.
    turns: transmitters in turn, 1 where all send at once.

    Raises ScenarioError for rows that do not fit.
    """
    tables = []
    for key, rows in (("gain_db", gain_db), ("phase_deg", phase_deg)):
        if rows and (len(rows) not in (1, turns) or any(len(row) != receivers for row in rows)):
            message = f"has rows of {[len(row) for row in rows]}; give {receivers} receivers in one row"
            message += f", or in each of {turns} rows, for the transmitters in turn" if turns > 1 else ""
            raise ScenarioError.of(f"recording.channel_{key}", message)
        tables.append(np.tile(rows or np.zeros((1, receivers)), (chirps // max(len(rows), 1), 1)))
    return (10 ** (tables[0] / 20) * np.exp(1j * np.deg2rad(tables[1])))[..., None]


def receiver_mixing(
    place_m: Float[np.ndarray, "rx 3"], error: Complex[np.ndarray, " rx"], coupling: float, wavelength_m: float
) -> Complex[np.ndarray, "rx rx"]:
    """Return the matrix from ideal to true receiver signals.

    place_m, error: places of the receivers, and their complex gains after calibration.
    coupling: amplitude that a receiver half a wavelength away couples over, which falls with the distance; its phase is
        that of the way (Svantesson 1999 takes the same form for a first order of mutual coupling).
    wavelength_m: of the carrier.
    """
    distance_wavelengths = np.linalg.norm(place_m[:, None] - place_m[None], axis=2) / wavelength_m
    np.fill_diagonal(distance_wavelengths, np.inf)
    coupled = (
        coupling
        * 0.5
        / distance_wavelengths
        * np.exp(-2j * np.pi * np.where(np.isfinite(distance_wavelengths), distance_wavelengths, 0.0))
    )
    return error[:, None] * (np.eye(len(place_m)) + coupled)


def difference_pattern(cut: Cut, axis: int) -> DifferencePattern:
    """Return the difference of the halves of a separable antenna's aperture over their sum, along one cut."""
    count = len(cut.voltage)
    size = scipy.fft.next_fast_len(PADDED * count)
    spectrum = scipy.fft.fft(cut.voltage, size)
    turn = -1j * np.sign(scipy.fft.fftfreq(size))
    difference = scipy.fft.ifft(spectrum * turn).real[:count]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.nan_to_num(difference / cut.voltage, nan=0.0, posinf=LARGEST_RATIO, neginf=-LARGEST_RATIO)
    return DifferencePattern(
        axis=axis,
        cosine=cut.cosine,
        ratio=np.clip(ratio, -LARGEST_RATIO, LARGEST_RATIO),
        lobe=lobe_samples(cut, UNAMBIGUOUS),
    )
