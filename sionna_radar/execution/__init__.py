"""Execution of surveys and studies: in this process or on workers, with checkpoints. It never affects results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
