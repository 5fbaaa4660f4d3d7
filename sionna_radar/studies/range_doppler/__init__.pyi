from .cfar import ClutterMap as ClutterMap
from .cfar import RingCfar as RingCfar
from .document import DOCUMENT as DOCUMENT
from .study import Frames as Frames
