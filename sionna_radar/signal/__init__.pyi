from .beat import synthesise as synthesise
from .noise import add_noise as add_noise
from .receiver import Receiver as Receiver

__all__ = [
    "Receiver",
    "add_noise",
    "synthesise",
]
