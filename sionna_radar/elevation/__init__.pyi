from .heightfield import Heightfield as Heightfield
