"""How surveys are computed: on this process or on workers, with checkpoints; never what they result in."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
