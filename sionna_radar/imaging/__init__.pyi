from .aperture import Aperture as Aperture
from .aperture import whole_beam as whole_beam
from .grid import PixelGrid as PixelGrid
from .grid import ground_pixels as ground_pixels
from .resolution import azimuth_resolution_m as azimuth_resolution_m
from .resolution import ground_range_resolution_m as ground_range_resolution_m
from .resolution import half_power_width as half_power_width
from .resolution import real_aperture_resolution_m as real_aperture_resolution_m
from .resolution import slant_range_resolution_m as slant_range_resolution_m
from .sar import BackProjection as BackProjection
from .sar import SarImage as SarImage
from .slar import SideLooking as SideLooking
from .slar import SlantImage as SlantImage
from .slar import to_ground as to_ground

__all__ = [
    "Aperture",
    "BackProjection",
    "PixelGrid",
    "SarImage",
    "SideLooking",
    "SlantImage",
    "azimuth_resolution_m",
    "ground_pixels",
    "ground_range_resolution_m",
    "half_power_width",
    "real_aperture_resolution_m",
    "slant_range_resolution_m",
    "to_ground",
    "whole_beam",
]
