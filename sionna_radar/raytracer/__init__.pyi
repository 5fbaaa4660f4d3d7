from .backend import BackendReport as BackendReport, describe_backend as describe_backend, load_mitsuba as load_mitsuba

__all__ = [
    "BackendReport",
    "describe_backend",
    "load_mitsuba",
]
