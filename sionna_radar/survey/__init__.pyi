from .observed_survey import ObservedSurvey as ObservedSurvey
from .observed_survey import observe_survey as observe_survey
from .sensors.lidar import Lidar as Lidar
from .sensors.radar import Radar as Radar
from .sensors.sensor import Observation as Observation
from .sensors.sensor import Sensor as Sensor
from .sensors.sensor import SensorInputs as SensorInputs
from .sensors.sweeps import ChirpRecord as ChirpRecord
