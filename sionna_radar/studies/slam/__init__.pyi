from .document import DOCUMENT as DOCUMENT
from .motion import Motion as Motion
from .study import Slam as Slam
from .study import SlamOptions as SlamOptions
from .study import slam as slam
