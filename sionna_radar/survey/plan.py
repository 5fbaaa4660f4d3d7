"""The plan of a survey: what an instrument flies over a world, and the map that it makes."""

from dataclasses import dataclass

import numpy as np

from sionna_radar.detection.build import build_expected_ground
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.flight.build import build_navigation, plan_route
from sionna_radar.flight.pulses import Bursts, PulseSchedule, in_bursts, schedule_pulses
from sionna_radar.flight.route import Route
from sionna_radar.flight.trajectory import Flight
from sionna_radar.foundation.errors import PluginError, ScenarioError
from sionna_radar.foundation.progress import advance
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.build import build_mapper, speckle_memory
from sionna_radar.mapping.mapper import Extent, Mapper, dem_grid
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.parts import SENSORS
from sionna_radar.scenario.radar import PanoramicScanTable
from sionna_radar.scene.build import World
from sionna_radar.scene.terrains.build import map_frame
from sionna_radar.survey.checks import (
    SAMPLED_PULSES,
    BoresightHits,
    boresight_hits,
    check_geometry,
    check_nominal_range,
    check_pulses,
    warn_of_repeated_angles,
)
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.instrument import Instrument
from sionna_radar.survey.limits import check_paths, check_route
from sionna_radar.survey.obstacles import rule_of


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A flight over a world, and its map.

    route: the way before its ground is known.
    flown: the trajectory with its nominal height and speed, and what a log gave for it.
    flight: the pulses.
    bursts: the chirps that are averaged to each pulse of the flight, or the frame that it is; None for one.
    hits: where the boresights of pulses spread over the flight meet the world.
    ground_extent_m: west, south, east and north of the ground that the beam's axis meets, or an array sees.
    mapper: from points to a DEM.
    expected_ground: what is known of the ground beforehand; None for nothing.
    """

    route: Route
    flown: Flight
    flight: PulseSchedule
    bursts: Bursts | None
    hits: BoresightHits
    ground_extent_m: Extent
    mapper: Mapper
    expected_ground: ExpectedGround | None


def checked_route(local: Scenario, instrument: Instrument) -> Route:
    """Return the flight before its ground is known; ScenarioError for one beyond the limits of the radar."""
    if isinstance(local.radar.scan, PanoramicScanTable):
        message = "'panoramic' shows the surroundings and maps no heights; use `sionna-radar panorama`"
        raise ScenarioError.of("radar.scan.mode", message)
    route = plan_route(local.platform, lambda: map_frame(local.terrain))
    check_route(local, instrument, route)
    if route.altitude_m is not None:
        check_nominal_range(instrument, route.altitude_m, route.duration_s)
    return route


def build_plan(local: Scenario, instrument: Instrument, route: Route, world: World, custom: CustomParts) -> Plan:
    """Return the flight and the map of a scenario.

    Raises ScenarioError for a flight without pulses, a swath that leaves the terrain, a map that is too large, or a
        method without the profiles that it requires.
    """
    place = world.scene.georeference
    datum_m = place.origin_m[2] if place else 0.0
    flown = route.fly(world.ground_m, local.seed, datum_m)
    if route.altitude_m is None:
        check_paths(local, instrument, flown.altitude_m)
    schedule = _schedule(local, instrument, flown, datum_m, custom)
    if instrument.frames is None or instrument.module is None:
        bursts = in_bursts(schedule, local.processing.average.chirps, local.radar.chirp_rate_hz)
    else:
        bursts = Bursts(schedule=schedule, chirps=instrument.module.chirps, period_s=instrument.module.period_s)
    flight = schedule if bursts is None else bursts.schedule
    check_pulses(flight, local.radar.chirp_rate_hz)
    hits = boresight_hits(flight, world)
    check_geometry(hits, world, instrument.chirp)
    advance()
    extent_m = _mapped_extent_m(instrument, flown, flight, hits)
    max_gap_m = local.dem.max_gap_m or _sampling_gap(local, instrument, flown)
    memory, grid = speckle_memory(local), dem_grid(local.dem.spacing_m, extent_m, max_gap_m, place)
    mapper = build_mapper(
        local.dem,
        grid,
        max_gap_m,
        # The points of an array lie at single places.
        instrument.antenna if local.sensor not in ("lidar", "mimo") else None,
        instrument.detector.analyser,
        local.processing.doppler_correction,
        custom.dem_method,
        memory,
        measured_ground=local.measured_ground or isinstance(custom.terrain, Raster),
        ground=local,
        obstacles=rule_of(local, instrument.detector.analyser.chirp.range_resolution_m, max_gap_m),
    )
    _check_profiles(local, mapper, custom)
    expected = local.processing.expected_ground
    return Plan(
        route=route,
        flown=flown,
        flight=flight,
        bursts=bursts,
        hits=hits,
        ground_extent_m=extent_m,
        mapper=mapper,
        expected_ground=build_expected_ground(expected, flown.altitude_m, instrument.antenna, grid, place),
    )


def _schedule(
    local: Scenario, instrument: Instrument, flown: Flight, datum_m: float, custom: CustomParts
) -> PulseSchedule:
    """Return the pulses of a flight, each a chirp or a frame."""
    errors, stagger = local.platform.navigation, local.radar.stagger
    scan, rate_hz = instrument.scan, instrument.pulse_rate_hz
    if local.sensor == "radar" and custom.flight is None:
        warn_of_repeated_angles(instrument, flown.altitude_m, flown.speed_mps, stagger)
    navigation = custom.navigation or build_navigation(errors, flown.trajectory, rate_hz, local.seed)
    if custom.flight is not None:
        return custom.flight.schedule(flown, scan, datum_m, navigation, errors.lever_arm_m)
    return schedule_pulses(
        flown.trajectory, scan, rate_hz, lever_arm_m=errors.lever_arm_m, navigation=navigation, stagger=stagger
    )


def _mapped_extent_m(instrument: Instrument, flown: Flight, flight: PulseSchedule, hits: BoresightHits) -> Extent:
    """Return the extent of the DEM: the ground that the beam's axis meets, or what an array sees to its sides."""
    extent_m = hits.extent_m
    if instrument.frames is None:
        return extent_m
    reach_m = flown.altitude_m * np.tan(np.deg2rad(instrument.frames.half_view_deg))
    pose = flight.sample(SAMPLED_PULSES).measured
    left = np.abs(pose.R_world_antenna[:, :2, 1]).max(axis=0)
    west, south, east, north = extent_m
    east_m, north_m = reach_m * left
    return (west - east_m, south - north_m, east + east_m, north + north_m)


