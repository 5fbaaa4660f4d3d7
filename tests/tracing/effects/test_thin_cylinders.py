"""Thin cylinders against closed forms, an oracle of faces, and the antenna's polarization."""

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.radar.antenna import Antenna, Cut
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scene.model import Body, Surface
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.scene.wires import Strands, ThinObstacle, Wire, lattice_mast, offset_line
from sionna_radar.tracing.effects.physical_optics import Scatterer
from sionna_radar.tracing.effects.thin_cylinders import ThinTracer, cylinder_amplitudes, grating_orders
from sionna_radar.tracing.paths import FIRST_OBSTACLE

# A triangle far below everything.
DEEP = np.array([[0.0, 0.0, -9e4], [1.0, 0.0, -9e4], [0.0, 1.0, -9e4]])
NOTHING = RayCaster([Surface(name="deep", vertices_m=DEEP, faces=np.array([[0, 1, 2]]), material="")])


def wide_antenna(**options: object) -> Antenna:
    """An antenna whose gain hardly changes over the wires of these tests."""
    cut = Cut(np.cos(np.linspace(-np.pi / 2, np.pi / 2, 2001)))
    return Antenna(azimuth=cut, elevation=cut, **options)


def looking(place_m: np.ndarray, toward_m: np.ndarray) -> Pulses:
    """One pulse of a radar that looks at a point with its antenna upright."""
    ahead = (toward_m - place_m) / np.linalg.norm(toward_m - place_m)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    left /= np.linalg.norm(left)
    turn = np.column_stack([ahead, left, np.cross(ahead, left)])
    pose = Pose(position_m=place_m[None], velocity_mps=np.zeros((1, 3)), R_world_antenna=turn[None])
    return Pulses(index=np.zeros(1, np.int64), time_s=np.zeros(1), scan_rad=np.zeros(1), true=pose, measured=pose)


def rcs_m2(wire: Wire, place_m: np.ndarray, carrier_hz: float, antenna: Antenna | None = None) -> float:
    """Cross-section of a wire as the sum of its paths, seen from a place that looks at the origin."""
    antenna = antenna or wide_antenna()
    chirp = Chirp(carrier_hz=carrier_hz, bandwidth_hz=1e6, rate_hz=1000.0, samples=100_000)
    obstacle = ThinObstacle(name="wires.0", kind="wires", wires=(wire,))
    paths = ThinTracer([obstacle], antenna, chirp, NOTHING).trace(looking(place_m, np.zeros(3)))
    assert np.all(paths.surface == FIRST_OBSTACLE)
    field = np.sum(paths.gain * np.exp(-2j * np.pi * carrier_hz * paths.delay_s))
    range_m, wavelength_m = float(np.linalg.norm(place_m)), speed_of_light / carrier_hz
    return float(abs(field) ** 2 * (4 * np.pi) ** 3 * range_m**4 / (antenna.peak_gain * wavelength_m) ** 2)


def level_wire(length_m: float, radius_m: float, **options: object) -> Wire:
    """A wire along the y axis about the origin."""
    ends = np.array([[0.0, -length_m / 2, 0.0], [0.0, length_m / 2, 0.0]])
    return Wire(vertex_m=ends, radius_m=radius_m, **options)


def from_slant(range_m: float, slant_rad: float) -> np.ndarray:
    """A place in the plane of the wire and the x axis."""
    return range_m * np.array([-np.cos(slant_rad), np.sin(slant_rad), 0.0])


def db(ratio: float) -> float:
    """Ten times the decimal logarithm."""
    return 10 * np.log10(ratio)


