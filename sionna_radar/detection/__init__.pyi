from .detector import Detector as Detector
from .echoes import Echoes as Echoes
from .echoes import Profiles as Profiles
from .range_doppler.cfar import ClutterMap as ClutterMap
from .range_doppler.cfar import RingCfar as RingCfar
from .range_doppler.frames import RangeDoppler as RangeDoppler
from .range_doppler.frames import RangeDopplerMap as RangeDopplerMap
from .range_doppler.movers import Movers as Movers
from .range_doppler.movers import StaggeredRangeDoppler as StaggeredRangeDoppler
from .range_doppler.movers import find_movers as find_movers
from .ranging.estimator import EchoSpans as EchoSpans
from .ranging.estimator import RangeEstimator as RangeEstimator
from .ranging.estimator import Ranges as Ranges
from .ranging.estimator import register_range_estimator as register_range_estimator
from .spectrum import SpectrumAnalyser as SpectrumAnalyser

__all__ = [
    "ClutterMap",
    "Detector",
    "EchoSpans",
    "Echoes",
    "Movers",
    "Profiles",
    "RangeDoppler",
    "RangeDopplerMap",
    "RangeEstimator",
    "Ranges",
    "RingCfar",
    "SpectrumAnalyser",
    "StaggeredRangeDoppler",
    "find_movers",
    "register_range_estimator",
]
