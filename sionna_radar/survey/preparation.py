"""Everything a survey needs before its first pulse, and the checks that need the terrain and the flight."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sionna_radar.detection.detector import Detector, build_detector
from sionna_radar.detection.expected_ground import ExpectedGround, build_expected_ground
from sionna_radar.flight.navigation import build_navigation
from sionna_radar.flight.pulses import Navigation, Pulses, PulseSchedule, schedule_pulses
from sionna_radar.flight.scan import Scan, build_scan
from sionna_radar.flight.trajectory import Track, Trajectory, plan_track, plan_trajectory
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.raster import Grid
from sionna_radar.mapping.coverage import closing_cells
from sionna_radar.radar.antenna import Antenna, build_antenna
from sionna_radar.radar.chirp import Chirp, build_chirp
from sionna_radar.radar.equation import plane_echo
from sionna_radar.scenario import Scenario
from sionna_radar.scene.build import BuiltScene, build_scene
from sionna_radar.scene.map_positions import in_local_frame
from sionna_radar.signal.noise import noise_power, transmit_power_w
from sionna_radar.signal.receiver import HighPass, build_high_pass
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.limits import check_limits
from sionna_radar.tracing.engines.scatterers import check_scatterers

SAMPLED_PULSES = 2000
LOST_SHARE = 0.1
MAX_DEM_CELLS = 25_000_000
MAX_CLOSED_CELLS = 100_000_000


@dataclass(frozen=True, kw_only=True)
class Preparation:
    """A survey that is ready to fly.

    scenario: with all positions in local metres.
    noise_power_w: noise power of a sample, on the scale of `transmit_power_w`.
    max_gap_m: greatest distance of a filled DEM cell from the nearest point.
    expected_ground: what is known of the ground beforehand; None for nothing.
    high_pass: of the receiver; None without one.
    """

    scenario: Scenario
    chirp: Chirp
    antenna: Antenna
    detector: Detector
    schedule: PulseSchedule
    built: BuiltScene
    grid: Grid
    transmit_power_w: float
    noise_power_w: float
    max_gap_m: float
    expected_ground: ExpectedGround | None = None
    high_pass: HighPass | None = None

    def window_m(self, pulses: Pulses, sweep: Chirp) -> Float[np.ndarray, "pulse 2"] | None:
        """Return the ranges in which a sweep's ground is searched; None for all."""
        return None if self.expected_ground is None else self.expected_ground.window_m(pulses, sweep)


@on_one_thread
def prepare(
    scenario: Scenario,
    *,
    antenna: Antenna | None = None,
    scan: Scan | None = None,
    navigation: Navigation | None = None,
) -> Preparation:
    """Build the scene and the flight of a scenario, and refuse what cannot be flown.

    Parameters
    ----------
    scenario:
        The survey.
    antenna, scan, navigation:
        A custom antenna, scan or navigation system in place of the scenario's.

    Raises
    ------
    ScenarioError
        No pulses, a radar under the terrain, a swath that leaves it, ranges beyond the sampled beat.
    InputFileError
        The elevation file cannot be used.

    """
    scenario = in_local_frame(scenario)
    chirp, track = build_chirp(scenario.radar), plan_track(scenario.platform)
    check_limits(scenario, chirp, track.length_m)
    own_scan = scan is not None
    scan = scan or build_scan(scenario.radar.scan)
    antenna = antenna or build_antenna(scenario.radar.antenna)
    high_pass = build_high_pass(scenario.radar.receiver)
    detector = build_detector(scenario.processing, chirp, antenna, high_pass)
    if not own_scan:
        _check_nominal_range(scenario, chirp)
    built = build_scene(scenario, _window(track, chirp.max_range_m))
    _check_track(track, built)
    trajectory = plan_trajectory(scenario.platform, track, built.ground_m)
    schedule = _schedule(scenario, trajectory, scan, navigation)
    _check_pulses(schedule, scenario)
    looks = _look(schedule, built)
    _check_geometry(looks, schedule, built, chirp)
    _check_scatterers(scenario, schedule, built, chirp)
    max_gap_m = scenario.dem.max_gap_m or _sampling_gap(scenario)
    grid = _dem_grid(scenario, looks, max_gap_m, built.scene.georeference)
    return Preparation(
        scenario=scenario,
        chirp=chirp,
        antenna=antenna,
        detector=detector,
        schedule=schedule,
        built=built,
        grid=grid,
        transmit_power_w=transmit_power_w(scenario.radar),
        noise_power_w=noise_power(scenario.radar, chirp, _reference_echo(scenario, antenna, chirp, built)),
        max_gap_m=max_gap_m,
        expected_ground=build_expected_ground(scenario, antenna, grid, built.scene.georeference),
        high_pass=high_pass,
    )


