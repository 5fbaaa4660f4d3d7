from .backscatter import Backscatter as Backscatter
from .backscatter import ConstantGammaBackscatter as ConstantGammaBackscatter
from .backscatter import LambertianBackscatter as LambertianBackscatter
from .build import build_materials as build_materials
from .build import register_material as register_material
from .radar_material import Mirror as Mirror
from .radar_material import RadarMaterial as RadarMaterial
