"""A material: sigma0 falls with a power of the cosine of the incidence angle."""

from typing import Annotated

import numpy as np
from pydantic import Field

from sionna_radar import register_material
from sionna_radar.scenario import MaterialParameters, Real


class LichenParameters(MaterialParameters):
    """nadir_sigma0_db: straight down; exponent: of the cosine."""

    nadir_sigma0_db: Annotated[Real, Field(ge=-60, le=10)] = -10.0
    exponent: Annotated[Real, Field(gt=0, le=10)] = 1.0


@register_material("lichen", LichenParameters)
class Lichen:
    """sigma0 = sigma0(nadir) cos^n(incidence), the same for every polarization."""

    def __init__(self, parameters, carrier_hz, channel):
        self.nadir, self.exponent = 10 ** (parameters.nadir_sigma0_db / 10), parameters.exponent

    def sigma0(self, incidence_rad):
        return self.nadir * np.maximum(np.cos(incidence_rad), 0.0) ** self.exponent
