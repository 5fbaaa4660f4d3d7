"""The weather: how rain, fog and the air weaken an echo, and how rain itself echoes.

Pure physics in NumPy, every number with its source. Attenuation is given in dB/km as the ITU-R
Recommendations state it (`rain`, `fog`, `gases`); `path` turns it into ratios of power along the way.
"""
