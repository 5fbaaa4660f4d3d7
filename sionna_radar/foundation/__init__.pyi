from .errors import BackendError as BackendError
from .errors import InputFileError as InputFileError
from .errors import KeptElsewhereError as KeptElsewhereError
from .errors import OutputError as OutputError
from .errors import PluginError as PluginError
from .errors import WorkerError as WorkerError
from .input_file import allow_network as allow_network
from .raster import Grid as Grid
