from .backend import BackendReport as BackendReport
from .backend import describe_backend as describe_backend
from .backend import load_mitsuba as load_mitsuba
