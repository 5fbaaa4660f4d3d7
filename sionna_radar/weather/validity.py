"""Refusal of inputs that a published model was not made for."""

from sionna_radar.foundation.errors import RadarError


class ValidityError(RadarError, ValueError):
    """A value outside the range in which the source of a model holds."""


def require_between(name: str, value: float, low: float, high: float, source: str) -> None:
    """Raise `ValidityError` unless low <= value <= high, the range for which `source` vouches."""
    if not low <= value <= high:
        message = f"{name} = {value:g} lies outside {low:g} to {high:g}, where {source} holds"
        raise ValidityError(message)


def require_not_negative(name: str, value: float) -> None:
    """Raise `ValidityError` for a negative or missing amount."""
    if not value >= 0:
        message = f"{name} = {value:g} must not be negative"
        raise ValidityError(message)
