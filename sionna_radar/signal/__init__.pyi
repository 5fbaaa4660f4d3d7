from .beat import SampleGrid as SampleGrid
from .beat import synthesise as synthesise
from .build import StageInputs as StageInputs
from .receiver import add_noise as add_noise
from .stages import Received as Received
from .stages import ReceiverStage as ReceiverStage
