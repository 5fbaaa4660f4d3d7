"""Link: the link budget over each material, in closed form and simulated."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "LinkBudget"