def _reference_echo(scenario: Scenario, antenna: Antenna, chirp: Chirp, built: BuiltScene) -> float:
    """Return the echo of level ground at the flight's height, over the sent power: what `radar.snr_db` counts from."""
    return plane_echo(
        antenna,
        # The noise is set against the co-polar echo, whatever the receiver's polarisation.
        as_radar_material(built.scene.materials[built.scene.ground_material]).co_polar,
        chirp.wavelength_m,
        scenario.platform.altitude_m,
        np.deg2rad(scenario.radar.scan.incidence_deg),
    )


def _schedule(scenario: Scenario, trajectory: Trajectory, scan: Scan, navigation: Navigation | None) -> PulseSchedule:
    rate_hz, errors = scenario.radar.chirp_rate_hz, scenario.platform.navigation
    return schedule_pulses(
        trajectory,
        scan,
        rate_hz,
        lever_arm_m=errors.lever_arm_m,
        navigation=navigation or build_navigation(errors, trajectory, rate_hz, scenario.seed),
    )


@dataclass(frozen=True)
class _Looks:
    """Boresights of pulses spread over the survey: where they start, how far they reach, what they hit."""

    origin_m: Float[np.ndarray, "look 3"]
    direction: Float[np.ndarray, "look 3"]
    range_m: Float[np.ndarray, " look"]

    @property
    def hit_m(self) -> Float[np.ndarray, "hit 3"]:
        hit = np.isfinite(self.range_m)
        return self.origin_m[hit] + self.range_m[hit, None] * self.direction[hit]


def _window(track: Track, reach_m: float) -> tuple[float, float, float, float]:
    west, south = track.waypoints_m.min(axis=0) - reach_m
    east, north = track.waypoints_m.max(axis=0) + reach_m
    return float(west), float(south), float(east), float(north)


def _look(schedule: PulseSchedule, built: BuiltScene) -> _Looks:
    pose = schedule.sample(SAMPLED_PULSES).true
    hits = built.caster.cast(pose.position_m, pose.boresight)
    return _Looks(pose.position_m, pose.boresight, hits.distance_m)


def _check_nominal_range(scenario: Scenario, chirp: Chirp) -> None:
    scan = scenario.radar.scan
    down = np.cos(np.deg2rad(scan.incidence_deg))
    if scan.mode == "whisk_broom":
        down *= np.cos(np.deg2rad(scan.half_swath_deg))
    elif scan.mode == "fixed":
        down *= np.cos(np.deg2rad(scan.start_deg))
    slant = scenario.platform.altitude_m / down if down > 0 else np.inf
    if slant > chirp.max_range_m:
        message = (
            f"at {scenario.platform.altitude_m:g} m the beam meets level ground {slant:.1f} m away, beyond the "
            f"{chirp.max_range_m:.1f} m of unambiguous range; raise radar.samples_per_chirp, or lower "
            "platform.altitude_m, radar.bandwidth_hz or the scan angles"
        )
        raise ScenarioError([Problem("radar.samples_per_chirp", message)])


def _check_track(track: Track, built: BuiltScene) -> None:
    along = track.point(np.linspace(0.0, track.length_m, 200))
    outside = np.isnan(built.ground_m(along))
    if outside.any():
        x, y = along[outside][0]
        message = (
            f"the track has no ground under it at ({x:.1f}, {y:.1f}) m; move platform.start_m, shorten "
            "platform.length_m, or enlarge the terrain"
        )
        raise ScenarioError([Problem("platform.start_m", message)])


def _check_pulses(schedule: PulseSchedule, scenario: Scenario) -> None:
    if len(schedule) == 0:
        start, end = schedule.trajectory.cruise_s()
        message = (
            f"no pulse falls into the sector during the {end - start:.3g} s of cruise at "
            f"{scenario.radar.chirp_rate_hz:g} chirps/s; lengthen platform.length_m or widen radar.scan.half_swath_deg"
        )
        raise ScenarioError([Problem("radar.scan", message)])


