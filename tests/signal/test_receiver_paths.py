"""Paths and noise as receivers beside the first have them."""

import numpy as np

from beams import make_chirp
from flights import make_pulses
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.radar.mimo_array import DifferencePattern, MimoArray
from sionna_radar.signal.mixer import receiver_paths
from sionna_radar.signal.receiver import Receiver
from sionna_radar.tracing.paths import Paths

PULSES = make_pulses(3, incidence_deg=45.0)


def target(left: float, up: float, range_m: float = 70.0) -> Paths:
    """One point in each pulse, at direction cosines from the true boresight."""
    direction = np.array([np.sqrt(1 - left**2 - up**2), left, up])
    away = range_m * PULSES.true.R_world_antenna @ direction
    return Paths.to_points(
        PULSES,
        np.arange(3),
        PULSES.true.position_m + away,
        gain=np.full(3, 1e-5 + 0j),
        incidence_rad=np.full(3, 0.5),
        surface=np.zeros(3, dtype=int),
    )


def receiver(chirp, noise_w: float = 0.0) -> Receiver:
    return Receiver(sweeps=(chirp,), transmit_power_w=1.0, noise_power_w=noise_w, seed=3)


def array(place_m, chirp, **keys) -> MimoArray:
    return MimoArray(
        transmitter_m=np.zeros((1, 3)),
        receiver_m=np.array([[0.0, 0.0, 0.0], place_m]),
        code=np.ones((1, 1), dtype=complex),
        blocks=1,
        period_s=1e-3,
        wavelength_m=chirp.wavelength_m,
        direction=chirp.direction,
        **keys,
    )


def test_the_phase_between_receivers_is_that_of_the_direction():
    for sweep in ("up", "down"):
        chirp = make_chirp(sweep=sweep)
        for axis, left, up in ((1, 0.03, -0.02), (2, 0.03, -0.02)):
            side = array(2.0 * chirp.wavelength_m * np.eye(3)[axis], chirp)
            paths = target(left, up)
            first, other = (receiver(chirp).beat(receiver_paths(paths, PULSES, side, n), PULSES) for n in (0, 1))
            one, two = (SpectrumAnalyser(chirp, "hann", 2).amplitude(beat) for beat in (first, other))
            strongest = np.argmax(np.abs(one), axis=1)
            turned = np.angle((two * one.conj())[np.arange(3), strongest])
            # Nearer to what lies in its direction, so that its wave arrives earlier: |b| / r = 1e-4 bends it a little.
            expected = -chirp.direction * 2 * np.pi * 2.0 * (left, up)[axis - 1]
            np.testing.assert_allclose(turned, expected, atol=2e-3)


def test_errors_turn_the_second_receiver_alone():
    for sweep in ("up", "down"):
        chirp, paths = make_chirp(sweep=sweep), target(0.0, 0.0)
        side = array([0.0, 0.0, 0.0], chirp, mixing=np.diag([1.0, np.exp(0.3j)]))
        beats = [receiver(chirp).beat(receiver_paths(paths, PULSES, side, n), PULSES) for n in (0, 1)]
        one, two = (SpectrumAnalyser(chirp, "hann", 2).amplitude(beat) for beat in beats)
        strongest = np.argmax(np.abs(one), axis=1)
        np.testing.assert_allclose(np.angle((two * one.conj())[np.arange(3), strongest]), 0.3, atol=1e-3)


def test_each_receiver_has_noise_of_its_own_and_the_first_that_of_before():
    noisy, silence = receiver(make_chirp(), 1e-12), target(0.0, 0.0).rows(slice(0))
    first, second, third = (noisy.beat(silence, PULSES, channel) for channel in range(3))
    np.testing.assert_array_equal(first, noisy.beat(silence, PULSES))
    for one, other in ((first, second), (first, third), (second, third)):
        together = np.sum(one * other) / np.sqrt(np.sum(one**2) * np.sum(other**2))
        assert abs(together) < 4 / np.sqrt(one.size)
    alone = noisy.beat(silence, PULSES.rows(slice(1, 2)), 1)
    np.testing.assert_array_equal(alone, second[1:2])


def test_a_difference_weighs_paths_by_direction():
    cosine = np.linspace(-1, 1, 401)
    ratio = DifferencePattern(axis=2, cosine=cosine, ratio=10 * cosine, lobe=slice(190, 211))
    paths = target(0.03, -0.02)
    weighed = receiver_paths(paths, PULSES, array([0.0, 0.0, 0.0], make_chirp(), difference=(ratio,)), 1)
    np.testing.assert_allclose(weighed.gain, -0.2 * paths.gain, rtol=1e-9)
    np.testing.assert_array_equal(weighed.delay_s, paths.delay_s)
