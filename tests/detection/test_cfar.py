"""CFAR factors against the closed forms of Gandhi and Kassam 1988, and false alarms counted on noise."""

from math import comb

import numpy as np
import pytest

from beams import make_chirp
from sionna_radar.detection.build import build_detector
from sionna_radar.detection.cfar import Cfar
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.processing import CfarTable, ProcessingTable

KINDS = ("CA", "GO", "SO", "OS")
INDEPENDENT = np.array([1.0])


def make_cfar(kind, training=16, pfa=1e-3, guard=2, **values) -> Cfar:
    values = {"correlation": INDEPENDENT} | values
    return Cfar(kind=kind, guard=guard, training=training, false_alarm_probability=pfa, **values)


def cell_averaging(factor, cells):
    """Mean of so many cells."""
    return (1 + factor / cells) ** -cells


def smallest_of(factor, side):
    """Smaller mean of two sides of so many cells each."""
    t = factor / side
    return 2 * sum(comb(side + i - 1, i) * (2 + t) ** -(side + i) for i in range(side))


def greatest_of(factor, side):
    """Greater mean of two sides of so many cells each."""
    return 2 * (1 + factor / side) ** -side - smallest_of(factor, side)


def ordered(factor, cells, k):
    """The k-th smallest of so many cells."""
    i = np.arange(k)
    return float(np.prod((cells - i) / (cells - i + factor)))


