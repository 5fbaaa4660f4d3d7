from .document import write_budget as write_budget
from .study import Budget as Budget
from .study import navigation_budget as navigation_budget
