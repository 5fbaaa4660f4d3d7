"""Sionna RT's own solver for radar cross-sections, as a third opinion on a target: field, delay and Doppler shift."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from flights import make_pulses
from sionna_radar.scene.model import Target
from sionna_radar.scene.motion import RcsTable, Way
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import sionna_angles
from sionna_radar.tracing.sionna.scene import SionnaScene
from worlds import make_scene, make_surface

# isort: split
# Loads libLLVM, which the imports above have selected.
import drjit as dr
import sionna.rt as rt
from sionna.rt.rcs import ConstantCPM, RCSSolver, ScatteringModel, SensingTarget

SPEED_MPS = 9.0


def table(seen_deg):
    """A cross-section by azimuth, in dB over a square metre, as smooth as that of a few plates."""
    return 10 + 6 * np.cos(np.deg2rad(2 * seen_deg)) + 3 * np.sin(np.deg2rad(seen_deg))


@pytest.mark.parametrize("east_m", [-6.0, 0.0, 4.0])
def test_sionna_agrees_on_a_moving_target_whose_cross_section_depends_on_the_angle(east_m):
    azimuth_deg = np.arange(-180.0, 180.0, 0.5)
    rcs = RcsTable(
        azimuth_rad=np.deg2rad(azimuth_deg), elevation_rad=np.zeros(1), rcs_m2=10 ** (table(azimuth_deg) / 10)[None]
    )
    antenna, chirp = make_antenna(20.0, 20.0), make_chirp()
    pulses = make_pulses(1, incidence_deg=60.0, position_m=(0.0, -60.0, 30.0))
    place = np.array([east_m, 1.0, 2.0])
    way = Way(corner_m=np.array([place, place + np.array([30.0, 0.0, 0.0])]), speed_mps=SPEED_MPS)
    start = way.at(pulses.time_s)[0][0]
    target = Target(position_m=tuple(place), rcs_m2=0.0, way=way, rcs_table=rcs)
    ground = make_scene(make_surface(lambda x, y: 0 * x, size_m=200.0, spacing_m=50.0))
    ours = trace_targets([target], pulses, antenna, chirp, RayCaster(ground.surfaces))

    sionna = SionnaScene(ground, antenna, chirp.carrier_hz)
    scene = rt.Scene()
    scene.frequency = chirp.carrier_hz
    sender, receiver = (
        rt.AntennaArray(pattern, mi.Point3f(0.0, 0.0, 0.0)) for pattern in (sionna.pattern, sionna.receive_pattern)
    )
    scene.tx_array, scene.rx_array = sender, receiver
    position = mi.Point3f(*pulses.true.position_m[0].tolist())
    angles = mi.Point3f(*sionna_angles(pulses.true.R_world_antenna)[0].tolist())
    for device in (rt.Transmitter("sender", position), rt.Receiver("receiver", position)):
        device.orientation = angles
        device.velocity = mi.Vector3f(*pulses.true.velocity_mps[0].tolist())
        scene.add(device)

    def cross_section(incident, _, __):
        # The target's front looks along +x in its own axes, and it drives east.
        toward = -incident
        seen = dr.rad2deg(dr.atan2(-toward.y, toward.x))
        return 10 ** ((10 + 6 * dr.cos(dr.deg2rad(2 * seen)) + 3 * dr.sin(dr.deg2rad(seen))) / 10)

    model = ScatteringModel(mi.Point3f(0.0, 0.0, 0.0), rcs=cross_section, cpm=ConstantCPM())
    body = SensingTarget(
        name="target", scattering_model=model, length=1.0, width=1.0, height=1.0, position=mi.Point3f(*start.tolist())
    )
    scene.add(body)
    body.velocity = mi.Vector3f(SPEED_MPS, 0.0, 0.0)
    found = RCSSolver()(scene, max_depth=1)
    theirs = np.hypot(found.a[0].numpy(), found.a[1].numpy()).ravel()
    assert len(theirs) == len(ours) == 1
    assert 20 * np.log10(theirs[0] / np.abs(ours.gain[0])) == pytest.approx(0.0, abs=0.1)
    assert found.tau.numpy().ravel()[0] == pytest.approx(ours.delay_s[0], rel=1e-6)
    shift_hz = -2 * ours.range_rate_mps[0] / chirp.wavelength_m
    assert found.doppler.numpy().ravel()[0] == pytest.approx(shift_hz, rel=1e-4, abs=0.5)
