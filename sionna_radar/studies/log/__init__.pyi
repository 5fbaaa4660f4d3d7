from .document import DOCUMENT as DOCUMENT
from .study import LogInspection as LogInspection
