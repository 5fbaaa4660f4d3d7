"""Counter-based random streams: numbers keyed by pulse or by place, independent of blocks and workers.

Every stream of a pulse is a counter-based Philox generator keyed by (seed, stream) whose counter is set from the pulse
index, so a pulse draws the same numbers in a block of one, in a block of a thousand, or alone (Salmon et al. 2011,
"Parallel random numbers: as easy as 1, 2, 3").

Numbers of a place are hashed from its coordinates, independently of earlier draws.
"""

from collections.abc import Iterator
from enum import IntEnum

import numpy as np
from jaxtyping import Float, Int, UInt64

STREAMS = 256  # an upper bound, so that no item's key equals another stream's


class Stream(IntEnum):
    """Independent uses of randomness within one pulse."""

    DIRECTIONS = 1
    SPECKLE = 2
    NOISE = 3
    TARGETS = 4
    TARGET_SCANS = 5
    VOLUME = 6
    PHASE_NOISE = 7
    VOLUME_DIRECTIONS = 8
    VEGETATION = 12
    MOTION = 13
    CROPS = 14
    NAVIGATION = 50
    WANDER = 51
    LIDAR = 52
    LIDAR_DROPS = 53
    GUSTS = 54
    CAMERA = 55
    LIDAR_RAYS = 56
    LIDAR_LEAVES = 57
    LIDAR_NOISE = 58
    CHECKPOINTS = 60
    VARIOGRAM = 61
    CELLS = 62
    SAMPLES = 63
    CALIBRATION = 64


def pulse_generator(seed: int, stream: Stream, pulse: int) -> np.random.Generator:
    """Return the Philox generator of a pulse, by index in the survey, and stream; pulses are 2**64 numbers apart."""
    return np.random.Generator(np.random.Philox(key=[seed, int(stream)], counter=[0, pulse, 0, 0]))


def pulse_generators(
    seed: int, stream: Stream, pulse: Int[np.ndarray, " pulse"], item: int = 0
) -> Iterator[np.random.Generator]:
    """Yield the `pulse_generator` of each pulse: one and the same object, reset each time.

    item: index among several similar items, each with its own numbers.
    """
    bits = np.random.Philox(key=[seed, int(stream) + STREAMS * item], counter=0)
    generator, fresh = np.random.Generator(bits), bits.state
    for index in pulse:
        fresh["state"]["counter"][1] = index
        bits.state = fresh
        yield generator


def pulse_uniforms(
    seed: int, stream: Stream, pulse: Int[np.ndarray, " pulse"], count: int, item: int = 0
) -> Float[np.ndarray, "pulse {count}"]:
    """Return `count` numbers in [0, 1) for each pulse, by index; a stream is drawn with one `count` throughout.

    item: index among several similar items, each with its own numbers.
    """
    steps = -(-count // 4)  # a step of the counter yields four numbers
    out = np.empty((len(pulse), 4 * steps))
    breaks = np.flatnonzero(np.diff(pulse) != 1) + 1
    for rows in np.split(np.arange(len(pulse)), breaks):
        if len(rows) == 0:
            continue
        generator = np.random.Philox(key=[seed, int(stream) + STREAMS * item], counter=0)
        generator.advance(int(pulse[rows[0]]) * steps)
        np.random.Generator(generator).random(out=out[rows[0] : rows[-1] + 1])
    return out[:, :count]


FIRST_STEP = np.ones(1, dtype=np.uint64)
# Resolution of places, 1/m.
PER_METRE = 1000


def split_mix(state: UInt64[np.ndarray, "..."], step: UInt64[np.ndarray, "..."]) -> UInt64[np.ndarray, "..."]:
    """Return the outputs of SplitMix64 at given steps from given states.

    Source: Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators"; the constants are
    those of Vigna's public-domain splitmix64.c.
    """
    z = state + step * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def unit_of(identity: UInt64[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return a number in [0, 1) for each identity."""
    return (split_mix(identity, FIRST_STEP) >> np.uint64(11)).astype(np.float64) * 2.0**-53


def place_uniforms(
    seed: int, stream: int, place_m: Float[np.ndarray, "place 3"], count: int
) -> Float[np.ndarray, "place count"]:
    """Return numbers in [0, 1) hashed from places and a stream: always the same for the same place."""
    state = split_mix(np.full(len(place_m), seed, dtype=np.uint64), np.array([stream], dtype=np.uint64))
    for column in np.round(place_m * PER_METRE).astype(np.int64).T:
        state = split_mix(state ^ column.view(np.uint64), FIRST_STEP)
    return np.stack([unit_of(state ^ np.uint64(number)) for number in range(count)], axis=1)
