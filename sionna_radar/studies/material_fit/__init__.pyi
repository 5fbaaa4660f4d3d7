from .document import DOCUMENT as DOCUMENT
from .study import MaterialFit as MaterialFit
from .study import measure_levels as measure_levels
