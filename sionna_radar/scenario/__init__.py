"""Scenarios: tables of terrain, flight, radar, processing and DEM; loading and validation; registries of parts."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
