"""The weather: how rain, snow, fog, haze, dust, smoke and the air weaken an echo, and how they themselves echo.

Pure physics in NumPy, every number with its source. Attenuation is given in dB/km as the ITU-R Recommendations state
it (`rain`, `fog`, `gases`); `path` turns it into ratios of power along the way. `conditions` joins what a survey meets,
`rain_map` tells rain by place, and `volume` what there is in the beam to send an echo.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
