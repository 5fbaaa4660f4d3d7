"""How many scatterers lie where, and what the rays beside them return."""

import numpy as np
import pytest

from beams import make_antenna, make_chirp, plane_power
from flights import make_pulses
from sionna_radar import load_scenario, prepare
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.persistent.density import filled_beam, footprint_density
from sionna_radar.tracing.engines.persistent.persistent import OuterRays, PersistentEngine
from sionna_radar.tracing.paths import SampledBeams
from worlds import make_scene, make_surface


def looks_at(height_m: float, incidence_deg: float) -> SampledBeams:
    east = np.arange(-40.0, 41.0, 2.0)
    place = np.column_stack([east, np.zeros(len(east)), np.full(len(east), height_m)])
    pose = make_pulses(len(east), incidence_deg=incidence_deg, position_m=place).true
    return SampledBeams(
        position_m=pose.position_m,
        R_world_antenna=pose.R_world_antenna,
        range_m=np.full(len(east), height_m / np.cos(np.deg2rad(incidence_deg))),
        beam=np.zeros(len(east), dtype=np.int64),
    )


@pytest.mark.parametrize("beam_deg", [1.0, 4.0])
def test_a_pulse_sees_as_many_as_wanted(beam_deg, plane):
    """An ellipse of half axes a and b at range r and incidence t covers pi a b r^2 / cos t."""
    beam = filled_beam(make_antenna(beam_deg, beam_deg))
    density = footprint_density(looks_at(50.0, 45.0), [beam], make_chirp().range_resolution_m, 500)
    area = np.pi * beam.left * beam.up * (50.0 / np.cos(np.pi / 4)) ** 2 / np.cos(np.pi / 4)
    expected = 500 / area
    under = density.at(np.array([[0.0, 50.0]]))[0]
    assert np.log2(under) == np.round(np.log2(expected))
    assert density.at(np.array([[0.0, -400.0]]))[0] == 0.0  # no beam comes near


def test_a_spread_echo_has_ten_in_a_range_cell():
    beam = filled_beam(make_antenna(8.0, 8.0))
    chirp = make_chirp()
    density = footprint_density(looks_at(100.0, 60.0), [beam], chirp.range_resolution_m, 16)
    under = density.at(np.array([[0.0, 100.0 * np.tan(np.pi / 3)]]))[0]
    across = 2 * beam.left * 200.0
    along = chirp.range_resolution_m / np.sin(np.pi / 3)
    assert 10 / np.sqrt(2) <= under * across * along <= 10 * np.sqrt(2) * 1.05


def test_the_lower_flight_decides():
    high, low = looks_at(100.0, 45.0), looks_at(50.0, 45.0)
    beam, resolution_m = [filled_beam(make_antenna(2.0, 2.0))], make_chirp().range_resolution_m
    both = SampledBeams.concatenate([high, low])
    under = np.array([[0.0, 50.0]])
    assert footprint_density(both, beam, resolution_m, 500).at(under) == footprint_density(
        low, beam, resolution_m, 500
    ).at(under)


@pytest.mark.parametrize("beam_deg", [2.0, 8.0])
def test_the_filled_beam_leaves_out_a_five_hundredth_of_the_power_at_most(beam_deg):
    antenna = make_antenna(beam_deg, beam_deg)
    beam = filled_beam(antenna)
    grid = np.linspace(-0.6, 0.6, 1201)
    u, v = (cosine.ravel() for cosine in np.meshgrid(grid, grid))
    direction = np.column_stack([np.sqrt(1 - u**2 - v**2), u, v])
    power = antenna.gain(direction) ** 2 / direction[:, 0]
    # Found on cells of the power, so that it may be somewhat larger than it need be.
    assert 1e-3 < power[~beam.holds(direction)].sum() / power.sum() < 2.1e-3


def test_rays_beside_the_beam_have_the_density_they_state():
    """The mean of f over the density is the integral of f, here of the two-way power outside the filled beam."""
    antenna = make_antenna(4.0, 4.0)
    beam = filled_beam(antenna)
    direction, density = OuterRays(antenna, beam, 26, seed=1).shoot(np.arange(4000))
    used = (density > 0) & ~beam.holds(direction)
    power = (antenna.gain(direction[used]) / antenna.peak_gain) ** 2 / density[used]
    found = power.sum() / 4000
    grid = np.linspace(-0.999, 0.999, 2001)
    u, v = (cosine.ravel() for cosine in np.meshgrid(grid, grid))
    inside = u**2 + v**2 < 0.999
    ahead = np.sqrt(1 - u[inside] ** 2 - v[inside] ** 2)
    every = np.column_stack([ahead, u[inside], v[inside]])
    outside = ~beam.holds(every)
    expected = (
        np.sum((antenna.gain(every[outside]) / antenna.peak_gain) ** 2 / ahead[outside]) * (grid[1] - grid[0]) ** 2
    )
    assert found == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("beam_deg", [2.0, 8.0])
