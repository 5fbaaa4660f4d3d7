"""Detection: range spectra, CFAR, range estimators and angles of arrival, from beat signals to echoes."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
