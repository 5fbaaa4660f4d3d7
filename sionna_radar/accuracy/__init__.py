"""Accuracy of a DEM against the truth; the only part of the processing with access to it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
