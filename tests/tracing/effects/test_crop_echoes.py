"""Crops in the beam: the waveform of a closed layer in closed form, and rows against explicit leaves."""

from functools import cache

import numpy as np
import pytest
from scipy.constants import speed_of_light

from sionna_radar.foundation.compiled import compiled
from sionna_radar.scenario import parse_scenario
from sionna_radar.surfaces.foliage import sheet_coefficients
from sionna_radar.surfaces.permittivity import leaf_permittivity, soil_permittivity
from sionna_radar.surfaces.rough_surface import fresnel_reflection
from sionna_radar.survey.preparation import prepare
from sionna_radar.tracing.paths import VEGETATION

ALTITUDE_M, CELL_M = 20.0, 0.3
FIELD = [[-40, -40], [60, -40], [60, 40], [-40, 40]]


def over_crop(carrier_hz, incidence_deg, pulses, **keys):
    """The paths of pulses to level ground under a crop, from a beam that stands still on the platform."""
    crop = {"kind": "crop", "crop": "maize", "stage": "flowering", "polygon_m": FIELD}
    scenario = parse_scenario(
        {
            "terrain": {"kind": "flat", "size_m": [300.0, 300.0]},
            "platform": {"altitude_m": ALTITUDE_M, "speed_mps": 0.5, "length_m": 4.0, "heading_deg": 90.0},
            "radar": {
                "carrier_hz": carrier_hz,
                "snr_db": 40.0,
                "samples_per_chirp": 1024,
                "antenna": {"beamwidth_deg": 2.0},
                "scan": {"mode": "fixed", "incidence_deg": incidence_deg},
            },
            "tracing": {"speckle": "per_pulse", "paths_per_pulse": 512},
            "vegetation": [crop | keys],
        }
    )
    prepared = prepare(scenario)
    block = prepared.flight.pulses(np.arange(pulses))
    return prepared, block, prepared.sensor_inputs().tracer().trace(block)


def waveform(paths, cells):
    """Power over range, summed over pulses."""
    range_m = speed_of_light * np.asarray(paths.delay_s, dtype=float) / 2
    return over_cells(range_m, cells, np.abs(paths.gain.astype(complex)) ** 2)


def over_cells(range_m, cells, power):
    """Sums of power in cells of equal length, faster than `np.histogram`, which searches each one's edges."""
    cell = np.floor((range_m - cells[0]) / CELL_M).astype(int)
    inside = (cell >= 0) & (cell < len(cells) - 1)
    return np.bincount(cell[inside], power[inside], len(cells) - 1)


def layered(prepared, incidence_deg, cells):
    """The waveform of ground under a uniform layer: attenuated ground, and the layer's exponential, over the beam."""
    cover, antenna = prepared.world.scene.vegetation, prepared.instrument.antenna
    loss, eta, height_m = cover.extinction_per_m[0], cover.backscatter_per_m[0], cover.highest_m
    width = antenna.beamwidths_rad[0]
    grid = np.concatenate([np.linspace(-20 * width, -3 * width, 60)[:-1], np.linspace(-3 * width, 3 * width, 201)])
    grid = np.concatenate([grid, np.linspace(3 * width, 20 * width, 60)[1:]])
    azimuth, elevation = (k.ravel() for k in np.meshgrid(grid, grid, indexing="ij"))
    step = np.gradient(grid)
    solid = np.outer(step, step).ravel() * np.cos(elevation)
    axis = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], 1)
    a = np.deg2rad(incidence_deg)
    down = np.cos(a) * axis[:, 0] - np.sin(a) * axis[:, 2]
    lit = down > 0.1
    weight, down = (antenna.gain(axis) ** 2 * solid)[lit], down[lit]
    ground_m = ALTITUDE_M / down
    sigma0 = prepared.world.scene.materials["ground"].co_polar.sigma0(np.arccos(down))
    power = weight * sigma0 / down / ground_m**2 * np.exp(-2 * loss * height_m / down)
    total = over_cells(ground_m, cells, power)
    steps = 120
    for n in range(steps):
        depth_m = (n + 0.5) / steps * height_m / down
        range_m = ground_m - height_m / down + depth_m
        power = weight * eta * np.exp(-2 * loss * depth_m) / range_m**2 * height_m / down / steps
        total += over_cells(range_m, cells, power)
    wavelength_m = speed_of_light / prepared.local.radar.carrier_hz
    return total * wavelength_m**2 / (4 * np.pi) ** 3


