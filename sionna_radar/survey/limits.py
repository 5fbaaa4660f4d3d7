"""What a survey takes in pulses, samples and paths, estimated before any of it is spent.

The bounds keep every array of a block of pulses, and every table that grows with the survey, within a few gigabytes.
What only the finished scene shows is bounded where it is built: cells of terrain and DEM, scatterers.
"""

import math

from sionna_radar.flight.route import Route
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.tracing import MOST_PATHS_PER_PULSE

MOST_CHIRPS = 10_000_000
# Samples times zero-padding: the length of the Fourier transform of a chirp.
MOST_SPECTRUM = 2**18
# Powers that an ordered-statistic CFAR sorts at once, for each row of a spectrum.
MOST_RANKED = 4_000_000
MOST_FOLLOWING_STEPS = 1_000_000
# Farther, float32 rays and the millimetres of a point cloud lose their meaning.
FARTHEST_M = 100_000.0


def check_limits(
    scenario: Scenario, chirp: Chirp, route: Route, beamwidths_rad: tuple[float, float], incidence_rad: float
) -> None:
    """Refuse a survey that would not fit into memory, with every reason.

    Parameters
    ----------
    scenario, chirp:
        The survey and its sweep.
    route:
        Where it flies.
    beamwidths_rad, incidence_rad:
        Of the antenna in azimuth and elevation, and of the scan from nadir.

    Raises
    ------
    ScenarioError
        With the field, its value and a value that works.

    """
    checks = [_chirps(scenario, route), _spectrum(scenario), _ranked(scenario), _steps(scenario, route.length_m)]
    checks += [
        _reach(chirp),
        _nearest(scenario, chirp),
        _shift(route.speed_mps, chirp),
    ]
    if route.altitude_m is not None:
        area_m2 = footprint_m2(scenario, chirp, route.altitude_m, beamwidths_rad, incidence_rad)
        checks.append(_paths(scenario, area_m2))
    problems = [problem for problem in checks if problem is not None]
    if problems:
        raise ScenarioError(problems)


def _chirps(scenario: Scenario, route: Route) -> Problem | None:
    rate_hz, track_m = scenario.radar.chirp_rate_hz, route.length_m
    chirps = route.duration_s * rate_hz
    if chirps <= MOST_CHIRPS:
        return None
    if scenario.platform.log is not None:
        message = (
            f"{route.duration_s:.0f} s of the log take {chirps:.3g} chirps at {rate_hz:g} Hz, more than "
            f"{MOST_CHIRPS:,}; choose a shorter part, or lower radar.chirp_rate_hz"
        )
        return Problem("platform.log_stop_s", message)
    message = (
        f"{route.speed_mps:g} m/s over {track_m:g} m takes {chirps:.3g} chirps at {rate_hz:g} Hz, more than "
        f"{MOST_CHIRPS:,}; raise it to {1.01 * track_m * rate_hz / MOST_CHIRPS:.3g}, shorten the track, or lower "
        "radar.chirp_rate_hz"
    )
    return Problem("platform.speed_mps", message)


def _spectrum(scenario: Scenario) -> Problem | None:
    samples, padding = scenario.radar.samples_per_chirp, scenario.processing.zero_padding
    if samples * padding <= MOST_SPECTRUM:
        return None
    message = (
        f"{padding} times {samples:,} samples make spectra of {samples * padding:,} bins, more than "
        f"{MOST_SPECTRUM:,}; lower it to {MOST_SPECTRUM // samples}, or radar.samples_per_chirp"
    )
    return Problem("processing.zero_padding", message)


def _ranked(scenario: Scenario) -> Problem | None:
    cfar, radar = scenario.processing.cfar, scenario.radar
    bins = radar.samples_per_chirp * scenario.processing.zero_padding // (2 if radar.sampling == "real" else 1)
    if cfar.kind != "OS" or 2 * cfar.training * bins <= MOST_RANKED:
        return None
    message = (
        f"{cfar.training} cells on each side of {bins:,} bins are too many to sort; "
        f"lower it to {max(1, MOST_RANKED // (2 * bins))}, or set processing.cfar.kind = 'CA'"
    )
    return Problem("processing.cfar.training", message)


def check_paths(
    scenario: Scenario, chirp: Chirp, height_m: float, beamwidths_rad: tuple[float, float], incidence_rad: float
) -> None:
    """Refuse more persistent scatterers than fit into memory, for a flight whose height only the ground told."""
    problem = _paths(scenario, footprint_m2(scenario, chirp, height_m, beamwidths_rad, incidence_rad))
    if problem is not None:
        raise ScenarioError([problem])


def _steps(scenario: Scenario, track_m: float) -> Problem | None:
    platform = scenario.platform
    steps = 10 * track_m / platform.follow_length_m
    if platform.height != "terrain_following" or steps <= MOST_FOLLOWING_STEPS:
        return None
    message = (
        f"{platform.follow_length_m:g} m divides a track of {track_m:g} m into {steps:.3g} steps, more than "
        f"{MOST_FOLLOWING_STEPS:,}; raise it to {10.1 * track_m / MOST_FOLLOWING_STEPS:.3g}"
    )
    return Problem("platform.follow_length_m", message)


def _reach(chirp: Chirp) -> Problem | None:
    if chirp.max_range_m <= FARTHEST_M:
        return None
    message = (
        f"{chirp.bandwidth_hz:g} and {chirp.samples} samples reach {chirp.max_range_m:.3g} m, farther than "
        f"{FARTHEST_M:g}; raise it to {1.01 * chirp.bandwidth_hz * chirp.max_range_m / FARTHEST_M:.3g}"
    )
    return Problem("radar.bandwidth_hz", message)


def _nearest(scenario: Scenario, chirp: Chirp) -> Problem | None:
    nearest_m = scenario.processing.min_range_m
    if nearest_m < chirp.max_range_m:
        return None
    message = f"{nearest_m:g} m is no nearer than the farthest echo, at {chirp.max_range_m:.3g} m; lower it"
    return Problem("processing.min_range_m", message)


def _shift(speed_mps: float, chirp: Chirp) -> Problem | None:
    """Refuse sweeps so slow that motion moves echoes farther than the radar reaches."""
    shift_m = chirp.carrier_hz * speed_mps / (chirp.bandwidth_hz * chirp.rate_hz)
    if shift_m <= chirp.max_range_m:
        return None
    message = (
        f"{chirp.rate_hz:g} Hz lets {speed_mps:g} m/s shift echoes by {shift_m:.3g} m, farther than "
        f"the {chirp.max_range_m:.3g} m of unambiguous range; raise it to "
        f"{1.01 * chirp.rate_hz * shift_m / chirp.max_range_m:.3g}"
    )
    return Problem("radar.chirp_rate_hz", message)


def _paths(scenario: Scenario, area_m2: float) -> Problem | None:
    """Refuse more persistent scatterers in the main lobe than a block of pulses can hold."""
    tracing = scenario.tracing
    if tracing.engine != "sionna" or tracing.speckle != "persistent" or tracing.scatterers_per_m2 is None:
        return None
    paths = tracing.scatterers_per_m2 * area_m2
    if paths <= MOST_PATHS_PER_PULSE:
        return None
    message = (
        f"{tracing.scatterers_per_m2:g} puts {paths:.3g} scatterers into the beam, more than {MOST_PATHS_PER_PULSE:,}; "
        f"lower it to {0.99 * MOST_PATHS_PER_PULSE / area_m2:.3g}, or narrow the antenna's beam"
    )
    return Problem("tracing.scatterers_per_m2", message)


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
