from .document import write_crosscheck as write_crosscheck
from .study import CrossCheck as CrossCheck
from .study import Tolerances as Tolerances
from .study import crosscheck as crosscheck
from .study import fit_material as fit_material
