"""MSI Planet files (.msi, .pln): attenuation below the peak around a horizontal and a vertical cut.

Horizontal angles turn clockwise seen from above, so to the right of boresight; vertical ones from boresight downward,
or, in files of some makers, from the zenith.
"""

import numpy as np
from jaxtyping import Float

from sionna_radar.radar.pattern_files.contents import PatternCuts

SECTIONS = ("HORIZONTAL", "VERTICAL")
MOST_ROWS = 100_000


def is_planet(text: str) -> bool:
    """Whether a text has the two sections of a Planet file."""
    upper = text.upper()
    return all(f"\n{section}" in f"\n{upper}" for section in SECTIONS)


def read_planet(text: str) -> PatternCuts:
    """Return the cuts of a Planet file.

    Raises
    ------
    ValueError
        A section is missing, has another number of rows than it says, or rows that are not an angle and a loss.

    """
    lines = text.splitlines()
    cuts = {}
    for number, line in enumerate(lines):
        words = line.split()
        if words and words[0].upper() in SECTIONS:
            cuts[words[0].upper()] = _section(lines, number, words)
    if set(cuts) != set(SECTIONS):
        lacking = ", ".join(section for section in SECTIONS if section not in cuts)
        message = f"expected a line with {lacking} and a number of rows, and found none"
        raise ValueError(message)
    (right, right_loss), (down, down_loss) = (cuts[section] for section in SECTIONS)
    azimuth, elevation = _turned(right, right_loss), _turned(down, down_loss)
    return PatternCuts(*azimuth, *elevation, turnable=True)


def _section(lines: list[str], first: int, words: list[str]) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    if len(words) != 2 or not words[1].isdecimal() or not 3 <= int(words[1]) <= MOST_ROWS:
        message = (
            f"line {first + 1} holds {lines[first].strip()[:60]!r}; expected {words[0].upper()} and how many rows "
            f"follow, 3 to {MOST_ROWS:,}"
        )
        raise ValueError(message)
    count = int(words[1])
    found = []
    for number, row in enumerate(lines[first + 1 : first + 1 + count], start=first + 2):
        try:
            values = [float(word.replace(",", ".")) for word in row.split()]
        except ValueError:
            values = []
        if len(values) != 2 or not np.isfinite(values).all():
            message = (
                f"line {number} holds {row.strip()[:60]!r}; expected an angle and a loss, as line {first + 1} "
                f"announces {count} rows of them"
            )
            raise ValueError(message)
        found.append(values)
    if len(found) < count:
        message = f"line {first + 1} announces {count} rows of an angle and a loss; the file ends after {len(found)}"
        raise ValueError(message)
    table = np.array(found)
    return table[:, 0], table[:, 1]


def _turned(
    angle_deg: Float[np.ndarray, " n"], loss_db: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Return angles the other way around, from -180 to 180 and increasing, and powers."""
    angle = -((angle_deg + 180) % 360 - 180)
    angle, first = np.unique(angle, return_index=True)
    # Losses are positive; a file with powers below zero means the same.
    return angle, -np.abs(loss_db[first])
