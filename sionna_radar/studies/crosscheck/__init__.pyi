from .document import DOCUMENT as DOCUMENT
from .study import CrossCheck as CrossCheck
from .study import Tolerances as Tolerances
from .study import crosscheck as crosscheck
from .study import fit_material as fit_material
