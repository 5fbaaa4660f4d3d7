"""Material fit: roughness, permittivity and gamma of covers from levels of backscatter."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

RECORD = "MaterialFit"
NEEDS = ("calibration",)
