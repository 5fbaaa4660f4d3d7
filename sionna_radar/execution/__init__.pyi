from .checkpoints import Checkpoints as Checkpoints
from .checkpoints import open_checkpoints as open_checkpoints
from .cluster import open_workers as open_workers
from .execution import Execution as Execution
from .workers import Workers as Workers
