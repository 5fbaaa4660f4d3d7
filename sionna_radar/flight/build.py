"""Builder of the flight of a scenario: scan, route and navigation system."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.constants import g as gravity

from sionna_radar.elevation.local_frame import MapFrame
from sionna_radar.flight.frames import Vector3
from sionna_radar.flight.gusts import INTENSITY, Wind
from sionna_radar.flight.instrument import InstrumentErrors
from sionna_radar.flight.navigation import ErrorComponents, InertialErrors, LoggedErrors, StatedError
from sionna_radar.flight.pulses import Navigation
from sionna_radar.flight.recorded import KEY, LogPart, recorded_route
from sionna_radar.flight.route import PlannedRoute, Route, SurveyLines, lines_track
from sionna_radar.flight.scan import ElectronicScan, RotatingScan, Scan, SideLookingScan
from sionna_radar.flight.trajectory import Course, FlightPlan, Track, Trajectory
from sionna_radar.flight.turns import rounded_track
from sionna_radar.foundation.errors import ScenarioError
from sionna_radar.scenario.bases import NavigationParameters, ScanParameters
from sionna_radar.scenario.parts import NAVIGATIONS, SCANS
from sionna_radar.scenario.platform import LoggedErrorsTable, NavigationTable, Platform, WindTable
from sionna_radar.scenario.processing import CalibrationTable, RefinedNavigationTable
from sionna_radar.scenario.radar import ElectronicScanTable, PanoramicScanTable, ScanTable
from sionna_radar.scenario.readers import FLIGHT_LOG
from sionna_radar.scenario.registry import Builder, registers, require


@registers(SCANS, "[radar.scan]")
def register_scan(name: str, parameters: type[ScanParameters]) -> Callable[[Builder], Builder]:
    """Register a scan, for `radar.scan.mode` in a scenario.

    It decorates a class or function that builds a `Scan`; it is called with the parameters.

    Examples
    --------
    >>> import numpy as np
    >>> from sionna_radar.flight import Pointing, whisk_broom_from_antenna
    >>> from sionna_radar.scenario import ScanParameters
    >>> class Nodding(ScanParameters):
    ...     amplitude_deg: float = 20.0
    >>> @register_scan("nodding", Nodding)
    ... class NoddingScan:
    ...     stabilised, incidence_rad, period_s = True, float(np.deg2rad(45.0)), 0.5
    ...     def __init__(self, parameters):
    ...         self.amplitude_rad = np.deg2rad(parameters.amplitude_deg)
    ...     def point(self, time_s):
    ...         angle = self.amplitude_rad * np.sin(2 * np.pi * time_s / self.period_s)
    ...         axes = whisk_broom_from_antenna(self.incidence_rad, angle)
    ...         return Pointing(axes, angle, np.ones(len(time_s), dtype=bool))
    ...     def spacing_m(self, height_m, speed_mps, chirp_rate_hz):
    ...         return speed_mps * self.period_s
    >>> scan = {"mode": "nodding", "amplitude_deg": 10.0}
    >>> len(prepare(load_scenario("hills", {"radar.scan": scan, "platform.length_m": 10.0})))
    360
    """
    return SCANS.register(name, parameters)


def build_scan(table: ScanParameters) -> Scan:
    """Return the scan of a scenario."""
    return SCANS.build(table.mode, Scan, table)


def rotating_scan(table: ScanTable) -> RotatingScan:
    """Return the scan of a scenario's table; a fixed one does not rotate."""
    assert table.mode != "side_looking"
    turns = 0.0 if table.mode == "fixed" else table.rotation_rpm / 60
    return RotatingScan(
        mode=table.mode,
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        half_swath_rad=np.pi if table.mode == "fixed" else float(np.deg2rad(table.half_swath_deg)),
        rotation_rad_s=2 * np.pi * turns,
        start_rad=float(np.deg2rad(table.start_deg)),
        stabilised=table.stabilised,
    )


