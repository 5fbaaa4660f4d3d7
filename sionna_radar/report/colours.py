"""Colours of pages and figures, safe for colour-blind readers."""

# Okabe and Ito
BLUE = "#0072b2"
RED = "#d55e00"
GREEN = "#009e73"
PURPLE = "#cc79a7"
ORANGE = "#e69f00"
SKY = "#56b4e9"
# Names of matplotlib's colour maps.
HEIGHTS, POWERS, ERRORS, LEVELS = "viridis", "viridis", "RdBu_r", "cividis"
# Grey of empty map cells.
EMPTY = "0.82"


def _stops(codes: str) -> list[str]:
    return [f"#{code}" for code in codes.split()]


# The same colour maps at evenly spaced stops, for pages, which are made without matplotlib.
STOPS = {
    HEIGHTS: _stops(
        "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c 1fa088 28ae80 3fbc73 "
        "5ec962 84d44b addc30 d8e219 fde725"
    ),
    ERRORS: _stops(
        "053061 175290 2a71b2 3f8ec0 6bacd1 9bc9e0 c2ddec e0ecf3 f7f6f6 fbe5d8 fbccb4 f5aa89 "
        "e48066 d05548 ba2832 930e26 67001f"
    ),
    LEVELS: _stops(
        "00224e 002e6a 1a386f 32436d 434e6c 535a6d 61656f 6f7073 7d7c78 8c8878 9b9476 aba072 "
        "bcae6c cdbb63 dec958 f0d846 fee838"
    ),
}
