from .frames import conical_from_antenna as conical_from_antenna, whisk_broom_from_antenna as whisk_broom_from_antenna, world_from_body as world_from_body
from .pulses import Navigation as Navigation, Pose as Pose, PulseSchedule as PulseSchedule, Pulses as Pulses, antenna_pose as antenna_pose, register_navigation as register_navigation
from .scan import Pointing as Pointing, Scan as Scan, register_scan as register_scan
from .trajectory import Trajectory as Trajectory

__all__ = [
    "Navigation",
    "Pointing",
    "Pose",
    "PulseSchedule",
    "Pulses",
    "Scan",
    "Trajectory",
    "antenna_pose",
    "conical_from_antenna",
    "register_navigation",
    "register_scan",
    "whisk_broom_from_antenna",
    "world_from_body",
]
