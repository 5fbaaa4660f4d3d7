from .document import DOCUMENT as DOCUMENT
from .study import Budget as Budget
from .study import navigation_budget as navigation_budget
