"""Fusion: one DEM from surveys, recordings, clouds and DEMs of different sensors and flight lines."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Fusion"