def side_looking_scan(table: ScanTable) -> SideLookingScan:
    """Return the scan of a scenario's table."""
    return table.to(SideLookingScan, incidence_rad=float(np.deg2rad(table.incidence_deg)))


def electronic_scan(table: ElectronicScanTable) -> ElectronicScan:
    """Return the scan of a scenario's table."""
    incidence_rad, half_swath_rad = np.deg2rad([table.incidence_deg, table.half_swath_deg]).tolist()
    return table.to(ElectronicScan, incidence_rad=incidence_rad, half_swath_rad=half_swath_rad)


def panoramic_scan(table: PanoramicScanTable) -> RotatingScan:
    """Return the scan of a scenario's table."""
    return RotatingScan(
        mode="conical",
        incidence_rad=float(np.deg2rad(table.incidence_deg)),
        half_swath_rad=np.pi,
        rotation_rad_s=2 * np.pi * table.rotation_rpm / 60,
        start_rad=float(np.deg2rad(table.start_deg)),
        stabilised=table.stabilised,
    )


@registers(NAVIGATIONS, "[platform.navigation]")
def register_navigation(name: str, parameters: type[NavigationParameters]) -> Callable[[Builder], Builder]:
    """Register a navigation system, for `platform.navigation.kind` in a scenario.

    It decorates a class or function that builds a `Navigation`, called with the parameters, the true trajectory, the
    chirp rate (Hz) and the scenario's seed. It may return None for a system without errors.

    Examples
    --------
    >>> from sionna_radar.flight import Pose, antenna_pose
    >>> from sionna_radar.scenario import NavigationParameters
    >>> class Drift(NavigationParameters):
    ...     east_mps: float = 0.1
    >>> @register_navigation("drift", Drift)
    ... class DriftingGps:
    ...     def __init__(self, parameters, trajectory, chirp_rate_hz, seed):
    ...         self.parameters = parameters
    ...     def measure(self, index, time_s, trajectory, R_body_antenna):
    ...         pose = antenna_pose(trajectory, time_s, R_body_antenna, self.parameters.lever_arm_m)
    ...         pose.position_m[:, 0] += self.parameters.east_mps * time_s
    ...         return pose
    >>> table = {"kind": "drift", "east_mps": 0.5}
    >>> prepared = prepare(load_scenario("hills", {"platform.navigation": table, "platform.length_m": 10.0}))
    >>> last = prepared.flight.sample(2)
    >>> bool((last.measured.position_m - last.true.position_m)[1, 0] > 0.2)
    True
    """
    return NAVIGATIONS.register(name, parameters)


def build_navigation(
    table: NavigationParameters, trajectory: Trajectory, chirp_rate_hz: float, seed: int
) -> Navigation | None:
    """Return the navigation system of a scenario; None if it reports the true pose."""
    system: Navigation | None = NAVIGATIONS.entry(table.kind)(table, trajectory, chirp_rate_hz, seed)
    if system is not None:
        require(system, Navigation, str(NAVIGATIONS.entry(table.kind)))
    return system


def inertial_errors(
    table: NavigationTable, trajectory: Trajectory, chirp_rate_hz: float, seed: int
) -> InertialErrors | None:
    """Return the navigation system of a scenario; None if it has no errors."""
    if not table.has_errors:
        return None
    start, end = trajectory.cruise_s()
    # Pulse times are the middles of chirps.
    return _inertial_errors(table, (start + 0.5 / chirp_rate_hz, end), 1 / chirp_rate_hz, seed)


