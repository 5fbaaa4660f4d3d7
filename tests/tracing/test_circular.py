"""Circular polarization: what each engine, mirrors, targets and rain return in the same and in the opposite sense."""

from dataclasses import replace

import numpy as np
import pytest

from beams import make_antenna, make_chirp
from direct_receiver import points_at
from flights import make_pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.equation import plane_echo
from sionna_radar.scenario import load_scenario
from sionna_radar.scene.model import Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.surfaces.build import build_materials
from sionna_radar.surfaces.radar_material import Mirror, RadarMaterial, as_radar_material
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.effects.volume_echo import volume_polarization
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.gamma.facets import GammaEngine
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.engines.stock import PathSolverEngine
from sionna_radar.tracing.paths import VOLUME
from sionna_radar.tracing.sionna.material import mi
from sionna_radar.tracing.sionna.pattern import SionnaPattern
from sionna_radar.tracing.tracer import Tracer
from sionna_radar.weather.conditions import Weather
from sionna_radar.weather.validity import Precipitation
from worlds import plane_of

WAVELENGTH_M = 299_792_458.0 / 77e9
EVEN, WEAK = ConstantGammaBackscatter(0.05), ConstantGammaBackscatter(0.0125)
GROUNDS = {
    "alike from all sides": RadarMaterial(vertical=EVEN, horizontal=EVEN, cross_polar=0.1),
    "correlated": RadarMaterial(vertical=EVEN, horizontal=EVEN, cross_polar=0.1, copolar_correlation=0.95),
    "uneven": RadarMaterial(vertical=EVEN, horizontal=WEAK, cross_polar=0.1, copolar_correlation=0.6),
}
SENSES = {"co": "same", "cross": "opposite"}


def level_db(paths, pulses, expected) -> float:
    return float(10 * np.log10(np.sum(np.abs(paths.gain.astype(complex)) ** 2) / len(pulses) / expected))


@pytest.mark.parametrize("name", GROUNDS)
@pytest.mark.parametrize("receives", SENSES)
def test_a_plane_returns_what_its_covariance_says(name, receives):
    """A beam scanned to 40 deg meets the plane of incidence at an angle, which a circular wave does not notice."""
    scene = plane_of(GROUNDS[name])
    antenna = replace(make_antenna(2.0, 2.0, "RHCP"), receives=receives)
    pulses = make_pulses(150, incidence_deg=45.0, scan_deg=40.0)
    tilt = np.arccos(np.cos(np.deg2rad(45)) * np.cos(np.deg2rad(40)))
    material = replace(GROUNDS[name], channel=SENSES[receives])
    expected = plane_echo(antenna, material, WAVELENGTH_M, 50.0, tilt)
    beam = BeamEngine(scene, antenna, make_chirp(), 1, 512, 0.05)
    assert level_db(beam.trace(pulses), pulses, expected) == pytest.approx(0.0, abs=0.05)
    # What the signs of a facet add in one hand they take in the other.
    pulses = make_pulses(2, incidence_deg=45.0)
    expected = plane_echo(antenna, material, WAVELENGTH_M, 50.0, np.deg2rad(45))
    facets = [
        GammaEngine(scene, replace(antenna, polarization=hand), make_chirp(), 1, RayCaster(scene.surfaces)).trace(
            pulses
        )
        for hand in ("RHCP", "LHCP")
    ]
    power = sum(np.sum(np.abs(paths.gain) ** 2) for paths in facets) / 4
    assert 10 * np.log10(power / expected) == pytest.approx(0.0, abs=0.05)


@pytest.mark.study
def test_the_other_engines_return_the_same():
    scene, antenna = plane_of(GROUNDS["uneven"]), make_antenna(20.0, 20.0, "LHCP")
    pulses = make_pulses(2, incidence_deg=50.0)
    beam = BeamEngine(scene, antenna, make_chirp(), 1, 8192, 0.05).trace(pulses)
    power = np.sum(np.abs(beam.gain.astype(complex)) ** 2) / len(pulses)
    stock = PathSolverEngine(scene, antenna, make_chirp(), 1, 200_000).trace(pulses)
    assert level_db(stock, pulses, power) == pytest.approx(0.0, abs=0.2)
    region = np.array([[-60.0, -20.0, -1.0], [60.0, 200.0, 1.0]])
    fixed = PersistentEngine(scene, antenna, make_chirp(), 1, 4.0, region).trace(pulses.rows(slice(0, 1)))
    assert level_db(fixed, pulses.rows(slice(0, 1)), power) == pytest.approx(0.0, abs=0.2)


