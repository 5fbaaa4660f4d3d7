from .document import DOCUMENT as DOCUMENT
from .study import Landing as Landing
from .study import Limits as Limits