@pytest.mark.parametrize("carrier_hz", [24e9, 77e9, 140e9])
@pytest.mark.parametrize("diameter_m", [0.5e-3, 1.2e-3, 5e-3, 30e-3])
@pytest.mark.parametrize("lobes", [0.0, 0.3, 1.43, 2.46])
def test_a_short_wire_far_away_has_the_cross_section_and_the_lobes_of_the_series(
    carrier_hz: float, diameter_m: float, lobes: float
) -> None:
    """sigma = 4 L^2 / pi |S|^2 sinc^2, for the field along the wire (H) and across it (V)."""
    k, length_m = 2 * np.pi * carrier_hz / speed_of_light, 0.3
    slant = np.arcsin(lobes * np.pi / (k * length_m))
    for polarization, field in (("H", 0), ("V", 1)):
        amplitude = abs(cylinder_amplitudes(np.array([k * diameter_m / 2 * np.cos(slant)]))[field][0])
        expected = 4 * length_m**2 / np.pi * amplitude**2 * np.sinc(lobes) ** 2
        found = rcs_m2(
            level_wire(length_m, diameter_m / 2),
            from_slant(3000.0, slant),
            carrier_hz,
            wide_antenna(polarization=polarization),
        )
        assert db(found / expected) == pytest.approx(0, abs=0.1)


def test_series_tends_to_physical_optics_and_to_the_thin_wire() -> None:
    """sqrt(pi x) / 2 for thick cylinders; -pi / 2 / (ln(x / 2) + gamma + j pi / 2) for thin ones along the field."""
    along, across = cylinder_amplitudes(np.array([300.0]))
    assert abs(along[0]) == pytest.approx(np.sqrt(np.pi * 300) / 2, rel=2e-3)
    assert across[0] == pytest.approx(along[0], rel=5e-3)
    x = 1e-3
    thin = np.pi / 2 / abs(np.log(x / 2) + np.euler_gamma + 1j * np.pi / 2)
    assert abs(cylinder_amplitudes(np.array([x]))[0][0]) == pytest.approx(thin, rel=1e-4)


@pytest.mark.parametrize("range_m", [5.0, 50.0, 400.0])
@pytest.mark.parametrize(("carrier_hz", "diameter_m"), [(24e9, 30e-3), (77e9, 22e-3), (140e9, 10e-3)])
def test_a_long_wire_returns_pi_a_r(range_m: float, carrier_hz: float, diameter_m: float) -> None:
    """Of a line far longer than its first Fresnel zone, thick against the wavelength."""
    found = rcs_m2(level_wire(1.2 * range_m, diameter_m / 2), from_slant(range_m, 0.0), carrier_hz)
    amplitude = abs(cylinder_amplitudes(np.array([np.pi * carrier_hz / speed_of_light * diameter_m]))[1][0])
    exact = 4 / np.pi * amplitude**2 * speed_of_light / carrier_hz * range_m / 2
    assert db(exact / (np.pi * diameter_m / 2 * range_m)) == pytest.approx(0, abs=0.3)
    # The ends, off the beam's axis, add ripples.
    assert db(found / exact) == pytest.approx(0, abs=0.3)


def tube(radius_m: float, length_m: float, around: int, along: int) -> Body:
    """The side of a cylinder along y, as faces."""
    angle = 2 * np.pi * np.arange(around) / around
    place = np.linspace(-length_m / 2, length_m / 2, along + 1)
    vertex = np.array([[radius_m * np.cos(a), y, radius_m * np.sin(a)] for y in place for a in angle])
    return Body(vertices_m=vertex, faces=_quads(around, along), two_sided=np.zeros(2 * around * along, dtype=bool))


def _quads(around: int, along: int) -> np.ndarray:
    faces = []
    for j in range(along):
        for i in range(around):
            a, b = j * around + i, j * around + (i + 1) % around
            faces += [[a, a + around, b], [b, a + around, b + around]]
    return np.array(faces)


