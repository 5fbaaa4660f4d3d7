"""Surveys made by hand: an analytic hill, a DEM of known error over it, and points on the beam axes."""

from dataclasses import replace

import numpy as np

from scenario_keys import with_keys
from seen_points import seen_points
from sionna_radar.accuracy.truth import compare_dem
from sionna_radar.flight.build import flight_plan, plan_track
from sionna_radar.flight.pulses import PulseSchedule, schedule_pulses
from sionna_radar.flight.trajectory import plan_trajectory
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.scenario import Scenario, parse_scenario
from sionna_radar.scene.build import World
from sionna_radar.scene.model import Surface, mesh_of
from sionna_radar.scene.raycast import RayCaster
from sionna_radar.survey.preparation import prepare
from sionna_radar.survey.result import Survey
from sionna_radar.survey.sensors.sweeps import ChirpRecord

# A radar whose echoes its noise reaches.
WEAK = {
    "radar.snr_db": None,
    "radar.transmit_power_dbm": -12.0,
    "radar.noise_figure_db": 15.0,
    "radar.samples_per_chirp": 512,
    "radar.bandwidth_hz": 250e6,
    "terrain.spacing_m": 4.0,
    "tracing.paths_per_pulse": 128,
    "platform.length_m": 10.0,
}
# A scenario file that is flown in a second.
SMALL = """
seed = 5
[terrain]
kind = "flat"
size_m = [300.0, 300.0]
[platform]
altitude_m = 50.0
speed_mps = 10.0
length_m = 5.0
start_m = [-60.0, 0.0]
[radar]
snr_db = 30.0
[tracing]
paths_per_pulse = 64
"""
# A small survey of hills.
HILLS = {
    "seed": 4,
    "terrain": {"kind": "hills", "size_m": [340.0, 340.0], "spacing_m": 2.0, "seed": 2},
    "platform": {"altitude_m": 50.0, "speed_mps": 10.0, "length_m": 20.0},
    "radar": {"snr_db": 30.0},
    "tracing": {"paths_per_pulse": 128},
}
SIZE_M = 120.0
EMPTY_PATCH = (slice(20, 32), slice(70, 90))


def hills(**keys: object) -> Scenario:
    """Return the small survey of hills with dotted keys (written with __) set."""
    return parse_scenario(with_keys(HILLS, keys))


def hill(point_m: np.ndarray, size_m: float = SIZE_M) -> np.ndarray:
    """Height of a hill 8 m high north-east of the middle, and a dip to the south-west."""
    u, v = (point_m / size_m).T
    return 8 * np.exp(-((u - 0.1) ** 2 + (v - 0.1) ** 2) / 0.03) - 3 * np.exp(-((u + 0.2) ** 2 + v**2) / 0.02)


def make_scenario(size_m: float, **radar: object) -> Scenario:
    return parse_scenario(
        {
            "seed": 7,
            # The swath and the ranges of the survey must stay on the ground.
            "terrain": {"kind": "flat", "size_m": [size_m + 400.0, size_m + 400.0], "spacing_m": max(5.0, size_m / 50)},
            "platform": {
                "altitude_m": 50.0,
                "speed_mps": 10.0,
                "length_m": 0.8 * size_m,
                "heading_deg": 70.0,
                "profile": "full",
            },
            "radar": {"snr_db": 30.0, "chirp_rate_hz": 360.0, **radar},
            "dem": {"spacing_m": size_m / SIZE_M},
        }
    )


def ground_points(schedule: PulseSchedule, grid: Grid, rng: np.random.Generator) -> Points:
    """Points of every pulse whose boresight reaches level ground inside the grid."""
    pulses = schedule.pulses(np.arange(len(schedule)))
    origin, boresight = pulses.true.position_m, pulses.true.boresight
    range_m = -origin[:, 2] / boresight[:, 2]
    position = origin + range_m[:, None] * boresight
    west, east, south, north = grid.extent_m
    inside = (position[:, 0] > west) & (position[:, 0] < east)
    inside &= (position[:, 1] > south) & (position[:, 1] < north)
    count, range_m = int(inside.sum()), range_m[inside]
    return seen_points(
        position[inside],
        origin[inside],
        pulse=np.flatnonzero(inside),
        range_m=range_m,
        range_sigma_m=np.full(count, 0.25),
        power=1e-12 * rng.exponential(size=count) * (50 / range_m) ** 4,
        echo_snr_db=rng.uniform(12, 40, count),
    )


