"""Scatterers fixed to the surface: coherence from chirp to chirp, power, and speckle."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.constants import speed_of_light
from scipy.stats import kstest

from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.flight.frames import R_WORLD_NED, whisk_broom_from_antenna
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import taylor_cut
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Scene, Surface
from sionna_radar.signal.beat import synthesise
from sionna_radar.tracing.engines.beam.beam import BeamEngine
from sionna_radar.tracing.engines.persistent.cell_tree import CellTree
from sionna_radar.tracing.engines.persistent.density import DensityMap, FilledBeam
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from sionna_radar.tracing.engines.persistent.scatterers import Scatterers
from sionna_radar.tracing.engines.persistent.seen_places import SeenPlaces
from worlds import make_scene

PENCIL = Antenna(taylor_cut(np.deg2rad(2.0), -20.0), taylor_cut(np.deg2rad(2.0), -20.0))


def square(half_m: float, height_m: float = 0.0, name: str = "ground") -> Surface:
    x = half_m * np.array([-1.0, 1.0, 1.0, -1.0])
    y = half_m * np.array([-1.0, -1.0, 1.0, 1.0])
    vertices = np.column_stack([x, y, np.full(4, height_m)])
    return Surface(name=name, vertices_m=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), material="ground")


def looking(position_m: np.ndarray, velocity_mps: np.ndarray, incidence_deg: float) -> Pulses:
    count = len(position_m)
    axes = R_WORLD_NED @ whisk_broom_from_antenna(np.deg2rad(incidence_deg), np.zeros(count))
    pose = Pose(
        position_m=position_m,
        velocity_mps=np.broadcast_to(velocity_mps, (count, 3)).copy(),
        R_world_antenna=axes,
    )
    index = np.arange(count)
    return Pulses(index=index, time_s=index.astype(float), scan_rad=np.zeros(count), true=pose, measured=pose)


def scatter(ground: Scene, per_m2: float, seed: int) -> SeenPlaces:
    """All scatterers below 100 m: those of a beam that fills the half space under it."""
    pulses, below = looking(np.array([[0.0, 0.0, 100.0]]), np.zeros(3), 0.0), FilledBeam(1.0, 1.0)
    places, ends = Scatterers(ground, DensityMap.constant(per_m2), seed).in_beams(pulses, below, 0.0, 0)
    return places.first(int(ends[-1]))


def chirp(rate_hz: float = 360.0, samples: int = 512) -> Chirp:
    return Chirp(carrier_hz=77e9, bandwidth_hz=500e6, rate_hz=rate_hz, samples=samples, sampling="iq")


def test_phase_of_a_fixed_point_follows_its_range():
    """Over a pass of 8 m past a point 50 m below, the beat's phase is 4 pi r / lambda within 0.02 rad."""
    ground = square(0.01)
    # Inside one cell of scatterers, whose sides are coordinate planes.
    speck = replace(ground, vertices_m=ground.vertices_m + np.array([0.05, 0.05, 0.01]))
    engine = PersistentEngine(make_scene(speck), PENCIL, chirp(), seed=3, density=1 / 4e-4)
    point = scatter(make_scene(speck), 1 / 4e-4, 3).hit_m.T
    assert len(point) == 1
    along = np.arange(-4.0, 4.0, 4e-4)
    position = np.column_stack([np.zeros(len(along)), along - 50 * np.tan(np.deg2rad(20)), np.full(len(along), 50.0)])
    # North along the beam's plane; the beam is 2 deg wide, so the cone sees the point for part of the pass.
    pulses = looking(position, np.array([0.0, 0.144, 0.0]), 20.0)
    paths = engine.trace(pulses)
    # Without the rays beside the beam, a few of which meet the speck.
    paths = paths.rows(np.linalg.norm(paths.hit_m - point, axis=1) < 1e-4)
    assert len(paths) > 1000
    beat = synthesise(paths, pulses, chirp())[paths.pulse]
    seen = position[paths.pulse]
    range_m = np.linalg.norm(seen - point, axis=1)
    delay = 2 * range_m / speed_of_light
    expected = 4 * np.pi * range_m / chirp().wavelength_m - np.pi * chirp().slope_hz_s * delay**2
    middle = chirp().samples // 2
    drift = np.angle(beat[:, middle] * np.exp(-1j * expected))
    drift = np.unwrap(drift) - drift[0]
    assert np.abs(drift).max() < 0.02
    assert np.ptp(4 * np.pi * range_m / chirp().wavelength_m) > 1000  # the phase itself turned many times


def test_slow_time_spectrum_peaks_at_the_doppler_of_the_beam():
    rate, count, speed, incidence = 20_000.0, 256, 10.0, 60.0
    sweep = chirp(rate, 256)
    engine = PersistentEngine(make_scene(square(200.0)), PENCIL, sweep, seed=1, density=4.0)
    position = np.column_stack([np.zeros(count), speed * np.arange(count) / rate - 50.0, np.full(count, 30.0)])
    pulses = looking(position, np.array([0.0, speed, 0.0]), incidence)
    beat = synthesise(engine.trace(pulses), pulses, sweep)
    doppler = np.abs(np.fft.fft(np.fft.fft(beat, axis=1) * np.hanning(count)[:, None], axis=0)) ** 2
    frequency = np.fft.fftfreq(count, 1 / rate)
    peak = frequency[np.argmax(doppler.sum(axis=1))]
    expected = -2 * speed * np.sin(np.deg2rad(incidence)) / sweep.wavelength_m  # approaching
    assert abs(peak - expected) <= rate / count


def grid_of_positions(count: int, spacing_m: float) -> np.ndarray:
    side = int(np.ceil(np.sqrt(count)))
    x, y = np.meshgrid(*[spacing_m * (np.arange(side) - side / 2)] * 2)
    return np.column_stack([x.ravel(), y.ravel() - 50.0, np.full(side * side, 50.0)])[:count]


