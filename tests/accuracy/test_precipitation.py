"""Which echoes are rain's: those with more of its power in their range cells than of anything else."""

import numpy as np

from beams import make_chirp
from direct_receiver import points_at
from sionna_radar.accuracy.truth import mostly_of
from sionna_radar.detection.echoes import Echoes
from sionna_radar.tracing.paths import TARGET, VOLUME


def paths_of(rows):
    """Return paths from (pulse, range, power, surface)."""
    pulse, range_m, power, surface = (np.array(column) for column in zip(*rows, strict=True))
    return points_at(range_m, np.sqrt(power), pulse=pulse, surface=surface)


def echoes_of(rows):
    pulse, range_m = (np.array(column) for column in zip(*rows, strict=True))
    nothing = np.zeros(len(pulse))
    return Echoes(
        pulse=pulse,
        number=np.zeros(len(pulse), dtype=int),
        range_m=range_m.astype(float),
        range_sigma_m=nothing,
        power=nothing,
        echo_snr_db=nothing,
    )


def test_each_echo_has_the_stronger_of_what_lies_at_its_range():
    paths = paths_of([
        (7, 10.0, 3.0, VOLUME), (7, 10.2, 1.0, 0), (7, 60.0, 2.0, VOLUME), (7, 60.1, 5.0, 0),
        (8, 10.0, 3.0, VOLUME), (8, 150.0, 9.0, TARGET),
        (9, 10.0, 1.0, 0),
    ])  # fmt: skip
    echoes = echoes_of([(7, 10.1), (7, 60.0), (7, 100.0), (8, 10.3), (8, 150.0), (9, 10.0)])
    assert mostly_of(VOLUME, echoes, paths, make_chirp()).tolist() == [True, False, False, True, False, False]


def test_in_clear_air_nothing_is_rain():
    paths = paths_of([(0, 10.0, 1.0, 0), (1, 10.0, 1.0, TARGET)])
    assert not mostly_of(VOLUME, echoes_of([(0, 10.0), (1, 10.0)]), paths, make_chirp()).any()
