from .document import DOCUMENT as DOCUMENT
from .levels import measure_levels as measure_levels
from .study import MaterialFit as MaterialFit
