from .chain import run as run
from .preparation import CustomParts as CustomParts
from .preparation import Prepared as Prepared
from .preparation import prepare as prepare
from .recording import Recording as Recording
from .recording import fly as fly
from .recording import place as place
from .recording import record as record
from .remapping import RecordedSurvey as RecordedSurvey
from .remapping import record_survey as record_survey
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
    "Prepared",
    "Processed",
    "Radar",
    "RecordedSurvey",
    "Recording",
    "Sensor",
    "SensorInputs",
    "Survey",
    "fly",
    "place",
    "prepare",
    "process",
    "record",
    "record_survey",
    "register_sensor",
    "run",
]
