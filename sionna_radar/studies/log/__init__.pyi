from .document import DOCUMENT as DOCUMENT
from .study import LogInspection as LogInspection
from .study import inspect_log as inspect_log
