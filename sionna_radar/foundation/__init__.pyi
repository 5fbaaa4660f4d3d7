from .errors import BackendError as BackendError
from .errors import InputFileError as InputFileError
from .errors import KeptElsewhereError as KeptElsewhereError
from .errors import OutputError as OutputError
from .errors import PluginError as PluginError
from .errors import Problem as Problem
from .errors import RadarError as RadarError
from .errors import ScenarioError as ScenarioError
from .errors import WorkerError as WorkerError
from .input_file import allow_network as allow_network
from .progress import Progress as Progress
from .randomness import Stream as Stream
from .randomness import pulse_generator as pulse_generator
from .randomness import pulse_uniforms as pulse_uniforms
from .raster import Georeference as Georeference
from .raster import Grid as Grid
from .raster import Raster as Raster

__all__ = [
    "BackendError",
    "Georeference",
    "Grid",
    "InputFileError",
    "KeptElsewhereError",
    "OutputError",
    "PluginError",
    "Problem",
    "Progress",
    "RadarError",
    "Raster",
    "ScenarioError",
    "Stream",
    "WorkerError",
    "allow_network",
    "pulse_generator",
    "pulse_uniforms",
]
