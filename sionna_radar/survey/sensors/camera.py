"""The camera in the list of sensors: it gives images and no ranges, and flies by its own command."""

from typing import NoReturn

from sionna_radar.foundation.errors import ScenarioError


def camera(*_: object) -> NoReturn:
    """Raise ScenarioError with the command that flies a camera."""
    message = "'camera' gives images and no ranges, and makes no map; use `sionna-radar camera`, or set 'radar'"
    raise ScenarioError.of("sensor", message)
