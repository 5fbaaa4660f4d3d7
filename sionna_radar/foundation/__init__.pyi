from .errors import BackendError as BackendError, InputFileError as InputFileError, KeptElsewhereError as KeptElsewhereError, OutputError as OutputError, PluginError as PluginError, Problem as Problem, RadarError as RadarError, ScenarioError as ScenarioError
from .georeference import Georeference as Georeference
from .progress import Progress as Progress
from .randomness import Stream as Stream, pulse_generator as pulse_generator, pulse_uniforms as pulse_uniforms
from .raster import Grid as Grid, Raster as Raster

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
    "pulse_generator",
    "pulse_uniforms",
]
