"""The ray tracer's set-up: libLLVM, the Dr.Jit variant, and what `doctor` reports of them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
