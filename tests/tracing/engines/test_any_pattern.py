"""Engines with antennas of any pattern, against the radar equation's integral over a plane and against each other."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp, plane_power
from flights import make_pulses
from sionna_radar.flight.frames import steering
from sionna_radar.radar.antenna import antenna_of
from sionna_radar.radar.array_pattern import ArrayPattern, ElementPattern, array_factor, steered
from sionna_radar.radar.pattern import SphericalPattern, directions_of
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.gamma.facet_index import Footprint
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.sionna.pattern import SionnaPattern, mi
from worlds import make_scene, make_surface

# isort: split
# Loads libLLVM, which the import above has selected.
import drjit as dr


def with_two_beams():
    """Return a beam of 4 deg with another 6 dB below it, 20 deg up and 10 deg left: separable in no plane."""
    own = make_antenna(4.0, 4.0)
    turn = steering(np.deg2rad(10.0), np.deg2rad(20.0))
    pattern = SphericalPattern.of(
        lambda d: np.sqrt(own.gain(d) + 0.25 * own.gain(d @ turn)) + 1e-3 * (d[:, 0] < 0), np.deg2rad(0.25)
    )
    return antenna_of(pattern)


def sparse_array():
    """Return an array of 16 by 16 elements 0.9 wavelengths apart, its beam 25 deg to the left of its normal."""
    left, up = np.meshgrid(np.arange(16) * 0.9, np.arange(16) * 0.5, indexing="ij")
    place = np.column_stack([left.ravel(), up.ravel()])
    factor = array_factor(place, np.ones(256, dtype=complex))
    return steered(antenna_of(ArrayPattern(factor, ElementPattern(1.0), (14.4, 8.0))), np.deg2rad(25.0))


def sent_and_heard():
    patterns = [
        SphericalPattern.of(lambda d, a=a: np.sqrt(a.gain(d)), np.deg2rad(0.25))
        for a in (make_antenna(8.0, 8.0), make_antenna(12.0, 5.0))
    ]
    return antenna_of(*patterns)


ANTENNAS = {"two beams": with_two_beams, "sparse array": sparse_array, "sent and heard": sent_and_heard}


@pytest.fixture(scope="module", params=ANTENNAS)
def antenna(request):
    return ANTENNAS[request.param]()


def mean_power(paths, pulses) -> float:
    return float(np.sum(np.abs(paths.gain.astype(complex)) ** 2)) / len(pulses)


@pytest.mark.parametrize("incidence_deg", [40.0])
def test_the_mean_echo_of_a_plane_is_the_radar_equation(antenna, plane, incidence_deg):
    pulses = make_pulses(400, incidence_deg=incidence_deg)
    engine = BeamEngine(plane, antenna, make_chirp(), 1, 512, 0.05)
    expected = plane_power(antenna, 50.0, incidence_deg)
    assert 10 * np.log10(mean_power(engine.trace(pulses), pulses) / expected) == pytest.approx(0.0, abs=0.03)


def test_the_engines_agree(antenna, plane):
    pulses = make_pulses(8, incidence_deg=30.0)
    expected = plane_power(antenna, 50.0, 30.0)
    # Side lobes below the level would fill the whole plane with facets.
    gamma = GammaEngine(plane, antenna, make_chirp(), 1, RayCaster(plane.surfaces), footprint_db=-24.0)
    assert 10 * np.log10(mean_power(gamma.trace(pulses), pulses) / expected) == pytest.approx(0.0, abs=0.15)


def test_scatterers_fill_the_same_beam():
    antenna = sent_and_heard()
    pulses = make_pulses(20, incidence_deg=30.0)
    ground = make_scene(make_surface(lambda x, y: 0 * x, size_m=300.0, spacing_m=10.0))
    persistent = PersistentEngine(ground, antenna, make_chirp(), 1, 20.0)
    expected = plane_power(antenna, 50.0, 30.0)
    assert 10 * np.log10(mean_power(persistent.trace(pulses), pulses) / expected) == pytest.approx(0.0, abs=0.2)


def test_sionna_sees_the_same_gain(antenna):
    away = np.random.default_rng(3).normal(size=(4000, 3)) * [1, 0.4, 0.4] + [1, 0, 0]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    angles = [mi.Float(a.astype(np.float32)) for a in (np.arccos(away[:, 2]), np.arctan2(away[:, 1], away[:, 0]))]
    (sent,) = SionnaPattern(antenna).patterns
    (heard,) = SionnaPattern(antenna, antenna.jones[1]).patterns
    for pattern, gain in ((sent, antenna.transmit_gain(away)), (heard, antenna.receive_gain(away))):
        found = dr.squared_norm(pattern(*angles)[0]).numpy()
        np.testing.assert_allclose(found, gain, rtol=5e-3, atol=2e-5 * antenna.peak_gain)


def test_a_footprint_holds_every_direction_that_counts(antenna):
    footprint = Footprint.of(antenna, -40.0)
    away = directions_of(*np.random.default_rng(1).uniform(-np.pi / 2, np.pi / 2, size=(2, 3000)))
    counts = antenna.gain(away) >= 1e-2 * antenna.peak_gain
    assert footprint.meets(50.0 * away[counts], 0.1).all()