def _check_geometry(looks: _Looks, schedule: PulseSchedule, built: BuiltScene, chirp: Chirp) -> None:
    low, high = built.scene.bounds_m
    problems = []
    pose = schedule.sample(SAMPLED_PULSES).true
    top = float(max(high[2], pose.position_m[:, 2].max())) + 10.0
    surface = built.caster.from_above(pose.position_m[:, :2], top)
    clearance = pose.position_m[:, 2] - np.where(np.isnan(surface), -np.inf, surface)
    if clearance.min() <= 0:
        x, y, z = pose.position_m[np.argmin(clearance)]
        message = (
            f"the radar would be {-clearance.min():.1f} m under the surface at ({x:.1f}, {y:.1f}, {z:.1f}) m; "
            "raise platform.altitude_m, move the track, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("platform.altitude_m", message))
    missed = np.isinf(looks.range_m) & ~_over_hole(looks, low, high)
    if missed.any():
        message = (
            f"{missed.mean():.0%} of the beams leave the terrain, which spans {low[0]:.0f} to {high[0]:.0f} m east "
            f"and {low[1]:.0f} to {high[1]:.0f} m north; enlarge it, shorten platform.length_m, or lower "
            "platform.altitude_m, radar.scan.incidence_deg or radar.scan.half_swath_deg"
        )
        problems.append(Problem("radar.scan", message))
    elif np.isinf(looks.range_m).mean() > 0.5:
        message = (
            f"{np.isinf(looks.range_m).mean():.0%} of the beams fall into holes of the terrain, where it has no data; "
            "move the track, or terrain.centre_lonlat_deg, to where it has"
        )
        problems.append(Problem("terrain", message))
    lost = np.isfinite(looks.range_m) & (looks.range_m > chirp.max_range_m)
    if lost.mean() > LOST_SHARE:
        message = (
            f"{lost.mean():.0%} of the beams meet the ground beyond the {chirp.max_range_m:.1f} m of "
            "unambiguous range; raise radar.samples_per_chirp, or set platform.height = 'terrain_following'"
        )
        problems.append(Problem("radar.samples_per_chirp", message))
    if problems:
        raise ScenarioError(problems)


def _over_hole(looks: _Looks, low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]) -> Bool[np.ndarray, " look"]:
    """Return which beams would meet the lowest ground inside the terrain's outline: they fall through a hole."""
    down = np.minimum(looks.direction[:, 2], -1e-6)
    reach = (low[2] - looks.origin_m[:, 2]) / down
    foot = looks.origin_m[:, :2] + reach[:, None] * looks.direction[:, :2]
    return np.all((foot > low[:2]) & (foot < high[:2]), axis=1)


def _check_scatterers(scenario: Scenario, schedule: PulseSchedule, built: BuiltScene, chirp: Chirp) -> None:
    tracing = scenario.tracing
    if tracing.engine == "sionna" and tracing.speckle == "persistent":
        check_scatterers(built.scene, tracing.scatterers_per_m2, region_in_reach_m(schedule, chirp))


def region_in_reach_m(schedule: PulseSchedule, chirp: Chirp) -> Float[np.ndarray, "2 3"]:
    """Return the lowest and highest corner of the box that the survey can see."""
    position = schedule.sample(SAMPLED_PULSES).true.position_m
    return np.array([position.min(axis=0) - chirp.max_range_m, position.max(axis=0) + chirp.max_range_m])


def _dem_grid(scenario: Scenario, looks: _Looks, max_gap_m: float, place: Georeference | None) -> Grid:
    """Return the cells of the DEM: the map's where the terrain has a place on it, so that other rasters fit it."""
    spacing_m = scenario.dem.spacing_m
    if not len(looks.hit_m):
        raise ScenarioError([Problem("terrain", "no beam meets it; move the track, or enlarge the terrain")])
    (west, south), (east, north) = looks.hit_m[:, :2].min(axis=0), looks.hit_m[:, :2].max(axis=0)
    cells = (east - west + 2 * spacing_m) * (north - south + 2 * spacing_m) / spacing_m**2
    if cells > MAX_DEM_CELLS:
        enough = spacing_m * 1.05 * np.sqrt(cells / MAX_DEM_CELLS)
        message = (
            f"{spacing_m:g} m makes {cells:.3g} cells of {east - west:.0f} x {north - south:.0f} m, more than "
            f"{MAX_DEM_CELLS:,}; raise it to {enough:.2g}"
        )
        raise ScenarioError([Problem("dem.spacing_m", message)])
    centre_m = place.cell_centre_m(spacing_m) if place else (0.0, 0.0)
    grid = Grid.covering(west, south, east, north, spacing_m, centre_m)
    border = 2 * closing_cells(max_gap_m, spacing_m)
    if (grid.rows + border) * (grid.columns + border) > MAX_CLOSED_CELLS:
        message = f"gaps of {max_gap_m:.3g} m are {border:,} cells of {spacing_m:g} m wide; give a smaller one"
        raise ScenarioError([Problem("dem.max_gap_m", message)])
    return grid


def _sampling_gap(scenario: Scenario) -> float:
    """Return the widest distance between neighbouring beam centres on level ground."""
    scan, platform = scenario.radar.scan, scenario.platform
    cell = 2 * scenario.dem.spacing_m
    if scan.mode in ("fixed", "side_looking"):
        return max(cell, platform.speed_mps / scenario.radar.chirp_rate_hz)
    line = platform.speed_mps * 60 / scan.rotation_rpm
    step = 2 * np.pi * scan.rotation_rpm / 60 / scenario.radar.chirp_rate_hz
    tilt = np.deg2rad(scan.incidence_deg)
    if scan.mode == "conical":
        across = platform.altitude_m * np.tan(tilt) * step
    else:
        across = platform.altitude_m / np.cos(np.deg2rad(scan.half_swath_deg)) ** 2 / np.cos(tilt) * step
    return float(max(cell, line, across))
