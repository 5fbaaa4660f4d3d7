from .document import DOCUMENT as DOCUMENT
from .study import Film as Film
from .study import Frame as Frame
