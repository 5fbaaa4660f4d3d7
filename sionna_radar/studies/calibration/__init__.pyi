from .document import write_calibration as write_calibration
from .study import Calibration as Calibration
from .study import calibrate as calibrate
