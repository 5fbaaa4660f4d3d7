"""SLAM: the way of a panoramic radar and the map around it, from its images alone."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Slam"
NEEDS = ("panorama",)
