"""Camera: what a pilot or a camera sees of the world that the radar flies over."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Film"
NEEDS = ("panorama",)
