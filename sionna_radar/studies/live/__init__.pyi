from .frame import Frame as Frame
from .live_map import LiveMap as LiveMap
from .poses import Poses as Poses
from .radar import Radar as Radar
