from .document import DOCUMENT as DOCUMENT
from .quantities import Area as Area
from .quantities import Costs as Costs
from .settings import Axis as Axis
from .settings import Design as Design
from .settings import Sampler as Sampler
from .settings import Span as Span
from .study import Case as Case
from .study import Sweep as Sweep
from .study import Trial as Trial
from .study import label as label
from .study import plan_sweep as plan_sweep
from .study import run_sweep as run_sweep

MARKER: str
