from .document import DOCUMENT as DOCUMENT
from .study import Fusion as Fusion
from .study import Pair as Pair
