from .detector import Detector as Detector
from .echoes import Echoes as Echoes
from .profiles import Profiles as Profiles
from .ranging.estimator import EchoSpans as EchoSpans
from .ranging.estimator import RangeEstimator as RangeEstimator
from .ranging.estimator import Ranges as Ranges
from .ranging.estimator import register_range_estimator as register_range_estimator
from .spectrum import SpectrumAnalyser as SpectrumAnalyser

__all__ = [
    "Detector",
    "EchoSpans",
    "Echoes",
    "Profiles",
    "RangeEstimator",
    "Ranges",
    "SpectrumAnalyser",
    "register_range_estimator",
]
