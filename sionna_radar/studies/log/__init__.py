"""Log: what a flight log holds, and which stretches can be flown."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "LogInspection"
