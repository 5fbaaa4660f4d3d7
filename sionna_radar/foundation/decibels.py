"""Decibels and power ratios."""

import math

import numpy as np
from jaxtyping import Float


def from_db(value_db: float) -> float:
    """Return the power ratio of a value in dB."""
    return 10.0 ** (value_db / 10.0)


def to_db(ratio: float) -> float:
    """Return a power ratio in dB; a ratio of zero gives minus infinity."""
    return 10.0 * math.log10(ratio) if ratio > 0 else -math.inf


def decibels(ratio: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return power ratios in dB; NaN for ratios that are not positive."""
    return 10.0 * np.log10(np.where(ratio > 0, ratio, np.nan))
