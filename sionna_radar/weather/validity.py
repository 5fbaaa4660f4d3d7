"""Validity ranges of published weather models, and enumerations of particles in the air.

The particles are precipitation and obscurants.
"""

from enum import Enum

from sionna_radar.foundation.errors import RadarError


class ValidityError(RadarError, ValueError):
    """A value outside the range in which a model is valid."""


def require_between(name: str, value: float, low: float, high: float, source: str) -> None:
    """Raise `ValidityError` unless low <= value <= high, the range of validity of `source`."""
    if not low <= value <= high:
        raise ValidityError(f"{name} = {value:g} is outside {low:g} to {high:g}, the range of {source}")


def require_not_negative(name: str, value: float) -> None:
    """Raise `ValidityError` for a negative or NaN amount."""
    if not value >= 0:
        raise ValidityError(f"{name} = {value:g} must not be negative")


class Precipitation(Enum):
    """Snowfall, given by its rate as water."""

    RAIN = "rain"
    DRY_SNOW = "dry snow"
    WET_SNOW = "wet snow"


class Obscurant(Enum):
    """Suspended particles, given by their visibility."""

    FOG = "fog"
    HAZE = "haze"
    DUST = "dust"
    SMOKE = "smoke"
