from .aperture import Aperture as Aperture, whole_beam as whole_beam
from .grid import PixelGrid as PixelGrid, ground_pixels as ground_pixels
from .resolution import azimuth_resolution_m as azimuth_resolution_m, ground_range_resolution_m as ground_range_resolution_m, half_power_width as half_power_width, real_aperture_resolution_m as real_aperture_resolution_m, slant_range_resolution_m as slant_range_resolution_m
from .sar import BackProjection as BackProjection, SarImage as SarImage
from .slar import SideLooking as SideLooking, SlantImage as SlantImage, to_ground as to_ground

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
