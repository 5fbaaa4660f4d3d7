from .document import DOCUMENT as DOCUMENT
from .motion import Motion as Motion
from .odometry import Odometry as Odometry
from .odometry import read_odometry as read_odometry
from .study import Slam as Slam
from .study import SlamOptions as SlamOptions
from .study import slam as slam