def test_the_mean_echo_is_the_radar_equation_and_so_are_its_side_lobes(beam_deg, plane):
    """With the scatterers' own reflectivities taken out; far side lobes are those beyond four beamwidths.

    Scatterers stay where they are: one pulse of one place is as many.
    """
    antenna, chirp = make_antenna(beam_deg, beam_deg), make_chirp()
    density = footprint_density(looks_at(50.0, 40.0), [filled_beam(antenna)], chirp.range_resolution_m, 500)
    engine = PersistentEngine(plane, antenna, chirp, 1, density)
    pulses = make_pulses(300, incidence_deg=40.0, position_m=np.tile([0.0, 0.0, 50.0], (300, 1)))
    paths = engine.trace(pulses.rows(slice(0, 1)))
    kept = engine._scatterers._points.rows(np.arange(engine._scatterers._used))
    place = {tuple(p): abs(q) for p, q in zip(kept.position_m.astype(np.float32), kept.reflectivity, strict=True)}
    own = np.array([place.get(tuple(p), 1.0) for p in paths.hit_m])
    power = np.abs(paths.gain / own) ** 2
    assert power.sum() == pytest.approx(plane_power(antenna, 50.0, 40.0), rel=0.015)

    beam = BeamEngine(plane, antenna, chirp, 1, 4096, 0.5)
    other = beam.trace(pulses)

    def far(paths, power):
        away = (paths.hit_m - [0.0, 0.0, 50.0]) / np.linalg.norm(paths.hit_m - [0.0, 0.0, 50.0], axis=1)[:, None]
        boresight = pulses.true.boresight[0]
        return power[away @ boresight < np.cos(np.deg2rad(4 * beam_deg))].sum()

    expected = far(other, np.abs(other.gain) ** 2) / 300
    assert far(paths, power) == pytest.approx(expected, rel=0.25)


def test_scatterers_do_not_depend_on_what_was_seen_before():
    ground = make_scene(make_surface(lambda x, y: 0.02 * x * x, size_m=200.0, spacing_m=1.0))
    antenna, chirp = make_antenna(4.0, 4.0), make_chirp()
    place = np.column_stack([np.linspace(-30, 30, 40), np.full(40, -40.0), np.full(40, 60.0)])
    pulses = make_pulses(40, incidence_deg=40.0, position_m=place)
    whole = PersistentEngine(ground, antenna, chirp, 1, 4.0).trace(pulses)
    late = PersistentEngine(ground, antenna, chirp, 1, 4.0)
    backwards = [late.trace(pulses.rows(slice(first, first + 10))) for first in (30, 20, 10, 0)]
    for first, part in zip((30, 20, 10, 0), backwards, strict=True):
        kept = (whole.pulse >= first) & (whole.pulse < first + 10)
        np.testing.assert_array_equal(part.gain, whole.gain[kept])
        np.testing.assert_array_equal(part.delay_s, whole.delay_s[kept])


def test_a_long_survey_has_scatterers_at_all_angles_of_its_scan():
    """One look in 500 pulses is one in a line of the scan: the looks must not meet one angle only."""
    prepared = prepare(
        load_scenario(
            "hills",
            {
                "terrain": {"kind": "flat", "size_m": [1300.0, 300.0]},
                "platform.start_m": [-500.0, 0.0],
                "platform.length_m": 1000.0,
                "radar.chirp_rate_hz": 36000.0,
                "radar.scan.rotation_rpm": 1200.0,
            },
        )
    )
    assert len(prepared) == pytest.approx(1_000_000, rel=1e-3)
    first = len(prepared) // 2
    pulses = prepared.flight.pulses(np.arange(first, first + 500))
    paths = prepared.sensor_inputs().tracer().trace(pulses)
    assert np.bincount(paths.pulse - first, minlength=500).min() > 200
