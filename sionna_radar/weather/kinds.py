"""Kinds of particles in the air: precipitation and obscurants."""

from enum import Enum


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
