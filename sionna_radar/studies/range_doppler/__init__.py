"""Range-Doppler: frames of chirps over range and range rate, and what moves in them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Frames"
