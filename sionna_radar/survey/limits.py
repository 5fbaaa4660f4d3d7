"""Limits on the pulses and paths of a flight.

Memory is estimated before any is allocated. The limits keep every array of a block of pulses, and every table that
grows with the survey, within a few gigabytes. Cells of terrain and DEM and numbers of scatterers are limited where
the scene is built.
"""

import math
from collections.abc import Iterator

from sionna_radar.flight.route import Route
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.tracing import MAX_PATHS_PER_PULSE
from sionna_radar.survey.instrument import Instrument

# Of a flight; in the map an echo of each that is in the sector of the scan takes half a kilobyte of memory.
MAX_CHIRPS = 100_000_000
MAX_FOLLOWING_STEPS = 1_000_000


def check_route(scenario: Scenario, instrument: Instrument, route: Route) -> None:
    """Raise ScenarioError with every reason for which a flight would not fit into memory."""
    problems = list(_flight_limits(scenario, instrument.chirp, route))
    if route.altitude_m is not None:
        problems += _path_limits(scenario, instrument, route.altitude_m)
    if problems:
        raise ScenarioError(problems)


def check_paths(scenario: Scenario, instrument: Instrument, height_m: float) -> None:
    """Raise ScenarioError if a flight with terrain-relative heights needs too many persistent scatterers."""
    if problems := list(_path_limits(scenario, instrument, height_m)):
        raise ScenarioError(problems)


def _flight_limits(scenario: Scenario, chirp: Chirp, route: Route) -> Iterator[Problem]:
    """Yield the problems of a flight of too many chirps or steps, or too fast for its sweeps."""
    platform, rate_hz, track_m, speed_mps = scenario.platform, chirp.rate_hz, route.length_m, route.speed_mps
    chirps = route.duration_s * scenario.radar.chirp_rate_hz
    taken = f"{chirps:.3g} chirps at {scenario.radar.chirp_rate_hz:g} Hz, more than {MAX_CHIRPS:,}"
    if chirps > MAX_CHIRPS and platform.log is not None:
        message = (
            f"{route.duration_s:.0f} s of the log take {taken}; choose a shorter part, or lower radar.chirp_rate_hz"
        )
        yield Problem("platform.log_stop_s", message)
    elif chirps > MAX_CHIRPS:
        message = (
            f"{speed_mps:g} m/s over {track_m:g} m takes {taken}; raise it to "
            f"{1.01 * track_m * scenario.radar.chirp_rate_hz / MAX_CHIRPS:.3g}, shorten the track, or lower "
            "radar.chirp_rate_hz"
        )
        yield Problem("platform.speed_mps", message)
    key, per_m = ("height_response_s", speed_mps) if platform.height == "sensed" else ("follow_length_m", 1.0)
    value = getattr(platform, key)
    steps = 10 * track_m / (value * per_m)
    if platform.height != "level" and steps > MAX_FOLLOWING_STEPS:
        message = (
            f"{value:g} divides a track of {track_m:g} m into {steps:.3g} steps, more than "
            f"{MAX_FOLLOWING_STEPS:,}; raise it to {10.1 * track_m / per_m / MAX_FOLLOWING_STEPS:.3g}"
        )
        yield Problem(f"platform.{key}", message)
    shift_m = chirp.carrier_hz * speed_mps / (chirp.bandwidth_hz * rate_hz)
    if shift_m > chirp.max_range_m:
        message = (
            f"{rate_hz:g} Hz lets {speed_mps:g} m/s shift echoes by {shift_m:.3g} m, farther than the "
            f"{chirp.max_range_m:.3g} m of unambiguous range; raise it to "
            f"{1.01 * rate_hz * shift_m / chirp.max_range_m:.3g}"
        )
        yield Problem("radar.chirp_rate_hz", message)


def _path_limits(scenario: Scenario, instrument: Instrument, height_m: float) -> Iterator[Problem]:
    """Yield the problem of more persistent scatterers in the main lobe than fit into a block of pulses."""
    tracing = scenario.tracing
    if tracing.engine != "sionna" or tracing.speckle != "persistent" or tracing.scatterers_per_m2 is None:
        return
    area_m2 = footprint_m2(scenario, instrument, height_m)
    paths = tracing.scatterers_per_m2 * area_m2
    if paths > MAX_PATHS_PER_PULSE:
        message = (
            f"{tracing.scatterers_per_m2:g} puts {paths:.3g} scatterers into the beam, more than "
            f"{MAX_PATHS_PER_PULSE:,}; lower it to {0.99 * MAX_PATHS_PER_PULSE / area_m2:.3g}, or narrow the antenna's "
            "beam"
        )
        yield Problem("tracing.scatterers_per_m2", message)


def footprint_m2(scenario: Scenario, instrument: Instrument, height: float) -> float:
    """Return the area of level ground within a half-power width of the axis on each side, as far as the radar reaches.

    height: of the radar over it, m. Less than a thousandth of the two-way power falls outside the area. The ground is
    no larger than a terrain of given size.
    """
    azimuth, elevation = instrument.antenna.beamwidths_rad
    incidence, reach_m = instrument.scan.incidence_rad, instrument.chirp.max_range_m
    horizon = math.acos(min(height / reach_m, 1.0))
    far, near = min(incidence + elevation, horizon), max(incidence - elevation, -horizon)
    along = height * max(math.tan(far) - math.tan(near), 0.0)
    across = 2 * height / math.cos(min(incidence, horizon)) * math.tan(min(azimuth, horizon))
    whole = math.prod(getattr(scenario.terrain, "size_m", (math.inf,)))
    return min(along * across, math.pi * reach_m**2, whole)
