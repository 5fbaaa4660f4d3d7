from .budget.products import write_budget as write_budget
from .compare.page import write_comparison as write_comparison
from .coordinates import Coordinates as Coordinates
from .crosscheck.products import write_crosscheck as write_crosscheck
from .imagery.products import write_imagery as write_imagery
from .link.figures import draw_floors as draw_floors
from .link.figures import draw_link as draw_link
from .link.products import write_link as write_link
from .log.figures import draw_log as draw_log
from .log.products import write_log as write_log
from .maps import colour_bar as colour_bar
from .maps import empty_patch as empty_patch
from .maps import finish_map as finish_map
from .maps import show_raster as show_raster
from .range_doppler.products import write_frames as write_frames
from .show.page import show_page as show_page
from .survey.contents import PointsFile as PointsFile
from .survey.contents import Report as Report
from .survey.environment_figure import draw_environment as draw_environment
from .survey.figures import draw_chirp as draw_chirp
from .survey.figures import draw_dem as draw_dem
from .survey.figures import draw_error as draw_error
from .survey.figures import draw_power as draw_power
from .survey.page import survey_page as survey_page
from .survey.products import write_survey as write_survey
from .sweep.products import write_sweep as write_sweep

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
