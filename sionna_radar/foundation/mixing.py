"""Random numbers that belong to a thing: mixed from its identity, whatever was drawn before."""

import numpy as np
from jaxtyping import Float, UInt64

FIRST_STEP = np.ones(1, dtype=np.uint64)
# Places are told apart by millimetres.
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
    """Return numbers in [0, 1) that belong to places, and to a use of randomness: the same whenever one is met."""
    state = split_mix(np.full(len(place_m), seed, dtype=np.uint64), np.array([stream], dtype=np.uint64))
    for column in np.round(place_m * PER_METRE).astype(np.int64).T:
        state = split_mix(state ^ column.view(np.uint64), FIRST_STEP)
    return np.stack([unit_of(state ^ np.uint64(number)) for number in range(count)], axis=1)
