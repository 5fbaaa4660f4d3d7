from .poses import Poses as Poses
from .radar import Frame as Frame
from .radar import Radar as Radar
