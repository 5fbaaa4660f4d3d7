from .consistency import Pair as Pair
from .document import DOCUMENT as DOCUMENT
from .study import Fusion as Fusion
