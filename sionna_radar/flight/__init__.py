"""The flight: trajectory, scan, navigation errors, and the schedule of pulses."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
