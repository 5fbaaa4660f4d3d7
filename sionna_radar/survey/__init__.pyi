from .chain import run as run
from .preparation import CustomParts as CustomParts, Prepared as Prepared, prepare as prepare
from .recording import Recording as Recording, fly as fly, place as place, record as record
from .remapping import RecordedSurvey as RecordedSurvey, record_survey as record_survey
from .result import Survey as Survey
from .sensors.lidar import Lidar as Lidar
from .sensors.radar import SawtoothRadar as SawtoothRadar, TriangularRadar as TriangularRadar
from .sensors.sensor import ChirpRecord as ChirpRecord, Observation as Observation, Sensor as Sensor, SensorInputs as SensorInputs, register_sensor as register_sensor

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
