"""Images of a panoramic radar: a beam that turns about the vertical axis of its vehicle, over the horizon.

The vehicle drives, sails or flies along `[platform]`; every complete turn of the antenna gives an image, power against
azimuth and range, out to the unambiguous range: what lies beyond folds into it, or is filtered as the receiver does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Int

from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.spectrum import SpectrumAnalyser
from sionna_radar.execution.execution import Execution
from sionna_radar.flight.build import build_navigation, plan_route
from sionna_radar.flight.pulses import Pose, Pulses, PulseSchedule, schedule_pulses
from sionna_radar.foundation.build_cache import LogCapture
from sionna_radar.foundation.errors import Problem, ScenarioError, named_after
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.mapping.points import Points, locate
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import PanoramicScanTable, refuse_average, refuse_gate, refuse_squint
from sionna_radar.scene.build import BUILDING_STEPS, World, build_world
from sionna_radar.scene.terrains.build import map_frame
from sionna_radar.studies.panorama.polar_images import PolarImages, Way
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.instrument import Instrument, build_instrument
from sionna_radar.survey.limits import check_route
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.preparation import LATEST, build_receiver, engine_inputs
from sionna_radar.survey.sensors.radar import Radar
from sionna_radar.survey.sensors.sensor import SensorInputs

# Most values of all images together, 8 GB in memory.
MAX_VALUES = 2_000_000_000


@dataclass(frozen=True, kw_only=True)
class Panorama:
    """Images of all turns of a drive, and the points that the detector finds in them.

    images: power against azimuth and range, one a turn.
    points: echoes above the CFAR threshold, at the measured poses; a pulse is a chirp, counted through all turns.
    measured: poses of all chirps, by the navigation system.
    speed_mps: nominal, over the ground.
    range_resolution_m, azimuth_resolution_rad: half-power widths of a point target, by the window and the two-way beam.
    warnings: what was said while the world was built.

    Examples
    --------
    >>> drive = {"platform.waypoints_m": [[-104.0, -60.0], [-104.0, -40.0]], "fences": []}
    >>> seen = panorama(load_scenario("stadium", drive))
    >>> len(seen.images), seen.images.power_w.shape[1]
    (2, 400)
    """

    scenario: Scenario
    images: PolarImages
    points: Points
    measured: Pose
    speed_mps: float
    range_resolution_m: float
    azimuth_resolution_rad: float
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        turns, azimuths, cells = self.images.power_w.shape
        return (
            f"Panorama: {self.scenario.description or 'no description'}\n  {turns} turns of {azimuths} chirps, {cells} "
            f"range cells; {len(self.points):,} points"
        )


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive of a panoramic radar before it is simulated.

    local: the scenario in the frame of the world. flight: every chirp. altitude_m, speed_mps: nominal.
    warnings: what was said while the world was built.
    """

    local: Scenario
    instrument: Instrument
    world: World
    flight: PulseSchedule
    altitude_m: float
    speed_mps: float
    warnings: tuple[str, ...] = ()


@on_one_thread
def plan_drive(scenario: Scenario) -> Drive:
    """Build the world and the chirps of a drive; ScenarioError, InputFileError as `panorama`, but for single turns."""
    with LogCapture() as said, stage("preparing", BUILDING_STEPS):
        local = in_local_frame(scenario)
        instrument = build_instrument(local, CustomParts(), LATEST)
        route = plan_route(local.platform, lambda: map_frame(local.terrain))
        check_route(local, instrument, route)
        world = build_world(local, route.window_m(instrument.chirp.max_range_m), cache=LATEST)
    place = world.scene.georeference
    flown = route.fly(world.ground_m, local.seed, place.origin_m[2] if place else 0.0)
    errors, rate_hz = local.platform.navigation, instrument.pulse_rate_hz
    schedule = schedule_pulses(
        flown.trajectory,
        instrument.scan,
        rate_hz,
        lever_arm_m=errors.lever_arm_m,
        navigation=build_navigation(errors, flown.trajectory, rate_hz, local.seed),
    )
    _check_place(schedule, world)
    return Drive(
        local=local,
        instrument=instrument,
        world=world,
        flight=schedule,
        altitude_m=flown.altitude_m,
        speed_mps=flown.speed_mps,
        warnings=said.warnings,
    )