@pytest.mark.parametrize("mode", ["per_pulse", "persistent"])
def test_speckle_is_fully_developed(mode):
    """Intensities of independent cells of a uniform field are exponential, with a contrast of one."""
    ground = make_scene(square(260.0))
    sweep = chirp(samples=384)
    position = grid_of_positions(1600, 9.0)
    pulses = looking(position, np.zeros(3), 45.0)
    if mode == "persistent":
        engine = PersistentEngine(ground, PENCIL, sweep, seed=5, density=20.0)
    else:
        engine = BeamEngine(ground, PENCIL, sweep, 5, 1024, 0.05)
    power = SpectrumAnalyser(sweep, "boxcar", 1).power(synthesise(engine.trace(pulses), pulses, sweep))
    mean = power.mean(axis=0)
    brightest = np.argsort(mean)[-8:]
    intensity = (power / mean)[:, brightest].ravel()
    assert len(intensity) >= 10_000
    assert kstest(intensity, "expon").pvalue > 0.01
    assert intensity.std() == pytest.approx(1.0, abs=0.03)


def test_a_wall_hides_what_is_behind_it():
    wall = Surface(
        name="wall",
        vertices_m=np.array([[-30.0, 20.0, 0.0], [30.0, 20.0, 0.0], [30.0, 20.0, 60.0], [-30.0, 20.0, 60.0]]),
        faces=np.array([[0, 1, 2], [0, 2, 3]]),
        material="ground",
    )
    engine = PersistentEngine(make_scene(square(100.0), wall), PENCIL, chirp(), seed=2, density=100.0)
    paths = engine.trace(looking(np.array([[0.0, 0.0, 30.0]]), np.zeros(3), 60.0))
    assert len(paths) > 100
    assert paths.hit_m[:, 1].max() < 20.0 + 1e-5


def test_scatterers_lie_on_their_faces_in_proportion_to_area():
    low, high = square(40.0), square(20.0, 10.0, "roof")
    points = scatter(make_scene(low, high), 2.0, seed=4)
    # Each of some 600 cells rounds its number at random, half a scatterer up or down at most.
    assert np.sum(points.surface == 0) == pytest.approx(2.0 * 80**2, abs=50)
    assert np.sum(points.surface == 1) == pytest.approx(2.0 * 40**2, abs=25)
    east_m, north_m, up_m = points.hit_m
    np.testing.assert_allclose(up_m, np.where(points.surface == 0, 0.0, 10.0), atol=1e-12)
    np.testing.assert_allclose(points.cosine, (100.0 - up_m) / points.range_m, rtol=1e-6)  # normals point up
    quadrant = (east_m > 0) & (north_m > 0) & (points.surface == 0)
    assert quadrant.sum() == pytest.approx(2.0 * 40**2, rel=0.05)


def test_another_surface_leaves_the_scatterers_where_they_were():
    alone = scatter(make_scene(square(20.0)), 2.0, seed=4)
    together = scatter(make_scene(square(20.0), square(5.0, 3.0, "roof")), 2.0, seed=4)
    mine = together.hit_m[:, together.surface == 0]
    assert {tuple(p) for p in alone.hit_m.T} == {tuple(p) for p in mine.T}


def test_cells_leave_out_no_scatterer_of_a_fan_beam():
    points = Scatterers(make_scene(square(60.0)), DensityMap.constant(1.0), seed=4)
    pulses = looking(grid_of_positions(30, 9.0), np.zeros(3), 40.0)
    pose, fan = pulses.true, FilledBeam(0.02, 0.3)
    place = points.cells.low_m, points.cells.high_m
    edges, cell = CellTree.over(*place).in_beams(pose.position_m, pose.R_world_antenna, fan)
    found = set(zip(np.repeat(np.arange(30), np.diff(edges)).tolist(), cell.tolist(), strict=True))
    away = (place[0] + place[1])[None] / 2 - pose.position_m[:, None]
    within = np.einsum("bni,bij->bnj", away / np.linalg.norm(away, axis=2)[..., None], pose.R_world_antenna)
    inside = fan.holds(within.reshape(-1, 3)).reshape(30, -1)
    wanted = set(zip(*(index.tolist() for index in np.nonzero(inside)), strict=True))
    assert wanted <= found
    assert len(wanted) > 0
    assert len(found) < 0.5 * inside.size


@pytest.mark.parametrize("side_m", [60.0, 2e6])
def test_a_region_of_a_large_surface_has_its_scatterers_however_large_the_surface_is(side_m):
    """Only the region is divided: of a square of 2,000 km the parts alone would be looked through for minutes."""
    region_m = np.array([[-8.0, -5.0, -1.0], [10.0, 12.0, 1.0]])
    scatterers = Scatterers(make_scene(square(side_m)), DensityMap.constant(1.0), seed=4, region_m=region_m)
    cells = scatterers.cells
    held = np.all((cells.high_m > region_m[0]) & (cells.low_m < region_m[1]), axis=1)
    # The cells that meet the region, and at most a row of parts around it.
    assert cells.expected[held].sum() >= 18.0 * 17.0
    if side_m < 100.0:
        whole = Scatterers(make_scene(square(side_m)), DensityMap.constant(1.0), seed=4).cells
        same = np.all((whole.low_m >= region_m[0]) & (whole.high_m <= region_m[1]), axis=1)
        places = {tuple(place): expected for place, expected in zip(cells.place, cells.expected, strict=True)}
        assert same.any()
        for place, expected in zip(whole.place[same], whole.expected[same], strict=True):
            assert places[tuple(place)] == expected
