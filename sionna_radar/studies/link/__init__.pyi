from .document import DOCUMENT as DOCUMENT
from .document import draw_floors as draw_floors
from .document import draw_link as draw_link
from .study import LinkBudget as LinkBudget
