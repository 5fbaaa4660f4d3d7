from .chain import run as run
from .observation import Observed as Observed
from .observation import observe as observe
from .observation import observe_blocks as observe_blocks
from .observation import place as place
from .observed_survey import ObservedSurvey as ObservedSurvey
from .observed_survey import observe_survey as observe_survey
from .preparation import CustomParts as CustomParts
from .preparation import Prepared as Prepared
from .preparation import prepare as prepare
from .reprocessing import process as process
from .result import Processed as Processed
from .result import Survey as Survey
from .sensors.lidar import Lidar as Lidar
from .sensors.radar import Radar as Radar
from .sensors.sensor import Observation as Observation
from .sensors.sensor import Sensor as Sensor
from .sensors.sensor import SensorInputs as SensorInputs
from .sensors.sensor import register_sensor as register_sensor
from .sensors.sweeps import ChirpRecord as ChirpRecord

__all__ = [
    "ChirpRecord",
    "CustomParts",
    "Lidar",
    "Observation",
    "Observed",
    "ObservedSurvey",
    "Prepared",
    "Processed",
    "Radar",
    "Sensor",
    "SensorInputs",
    "Survey",
    "observe",
    "observe_blocks",
    "observe_survey",
    "place",
    "prepare",
    "process",
    "register_sensor",
    "run",
]
