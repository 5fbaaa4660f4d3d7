"""Planning: flights that cover an area, checked with the beam over the terrain."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
