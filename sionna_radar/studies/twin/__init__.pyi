from .document import write_twin as write_twin
from .study import Twin as Twin
from .study import twin as twin
