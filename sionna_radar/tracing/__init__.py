"""Ray tracing: propagation paths of pulses through a scene, with engines and effects."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
