"""Design: the radar and flight that meet requirements at the least cost."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The file by which a folder of results is told.
MARKER = "design.json"
RECORD = "RadarDesign"
NEEDS = ("sweep",)