def test_a_thick_short_wire_agrees_with_the_faces_of_a_target() -> None:
    """Physical optics of a tube of faces, in the near field and aside of broadside."""
    radius_m, length_m, carrier_hz = 10e-3, 0.2, 77e9
    scatterer = Scatterer(tube(radius_m, length_m, 240, 100), speed_of_light / carrier_hz)
    for range_m, slant in ((3.0, 0.0), (3.0, 0.012), (40.0, 0.0), (40.0, 0.014)):
        place = from_slant(range_m, slant)
        amplitude = scatterer.amplitude(place[None])[0]
        away = np.linalg.norm(scatterer.middle_m - place, axis=1)
        phase = np.exp(-4j * np.pi / scatterer.wavelength_m * (away - range_m))
        faces = abs(np.sum(amplitude * phase * (range_m / away) ** 2)) ** 2
        assert db(rcs_m2(level_wire(length_m, radius_m), place, carrier_hz) / faces) == pytest.approx(0, abs=0.25)


def cable(radius_m: float, strands: Strands, length_m: float, around: int, along: int) -> Body:
    """The surface of a stranded conductor along y, as faces: `around` of each strand, from notch to notch."""
    sine = np.sin(np.pi / strands.count)
    strand = radius_m * sine / (1 + sine)
    centre = radius_m - strand
    on_strand = ((np.arange(around) + 0.5) / around - 0.5) * (np.pi + 2 * np.pi / strands.count)
    g = np.hypot(centre + strand * np.cos(on_strand), strand * np.sin(on_strand))
    x = np.arctan2(strand * np.sin(on_strand), centre + strand * np.cos(on_strand))
    turns = 2 * np.pi * np.arange(strands.count) / strands.count
    vertex = []
    for y in np.linspace(-length_m / 2, length_m / 2, along + 1):
        angle = np.add.outer(turns + 2 * np.pi * y / strands.lay_m, x).ravel()
        far = np.tile(g, strands.count)
        # About y, from x towards -z.
        vertex.append(np.column_stack([far * np.cos(angle), np.full(len(far), y), -far * np.sin(angle)]))
    faces = _quads(around * strands.count, along)[:, ::-1]
    return Body(vertices_m=np.concatenate(vertex), faces=faces, two_sided=np.zeros(len(faces), dtype=bool))


@pytest.mark.parametrize(("carrier_hz", "count", "lay_m"), [(77e9, 12, 0.12), (35e9, 6, 0.10), (94e9, 24, 0.25)])
def test_strands_return_lobes_in_place_and_height(carrier_hz: float, count: int, lay_m: float) -> None:
    """Each order at sin t = -m wavelength / (2 period), as high as from the visible faces of the twisted surface."""
    radius_m, strands, wavelength_m = 8e-3, Strands(count=count, lay_m=lay_m), speed_of_light / carrier_hz
    scatterer = Scatterer(cable(radius_m, strands, 4 * strands.period_m, 16, 80), wavelength_m)
    wire = level_wire(4 * strands.period_m, radius_m, strands=strands)
    orders, ratio = grating_orders(radius_m, strands, wavelength_m)
    strong = [
        order for order, high in zip(orders, ratio, strict=True) if order >= 0 and abs(high) > 0.32 * abs(ratio).max()
    ]
    assert len(strong) >= 2
    for order in strong:
        slant = np.arcsin(-order * wavelength_m / (2 * strands.period_m))
        place = from_slant(400.0, slant)
        away = np.linalg.norm(scatterer.middle_m - place, axis=1)
        field = scatterer.amplitude(place[None])[0] * np.exp(-4j * np.pi / wavelength_m * (away - 400.0))
        assert db(rcs_m2(wire, place, carrier_hz) / abs(np.sum(field)) ** 2) == pytest.approx(0, abs=0.5)
        # Beside the lobe, as far as the length of this cable resolves.
        aside = from_slant(400.0, slant + 0.9 * wavelength_m / (8 * strands.period_m) / np.cos(slant))
        assert rcs_m2(wire, aside, carrier_hz) < 0.5 * rcs_m2(wire, place, carrier_hz)


