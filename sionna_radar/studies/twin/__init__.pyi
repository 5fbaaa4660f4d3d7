from .document import DOCUMENT as DOCUMENT
from .study import Twin as Twin
