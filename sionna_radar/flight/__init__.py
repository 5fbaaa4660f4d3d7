"""The flight: where the radar is, where it looks, and when it transmits a chirp."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
