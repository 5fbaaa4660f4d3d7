"""Foundation of all other packages: errors, rasters, random streams, threads, progress."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
