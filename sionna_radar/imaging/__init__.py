"""Images from pulses: the real-aperture image of a side-looking radar, and synthetic-aperture focusing."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
