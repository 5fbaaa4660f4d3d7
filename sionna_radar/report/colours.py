"""Colours of the figures, safe for colour-blind readers."""

# Okabe and Ito
BLUE = "#0072b2"
RED = "#d55e00"
GREEN = "#009e73"
PURPLE = "#cc79a7"
ORANGE = "#e69f00"
SKY = "#56b4e9"
# Names of matplotlib's colour maps.
HEIGHTS, POWERS, ERRORS = "viridis", "viridis", "RdBu_r"
# An empty cell of a map, in grey.
EMPTY = "0.82"
