from .document import DOCUMENT as DOCUMENT
from .study import Calibration as Calibration
