"""The weather: attenuation by rain, snow, fog, haze, dust, smoke and the air, and their own echoes.

Pure physics in NumPy, every number with its source. Attenuation is given in dB/km as in the ITU-R Recommendations
(`rain`, `obscurants`, `gases`); `path` turns it into power ratios along a path. `conditions` combines the weather of a
survey, `rain_map` gives rain by position, and `volume` the scatterers in the beam.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
