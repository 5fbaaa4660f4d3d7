from .study import Sensitivities as Sensitivities
