from .backscatter import Backscatter as Backscatter
