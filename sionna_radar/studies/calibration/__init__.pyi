from .document import write_calibration as write_calibration
from .study import Calibration as Calibration
from .study import run_calibration as run_calibration
