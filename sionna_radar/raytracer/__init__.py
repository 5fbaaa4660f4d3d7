"""Set-up of the ray tracer: libLLVM, the Dr.Jit variant, and the report on them for `doctor`."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
