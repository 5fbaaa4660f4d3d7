from .drawing import Coordinates as Coordinates
from .drawing import colour_bar as colour_bar
from .drawing import empty_patch as empty_patch
from .drawing import finish_map as finish_map
from .drawing import show_raster as show_raster
from .files.contents import PointsFile as PointsFile
from .files.contents import Report as Report
from .survey.figures import draw_dem as draw_dem
