from .costs import Costs as Costs
from .document import DOCUMENT as DOCUMENT
from .plan import plan_sweep as plan_sweep
from .quantities import Area as Area
from .settings import Axis as Axis
from .settings import Design as Design
from .settings import Sampler as Sampler
from .settings import Span as Span
from .settings import label as label
from .study import Case as Case
from .study import Sweep as Sweep
from .study import run_sweep as run_sweep
from .trial import Trial as Trial

MARKER: str
