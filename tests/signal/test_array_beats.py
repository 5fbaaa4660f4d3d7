"""Beat signals of arrays against plain sums of exponentials."""

from dataclasses import replace

import numpy as np
import pytest

from direct_receiver import points_at
from modules import CHIRP, frame_of, line_of, middle, plain_frame, poses
from sionna_radar.radar.mimo_array import receiver_mixing
from sionna_radar.signal.array_beats import FramePaths, array_beats


def scatterers(count=40):
    rng = np.random.default_rng(3)
    place = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-9, 9, count), rng.uniform(-1, 1, count)])
    return place, rng.normal(size=count) + 1j * rng.normal(size=count)


def relative(found, expected):
    return np.sqrt(np.mean(np.abs(found - expected) ** 2) / np.mean(np.abs(expected) ** 2))


@pytest.mark.parametrize("code", ["tdm", "ddm", "bpm"])
@pytest.mark.parametrize("sweep", ["up", "down"])
def test_all_channels_are_those_of_exact_ways(code, sweep):
    chirp = replace(CHIRP, sweep=sweep)
    array = line_of(3, 4, blocks=2, code=code, chirp=chirp)
    place, gain = scatterers()
    if sweep == "down":  # beats of a falling sweep are negative: real samples hold both signs
        chirp = replace(chirp, sampling="real", samples=128)
    found = frame_of(array, place, gain, chirp)
    assert relative(found, plain_frame(array, place, gain, chirp)) < 5e-4


def test_a_wide_array_bends_the_wavefronts():
    array = line_of(4, 16, blocks=1)
    place, gain = scatterers()
    found = frame_of(array, place, gain)
    assert 2 * np.ptp(array.receiver_m[:, 1]) ** 2 / array.wavelength_m > 0.1  # beyond it waves are plane
    assert relative(found, plain_frame(array, place, gain)) < 5e-4


def test_longer_ways_and_drift_go_with_the_paths():
    """A path by way of a mirror is longer than twice the range; drops fall during a frame."""
    array, place = line_of(2, 2, blocks=2), np.array([[1.0, 2.0, 0.5]])
    pose = middle()
    away = place[0] - pose.position_m[0]
    range_m = np.linalg.norm(away)
    rate = -float(away @ pose.velocity_mps[0]) / range_m
    paths = points_at(range_m + 1.5, 1.0, rate + 4.0, hit_m=place)
    frame = FramePaths.of(paths, pose)
    assert frame.beyond_m == pytest.approx([1.5])
    assert frame.drift_mps == pytest.approx([4.0])
    found = array_beats(frame, poses(array), array, CHIRP)
    still = frame_of(array, place, np.ones(1))
    # Between two blocks the drift turns the phase by twice its way.
    turn = np.angle(np.vdot(found[0] * np.conj(still[0]), found[2] * np.conj(still[2])))
    way = 2 * 4.0 * array.block_s / CHIRP.wavelength_m
    assert np.exp(1j * turn) == pytest.approx(np.exp(2j * np.pi * way), abs=2e-2)


def test_errors_of_channels_are_those_of_their_elements():
    error = np.array([1.0, 0.5j, 1.0, 1.0])
    ideal = line_of(2, 4, blocks=1)
    mixing = receiver_mixing(ideal.receiver_m, error, 0.1, ideal.wavelength_m)
    spoiled = replace(ideal, true_code=ideal.code * np.array([1.0, 2.0j]), mixing=mixing)
    place, gain = scatterers(5)
    clean, found = frame_of(ideal, place, gain), frame_of(spoiled, place, gain)
    # Half a wavelength away the amplitude is 0.1, and the phase that of half a turn.
    first = clean[0, 1] - 0.1 * (clean[0, 0] + clean[0, 2]) + 0.05 * clean[0, 3]
    assert found[0, 1] == pytest.approx(0.5j * first)
    assert (
        relative(found[1, 0] / 2j, clean[1, 0] - 0.1 * clean[1, 1] + 0.05 * clean[1, 2] - 0.1 / 3 * clean[1, 3]) < 1e-9
    )


def test_more_receivers_change_nothing_of_the_others():
    place, gain = scatterers()
    few = line_of(1, 1, blocks=2)
    many = replace(
        few, receiver_m=np.pad(few.receiver_m, ((0, 2), (0, 0))) + np.array([[0, 0, 0], [0, 0.01, 0], [0, 0, 0.02]])
    )
    assert relative(frame_of(many, place, gain)[:, :1], frame_of(few, place, gain)) < 1e-4
