from .document import DOCUMENT as DOCUMENT
from .results import compare as compare
from .results import read_results as read_results
from .study import ResultsComparison as ResultsComparison