def _inertial_errors(table: NavigationTable, span_s: tuple[float, float], step_s: float, seed: int) -> InertialErrors:
    lever = np.array(table.lever_arm_m) + np.array(table.lever_arm_error_m)
    return InertialErrors(
        position=ErrorComponents(
            constant=_vector(table.position_constant_m),
            white=_vector(table.position_white_m),
            markov=_vector(table.position_markov_m),
            correlation_s=table.position_correlation_s,
        ),
        velocity=ErrorComponents(
            constant=_vector(table.velocity_constant_mps),
            white=_vector(table.velocity_white_mps),
            markov=_vector(table.velocity_markov_mps),
            correlation_s=table.velocity_correlation_s,
        ),
        attitude=ErrorComponents(
            constant=_radians(table.attitude_constant_deg),
            white=_radians(table.attitude_white_deg),
            markov=_radians(table.attitude_markov_deg),
            correlation_s=table.attitude_correlation_s,
        ),
        time_offset_s=table.time_offset_s,
        lever_arm_m=_vector(lever),
        boresight_rad=_radians(table.boresight_error_deg),
        seed=seed,
        span_s=span_s,
        step_s=step_s,
    )


def build_stated_errors(
    table: RefinedNavigationTable, navigation: NavigationParameters | None, system: Navigation | None = None
) -> tuple[StatedError, ...]:
    """Return the stated standard deviations of the navigation's errors, for processing that refines it.

    navigation: as the scenario has it; None without one. system: built of it; None where the flight is not simulated.

    Raises ScenarioError if nothing is stated.
    """
    true = (0.0, 0.0, 0.0) if navigation is None else navigation.lever_arm_m
    if table.position_m is not None or table.attitude_deg is not None:
        position, attitude = _vector(table.position_m or 0.0), _radians(table.attitude_deg or 0.0)
        system = InertialErrors(
            position=ErrorComponents(markov=position, correlation_s=table.position_correlation_s),
            attitude=ErrorComponents(markov=attitude, correlation_s=table.attitude_correlation_s),
            lever_arm_m=true,
            seed=0,
            span_s=(0.0, 0.0),
            step_s=1.0,
        )
    elif system is None and isinstance(navigation, NavigationTable):
        system = _inertial_errors(navigation, (0.0, 0.0), 1.0, 0)
    if isinstance(system, InertialErrors):
        return system.stated(true)
    message = "states nothing of the errors; give position_m and attitude_deg, their standard deviations"
    raise ScenarioError.of("processing.refined_navigation", message)


def logged_errors(table: LoggedErrorsTable, trajectory: Trajectory, chirp_rate_hz: float, seed: int) -> LoggedErrors:
    """Return the navigation system of a recorded flight.

    Raises ScenarioError for a flight without a log, or with one that states no errors.
    """
    if trajectory.logged_sigma is None:
        message = (
            "'from_log' needs platform.log with a covariance, innovations or sigma columns, and there are none; give "
            "kind = 'errors' with the errors themselves"
        )
        raise ScenarioError.of("platform.navigation.kind", message)
    start, end = trajectory.cruise_s()
    position, velocity, attitude = table.correlation_s
    return LoggedErrors(
        position=ErrorComponents(markov=UNIT, correlation_s=position),
        velocity=ErrorComponents(markov=UNIT, correlation_s=velocity),
        attitude=ErrorComponents(markov=UNIT, correlation_s=attitude),
        lever_arm_m=table.lever_arm_m,
        sigma=trajectory.logged_sigma,
        seed=seed,
        span_s=(start + 0.5 / chirp_rate_hz, end),
        step_s=1 / chirp_rate_hz,
    )


def plan_track(platform: Platform, centre_m: tuple[float, float] = (0.0, 0.0)) -> Track:
    """Return the track of a scenario; without a start it is centred on the terrain."""
    if platform.waypoints_m:
        return Track(np.array(platform.waypoints_m, dtype=float))
    heading = np.deg2rad(platform.heading_deg)
    track_vector = platform.length_m * np.array([np.sin(heading), np.cos(heading)])
    start = np.array(centre_m) - track_vector / 2 if platform.start_m is None else np.array(platform.start_m)
    return Track(np.array([start, start + track_vector]))


def turn_radius_m(platform: Platform) -> float | None:
    """Return the radius of a planned flight's turns; None for instantaneous ones."""
    if platform.turn_radius_m is not None or platform.bank_deg is None:
        return platform.turn_radius_m
    _, speed_mps = platform.planned
    return float(speed_mps**2 / (gravity * np.tan(np.deg2rad(platform.bank_deg))))


