from .study import Sensitivities as Sensitivities
from .study import sensitivities as sensitivities
