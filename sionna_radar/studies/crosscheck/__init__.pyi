from .document import DOCUMENT as DOCUMENT
from .study import CrossCheck as CrossCheck
from .study import Tolerances as Tolerances