def make_record(scenario: Scenario, rng: np.random.Generator) -> ChirpRecord:
    """Two scatterers, at 44 and 68 m, in weak noise."""
    radar = scenario.radar
    count, rate = radar.samples_per_chirp, radar.chirp_rate_hz
    time_s = np.arange(count) / (count * rate)
    cells = np.array([44.0, 68.0]) * 2 * radar.bandwidth_hz / 299792458
    phase = 2 * np.pi * np.outer(time_s * rate, cells)
    beat = (np.exp(1j * phase) * [0.7e-6, 1.2e-6]).sum(axis=1) + 1e-7 * rng.normal(size=count)
    if radar.sampling == "real":
        beat = beat.real
    power = np.abs(np.fft.fft(beat * np.hanning(count))[: count // 2] / count) ** 2
    threshold = np.full(len(power), 20 * np.median(power))
    threshold[:10] = np.nan
    found = np.round(cells).astype(int)
    range_m = np.arange(count // 2) * 299792458 / (2 * radar.bandwidth_hz)
    return ChirpRecord(
        pulse=5,
        sample_time_s=time_s,
        beat=beat,
        range_m=range_m,
        power=power,
        threshold=threshold,
        echo_range_m=range_m[found],
        echo_power=power[found],
    )


def make_survey(*, size_m: float = SIZE_M, height_m: float = 0.0, **radar: object) -> Survey:
    """Return a survey of the hill, stretched to a size and raised to a height."""
    rng = np.random.default_rng(3)
    scenario = make_scenario(size_m, **radar)
    spacing = scenario.dem.spacing_m
    start = spacing / 2 - size_m / 2
    grid = Grid(west_m=start, south_m=start, spacing_m=spacing, columns=int(SIZE_M), rows=int(0.8 * SIZE_M))

    def ground_m(point_m: np.ndarray) -> np.ndarray:
        return hill(point_m, size_m) + height_m

    truth = Raster(grid=grid, height_m=ground_m(grid.centres_m).reshape(grid.shape))
    dem_height = truth.height_m + rng.normal(0.05, 0.2, grid.shape)
    dem_height[EMPTY_PATCH] = np.nan
    dem = Raster(grid=grid, height_m=dem_height)
    track = plan_track(scenario.platform, (-0.2 * size_m, 0.0))
    trajectory = plan_trajectory(flight_plan(scenario.platform), track, ground_m)
    vertices, faces = mesh_of(truth)
    surface = Surface(name="hill", vertices_m=vertices, faces=faces, material="ground")
    prepared = prepare(scenario)
    prepared = replace(
        prepared,
        plan=replace(
            prepared.plan,
            flight=schedule_pulses(trajectory, prepared.flight.scan, scenario.radar.chirp_rate_hz),
            mapper=replace(prepared.mapper, grid=grid),
        ),
        world=World(
            scene=replace(prepared.world.scene, surfaces=(surface,)),
            ground_m=ground_m,
            caster=RayCaster((surface,)),
        ),
    )
    return Survey(
        prepared=prepared,
        paths=512 * len(prepared),
        points=ground_points(prepared.flight, grid, rng),
        dem=dem,
        **vars(compare_dem(dem, truth, np.ones(grid.shape, dtype=bool), None)),
        chirp=make_record(scenario, rng),
        timing_s={"tracing": 1.5, "total": 2.25},
        peak_memory_mb=512.5,
    )


def make_empty(survey: Survey) -> Survey:
    """Return a survey that detected nothing: no points, no DEM, no echo in its chirp."""
    points, chirp = survey.points, survey.chirp
    nothing = np.zeros(0, dtype=int)
    columns = ("pulse", "number", "position_m", "origin_m", "range_m", "range_sigma_m", "power", "echo_snr_db")
    dem = replace(survey.dem, height_m=np.full(survey.dem.grid.shape, np.nan))
    return replace(
        survey,
        points=replace(points, **{name: getattr(points, name)[nothing] for name in columns}),
        dem=dem,
        **vars(compare_dem(dem, survey.truth, np.ones(dem.grid.shape, dtype=bool), None)),
        chirp=replace(chirp, echo_range_m=chirp.range_m[nothing], echo_power=chirp.power[nothing]),
    )
