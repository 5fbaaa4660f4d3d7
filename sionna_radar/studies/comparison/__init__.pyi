from .document import DOCUMENT as DOCUMENT
from .study import ResultsComparison as ResultsComparison
