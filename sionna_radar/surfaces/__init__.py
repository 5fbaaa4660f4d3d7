"""Scattering by surfaces: permittivity, rough-surface models, measured tables."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
