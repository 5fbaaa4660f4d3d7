from .document import write_log as write_log
from .study import LogInspection as LogInspection
from .study import inspect_log as inspect_log
