"""Pattern files with bytes changed, lines lost or ends cut: each is one clear error or a sane antenna."""

import contextlib

import numpy as np
import pytest

from beams import make_antenna
from pattern_files import WRITERS
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.radar.pattern import directions_of
from sionna_radar.radar.pattern_files.reader import read_pattern

MUTATIONS_EACH = 10


def mutated(text: bytes, generator: np.random.Generator) -> bytes:
    """Return a text cut short, with some bytes changed, or with lines lost or repeated."""
    kind = generator.integers(4)
    if kind == 0:
        return text[: generator.integers(len(text))]
    if kind == 1:
        found = bytearray(text)
        for place in generator.integers(len(found), size=generator.integers(1, 30)):
            found[place] = generator.integers(256)
        return bytes(found)
    lines = text.split(b"\n")
    chosen = generator.integers(len(lines), size=3)
    if kind == 2:
        return b"\n".join(line for number, line in enumerate(lines) if number not in chosen)
    for place in chosen:
        lines[place] = lines[place].replace(b"1", b"9e99").replace(b"0", b"-")
    return b"\n".join(lines)


@pytest.mark.parametrize("kind", WRITERS)
def test_mutations(kind, tmp_path):
    name, write = WRITERS[kind]
    path = write(make_antenna(20.0, 20.0), tmp_path / name)
    whole = path.read_bytes()
    generator = np.random.default_rng(sum(map(ord, kind)))
    away = directions_of(*np.random.default_rng(1).uniform(-3, 3, size=(2, 50)))
    for _ in range(MUTATIONS_EACH):
        path.write_bytes(mutated(whole, generator))
        with contextlib.suppress(InputFileError):  # anything else fails the test
            pattern = read_pattern(path, "radar.antenna.pattern")
            amplitude = pattern.amplitude(away)
            assert np.all(np.isfinite(amplitude))
            assert 0 < pattern.directivity < 1e6