def plan_route(platform: Platform, frame: Callable[[], MapFrame | None]) -> Route:
    """Return the route of a scenario.

    platform: the flight, in local metres.
    frame: returns the local frame on the map, if there is one; called only for logs on the map.

    Raises ScenarioError, InputFileError if turns do not fit the track; the log cannot be read or flown, or has no place
        on the ground.
    """
    if platform.log is not None:
        log = FLIGHT_LOG(platform.log, KEY, platform.log_columns, platform.log_crs)
        return recorded_route(log, _log_stretch(platform, platform.log), frame)
    off_ground = "start_m", "move platform.start_m, shorten platform.length_m"
    if platform.lines is not None:
        off_ground = "lines", "move lines.centre_m, shorten lines.length_m, turn more tightly (bank_deg)"
    elif platform.waypoints_m:
        off_ground = "waypoints_m", "move the points, turn more tightly (bank_deg)"
    return PlannedRoute(
        plan=flight_plan(platform),
        track=_course(platform),
        roll_in_s=platform.roll_in_s,
        transmit_in_turns=platform.lines is None or platform.lines.transmit_in_turns,
        wind=None if platform.wind is None else build_wind(platform.wind),
        off_ground=off_ground,
    )


def flight_plan(platform: Platform) -> FlightPlan:
    """Return the heights and speeds of a planned flight."""
    altitude_m, speed_mps = platform.planned
    return platform.to(
        FlightPlan,
        altitude_m=altitude_m,
        speed_mps=speed_mps,
        follows_terrain=platform.height in ("terrain_following", "sensed"),
        response_s=platform.height_response_s if platform.height == "sensed" else None,
        vertical=platform.profile == "full",
        wheels_m=platform.wheels_m if platform.height == "ground" else None,
    )


def build_wind(table: WindTable) -> Wind:
    """Return the wind of a scenario."""
    return table.to(
        Wind,
        from_rad=float(np.deg2rad(table.from_deg)),
        gust_mps=INTENSITY * table.speed_mps if table.gust_mps is None else table.gust_mps,
        attitude_s=table.attitude_response_s,
        position_s=table.position_response_s,
    )


def _log_stretch(platform: Platform, path: Path) -> LogPart:
    return LogPart(
        path=path,
        start_s=platform.log_start_s,
        stop_s=np.inf if platform.log_stop_s is None else platform.log_stop_s,
        gap_s=platform.log_gap_s,
        shift=(0.0, 0.0, 0.0) if platform.log_shift == "none" else platform.log_shift,
        height=platform.log_height,
    )


def _course(platform: Platform) -> Course:
    radius_m = turn_radius_m(platform)
    if platform.lines is not None:
        lead_m = platform.roll_in_s * platform.planned[1] / 2 if radius_m is not None else 0.0
        lines = platform.lines.to(SurveyLines, centre_m=platform.lines.centre_m or (0.0, 0.0))
        return lines_track(lines, float(np.deg2rad(platform.heading_deg)), radius_m, lead_m)
    track = plan_track(platform)
    return track if radius_m is None else rounded_track(track.waypoints_m, radius_m)


def _vector(value: float | Vector3 | Float[np.ndarray, " 3"]) -> Vector3:
    x, y, z = (float(v) for v in np.broadcast_to(value, 3))
    return x, y, z


def _radians(value: float | Vector3) -> Vector3:
    return _vector(np.deg2rad(np.broadcast_to(value, 3)))


UNIT = (1.0, 1.0, 1.0)


def build_errors(table: CalibrationTable) -> InstrumentErrors:
    """Return the known errors of an instrument from their table."""
    return table.to(
        InstrumentErrors,
        mounting_rad=_radians(table.mounting_deg),
        squint_rad=float(np.deg2rad(table.squint_deg)),
        range_scale=table.range_scale_ppm * 1e-6,
    )
