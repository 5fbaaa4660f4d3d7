from .echoes import Echoes as Echoes
from .echoes import Profiles as Profiles
from .ranging.estimators import EchoSpans as EchoSpans
from .ranging.estimators import RangeEstimator as RangeEstimator
from .ranging.estimators import RangeLoop as RangeLoop
from .ranging.estimators import Ranges as Ranges
from .spectrum import SpectrumAnalyser as SpectrumAnalyser
