"""Panorama: images of a beam that turns over the horizon, one a turn, and their mosaic."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Panorama"