def test_polarization_of_a_wire_follows_its_direction() -> None:
    """A very thin wire returns the field along it only: at 45 degrees a quarter of it in either port."""
    turned = Wire(vertex_m=np.array([[0.0, -0.1, -0.1], [0.0, 0.1, 0.1]]), radius_m=2e-5)
    along = level_wire(0.2 * np.sqrt(2), 2e-5)
    place = from_slant(2000.0, 0.0)
    whole = rcs_m2(along, place, 77e9, wide_antenna(polarization="H"))
    for polarization, receives in (("H", "co"), ("V", "co"), ("H", "cross")):
        antenna = wide_antenna(polarization=polarization, receives=receives)
        assert rcs_m2(turned, place, 77e9, antenna) / whole == pytest.approx(0.25, rel=0.02)


def test_hanging_wire_is_one_parabola_however_it_is_divided() -> None:
    """Ends, depth in the middle, and points of a fine and a coarse division."""
    wire = Wire(vertex_m=np.array([[0.0, 0.0, 10.0], [100.0, 0.0, 14.0]]), radius_m=0.01, sag_m=3.0)
    fine, coarse = wire.points(0.5), wire.points(30.0)
    np.testing.assert_allclose(coarse[[0, -1]], [[0, 0, 10], [100, 0, 14]])
    expected = 10 + 0.04 * coarse[:, 0] - 4 * 3 * coarse[:, 0] * (100 - coarse[:, 0]) / 1e4
    np.testing.assert_allclose(coarse[:, 2], expected, atol=1e-9)
    np.testing.assert_allclose(np.interp(coarse[:, 0], fine[:, 0], fine[:, 2]), coarse[:, 2], atol=1e-4)


def test_a_sagging_wire_glints_where_it_is_square_to_the_radar() -> None:
    """From beside the lowest point along the wire its curvature widens or narrows the Fresnel zone.

    Bent towards the radar with the radius R it has the zone of the range r R / (R - r), away from it r R / (R + r).
    """
    sag_m, span_m, range_m, radius_m = 5.0, 100.0, 30.0, 5e-3
    bend_m = span_m**2 / (8 * sag_m)
    ends = np.array([[0.0, -span_m / 2, sag_m], [0.0, span_m / 2, sag_m]])
    wire = Wire(vertex_m=ends, radius_m=radius_m, sag_m=sag_m)
    carrier_hz = 77e9
    amplitude = abs(cylinder_amplitudes(np.array([2 * np.pi * carrier_hz / speed_of_light * radius_m]))[1][0])
    for height_m, zone_m in (
        (-range_m, range_m * bend_m / (range_m + bend_m)),
        (range_m, range_m * bend_m / (bend_m - range_m)),
    ):
        expected = 4 / np.pi * amplitude**2 * speed_of_light / carrier_hz * zone_m / 2
        place = np.array([1e-6, 0.0, height_m])
        found = rcs_m2(wire, place, carrier_hz, wide_antenna(polarization="V"))
        assert db(found / expected) == pytest.approx(0, abs=0.4)


def test_parallels_keep_their_distance_round_a_corner() -> None:
    """Both legs lie to the right by the offset."""
    line = offset_line(np.array([[0.0, 0.0, 5.0], [10.0, 0.0, 5.0], [10.0, 10.0, 5.0]]), 2.0)
    np.testing.assert_allclose(line, [[0, -2, 5], [12, -2, 5], [12, 10, 5]], atol=1e-12)


def test_lattice_mast_is_braced_from_foot_to_top() -> None:
    """Members join all levels; the highest ring is at the top."""
    members = lattice_mast(np.array([1.0, 2.0, 3.0]), 30.0, 4.0, 1.0)
    ends = np.concatenate(members)
    assert ends[:, 2].min() == pytest.approx(3.0)
    assert ends[:, 2].max() == pytest.approx(33.0)
    assert len(members) > 60
