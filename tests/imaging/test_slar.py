"""The real-aperture image of a side-looking radar."""

import dataclasses

import numpy as np
import pytest

from side_looking import make_flight
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.imaging.slar import SideLooking, slant_range_image, to_ground
from sionna_radar.imaging.strip import ground_range_resolution_m, half_power_width, real_aperture_resolution_m
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.beat import synthesise
from sionna_radar.tracing.effects.targets import trace_targets


@pytest.fixture(scope="module")
def caster(plane):
    return RayCaster(plane.surfaces)


def compressed(flight, caster, pulses, *ground_m: float, zero_padding: int = 16):
    targets = [Target(position_m=(g, 0.0, 0.0), rcs_m2=1.0) for g in ground_m]
    beats = synthesise(trace_targets(targets, pulses, flight.antenna, flight.chirp, caster), pulses, flight.chirp)
    return beats, SpectrumAnalyser(flight.chirp, "hann", zero_padding)


@pytest.mark.parametrize("incidence_deg", [38.0, 45.0, 52.0])
def test_ground_range_resolution_is_the_theorys(caster, incidence_deg):
    flight = make_flight()
    pulses = flight.pulses(0.1)
    place = 28.0 * np.tan(np.deg2rad(incidence_deg))
    beats, analyser = compressed(flight, caster, pulses, place)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    ground = to_ground(image, 0.0, np.arange(15.0, 45.0, 0.01))
    width = half_power_width(ground.ground_m, np.nan_to_num(ground.power[0]))
    assert width == pytest.approx(ground_range_resolution_m(flight.chirp, "hann", np.deg2rad(incidence_deg)), rel=0.05)
    assert ground.ground_m[np.nanargmax(ground.power[0])] == pytest.approx(place, abs=0.02)


def test_along_the_track_it_resolves_the_two_way_beam(caster):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=4)
    beats, analyser = compressed(flight, caster, pulses, 28.0, zero_padding=4)
    image = slant_range_image(beats, pulses.measured, analyser, 0.05)
    width = half_power_width(image.along_m, image.power.max(axis=1))
    cut = flight.antenna.azimuth
    assert width == pytest.approx(real_aperture_resolution_m(cut, 28.0 * np.sqrt(2)), rel=0.03)
    assert image.along_m[np.argmax(image.power.max(axis=1))] == pytest.approx(4.0, abs=0.05)


def test_two_points_a_resolution_and_a_half_apart_are_two(caster):
    flight = make_flight()
    pulses = flight.pulses(0.1)
    apart = 1.5 * ground_range_resolution_m(flight.chirp, "hann", np.pi / 4)
    beats, analyser = compressed(flight, caster, pulses, 28.0, 28.0 + apart)
    ground = to_ground(slant_range_image(beats, pulses.measured, analyser, 1.0), 0.0, np.arange(26.0, 31.0, 0.02))
    power = ground.power[0]
    maxima = (power[1:-1] > power[:-2]) & (power[1:-1] > power[2:]) & (power[1:-1] > power.max() / 4)
    assert maxima.sum() == 2


def test_power_is_the_points_at_the_middle_of_the_beam(caster):
    flight = make_flight()
    pulses = flight.pulses(0.02)
    beats, analyser = compressed(flight, caster, pulses, 28.0)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    range_m = 28.0 * np.sqrt(2)
    expected = flight.antenna.peak_gain**2 * flight.chirp.wavelength_m**2 / ((4 * np.pi) ** 3 * range_m**4)
    assert image.power.max() == pytest.approx(expected, rel=0.02)


def test_doppler_of_the_measured_velocity_is_taken_out(caster):
    """A climb of 2 m/s moves the echo by f0 v T / B; the measured velocity puts it back."""
    flight = make_flight()
    pulses = flight.pulses(0.02)
    climbing = dataclasses.replace(pulses.true, velocity_mps=pulses.true.velocity_mps + np.array([0.0, 0.0, 2.0]))
    pulses = dataclasses.replace(pulses, true=climbing, measured=climbing)
    beats, analyser = compressed(flight, caster, pulses, 28.0)
    image = slant_range_image(beats, pulses.measured, analyser, 1.0)
    raw = analyser.range_m[np.argmax(analyser.power(beats)[0])]
    assert raw == pytest.approx(28.0 * np.sqrt(2) + 77e9 * 2.0 / np.sqrt(2) / 1000 / 500e6, abs=0.03)
    assert image.range_m[np.nanargmax(image.power[0])] == pytest.approx(28.0 * np.sqrt(2), abs=0.03)


def test_blocks_do_not_change_the_image_and_gaps_are_empty(caster):
    flight = make_flight()
    pulses = flight.pulses(1.0, every=8)
    beats, analyser = compressed(flight, caster, pulses, 28.0, zero_padding=1)
    whole = slant_range_image(beats, pulses.measured, analyser, 0.3)
    growing = SideLooking(analyser, 0.3)
    for part in (slice(0, 7), slice(7, 20), slice(20, None)):
        pose = pulses.measured
        growing.add(
            beats[part],
            dataclasses.replace(
                pose,
                position_m=pose.position_m[part],
                velocity_mps=pose.velocity_mps[part],
                R_world_antenna=pose.R_world_antenna[part],
            ),
        )
    np.testing.assert_allclose(growing.image().power, whole.power, rtol=1e-9)
    sparse = slant_range_image(beats, pulses.measured, analyser, 0.01)
    assert np.isnan(sparse.power).all(axis=1).any()
    assert np.isnan(to_ground(sparse, 0.0, np.array([20.0])).power).any()


def test_no_pulses_make_no_image():
    with pytest.raises(ValueError, match="no pulses"):
        SideLooking(SpectrumAnalyser(make_flight().chirp, "hann", 1), 1.0).image()
