from .document import write_budget as write_budget
from .study import Budget as Budget
from .study import run_budget as run_budget
