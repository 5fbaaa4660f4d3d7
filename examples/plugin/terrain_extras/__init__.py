"""Parts for sionna_radar; importing the package registers them."""

from terrain_extras import gated_centroid, lichen, median

__all__ = ["gated_centroid", "lichen", "median"]