@pytest.mark.parametrize("pfa", [1e-2, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("training", [4, 16, 32])
def test_factors_of_the_means_for_independent_cells(training, pfa):
    n = training
    ca, go, so = (make_cfar(kind, n, pfa) for kind in ("CA", "GO", "SO"))
    assert cell_averaging(ca.both_sides_factor, 2 * n) == pytest.approx(pfa, rel=1e-6)
    assert greatest_of(go.both_sides_factor, n) == pytest.approx(pfa, rel=1e-6)
    assert smallest_of(so.both_sides_factor, n) == pytest.approx(pfa, rel=1e-6)
    for cfar in (ca, go, so):  # with a single side there is nothing to choose from
        assert cell_averaging(cfar.one_side_factor, n) == pytest.approx(pfa, rel=1e-6)


@pytest.mark.parametrize("pfa", [1e-2, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("training", [4, 8, 16, 32])
def test_factors_of_os_for_independent_cells(training, pfa):
    cfar = make_cfar("OS", training, pfa)
    both, one = int(np.ceil(0.75 * 2 * training)), int(np.ceil(0.75 * training))
    assert ordered(cfar.both_sides_factor, 2 * training, both) == pytest.approx(pfa, rel=1e-6)
    assert ordered(cfar.one_side_factor, training, one) == pytest.approx(pfa, rel=1e-6)


@pytest.mark.parametrize("rank", [0.5, 0.9, 1.0])
def test_the_rank_of_os(rank):
    cfar = make_cfar("OS", 16, 1e-4, rank=rank)
    assert ordered(cfar.both_sides_factor, 32, int(np.ceil(rank * 32))) == pytest.approx(1e-4, rel=1e-6)


def plain_noise_level(kind, power, guard, training, stride, rank=0.75):
    """The definition, cell by cell."""
    bins = len(power)
    level = np.full(bins, np.inf)
    steps = [stride * (guard + 1 + i) for i in range(training)]
    for cell in range(bins):
        lag = [power[cell - s] for s in steps] if cell - steps[-1] >= 0 else None
        lead = [power[cell + s] for s in steps] if cell + steps[-1] < bins else None
        sides = [side for side in (lag, lead) if side is not None]
        if not sides:
            continue
        if kind == "OS":
            cells = sorted(np.concatenate(sides))
            level[cell] = cells[int(np.ceil(rank * len(cells))) - 1]
        else:
            combine = {"CA": np.mean, "GO": np.max, "SO": np.min}[kind]
            level[cell] = combine([np.mean(side) for side in sides])
    return level


@pytest.mark.parametrize("bins", [60, 61, 37, 20])
@pytest.mark.parametrize("stride", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_noise_levels_follow_the_definition(kind, stride, bins):
    power = np.random.default_rng(4).exponential(size=(70, bins)) * np.linspace(1, 5, bins)
    cfar = make_cfar(kind, training=5, guard=2, stride=stride)
    level, both = cfar.noise_level(power)
    reach = 7 * stride
    np.testing.assert_array_equal(both, [c >= reach and c + reach < bins for c in range(bins)])
    for row in (0, 33, 69):
        np.testing.assert_allclose(level[row], plain_noise_level(kind, power[row], 2, 5, stride), rtol=1e-9)
    factor = np.where(both, cfar.both_sides_factor, cfar.one_side_factor)
    np.testing.assert_allclose(cfar.threshold(power), level * factor)


def false_alarms(sampling: str, zero_padding: int, guard: int, training: int, chirps: int):
    """Count false alarms in pure noise at a wanted 1e-3: for each kind, (alarms, cells) of middle and edges."""
    samples = 512 if sampling == "real" else 256  # 256 range cells either way
    chirp = make_chirp(samples=samples, sampling=sampling)
    detectors = {}
    for kind in KINDS:
        table = CfarTable(kind=kind, guard=guard, training=training, false_alarm_probability=1e-3)
        detectors[kind] = build_detector(ProcessingTable(cfar=table, zero_padding=zero_padding), chirp)
    over = dict.fromkeys(KINDS, 0)
    random = np.random.default_rng(11)
    for _ in range(chirps // 1000):
        noise = random.standard_normal((1000, samples))
        if sampling == "iq":
            noise = noise + 1j * random.standard_normal(noise.shape)
        # The spectra are those of all kinds; what a detector makes of them is its CFAR's threshold.
        power = detectors["CA"].analyser.power(noise)
        for kind, detector in detectors.items():
            over[kind] = over[kind] + np.sum(power > detector.cfar.threshold(power), axis=0)
    analyser = detectors["CA"].analyser
    cell = np.arange(256 * zero_padding)
    reach = (guard + training) * zero_padding
    middle = (cell >= reach) & (cell + reach < len(cell))
    edges = ~middle & (analyser.range_m >= ProcessingTable().min_range_m)
    return {kind: [(n[part].sum(), chirps * part.sum()) for part in (middle, edges)] for kind, n in over.items()}


# A Hann window leaves half as many independent cells as there are: with 2.6 million the error of the count is 2.7 %.
@pytest.mark.parametrize(
    ("sampling", "zero_padding", "guard", "training", "chirps", "parts"),
    [
        ("real", 1, 3, 16, 10_000, 1),
        ("iq", 2, 3, 16, 10_000, 1),
        ("real", 2, 40, 24, 10_000, 2),
        ("iq", 1, 40, 24, 20_000, 2),
    ],
)
def test_false_alarms_in_noise_and_at_the_ends_of_the_spectrum(sampling, zero_padding, guard, training, chirps, parts):
    for kind, counts in false_alarms(sampling, zero_padding, guard, training, chirps).items():
        for alarms, cells in counts[:parts]:
            assert cells >= 2_000_000
            assert alarms / cells == pytest.approx(1e-3, rel=0.1), kind


def test_guard_cells_that_the_window_reaches_over_are_refused():
    with pytest.raises(ScenarioError, match=r"processing.cfar.guard.*needs at least 2"):
        build_detector(ProcessingTable(cfar=CfarTable(guard=1)), make_chirp())
    build_detector(ProcessingTable(cfar=CfarTable(guard=2)), make_chirp())


@pytest.mark.parametrize("kind", KINDS)
def test_probability_of_detection_of_speckle(kind):
    """Gandhi and Kassam 1988, eqs. 8, 17, 20 and 35: the factor over 1 + SNR in place of the factor."""
    cfar = make_cfar(kind, 8, 1e-3)
    k = int(np.ceil(cfar.rank * 16))
    closed = {
        "CA": lambda t: cell_averaging(t, 16),
        "GO": lambda t: greatest_of(t, 8),
        "SO": lambda t: smallest_of(t, 8),
        "OS": lambda t: ordered(t, 16, k),
    }[kind]
    for snr in (0.0, 0.5, 10.0, 1000.0):
        found = cfar.detection_probability(np.array([snr]))[0]
        # The order statistic's is a mean over drawn noise.
        accuracy = {"rel": 0.05, "abs": 2e-3} if kind == "OS" else {"rel": 1e-6}
        assert found == pytest.approx(closed(cfar.both_sides_factor / (1 + snr)), **accuracy)
