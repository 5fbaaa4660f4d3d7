"""Live: a radar that is stepped pose by pose, a map that grows, and the protocols of autopilots and recorders."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
