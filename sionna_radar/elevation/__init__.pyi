from .heightfield import Heightfield as Heightfield

__all__ = [
    "Heightfield",
]
