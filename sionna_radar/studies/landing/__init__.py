"""Landing: where a map shows ground to land on, with the probability that it is fit."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "Landing"
