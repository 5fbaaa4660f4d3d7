from .frames import conical_from_antenna as conical_from_antenna
from .frames import whisk_broom_from_antenna as whisk_broom_from_antenna
from .frames import world_from_body as world_from_body
from .logs.log import FlightLog as FlightLog
from .logs.reader import read_log as read_log
from .pulses import Navigation as Navigation
from .pulses import Pose as Pose
from .pulses import Pulses as Pulses
from .pulses import PulseSchedule as PulseSchedule
from .pulses import antenna_pose as antenna_pose
from .pulses import register_navigation as register_navigation
from .scan import Pointing as Pointing
from .scan import Scan as Scan
from .scan import register_scan as register_scan
from .trajectory import Trajectory as Trajectory

__all__ = [
    "FlightLog",
    "Navigation",
    "Pointing",
    "Pose",
    "PulseSchedule",
    "Pulses",
    "Scan",
    "Trajectory",
    "antenna_pose",
    "conical_from_antenna",
    "read_log",
    "register_navigation",
    "register_scan",
    "whisk_broom_from_antenna",
    "world_from_body",
]
