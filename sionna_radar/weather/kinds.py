"""What can fill the air, by name: what falls, and what only takes the sight away."""

from enum import Enum


class Precipitation(Enum):
    """What falls, told by its rate as water."""

    RAIN = "rain"
    DRY_SNOW = "dry snow"
    WET_SNOW = "wet snow"


class Obscurant(Enum):
    """What hangs in the air, told by its visibility."""

    FOG = "fog"
    HAZE = "haze"
    DUST = "dust"
    SMOKE = "smoke"