def _sampling_gap(local: Scenario, instrument: Instrument, flown: Flight) -> float:
    """Return the widest distance between neighbouring beam centres on level ground, and no less than two cells."""
    scan = instrument.scan
    spacing_m = scan.spacing_m(flown.altitude_m, flown.speed_mps, instrument.mean_rate_hz)
    if not (isinstance(spacing_m, float | int) and 0 <= spacing_m < np.inf):
        raise PluginError(f"{type(scan).__name__}.spacing_m is {spacing_m!r}; return metres, or set dem.max_gap_m")
    return max(2 * local.dem.spacing_m, spacing_m)


def _check_profiles(local: Scenario, mapper: Mapper, custom: CustomParts) -> None:
    """Refuse a DEM method without the range profiles that it requires; a custom sensor shows what it has in flight."""
    method, name = mapper.method, mapper.name
    if method.profiles not in ("unused", "optional", "required"):
        message = f"DEM method {name!r}: profiles = {method.profiles!r}; give 'unused', 'optional' or 'required'"
        raise PluginError(message)
    if method.profiles != "required" or custom.sensor is not None:
        return
    paired = local.sensor == "radar" and local.radar.sweep == "triangular"
    if paired or not SENSORS.entry(local.sensor).facts.provides_profiles:
        message = f"{name!r} needs range profiles, which this sensor does not have; set dem.method = 'smooth'"
        raise ScenarioError.of("dem.method", message)