# The band is in the extinction and the backscatter alone, the incidence in all else.
@pytest.mark.parametrize(("carrier_hz", "incidence_deg"), [(24.1e9, 0.0), (77e9, 30.0), (77e9, 60.0)])
def test_the_waveform_of_a_closed_crop_is_ground_under_a_uniform_layer(carrier_hz, incidence_deg):
    pulses = 500
    prepared, _, paths = over_crop(carrier_hz, incidence_deg, pulses, height_spread=0.0)
    nearest_m = (ALTITUDE_M - prepared.world.scene.vegetation.highest_m) / np.cos(np.deg2rad(incidence_deg))
    cells = np.arange(nearest_m - 3.0, ALTITUDE_M / np.cos(np.deg2rad(incidence_deg)) + 3.0, CELL_M)
    found, expected = waveform(paths, cells) / pulses, layered(prepared, incidence_deg, cells)
    strong = expected > 0.1 * expected.max()
    error_db = 10 * np.log10(found[strong] / expected[strong])
    assert strong.sum() >= 5
    assert np.abs(error_db).max() < 0.1
    assert 10 * np.log10(found.sum() / expected.sum()) == pytest.approx(0.0, abs=0.01)


def leaves(rng, box_m, row_width_m, row_spacing_m, height_m, leaf_area_index, radius_m):
    """Explicit discs in rows: their centres and normals, spread over the sphere."""
    west, south, east, north = box_m
    count = rng.poisson(leaf_area_index * (east - west) * (north - south) / (np.pi * radius_m**2))
    row = np.round(rng.uniform(west, east, count) / row_spacing_m)
    east_m = row * row_spacing_m + rng.uniform(-0.5, 0.5, count) * row_width_m
    centre = np.column_stack([east_m, rng.uniform(south, north, count), rng.uniform(0, height_m, count)])
    normal = rng.normal(size=(count, 3))
    return centre, normal / np.linalg.norm(normal, axis=1)[:, None]


@compiled
def met(foot, back, centre, normal, radius):
    """Where a ray meets discs: distances from its foot, and cosines of incidence."""
    along, cosine = [0.0], [0.0]
    for k in range(len(centre)):
        lean = normal[k, 0] * back[0] + normal[k, 1] * back[1] + normal[k, 2] * back[2]
        off = centre[k] - foot
        s = (off[0] * normal[k, 0] + off[1] * normal[k, 1] + off[2] * normal[k, 2]) / lean
        x, y, z = s * back[0] - off[0], s * back[1] - off[1], s * back[2] - off[2]
        if s > 0 and x * x + y * y + z * z <= radius * radius:
            along.append(s)
            cosine.append(abs(lean))
    return np.array(along[1:]), np.array(cosine[1:])


