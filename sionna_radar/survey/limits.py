"""Limits on the pulses, samples and paths of a survey.

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
from sionna_radar.scenario.processing import ProcessingTable
from sionna_radar.scenario.tracing import MAX_PATHS_PER_PULSE

# Of a flight; in the map an echo of each that is in the sector of the scan takes half a kilobyte of memory.
MAX_CHIRPS = 100_000_000
# Samples times zero-padding: the length of the Fourier transform of a chirp.
MAX_SPECTRUM = 2**18
# Most powers that an ordered-statistic CFAR sorts per spectrum.
MAX_RANKED = 4_000_000
MAX_FOLLOWING_STEPS = 1_000_000
# Beyond this, float32 rays and millimetre point clouds lose precision, m.
FARTHEST_M = 100_000.0


def check_instrument(processing: ProcessingTable, chirp: Chirp) -> None:
    """Raise ScenarioError with every reason for which spectra would not fit into memory."""
    if problems := [*_sweep_limits(chirp), *processing_limits(processing, chirp)]:
        raise ScenarioError(problems)


def check_route(
    scenario: Scenario, chirp: Chirp, route: Route, beamwidths_rad: tuple[float, float], incidence_rad: float
) -> None:
    """Raise ScenarioError with every reason for which a flight would not fit into memory.

    scenario, chirp: the survey and its sweep.
    route: where it flies.
    beamwidths_rad, incidence_rad: of the antenna in azimuth and elevation, and of the scan from nadir.

    Raises ScenarioError with the field, its value and a value that works.
    """
    problems = list(_flight_limits(scenario, chirp, route))
    if route.altitude_m is not None:
        area_m2 = footprint_m2(scenario, chirp, route.altitude_m, beamwidths_rad, incidence_rad)
        problems += _path_limits(scenario, area_m2)
    if problems:
        raise ScenarioError(problems)


def check_paths(
    scenario: Scenario, chirp: Chirp, height_m: float, beamwidths_rad: tuple[float, float], incidence_rad: float
) -> None:
    """Raise ScenarioError if a flight with terrain-relative heights needs too many persistent scatterers."""
    problems = list(_path_limits(scenario, footprint_m2(scenario, chirp, height_m, beamwidths_rad, incidence_rad)))
    if problems:
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


def processing_limits(processing: ProcessingTable, chirp: Chirp) -> Iterator[Problem]:
    """Yield the problems of too long spectra, too many ranked cells, and ranges that are all too near."""
    samples = chirp.samples
    bins = samples * processing.zero_padding
    if bins > MAX_SPECTRUM:
        message = (
            f"{processing.zero_padding} times {samples:,} samples make spectra of {bins:,} bins, more than "
            f"{MAX_SPECTRUM:,}; lower it to {MAX_SPECTRUM // samples}, or radar.samples_per_chirp"
        )
        yield Problem("processing.zero_padding", message)
    cfar = processing.cfar
    tested = bins // (2 if chirp.sampling == "real" else 1)
    _, training = cfar.sides(chirp.range_cells)
    if cfar.kind == "OS" and 2 * training * tested > MAX_RANKED:
        message = (
            f"{training} cells on each side of {tested:,} bins are too many to sort; "
            f"lower it to {max(1, MAX_RANKED // (2 * tested))}, or set processing.cfar.kind = 'CA'"
        )
        yield Problem("processing.cfar.training", message)
    # The detector tests cells from the nearest range on, and not the last one.
    nearest_m, last_m = processing.min_range_m, chirp.max_range_m - 2 * chirp.range_resolution_m
    if nearest_m > last_m:
        message = f"{nearest_m:g} m is beyond the last tested range cell, at {last_m:.4g} m; lower it"
        yield Problem("processing.min_range_m", message)


def _sweep_limits(chirp: Chirp) -> Iterator[Problem]:
    """Yield the problem of a sweep that reaches too far."""
    if chirp.max_range_m > FARTHEST_M:
        message = (
            f"{chirp.bandwidth_hz:g} and {chirp.samples} samples reach {chirp.max_range_m:.3g} m, farther than "
            f"{FARTHEST_M:g}; raise it to {1.01 * chirp.bandwidth_hz * chirp.max_range_m / FARTHEST_M:.3g}"
        )
        yield Problem("radar.bandwidth_hz", message)


def _path_limits(scenario: Scenario, area_m2: float) -> Iterator[Problem]:
    """Yield the problem of more persistent scatterers in the main lobe than fit into a block of pulses."""
    tracing = scenario.tracing
    if tracing.engine != "sionna" or tracing.speckle != "persistent" or tracing.scatterers_per_m2 is None:
        return
    paths = tracing.scatterers_per_m2 * area_m2
    if paths > MAX_PATHS_PER_PULSE:
        message = (
            f"{tracing.scatterers_per_m2:g} puts {paths:.3g} scatterers into the beam, more than "
            f"{MAX_PATHS_PER_PULSE:,}; lower it to {0.99 * MAX_PATHS_PER_PULSE / area_m2:.3g}, or narrow the antenna's "
            "beam"
        )
        yield Problem("tracing.scatterers_per_m2", message)


def footprint_m2(
    scenario: Scenario, chirp: Chirp, height: float, beamwidths_rad: tuple[float, float], incidence_rad: float
) -> float:
    """Return the area of level ground within a half-power width of the axis on each side, as far as the radar reaches.

    height: of the radar over it, m. Less than a thousandth of the two-way power falls outside the area. The ground is
    no larger than a terrain of given size.
    """
    azimuth, elevation = beamwidths_rad
    incidence = incidence_rad
    horizon = math.acos(min(height / chirp.max_range_m, 1.0))
    far, near = min(incidence + elevation, horizon), max(incidence - elevation, -horizon)
    along = height * max(math.tan(far) - math.tan(near), 0.0)
    across = 2 * height / math.cos(min(incidence, horizon)) * math.tan(min(azimuth, horizon))
    whole = math.prod(getattr(scenario.terrain, "size_m", (math.inf,)))
    return min(along * across, math.pi * chirp.max_range_m**2, whole)