def test_closed_forms_of_the_covariance():
    """(s_h + s_v -+ 2 rho sqrt(s_h s_v)) / 4, with s_hv beside it in the same sense; symmetry gives rho = 1 - 2 x."""
    at = np.deg2rad([45.0])
    v, h = EVEN.sigma0(at), WEAK.sigma0(at)
    uneven = GROUNDS["uneven"]
    mixed = 2 * 0.6 * np.sqrt(v * h)
    same = replace(uneven, channel="same").sigma0(at)
    np.testing.assert_allclose(same, (v + h - mixed) / 4 + 0.1 * h, rtol=1e-12)
    np.testing.assert_allclose(replace(uneven, channel="opposite").sigma0(at), (v + h + mixed) / 4, rtol=1e-12)
    even = GROUNDS["alike from all sides"]
    np.testing.assert_allclose(replace(even, channel="same").sigma0(at), 0.2 * v, rtol=1e-12)
    np.testing.assert_allclose(replace(even, channel="opposite").sigma0(at), 0.9 * v, rtol=1e-12)
    # Straight down V and H are one: what was given for slant angles cannot hold there.
    down = replace(GROUNDS["correlated"], channel="same").sigma0(np.zeros(1))
    np.testing.assert_allclose(down, 0.2 * EVEN.sigma0(np.zeros(1)), rtol=1e-12)


@pytest.mark.parametrize("axial_ratio_db", [0.0, 1.0, 3.0])
def test_an_axial_ratio_bounds_what_is_rejected(axial_ratio_db):
    """The integrated cancellation ratio of a mirror or sphere: 20 log10 (r^2 + 1) / (r^2 - 1)."""
    antenna = replace(make_antenna(2.0, 2.0, "RHCP"), axial_ratio_db=axial_ratio_db)
    r2 = 10 ** (axial_ratio_db / 10)
    same, opposite = antenna.mirrored, replace(antenna, receives="cross").mirrored
    assert abs(same) == pytest.approx((r2 - 1) / (r2 + 1), abs=1e-12)
    assert abs(opposite) ** 2 + abs(same) ** 2 == pytest.approx(1.0)
    sent, received = replace(antenna, receives="cross").jones
    assert np.vdot(sent, received) == pytest.approx(0.0, abs=1e-15)


def test_sionna_sends_the_hand_that_the_antenna_names():
    """To the right: seen along the way of the wave, the field turns from up to the right as time goes on."""
    antenna = make_antenna(20.0, 20.0, "RHCP")
    assert np.angle(antenna.jones[0][1] / antenna.jones[0][0]) == pytest.approx(np.pi / 2)
    up, right = antenna.jones[0][0], -antenna.jones[0][1]
    quarter_later = np.real(np.array([up, right]) * 1j)
    assert quarter_later[1] > 0
    assert quarter_later[0] == pytest.approx(0.0)
    away = np.array([[1.0, 0.1, -0.2], [1.0, -0.3, 0.1]])
    away /= np.linalg.norm(away, axis=1)[:, None]
    theta, phi = np.arccos(away[:, 2]), np.arctan2(away[:, 1], away[:, 0])
    shares = SionnaPattern(antenna).patterns[0](mi.Float(theta), mi.Float(phi))
    c_theta, c_phi = (s.real.numpy() + 1j * s.imag.numpy() for s in shares)
    e_theta = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)], axis=1)
    e_phi = np.stack([-np.sin(phi), np.cos(phi), 0 * phi], axis=1)
    theirs, ours = c_theta[:, None] * e_theta + c_phi[:, None] * e_phi, antenna.fields(away)[0]
    overlap = np.abs(np.sum(theirs * ours.conj(), axis=1)) ** 2 / np.sum(np.abs(theirs) ** 2, axis=1)
    np.testing.assert_allclose(overlap, 1.0, atol=1e-5)


def test_mirrors_and_targets_return_the_opposite_sense():
    metal = Mirror(permittivity=1 - 1e9j, rms_height_m=0.0, frequency_hz=77e9)
    plate = replace(as_radar_material(EVEN), mirror=metal)
    target = Target(position_m=(0.0, 0.3, 2.0), rcs_m2=1.0)
    scene = replace(plane_of(plate), targets=(target,))
    chirp, pulses = make_chirp(), make_pulses(1)
    levels = {}
    for name, changes in {
        "linear": {"polarization": "V"},
        "same": {"polarization": "RHCP"},
        "opposite": {"polarization": "RHCP", "receives": "cross"},
        "same, 3 dB": {"polarization": "LHCP", "axial_ratio_db": 3.0},
    }.items():
        antenna = replace(make_antenna(2.0, 2.0), **changes)
        paths = Tracer(Nothing(), scene, antenna, chirp, RayCaster(scene.surfaces)).trace(pulses)
        levels[name] = np.abs(paths.gain)
    assert len(levels["linear"]) == 2
    assert len(levels["same"]) == 0
    np.testing.assert_allclose(levels["opposite"], levels["linear"], rtol=1e-9)
    np.testing.assert_allclose(20 * np.log10(levels["same, 3 dB"] / levels["linear"]), -9.565, atol=0.01)


