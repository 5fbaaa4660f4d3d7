from .backscatter import Backscatter as Backscatter, ConstantGammaBackscatter as ConstantGammaBackscatter, LambertianBackscatter as LambertianBackscatter
from .material import build_materials as build_materials, register_material as register_material
from .radar_material import Mirror as Mirror, RadarMaterial as RadarMaterial

__all__ = [
    "Backscatter",
    "ConstantGammaBackscatter",
    "LambertianBackscatter",
    "Mirror",
    "RadarMaterial",
    "build_materials",
    "register_material",
]
