from .conditions import Volume as Volume
from .conditions import Weather as Weather
from .conditions import volume_of as volume_of
from .drops import drop_polarization as drop_polarization
from .drops import marshall_palmer as marshall_palmer
