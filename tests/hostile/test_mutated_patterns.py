"""Pattern files with bytes changed, lines lost or ends cut: each is one clear error or a sane antenna."""

import contextlib

import numpy as np
import pytest

from beams import make_antenna
from mutants import mutated
from pattern_files import WRITERS
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.radar.pattern import directions_of
from sionna_radar.readers.antennas.reader import read_pattern

MUTATIONS_EACH = 10


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
