from .aperture import Aperture as Aperture
from .aperture import PixelGrid as PixelGrid
from .aperture import ground_pixels as ground_pixels
from .aperture import whole_beam as whole_beam
from .sar import BackProjection as BackProjection
from .sar import SarImage as SarImage
from .slar import SideLooking as SideLooking
from .slar import SlantImage as SlantImage
from .slar import to_ground as to_ground
from .strip import azimuth_resolution_m as azimuth_resolution_m
from .strip import ground_range_resolution_m as ground_range_resolution_m
from .strip import half_power_width as half_power_width
from .strip import real_aperture_resolution_m as real_aperture_resolution_m
from .strip import slant_range_resolution_m as slant_range_resolution_m

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
