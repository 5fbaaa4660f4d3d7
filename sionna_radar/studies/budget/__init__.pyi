from .document import DOCUMENT as DOCUMENT
from .study import Budget as Budget
