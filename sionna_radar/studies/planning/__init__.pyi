from .study import FlightPlan as FlightPlan
from .study import Wanted as Wanted
from .study import check_plan as check_plan
from .study import planned_scenario as planned_scenario
