from .document import DOCUMENT as DOCUMENT
from .document import draw_front as draw_front
from .document import draw_slices as draw_slices
from .plan import DesignPlan as DesignPlan
from .plan import RadarDesign as RadarDesign
from .plan import plan_design as plan_design

MARKER: str