@pytest.mark.study
@pytest.mark.parametrize("incidence_deg", [0.0, 35.0])
def test_rows_are_the_mean_of_explicit_leaves(incidence_deg):
    """Rays through discs in rows, each passing |T|^2 and returning |R|^2 evenly, way down and up through other leaves.

    The same leaves on both ways would pass more (`test_the_power_on_the_ground_falls_as_the_extinction_says`).
    """
    carrier_hz, radius_m, height_m = 77e9, 0.03, 1.0
    rows = {"row_spacing_m": 0.75, "row_width_m": 0.45, "height_m": height_m, "leaf_area_index": 1.5}
    rows |= {"height_spread": 0.0, "stage": "stem_elongation"}
    prepared, block, paths = over_crop(carrier_hz, incidence_deg, 2500, **rows)
    tracer = prepared.sensor_inputs().tracer()
    tracer._canopy = None
    bare = tracer.trace(block)
    position_m = block.true.position_m[block.row_of(bare.pulse)]
    back = position_m - bare.hit_m
    range_m = np.linalg.norm(back, axis=1)
    back /= range_m[:, None]
    # The main beam alone, by its rays; both worlds have the same.
    main = np.abs(range_m - ALTITUDE_M / np.cos(np.deg2rad(incidence_deg))) < 0.8
    main &= np.abs(bare.hit_m[:, 1]) < 0.8
    ground = np.flatnonzero(paths.surface >= 0)
    plants = np.flatnonzero(paths.surface == VEGETATION)
    np.testing.assert_array_equal(paths.hit_m[ground], bare.hit_m)
    chosen = np.zeros(len(paths), dtype=bool)
    chosen[ground[main]] = True
    line = np.abs(paths.hit_m[plants, 1]) < 0.8
    chosen[plants[line & (np.abs(paths.hit_m[plants, 0] - position_m[:, 0].mean()) < 40)]] = True
    cells = np.arange(range_m[main].min() - 2.0, range_m[main].max() + 0.3, CELL_M)
    found = waveform(paths.rows(np.flatnonzero(chosen)), cells) / main.sum()

    grown = prepared.local.vegetation[0]
    permittivity = leaf_permittivity(carrier_hz, water_content=grown.grown.water_content)
    sheet = permittivity, grown.planted.leaf_thickness_mm / 1e3, speed_of_light / carrier_hz
    returned = np.abs(sheet_coefficients(*sheet, np.ones(1))[0][0, 0]) ** 2
    sigma0 = prepared.world.scene.materials["ground"].co_polar.sigma0(bare.incidence_rad)
    rng = np.random.default_rng(1)
    foot = bare.hit_m[main]
    box = foot[:, 0].min() - 0.5, foot[:, 1].min() - 0.5, foot[:, 0].max() + 1.5, foot[:, 1].max() + 0.5
    rays, fields = 300, 40
    each = np.zeros((fields, len(cells) - 1))
    cosines = np.linspace(0, 1, 2001)
    through = np.mean(np.abs(sheet_coefficients(*sheet, cosines)[1]) ** 2, axis=0)
    for expected in each:
        down, up = (leaves(rng, box, 0.45, 0.75, height_m, 1.5, radius_m) for _ in range(2))
        for ray in rng.choice(np.flatnonzero(main), rays):
            ways = [met(bare.hit_m[ray], back[ray], *discs, radius_m) for discs in (down, up)]
            passed = [np.interp(cosine, cosines, through) for _, cosine in ways]
            power = np.abs(bare.gain[ray].astype(complex)) ** 2
            whole = power * passed[0].prod() * passed[1].prod()
            expected[np.searchsorted(cells, range_m[ray]) - 1] += whole
            beam = power * range_m[ray] ** 2 * np.cos(bare.incidence_rad[ray]) / sigma0[ray]
            for place_m in ways[0][0]:
                before = np.prod([p[along > place_m].prod() for (along, _), p in zip(ways, passed, strict=True)])
                away_m = range_m[ray] - place_m
                expected[np.searchsorted(cells, away_m) - 1] += beam * returned * before / away_m**2
    mean, sigma = each.mean(axis=0) / rays, each.std(axis=0) / rays / np.sqrt(fields)
    strong = mean > 0.1 * mean.max()
    # Other leaves and rays (four draws) moved single cells by up to 0.6 dB, all of it by up to 0.2 dB.
    assert np.abs(10 * np.log10(found[strong] / mean[strong])).max() < 0.7
    assert np.median(sigma[strong] / mean[strong]) < 0.05
    assert 10 * np.log10(found.sum() / mean.sum()) == pytest.approx(0.0, abs=0.25)


SOIL = {"temperature_c": 15.0, "sand_percent": 40.0, "clay_percent": 20.0, "water_fraction": 0.2}
# Radii of maize stems, m, and the rms slope of a seedbed: typical.
STEM_RADII_M, SLOPE = {"leaf_development": 0.005, "stem_elongation": 0.01, "flowering": 0.012, "ripe": 0.011}, 0.24


