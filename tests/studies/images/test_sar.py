"""Focusing a point, and ground that bears persistent scatterers: resolution, power, speckle and contrast."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import kstest

from side_looking import make_flight, uniform_cut
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Surface, Target
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.signal.beat import synthesise
from sionna_radar.studies.images.aperture import Aperture, PixelGrid, ground_pixels, whole_beam
from sionna_radar.studies.images.sar import PULSES_AT_ONCE, BackProjection, SarImage
from sionna_radar.studies.images.strip import azimuth_resolution_m, ground_range_resolution_m, half_power_width
from sionna_radar.surfaces.backscatter import ConstantGammaBackscatter
from sionna_radar.tracing.effects.targets import trace_targets
from sionna_radar.tracing.engines.persistent.persistent import PersistentEngine
from worlds import make_scene

TARGET = Target(position_m=(28.0, 0.13, 0.0), rcs_m2=1.0)


@pytest.fixture(scope="module")
def caster(plane):
    return RayCaster(plane.surfaces)


def received(flight, pulses: Pulses, caster: RayCaster, *targets: Target) -> np.ndarray:
    paths = trace_targets(targets or (TARGET,), pulses, flight.antenna, flight.chirp, caster)
    return synthesise(paths, pulses, flight.chirp)


def around(pulses: Pulses, along_m: float = 0.1, across_m: float = 1.2, count: int = 81) -> PixelGrid:
    """Return pixels about the target; the axis along the track counts from the first pulse."""
    start = pulses.measured.position_m[0, 1]
    return ground_pixels(
        pulses.measured,
        "right",
        0.0,
        TARGET.position_m[1] - start + np.linspace(-along_m, along_m, count),
        TARGET.position_m[0] + np.linspace(-across_m, across_m, 61),
    )


def focus(beats: np.ndarray, measured: Pose, chirp: Chirp, grid: PixelGrid, aperture: Aperture) -> SarImage:
    projection = BackProjection(chirp, grid, aperture)
    projection.add(beats, measured)
    return projection.image()


def peak(image: SarImage) -> tuple[int, int]:
    row, column = np.unravel_index(np.argmax(image.power), image.power.shape)
    return int(row), int(column)


def widths(image: SarImage) -> tuple[float, float]:
    """Return the half-power widths along and across the track."""
    row, column = peak(image)
    along = half_power_width(image.grid.along_m, image.power[row])
    return along, half_power_width(image.grid.across_m, image.power[:, column])


@pytest.mark.parametrize(
    ("width_deg", "weighting", "window"),
    [(9.0, "beam", "boxcar"), (4.0, "beam", "boxcar"), (4.0, "flat", "boxcar"), (5.0, "flat", "hann")],
)
def test_resolution_is_the_theorys(caster, width_deg, weighting, window):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=2)
    aperture = Aperture(
        width_rad=np.deg2rad(width_deg), azimuth=flight.antenna.azimuth, weighting=weighting, window=window
    )
    image = focus(received(flight, pulses, caster), pulses.measured, flight.chirp, around(pulses), aperture)
    along, across = widths(image)
    assert along == pytest.approx(azimuth_resolution_m(aperture, flight.chirp.wavelength_m), rel=0.03)
    # A wide aperture sharpens range a little too: its depth of focus comes near a range cell.
    assert across == pytest.approx(ground_range_resolution_m(flight.chirp, "hann", np.pi / 4), rel=0.10)


def test_a_uniform_aperture_resolves_half_its_length(caster):
    """Focused flat over lambda / d, the first null lies d / 2 away and the half-power width is 0.886 d / 2."""
    flight, length = make_flight(rate_hz=2000.0), 0.05
    azimuth = uniform_cut(length, flight.chirp.wavelength_m)
    flight = dataclasses.replace(flight, antenna=Antenna(azimuth, flight.antenna.elevation))
    width = 2 * float(np.arcsin(flight.chirp.wavelength_m / length / 2))
    aperture = Aperture(width_rad=width, azimuth=azimuth, weighting="flat")
    pulses = flight.pulses(4.0, every=2)
    image = focus(received(flight, pulses, caster), pulses.measured, flight.chirp, around(pulses, 0.04), aperture)
    along, _ = widths(image)
    assert along == pytest.approx(0.8859 * length / 2, rel=0.03)
    row, column = peak(image)
    cut = image.power[row]
    null = column + int(np.argmax(np.diff(cut[column:]) > 0))
    assert image.grid.along_m[null] - image.grid.along_m[column] == pytest.approx(length / 2, rel=0.06)
    assert cut[null] < 3e-3 * cut[column]


def test_the_point_lies_in_its_pixel_with_its_power(caster):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=2)
    image = focus(
        received(flight, pulses, caster), pulses.measured, flight.chirp, around(pulses), whole_beam(flight.antenna)
    )
    row, column = peak(image)
    np.testing.assert_allclose(image.grid.position_m[row, column], TARGET.position_m, atol=1e-9)
    range_m = np.hypot(28.0, 28.0)
    expected = flight.antenna.peak_gain**2 * flight.chirp.wavelength_m**2 / ((4 * np.pi) ** 3 * range_m**4)
    assert image.power[row, column] == pytest.approx(expected, rel=0.02)
    assert np.angle(image.amplitude[row, column]) == pytest.approx(0.0, abs=0.05)  # the phase of a target is zero


@pytest.mark.parametrize("change", [{"sweep": "down"}, {"sampling": "real", "samples": 512}])
def test_down_sweeps_and_real_samples_focus_alike(caster, change):
    flight, pulses = make_flight(), make_flight().pulses(4.0, every=2)
    other = make_flight(**change)
    images = [
        focus(received(f, pulses, caster), pulses.measured, f.chirp, around(pulses), whole_beam(f.antenna))
        for f in (flight, other)
    ]
    np.testing.assert_allclose(images[1].amplitude, images[0].amplitude, atol=0.02 * np.abs(images[0].amplitude).max())


def test_a_shift_of_the_measured_track_shifts_the_image(caster):
    """Focusing knows the measured pose alone."""
    flight = make_flight()
    pulses = flight.pulses(4.0, every=2)
    shift = np.array([0.4, -0.3, 0.0])
    wrong = dataclasses.replace(pulses.measured, position_m=pulses.measured.position_m + shift)
    grid = around(pulses)
    moved = dataclasses.replace(grid, origin_m=grid.origin_m + shift)
    beats, aperture = received(flight, pulses, caster), whole_beam(flight.antenna)
    here = focus(beats, pulses.measured, flight.chirp, grid, aperture)
    there = focus(beats, wrong, flight.chirp, moved, aperture)
    np.testing.assert_allclose(there.amplitude, here.amplitude, atol=1e-6 * np.abs(here.amplitude).max())


def test_a_wobble_that_is_measured_does_no_harm_and_one_that_is_not_defocuses(caster):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=2)
    wobble = 1e-3 * np.sin(2 * np.pi * pulses.true.position_m[:, 1] / 1.3)[:, None] * np.array([1.0, 0.0, -1.0])
    true = dataclasses.replace(pulses.true, position_m=pulses.true.position_m + wobble)
    beats = received(flight, dataclasses.replace(pulses, true=true), caster)
    grid, aperture = around(pulses), whole_beam(flight.antenna)
    known = focus(beats, true, flight.chirp, grid, aperture)
    unknown = focus(beats, pulses.measured, flight.chirp, grid, aperture)
    assert widths(known)[0] == pytest.approx(azimuth_resolution_m(aperture, flight.chirp.wavelength_m), rel=0.03)
    assert unknown.power.max() < 0.5 * known.power.max()


def test_blocks_do_not_change_the_image(caster):
    flight = make_flight()
    pulses = flight.pulses(4.0, every=2)
    beats, grid, aperture = received(flight, pulses, caster), around(pulses), whole_beam(flight.antenna)
    projection = BackProjection(flight.chirp, grid, aperture)
    for start in range(0, len(pulses), 97):
        part = slice(start, start + 97)
        projection.add(beats[part], pulses.measured.rows(part))
    whole = focus(beats, pulses.measured, flight.chirp, grid, aperture)
    assert len(pulses) > 2 * PULSES_AT_ONCE
    np.testing.assert_array_equal(projection.image().amplitude, whole.amplitude)
    np.testing.assert_array_equal(projection.image().pulses, whole.pulses)


def test_a_pixel_that_no_pulse_sees_is_empty(caster):
    flight = make_flight()
    pulses = flight.pulses(0.5)
    far = ground_pixels(pulses.measured, "right", 0.0, np.array([30.0, 31.0]), np.array([28.0]))
    image = focus(received(flight, pulses, caster), pulses.measured, flight.chirp, far, whole_beam(flight.antenna))
    assert not image.amplitude.any()
    assert not image.pulses.any()


def test_too_few_chirps_a_second_are_refused_with_the_remedy(caster):
    flight = make_flight(rate_hz=200.0)
    pulses = flight.pulses(4.0)
    aperture = whole_beam(flight.antenna)
    with pytest.raises(
        ScenarioError, match=r"radar.chirp_rate_hz: 200 puts the pulses 25 mm apart .* raise it to"
    ) as e:
        focus(received(flight, pulses, caster), pulses.measured, flight.chirp, around(pulses), aperture)
    needed = float(str(e.value).split("raise it to ")[1].split(",")[0])
    enough = make_flight(rate_hz=needed)
    pulses = enough.pulses(4.0)
    focus(received(enough, pulses, caster), pulses.measured, enough.chirp, around(pulses), aperture)


NEAR_M, FAR_M, HALF_M = 26.0, 30.5, 1.5
BRIGHT_DB = 3.0


def patch(south_m: float, north_m: float, material: str) -> Surface:
    east, north = np.array([NEAR_M, FAR_M, FAR_M, NEAR_M]), np.array([south_m, south_m, north_m, north_m])
    vertices = np.column_stack([east, north, np.zeros(4)])
    return Surface(name=material, vertices_m=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]]), material=material)


@pytest.fixture(scope="module")
def field():
    """Independent pixels of a focused field whose northern half scatters 3 dB more: power, and place along."""
    flight = make_flight(rate_hz=1000.0, bandwidth_hz=1e9, samples=384)
    halves = patch(-HALF_M, 0.0, "dark"), patch(0.0, HALF_M, "bright")
    bright = ConstantGammaBackscatter(0.01 * 10 ** (BRIGHT_DB / 10))
    scene = make_scene(*halves, materials={"dark": ConstantGammaBackscatter(0.01), "bright": bright})
    pulses = flight.pulses(4.0, every=2)
    engine = PersistentEngine(scene, flight.antenna, flight.chirp, seed=3, density=400.0)
    beats = synthesise(engine.trace(pulses), pulses, flight.chirp)
    aperture = Aperture(width_rad=np.deg2rad(4.0), azimuth=flight.antenna.azimuth)
    # A spacing of 1.3 widths leaves neighbours nearly independent.
    along = 1.3 * azimuth_resolution_m(aperture, flight.chirp.wavelength_m)
    across = 1.3 * ground_range_resolution_m(flight.chirp, "hann", np.pi / 4)
    grid = ground_pixels(
        pulses.measured,
        "right",
        0.0,
        4.0 + np.arange(-HALF_M - 0.3, HALF_M + 0.3, along),
        np.arange(NEAR_M + 2 * across, FAR_M - 2 * across, across),
    )
    image = focus(beats, pulses.measured, flight.chirp, grid, aperture)
    return image.power, grid.along_m - 4.0


def inside(along_m: np.ndarray, south_m: float, north_m: float) -> np.ndarray:
    return (along_m > south_m + 0.06) & (along_m < north_m - 0.06)


def test_speckle_is_exponential_with_a_contrast_of_one(field):
    power, along = field
    halves = [power[:, inside(along, *ends)] for ends in ((-HALF_M, 0.0), (0.0, HALF_M))]
    samples = np.concatenate([(half / half.mean()).ravel() for half in halves])
    assert len(samples) > 500
    assert samples.std() == pytest.approx(1.0, abs=0.12)
    assert kstest(samples, "expon").pvalue > 0.01


def test_a_step_of_three_decibels_is_seen_where_it_is(field):
    power, along = field
    profile = power.mean(axis=0)
    dark, bright = (profile[inside(along, *ends)].mean() for ends in ((-HALF_M, 0.0), (0.0, HALF_M)))
    assert 10 * np.log10(bright / dark) == pytest.approx(BRIGHT_DB, abs=0.7)
    outside = profile[np.abs(along) > HALF_M + 0.15].mean()
    assert outside < 0.01 * dark
    # The step that fits the profile best, in logarithms as speckle multiplies.
    middle = np.abs(along) < HALF_M - 0.06
    place, level = along[middle], np.log(profile[middle])
    edges = np.arange(-1.0, 1.0, 0.02)
    misfit = [sum(np.sum((s - s.mean()) ** 2) for s in (level[place < e], level[place >= e])) for e in edges]
    assert abs(edges[int(np.argmin(misfit))]) < 0.2
