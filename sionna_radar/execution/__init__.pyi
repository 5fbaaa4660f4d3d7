from .checkpoints import Checkpoints as Checkpoints
from .checkpoints import open_checkpoints as open_checkpoints
from .workers import Workers as Workers
