"""From echoes to points, and from points and range profiles to a DEM with its uncertainty."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