class Nothing:
    """An engine that meets no surface."""

    def trace(self, pulses):
        return points_at([])


def survey(**antenna):
    return load_scenario("hills", {"platform.length_m": 2.0, "radar.antenna": {"beamwidth_deg": 2.0, **antenna}})


def test_a_ground_without_a_cross_polar_ratio_has_a_typical_one_for_a_circular_wave(caplog):
    scenario = survey(polarization="RHCP")
    ground = build_materials(scenario.materials, scenario.radar)["ground"]
    at = np.deg2rad([30.0])
    assert 10 * np.log10(ground.sigma0(at) / ground.vertical.sigma0(at)) == pytest.approx(10 * np.log10(0.2))
    assert "no cross_polar_db" in caplog.text
    # The noise of snr_db is set against the strong echo, in the opposite sense.
    assert 10 * np.log10(ground.co_polar.sigma0(at) / ground.vertical.sigma0(at)) == pytest.approx(10 * np.log10(0.9))
    linear = survey(polarization="V")
    assert build_materials(linear.materials, linear.radar)["ground"].cross_polar == 0.0


def test_an_axial_ratio_needs_a_circular_wave():
    with pytest.raises(ScenarioError, match=r"radar.antenna.axial_ratio_db: 1 has no effect"):
        survey(axial_ratio_db=1.0)


@pytest.mark.parametrize("scan_deg", [0.0, 45.0])
def test_rain_in_each_port(scan_deg):
    weather = Weather(carrier_hz=77e9, rain_rate_mm_per_h=4.0)
    pose = make_pulses(1, incidence_deg=45.0, scan_deg=scan_deg).true
    assert volume_polarization(weather, make_antenna(2.0, 2.0)) is None

    def share_db(**changes) -> float:
        antenna = replace(make_antenna(2.0, 2.0), **changes)
        return float(10 * np.log10(volume_polarization(weather, antenna).received_fraction(pose)[0]))

    assert share_db(polarization="RHCP", receives="cross") == pytest.approx(0.0, abs=1e-6)
    same = share_db(polarization="RHCP")
    assert same < -34
    assert share_db(polarization="LHCP") == pytest.approx(same, abs=1e-9)
    # A real antenna's ellipse rules: 18.8 dB at 1 dB, whatever drops add to it.
    assert share_db(polarization="RHCP", axial_ratio_db=1.0) == pytest.approx(-18.8, abs=0.5)
    # A beam scanned aside sees the drops' axis slanted: what is opposed in V and H of the drops is exchanged there.
    crossed = share_db(receives="cross")
    assert crossed < -48 if scan_deg == 0 else same - 6 < crossed < same


def test_snow_turns_more_and_fog_turns_nothing():
    pose, antenna = make_pulses(1, incidence_deg=45.0).true, replace(make_antenna(2.0, 2.0), polarization="RHCP")
    fog = {"liquid_water_g_per_m3": 0.1}
    shares = {}
    for name, weather in {"fog": fog, "snow": {"snowfall_mm_per_h": {Precipitation.DRY_SNOW: 1.0}, **fog}}.items():
        shares[name] = volume_polarization(Weather(carrier_hz=77e9, **weather), antenna).received_fraction(pose)[0]
    assert shares["fog"] == pytest.approx(0.0, abs=1e-12)
    # Of randomly turned particles the same sense has twice the linear depolarization.
    assert 10 * np.log10(shares["snow"]) == pytest.approx(-15.0, abs=0.1)


def test_rain_of_a_survey_is_rejected():
    weather = {"weather.rain_rate_mm_per_h": 25.0, "platform.length_m": 2.0, "tracing.paths_per_pulse": 32}
    levels = []
    for antenna in ({}, {"polarization": "RHCP", "axial_ratio_db": 1.0}):
        ready = prepare(load_scenario("hills", {**weather, "radar.antenna": {"beamwidth_deg": 2.0, **antenna}}))
        paths = ready.sensor_inputs().tracer().trace(ready.flight.pulses(np.arange(20)))
        levels.append(np.sum(np.abs(paths.gain[paths.surface == VOLUME]) ** 2))
    # The ellipse's major axis is V's and flat drops return more of H: a part of what leaks is taken back.
    assert -19.8 < 10 * np.log10(levels[1] / levels[0]) < -18.8
