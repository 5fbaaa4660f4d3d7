"""Sweep: DEM errors over varied, listed, sampled or tabulated settings."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# The file by which a folder of results is told.
MARKER = "sweep.json"
RECORD = "Sweep"
