from .document import write_comparison as write_comparison
