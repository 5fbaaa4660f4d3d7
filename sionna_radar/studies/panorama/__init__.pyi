from .document import DOCUMENT as DOCUMENT
from .polar_images import PolarImages as PolarImages
from .polar_images import read_images as read_images
from .study import Panorama as Panorama
from .study import panorama as panorama
