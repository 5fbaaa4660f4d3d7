from .drawing import Coordinates as Coordinates
from .drawing import colour_bar as colour_bar
from .drawing import empty_patch as empty_patch
from .drawing import finish_map as finish_map
from .drawing import show_raster as show_raster
from .files.contents import PointsFile as PointsFile
from .files.contents import Report as Report
from .page.compare import write_comparison as write_comparison
from .page.show import show_page as show_page
from .studies.budget import write_budget as write_budget
from .studies.crosscheck import write_crosscheck as write_crosscheck
from .studies.imagery import write_imagery as write_imagery
from .studies.link import draw_floors as draw_floors
from .studies.link import draw_link as draw_link
from .studies.link import write_link as write_link
from .studies.log import draw_log as draw_log
from .studies.log import write_log as write_log
from .studies.range_doppler import write_frames as write_frames
from .studies.sweep import write_sweep as write_sweep
from .survey.figures import draw_chirp as draw_chirp
from .survey.figures import draw_dem as draw_dem
from .survey.figures import draw_environment as draw_environment
from .survey.figures import draw_error as draw_error
from .survey.figures import draw_power as draw_power
from .survey.page import survey_page as survey_page
from .survey.products import write_survey as write_survey

__all__ = [
    "Coordinates",
    "PointsFile",
    "Report",
    "colour_bar",
    "draw_chirp",
    "draw_dem",
    "draw_environment",
    "draw_error",
    "draw_floors",
    "draw_link",
    "draw_log",
    "draw_power",
    "empty_patch",
    "finish_map",
    "show_page",
    "show_raster",
    "survey_page",
    "write_budget",
    "write_comparison",
    "write_crosscheck",
    "write_frames",
    "write_imagery",
    "write_link",
    "write_log",
    "write_survey",
    "write_sweep",
]
