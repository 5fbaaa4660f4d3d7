"""An array of transmitters and receivers: its virtual elements, their codes and calibration, and steering vectors.

A path from transmitter i over a scatterer to receiver k is as long as twice that of an element halfway between both,
so that N transmitters and K receivers act as N K virtual elements at the sums of their places (Li and Stoica 2007,
"MIMO radar with colocated antennas", IEEE Signal Process. Mag. 24). For a scatterer at range r in direction u an
element at e makes the way longer by

    |r u - e| - r = -u.e + (|e|^2 - (u.e)^2) (1 / 2 r + u.e / 2 r^2) + O(e^4 / r^3).

Transmitters are told apart over blocks of as many chirps as there are codes: in chirp c of a block transmitter i sends
with the factor H_ci. With H the unit matrix they take turns (TDM); with that of Hadamard all transmit at once with
binary phases (BPM); with that of a Fourier transform each has a Doppler frequency of its own (DDM). In a block the
scatterer moves; in chirp c, at time t_c from the middle of the block, receiver k gets

    a_ck = exp(j 4 pi v t_c / wavelength) (H a_tx(u))_c a_rx,k(u)

of a scatterer of range rate v. This is the steering vector of all codes alike: the chirps of a block are not separated
into transmitters first, which is possible only for known motion, but compared with what a direction with its own range
rate would give. The array is unambiguous in range rate over a quarter of a wavelength a block, to either side.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float, Int

# Elements closer than this share of a wavelength are one: 1 deg of phase is 0.003.
SAME_WAVELENGTHS = 1e-3
# Spacings of a filled row: its beams repeat outside of the visible directions.
FILLED_WAVELENGTHS = 0.5


@dataclass(frozen=True, kw_only=True)
class MimoArray:
    """Transmitters and receivers of a radar, their codes, and their errors.

    transmitter_m, receiver_m: places in the antenna's frame (boresight, left, up), m.
    code: factor of each transmitter in each chirp of a block.
    blocks: of a frame. period_s: from chirp to chirp.
    wavelength_m: of the carrier; direction: of the sweep, which the beat's phases follow.
    true_code: what the transmitters truly send; the assumed `code` by default.
    mixing: true receiver signals from ideal ones (gain, phase, coupling): none by default.
    """

    transmitter_m: Float[np.ndarray, "tx 3"]
    receiver_m: Float[np.ndarray, "rx 3"]
    code: Complex[np.ndarray, "code tx"]
    blocks: int
    period_s: float
    wavelength_m: float
    direction: int = 1
    true_code: Complex[np.ndarray, "code tx"] | None = None
    mixing: Complex[np.ndarray, "rx rx"] | None = None

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
    def block_time_s(self) -> Float[np.ndarray, " block"]:
        """Time of each block from the middle of the frame."""
        return (np.arange(self.blocks) - (self.blocks - 1) / 2) * self.block_s

    @cached_property
    def virtual_m(self) -> Float[np.ndarray, "channel 3"]:
        """Places of the virtual elements, transmitter by transmitter."""
        return (self.transmitter_m[:, None] + self.receiver_m[None]).reshape(-1, 3)

    @property
    def size_m(self) -> Float[np.ndarray, "3"]:
        """Extent of the virtual array along boresight, left and up."""
        return np.ptp(self.virtual_m, axis=0)

    @property
    def fraunhofer_m(self) -> float:
        """Range from which wavefronts are plane within an eighth of a wavelength: 2 D^2 / wavelength."""
        widest = max(float(np.linalg.norm(np.ptp(e, axis=0))) for e in (self.transmitter_m, self.receiver_m))
        return 2 * widest**2 / self.wavelength_m

    @cached_property
    def duplicates(self) -> Int[np.ndarray, " place"]:
        """Number of virtual elements at each place."""
        step = SAME_WAVELENGTHS * self.wavelength_m
        _, count = np.unique(np.round(self.virtual_m / step).astype(np.int64), axis=0, return_counts=True)
        return count

    def widest_gap_wavelengths(self, axis: int) -> float:
        """Return the widest gap between neighbouring virtual elements along an axis (1 left, 2 up); 0 for a point."""
        places = np.unique(np.round(self.virtual_m[:, axis] / self.wavelength_m / SAME_WAVELENGTHS))
        return float(np.diff(places).max() * SAME_WAVELENGTHS) if len(places) > 1 else 0.0

    def steps_m(
        self,
        place_m: Float[np.ndarray, "element 3"],
        direction: Float[np.ndarray, "n 3"],
        range_m: Float[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n element"]:
        """Return the excess path lengths from scatterers to elements over those to the array's middle."""
        along, bent = direction @ place_m.T, 1 / range_m[:, None]
        square = np.sum(place_m**2, axis=1) - along**2
        return -along + square * (bent / 2) * (1 + along * bent)

    def steering(
        self,
        direction: Float[np.ndarray, "n 3"],
        range_rate_mps: Float[np.ndarray, " n"],
        range_m: Float[np.ndarray, " n"] | float = np.inf,
    ) -> Complex[np.ndarray, "n channel"]:
        """Return the signals of a block, chirp by chirp and receiver by receiver, from scatterers of unit amplitude.

        Parameters
        ----------
        direction:
            Unit vectors in the antenna's frame.
        range_rate_mps:
            Of the scatterers in these directions.
        range_m:
            Their ranges; wavefronts are plane by default.

        """
        sent, got = self.responses(direction, range_rate_mps, range_m)
        vectors: Complex[np.ndarray, "n channel"] = (sent[:, :, None] * got[:, None, :]).reshape(
            len(direction), sent.shape[1] * got.shape[1]
        )
        return vectors

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

    def factor(
        self, direction: Float[np.ndarray, "n 3"], toward: Float[np.ndarray, "3"] | None = None
    ) -> Complex[np.ndarray, " n"]:
        """Return the array factor of the virtual array, one toward the direction it is steered to (boresight).

        It is that of separated transmitters, without motion.
        """
        axis = np.array([1.0, 0.0, 0.0]) if toward is None else toward
        phase = (direction - axis) @ self.virtual_m.T
        turned = np.exp(-2j * np.pi / self.wavelength_m * phase)
        factor: Complex[np.ndarray, " n"] = turned.mean(axis=1)
        return factor


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


def receiver_mixing(
    place_m: Float[np.ndarray, "rx 3"], error: Complex[np.ndarray, " rx"], coupling: float, wavelength_m: float
) -> Complex[np.ndarray, "rx rx"]:
    """Return the matrix from ideal to true receiver signals.

    Parameters
    ----------
    place_m, error:
        Places of the receivers, and their complex gains after calibration.
    coupling:
        Amplitude that a receiver half a wavelength away couples over, which falls with the distance; its phase is that
        of the way (Svantesson 1999 takes the same form for a first order of mutual coupling).
    wavelength_m:
        Of the carrier.

    """
    apart = np.linalg.norm(place_m[:, None] - place_m[None], axis=2) / wavelength_m
    np.fill_diagonal(apart, np.inf)
    coupled = coupling * 0.5 / apart * np.exp(-2j * np.pi * np.where(np.isfinite(apart), apart, 0.0))
    mixing: Complex[np.ndarray, "rx rx"] = error[:, None] * (np.eye(len(place_m)) + coupled)
    return mixing
