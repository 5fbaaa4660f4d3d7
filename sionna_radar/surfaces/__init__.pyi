from .backscatter import Backscatter as Backscatter
from .foliage import Foliage as Foliage