def panorama(
    scenario: Scenario, *, execution: Execution | None = None, accept: Callable[[PolarImages], object] | None = None
) -> Panorama:
    """Return the images of a panoramic radar along its drive.

    Parameters
    ----------
    scenario:
        The drive, with `radar.scan.mode = "panoramic"`.
    execution:
        As for `sionna_radar.run`; blocks are traced in this process.
    accept:
        Called before the drive with the images of undefined powers, whose times and poses are known: what it raises
        ends the call before anything is simulated.

    Returns
    -------
    An image of each complete turn of the antenna, and the points that the detector finds.

    Raises
    ------
    ScenarioError, InputFileError
        Another scan, a sensor without beats, less than a turn, a vehicle inside a wall, or a track that leaves the
        terrain.

    Examples
    --------
    >>> drive = {"platform.waypoints_m": [[-104.0, -60.0], [-104.0, -40.0]], "fences": []}
    >>> seen = panorama(load_scenario("stadium", drive))
    >>> seen.images.true.position_m.shape
    (2, 400, 3)
    """
    _check(scenario)
    execution = execution or Execution()
    with named_after(scenario.source), execution.reported():
        return _drive(scenario, execution.block_size, accept)


@on_one_thread
def _drive(scenario: Scenario, block_size: int, accept: Callable[[PolarImages], object] | None) -> Panorama:
    drive = plan_drive(scenario)
    local, instrument, schedule, place = drive.local, drive.instrument, drive.flight, drive.world.scene.georeference
    turns = _turns(schedule, local)
    sensor = Radar(_inputs(drive))
    analyser = instrument.detector.analyser
    shown = analyser.range_m <= instrument.chirp.max_range_m
    if turns.size * shown.sum() > MAX_VALUES:
        longest_m = drive.speed_mps * instrument.chirp.duration_s * MAX_VALUES / shown.sum()
        message = f"{turns.size:,} chirps of {shown.sum():,} range cells do not fit into memory"
        raise ScenarioError.of("platform.length_m", f"{message}; shorten the track to {0.99 * longest_m:.3g} m")
    power = np.empty((*turns.shape, int(shown.sum())), dtype=np.float32)
    flat, found, start = power.reshape(-1, power.shape[2]), [], 0
    chirps = turns.ravel()
    every = schedule.pulses(chirps)
    images = PolarImages(
        chirp=instrument.chirp,
        beamwidths_rad=instrument.antenna.beamwidths_rad,
        power_w=power,
        range_m=analyser.range_m[shown],
        time_s=every.time_s.reshape(turns.shape),
        scan_rad=every.scan_rad.reshape(turns.shape),
        true=Way.of(every.true, turns.shape),
        measured=Way.of(every.measured, turns.shape),
        georeference=place,
    )
    if accept is not None:
        accept(images)
    with stage("driving", -(-len(chirps) // block_size)):
        while start < len(chirps):
            pulses = schedule.pulses(chirps[start : start + block_size])
            spectra = analyser.power(sensor.beat(pulses))
            flat[start : start + len(pulses)] = spectra[:, shown]
            echoes = instrument.detector.find_in(spectra, pulses.index, None).echoes
            found.append(sensor.correct(echoes, pulses.index, pulses.measured))
            start += len(pulses)
            advance()
    return Panorama(
        scenario=scenario,
        images=images,
        points=_located(found, every),
        measured=every.measured,
        speed_mps=drive.speed_mps,
        range_resolution_m=_half_power_cells(analyser) * instrument.chirp.range_resolution_m,
        azimuth_resolution_rad=_two_way_width_rad(instrument),
        warnings=drive.warnings,
    )


def _inputs(drive: Drive) -> SensorInputs:
    local, instrument, world, schedule = drive.local, drive.instrument, drive.world, drive.flight
    return SensorInputs(
        engine=engine_inputs(local, instrument, world, schedule),
        receiver=build_receiver(local, instrument, world, drive.altitude_m),
        detector=instrument.detector,
        schedule=schedule,
        expected_ground=None,
        weather=local.weather,
        lidar=local.lidar,
    )


def _located(blocks: list[Echoes], every: Pulses) -> Points:
    echoes = Echoes.concatenate(blocks)
    points = locate(echoes, every.index, every.measured)
    return replace(points, pulse=every.row_of(points.pulse))


def _half_power_cells(analyser: SpectrumAnalyser) -> float:
    """Return the half-power width of the window's response, in range cells."""
    steps = 256
    response = analyser.response(2 * steps, steps)
    above = response >= response.max() / 2
    return float(above.sum() / steps)


def _two_way_width_rad(instrument: Instrument) -> float:
    """Return the azimuth width between the half-power points of the two-way pattern."""
    half = min(2 * instrument.antenna.beamwidths_rad[0], np.pi / 2)
    angle = np.linspace(-half, half, 4001)
    direction = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    power = instrument.antenna.gain(direction) ** 2
    return float(np.ptp(angle[power >= power.max() / 2]))


def _turns(schedule: PulseSchedule, local: Scenario) -> Int[np.ndarray, "turn azimuth"]:
    """Return the chirps of each complete turn, equally many of all."""
    number = schedule.scan_numbers
    assert number is not None
    scan, radar = local.radar.scan, local.radar
    assert isinstance(scan, PanoramicScanTable)
    azimuths = int(radar.chirp_rate_hz * 60 / scan.rotation_rpm + 1e-6)
    if azimuths < 4:
        message = f"{scan.rotation_rpm:g} turns by more than a quarter from chirp to chirp; lower it"
        raise ScenarioError.of("radar.scan.rotation_rpm", message)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    count = np.diff(np.append(first, len(number)))
    first = first[count >= azimuths]
    if len(first) == 0:
        message = (
            f"the antenna makes no complete turn in the {len(schedule) / radar.chirp_rate_hz:.3g} s of the drive; "
            f"lengthen the track to {1.01 * 120 / scan.rotation_rpm * local.platform.planned[1]:.3g} m or more"
        )
        raise ScenarioError.of("platform.length_m", message)
    return first[:, None] + np.arange(azimuths)


def _check(scenario: Scenario) -> None:
    radar = scenario.radar
    problems = []
    if not isinstance(radar.scan, PanoramicScanTable):
        message = f"{radar.scan.mode!r} does not turn over the horizon; set 'panoramic'"
        problems.append(Problem("radar.scan.mode", message))
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} has no images; set 'radar'"))
    if radar.snr_db is not None:
        message = "counts from the echo of the ground on the beam's axis, which meets none; give transmit_power_dbm"
        problems.append(Problem("radar.snr_db", message))
    if radar.sweep == "triangular":
        problems.append(Problem("radar.sweep", "'triangular' is not imaged; set 'up' or 'down'"))
    if radar.stagger > 0:
        problems.append(Problem("radar.stagger", f"{radar.stagger:g}: a turn takes even intervals; set 0"))
    if scenario.platform.log is not None:
        problems.append(Problem("platform.log", "is not driven along here; give waypoints_m"))
    if scenario.tracing.speckle == "persistent" and scenario.tracing.scatterers_per_m2 is None:
        message = "a beam along a street sees more scatterers than fit into memory"
        problems.append(Problem("tracing.speckle", f"'persistent': {message}; set 'per_pulse', or scatterers_per_m2"))
    if problems:
        raise ScenarioError(problems)
    refuse_average(scenario.processing, "a panorama")
    refuse_squint(radar, "a panorama")
    refuse_gate(radar, "a panorama")


def _check_place(schedule: PulseSchedule, world: World) -> None:
    """Raise ScenarioError for a radar inside a building, or under the ground."""
    place = schedule.sample(2000).true.position_m
    top = float(max(world.scene.bounds_m[1][2], place[:, 2].max())) + 10.0
    surface = world.caster.from_above(place[:, :2], top)
    inside = np.flatnonzero(place[:, 2] <= np.where(np.isnan(surface), -np.inf, surface))
    if len(inside):
        x, y, z = place[inside[0]]
        message = (
            f"the radar would be {surface[inside[0]] - z:.1f} m under a roof or the ground at ({x:.1f}, {y:.1f}) m; "
            "move the track, or raise platform.altitude_m"
        )
        raise ScenarioError.of("platform.waypoints_m", message)
