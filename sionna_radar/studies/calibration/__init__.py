"""Calibration: mounting, lever arm, range and clock errors of an instrument from its echoes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Calibration"
