"""Twin: a recorded flight simulated again, and tests of where signals differ."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Twin"
