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
from .result import Survey as Survey
from .sensors.lidar import Lidar as Lidar
from .sensors.radar import SawtoothRadar as SawtoothRadar
from .sensors.radar import TriangularRadar as TriangularRadar
from .sensors.sensor import ChirpRecord as ChirpRecord
from .sensors.sensor import Observation as Observation
from .sensors.sensor import Sensor as Sensor
from .sensors.sensor import SensorInputs as SensorInputs
from .sensors.sensor import register_sensor as register_sensor

__all__ = [
    "ChirpRecord",
    "CustomParts",
    "Lidar",
    "Observation",
    "Prepared",
    "RecordedSurvey",
    "Recording",
    "SawtoothRadar",
    "Sensor",
    "SensorInputs",
    "Survey",
    "TriangularRadar",
    "fly",
    "place",
    "prepare",
    "record",
    "record_survey",
    "register_sensor",
    "run",
]
