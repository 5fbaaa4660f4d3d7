"""From spectra to echoes: grouping, choice and ranging, on spectra made by hand and on point targets."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_chirp
from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.detection.build import build_detector, build_range_estimator
from sionna_radar.detection.detector import Detector, Spectra, detected_spans
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.ranging.estimators import EchoSpans
from sionna_radar.scenario.parts import RANGE_ESTIMATORS
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.signal.beat import synthesise
from sionna_radar.signal.receiver import add_noise

C = 299_792_458.0
CELL_M = C / 1e9  # c / 2B at 500 MHz


def detector_of(chirp, **processing) -> Detector:
    defaults = {"doppler_correction": False, "zero_padding": 1, "merge_gap_m": 1.0}
    return build_detector(ProcessingTable(**(defaults | processing)), chirp)


def spectra_of(chirp, *pulses: dict[int, float]) -> Spectra:
    """Spectra of noise 1 under a threshold of 10, with the given powers in some bins."""
    power = np.ones((len(pulses), chirp.samples // 2))
    for row, cells in zip(power, pulses, strict=True):
        row[list(cells)] = list(cells.values())
    return Spectra(power=power, noise=np.ones_like(power), threshold=np.full_like(power, 10.0))


def found(detector, spectra) -> Echoes:
    pulses = make_pulses(len(spectra.power), first=20)
    return detector.echoes(spectra, pulses.index, pulses.measured)


def cells_of(echoes: Echoes) -> list[tuple[int, int, float]]:
    return [
        (int(p), int(n), float(r)) for p, n, r in zip(echoes.pulse, echoes.number, echoes.range_m / CELL_M, strict=True)
    ]


def test_neighbouring_cells_are_one_echo():
    detector = detector_of(make_chirp(), echoes="all", merge_gap_m=0.0)
    echoes = found(detector, spectra_of(make_chirp(), {50: 20, 51: 40, 52: 20, 60: 30}, {}, {70: 15}))
    assert cells_of(echoes) == [(20, 0, pytest.approx(51)), (20, 1, pytest.approx(60)), (22, 0, pytest.approx(70))]
    np.testing.assert_allclose(echoes.power, [40, 30, 15])
    np.testing.assert_allclose(echoes.echo_snr_db, 10 * np.log10([40, 30, 15]))


@pytest.mark.parametrize("elsewhere", [{}, {1: 1e7}, {511: 1e7}], ids=["nothing", "too near", "highest frequency"])
def test_power_where_nothing_is_searched_leaves_the_weak_cells_of_an_echo(elsewhere):
    chirp = make_chirp()
    spectra = spectra_of(chirp, {50: 200, 51: 60, 52: 40, 53: 40, 54: 150} | elsewhere)
    found_in = detector_of(chirp, merge_gap_m=0.0).spans(replace(spectra, threshold=10 * spectra.threshold))
    assert (found_in.start.tolist(), found_in.stop.tolist()) == ([50], [55])


@pytest.mark.parametrize("gap", [0, 2])
def test_spans_are_those_of_a_plain_search(gap):
    rng = np.random.default_rng(gap)
    power, threshold = rng.exponential(size=(2, 40, 60))
    power[:, 30:40] *= 9
    limit, low, high = rng.uniform(0.5, 4.0, 40), rng.integers(0, 20, 40), rng.integers(15, 61, 40)
    spans = []
    for row in range(40):
        tested = (np.arange(60) >= low[row]) & (np.arange(60) < high[row])
        detected = (power[row] > threshold[row]) & tested
        cells = np.flatnonzero(detected | (tested & (power[row] > limit[row])))
        for part in np.split(cells, np.flatnonzero(np.diff(cells) > gap + 1) + 1):
            if detected[part].any():
                within = power[row, part[0] : part[-1] + 1]
                spans.append((row, part[0], part[-1] + 1, part[0] + np.argmax(within)))
    assert len(spans) > 50
    np.testing.assert_array_equal(detected_spans(power, threshold, limit, low, high, gap), spans)


@pytest.mark.parametrize(("gap_cells", "count"), [(0, 3), (1, 2), (2, 2), (3, 1)])
def test_gaps_up_to_the_merge_gap_are_bridged(gap_cells, count):
    # One cell lies between 50 and 52, three between 52 and 56.
    detector = detector_of(make_chirp(), echoes="all", merge_gap_m=(gap_cells + 0.01) * CELL_M)
    assert len(found(detector, spectra_of(make_chirp(), {50: 20, 52: 20, 56: 20}))) == count


def test_a_merged_echo_is_placed_by_all_its_power():
    detector = detector_of(make_chirp(), merge_gap_m=1.0)
    echoes = found(detector, spectra_of(make_chirp(), {50: 31, 52: 11}))
    assert echoes.range_m[0] / CELL_M == pytest.approx((30 * 50 + 10 * 52) / 40)  # power above the noise


@pytest.mark.parametrize(("choice", "cells"), [("all", [40, 60, 80]), ("first", [40]), ("strongest", [60])])
def test_which_echoes_are_kept(choice, cells):
    detector = detector_of(make_chirp(), echoes=choice)
    spectra = spectra_of(make_chirp(), {40: 20, 60: 90, 80: 50}, {40: 20, 60: 90, 80: 50})
    echoes = found(detector, spectra)
    assert cells_of(echoes) == [(p, n, pytest.approx(c)) for p in (20, 21) for n, c in enumerate(cells)]


@pytest.mark.parametrize(("choice", "cells"), [("all", [60, 80]), ("first", [60]), ("strongest", [80])])
def test_echoes_far_below_the_strongest_are_dropped(choice, cells):
    detector = detector_of(make_chirp(), echoes=choice, dynamic_range_db=20.0)
    spectra = spectra_of(make_chirp(), {40: 9.9e3, 60: 1.1e4, 80: 1e6})
    assert [c for _, _, c in cells_of(found(detector, spectra))] == pytest.approx(cells, abs=1e-3)


def test_of_equal_echoes_the_nearest_is_the_strongest():
    detector = detector_of(make_chirp(), echoes="strongest")
    assert cells_of(found(detector, spectra_of(make_chirp(), {40: 50, 60: 50}))) == [(20, 0, pytest.approx(40))]


def test_nothing_nearer_than_the_least_range_counts():
    detector = detector_of(make_chirp(), min_range_m=20.5 * CELL_M, echoes="all")
    spectra = spectra_of(make_chirp(), {3: 99, 20: 99, 21: 99, 30: 99})
    assert [c for _, _, c in cells_of(found(detector, spectra))] == pytest.approx([21, 30])


def test_silence_has_no_echoes():
    for ranging in RANGE_ESTIMATORS.origins():
        assert len(found(detector_of(make_chirp(), ranging=ranging), spectra_of(make_chirp(), {}, {}))) == 0


def test_a_run_at_the_end_of_the_spectrum_is_kept():
    for ranging in RANGE_ESTIMATORS.origins():
        detector = detector_of(make_chirp(), ranging=ranging)
        echoes = found(detector, spectra_of(make_chirp(), {510: 50}))
        assert echoes.range_m[0] / CELL_M == pytest.approx(510, abs=0.51)


@pytest.mark.parametrize(("centre", "kept"), [(470, True), (485, True), (500, False), (511, False)])
def test_an_echo_that_the_last_range_cuts_off_is_dropped_and_no_weaker_one_takes_its_place(centre, kept):
    """Its skirts may reach the end: two standard deviations of a hump behind its centre do not."""
    hump = {cell: 1e4 * np.exp(-(((cell - centre) / 8) ** 2) / 2) for cell in range(440, 512)} | {60: 200}
    for ranging in RANGE_ESTIMATORS.origins():
        echoes = found(detector_of(make_chirp(), ranging=ranging, echoes="strongest"), spectra_of(make_chirp(), hump))
        # Of the hump half of the amplitude is reached 10.5 cells before its centre.
        expected = [pytest.approx(centre, abs=11)] if kept else []
        assert list(echoes.range_m / CELL_M) == expected


@pytest.mark.parametrize(("sampling", "range_m", "kept"), [
    ("real", 2.6, False), ("real", 2.85, False), ("real", 3.6, True), ("iq", 2.7, False), ("iq", 0.1, False),
    ("iq", 4.5, True),
])  # fmt: skip
def test_the_skirt_of_what_lies_beside_the_searched_ranges_is_no_echo(sampling, range_m, kept):
    """Before the least range; and at zero beat, beside which the last I/Q cells lie. A weaker echo far away stays."""
    chirp = make_chirp(sampling=sampling)
    detector = detector_of(chirp, echoes="all", zero_padding=2, dynamic_range_db=60)
    beat, pulses = beats(chirp, np.array([[range_m, 40.0]]), [1.0, 0.01], noise=1e-9)
    seen = detector.echoes(detector.spectra(beat), pulses.index, pulses.measured).range_m
    wanted = [range_m, 40.0] if kept else [40.0]
    assert list(seen) == pytest.approx(wanted, abs=0.2)


def test_estimators_on_a_known_shape():
    # A Gaussian hump about bin 20.3 is a parabola in the logarithm, and symmetric about its centroid.
    bins = np.arange(64)
    power = 1.0 + 500 * np.exp(-((bins - 20.3) ** 2) / 8)[None]
    runs = EchoSpans(
        power=power, noise=np.ones_like(power), bin_m=0.3,
        row=np.array([0]), start=np.array([8]), stop=np.array([34]), peak=np.array([20]),
    )  # fmt: skip
    for name in ("peak", "centroid", "model_fit"):  # the leading edge counts on speckle; without a beam a fit is a mean
        assert build_range_estimator(ProcessingTable(ranging=name))(runs).range_m[0] == pytest.approx(
            0.3 * 20.3, abs=2e-3
        )


def beats(chirp, ranges_m, powers, noise=1e-4):
    """Beats of one pulse for each row of ranges, each with a phase of its own."""
    ranges_m = np.atleast_2d(ranges_m)
    pulses, each = make_pulses(len(ranges_m), velocity_mps=(0, 0, 0)), ranges_m.shape[1]
    phase = np.random.default_rng(4).uniform(0, 2 * np.pi, ranges_m.size)
    gain = np.sqrt(np.tile(powers, len(ranges_m))) * np.exp(1j * phase)
    paths = points_at(ranges_m.ravel(), gain, pulse=np.repeat(pulses.index, each))
    return add_noise(synthesise(paths, pulses, chirp), noise, 1, pulses.index), pulses


@pytest.mark.parametrize("ranging", ["peak", "centroid"])
@pytest.mark.parametrize("zero_padding", [1, 2, 4])
@pytest.mark.parametrize("sampling", ["real", "iq"])
def test_a_point_target_is_ranged_within_a_centimetre(sampling, zero_padding, ranging):
    chirp = make_chirp(sampling=sampling)
    truth = np.linspace(60, 61, 50)
    beat, pulses = beats(chirp, truth[:, None], [1.0])
    detector = detector_of(chirp, ranging=ranging, zero_padding=zero_padding)
    error = detector.detect(beat, pulses.index, pulses.measured).range_m - truth
    # The parabola through a Hann lobe sampled once a cell is off by up to 1.6 % of the cell: 5 mm.
    assert np.abs(error).max() < 0.01
    assert abs(error.mean()) < 0.001


def test_an_echoes_power_is_the_targets():
    chirp = make_chirp()
    beat, pulses = beats(chirp, [[200 * CELL_M]], [2.5], noise=1e-6)
    echoes = detector_of(chirp, zero_padding=2).detect(beat, pulses.index, pulses.measured)
    assert 10 * np.log10(echoes.power[0] / 2.5) == pytest.approx(0.0, abs=0.02)


def test_snr_is_counted_against_the_noise():
    chirp = make_chirp()
    beat, pulses = beats(chirp, np.full((200, 1), 200 * CELL_M), [1.0], noise=0.1)
    cfar = {"kind": "CA", "guard": 3, "training": 32}
    echoes = detector_of(chirp, cfar=cfar).detect(beat, pulses.index, pulses.measured)
    # Noise 0.1 over 512 cells, times Hann's 1.5: 35.3 dB below the target.
    assert np.mean(echoes.echo_snr_db) == pytest.approx(10 * np.log10(512 / 1.5 / 0.1), abs=0.3)


@pytest.mark.parametrize("gap_m", [2.5, 7.6])
def test_two_targets_are_told_apart(gap_m):
    """The paper's roof edge: 36.4 m and 44.0 m in one chirp."""
    chirp = make_chirp()
    truth = np.array([36.4, 36.4 + gap_m])
    beat, pulses = beats(chirp, [truth] * 20, [1.0, 0.5], noise=0.1)  # 35 and 32 dB
    echoes = detector_of(chirp, echoes="all", zero_padding=2).detect(beat, pulses.index, pulses.measured)
    np.testing.assert_array_equal(echoes.number, [0, 1] * 20)
    np.testing.assert_allclose(echoes.range_m.reshape(20, 2), np.tile(truth, (20, 1)), atol=0.02)


def test_detection_knows_no_other_pulse():
    chirp = make_chirp()
    beat, pulses = beats(chirp, np.linspace(40, 90, 30)[:, None], [1.0])
    detector = detector_of(chirp, echoes="all")
    whole = detector.detect(beat, pulses.index, pulses.measured)
    parts = [detector.detect(beat[k : k + 1], pulses.index[k : k + 1], make_pulses(1).measured) for k in range(30)]
    np.testing.assert_array_equal(Echoes.concatenate(parts).range_m, whole.range_m)
