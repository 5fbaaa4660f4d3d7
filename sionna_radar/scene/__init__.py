"""The environment: terrain, buildings, cities, targets, and what a ray from above sees of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