@cache
def planted(carrier_hz, stage):
    """Return a flight over level ground under maize, prepared once."""
    return prepare(
        parse_scenario(
            {
                "terrain": {"kind": "flat", "size_m": [100.0, 100.0]},
                "platform": {"altitude_m": ALTITUDE_M, "speed_mps": 5.0, "length_m": 5.0},
                "radar": {"carrier_hz": carrier_hz, "snr_db": 30.0, "scan": {"mode": "fixed", "incidence_deg": 0.0}},
                "vegetation": [{"kind": "crop", "crop": "maize", "stage": stage, "polygon_m": FIELD}],
            }
        )
    )


def double_bounce_db(carrier_hz, stage, incidence_deg, polarization):
    """A bound of the echo by stem and ground, and that of soil and of leaves: sigma0 in dB, all dimmed as they arrive.

    In geometrical optics. Upright smooth stems of radius a and length L return by the ground, in both orders in phase,
    sigma = 4 pi a L G_ground G_stem / (sqrt(2 pi) s) each: a stem's section 2 a L sin t catches what the ground
    reflects, turns it around in azimuth with a density of 1/4 per radian, and slopes s of the ground spread it over
    2 s in elevation. The way through the leaves is that of the ground's echo, wherever on the stem.
    """
    prepared = planted(carrier_hz, stage)
    cover, grown = prepared.world.scene.vegetation, prepared.local.vegetation[0].grown
    rows = grown.row_width_m / 0.75
    loss, eta = cover.extinction_per_m[0] * rows, cover.backscatter_per_m[0] * rows
    angle = np.deg2rad(incidence_deg)
    soil = soil_permittivity(carrier_hz, specific_gravity=2.65, **SOIL)
    stem = leaf_permittivity(carrier_hz, water_content=0.85)
    reflected = 1.0
    for medium, cosine in ((soil, np.cos(angle)), (stem, np.sin(angle))):
        reflected *= np.abs(fresnel_reflection(medium, np.array([cosine]), polarization)[0]) ** 2
    stems_per_m2 = 1 / (0.75 * 0.16)
    passed = np.exp(-2 * loss * grown.height_m / np.cos(angle))
    bounced = stems_per_m2 * 4 * np.pi * STEM_RADII_M[stage] * grown.height_m * reflected / (np.sqrt(2 * np.pi) * SLOPE)
    leaf = eta * np.cos(angle) / (2 * loss) * (1 - passed)
    return 10 * np.log10([bounced * passed, 0.1 * np.cos(angle) * passed, leaf])


@pytest.mark.parametrize(
    ("carrier_hz", "stage", "over_soil_db", "over_leaves_db"),
    [
        (24.1e9, "leaf_development", (-8.2, 1.4), (-8.1, -0.3)),
        (24.1e9, "stem_elongation", (-0.2, 9.4), (-10.1, -2.2)),
        (24.1e9, "flowering", (3.9, 13.6), (-13.6, -5.1)),
        (24.1e9, "ripe", (3.4, 13.0), (-1.7, 6.0)),
        (77e9, "leaf_development", (-14.0, -1.4), (-14.4, -3.6)),
        (77e9, "stem_elongation", (-6.0, 6.6), (-16.8, -5.7)),
        (77e9, "flowering", (-1.9, 10.8), (-20.5, -9.5)),
        (77e9, "ripe", (-2.4, 10.2), (-9.9, 1.2)),
    ],
)
def test_double_bounces_are_bounded_as_the_page_says(carrier_hz, stage, over_soil_db, over_leaves_db):
    """V and H, at most over 15 to 60 deg: over soil of gamma = -10 dB, and over the leaves' echo."""
    for polarization, over_soil, over_leaves in zip("VH", over_soil_db, over_leaves_db, strict=True):
        levels = [double_bounce_db(carrier_hz, stage, t, polarization) for t in (15.0, 30.0, 45.0, 60.0)]
        bounced, soil, leaves_ = np.transpose(levels)
        assert (bounced - soil).max() == pytest.approx(over_soil, abs=0.06)
        assert (bounced - leaves_).max() == pytest.approx(over_leaves, abs=0.06)
