"""Preparation of a survey: everything it needs before its first pulse.

Radar, route, processing, world, flight, map and receiver are built one after another; each checks its own subject.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.accuracy.truth import GroundTruth, Tally
from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.build import build_angle_estimator, build_detector, build_expected_ground
from sionna_radar.detection.detector import Detector
from sionna_radar.detection.echoes import Echoes
from sionna_radar.detection.expected_ground import ExpectedGround
from sionna_radar.flight.build import build_navigation, build_scan, plan_route
from sionna_radar.flight.pulses import Bursts, Navigation, Pose, Pulses, PulseSchedule, in_bursts, schedule_pulses
from sionna_radar.flight.route import Route
from sionna_radar.flight.scan import Scan
from sionna_radar.flight.trajectory import Flight
from sionna_radar.foundation.errors import PluginError, Problem, ScenarioError, named_after
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.world import LogCapture, World
from sionna_radar.mapping.build import build_mapper, speckle_memory
from sionna_radar.mapping.mapper import Extent, Mapper, dem_grid
from sionna_radar.radar.antenna import Antenna
from sionna_radar.radar.array_antenna import beams_of
from sionna_radar.radar.build import (
    build_antenna,
    build_array,
    build_chirp,
    build_receivers,
    build_sweeps,
    squinting,
    warn_of_frequency,
)
from sionna_radar.radar.chirp import Chirp
from sionna_radar.radar.equation import plane_echo
from sionna_radar.radar.mimo_array import MimoArray
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.loading import content_key
from sionna_radar.scenario.parts import ANTENNAS, SENSORS
from sionna_radar.scenario.radar import speckle_looks
from sionna_radar.scenario.registry import PACKAGE, require
from sionna_radar.scene.build import BUILDING_STEPS, BuiltScene, box_of, build_scene
from sionna_radar.scene.terrains.build import map_frame
from sionna_radar.signal.analog_filters import HighPass
from sionna_radar.signal.build import build_chain, build_high_pass, build_interference, noise_power, transmit_power_w
from sionna_radar.signal.receiver import Receiver
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.beam_bias import beam_bias, maps_by_turning, warn_of_wide_beam
from sionna_radar.survey.checks import (
    SAMPLED_PULSES,
    BoresightHits,
    boresight_hits,
    check_bounces,
    check_geometry,
    check_limits,
    check_nominal_range,
    check_paths,
    check_pulses,
    check_reference,
    check_rotors,
    check_vegetation,
    warn_of_folded,
    warn_of_posting,
    warn_of_repeated_angles,
)
from sionna_radar.survey.custom_parts import CustomParts, over_file, refuse_for_workers
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.sensors.sensor import (
    Observation,
    Sensor,
    SensorInputs,
    SensorWithChirps,
    build_sensor,
    corrected,
    loop_of,
)
from sionna_radar.survey.sensors.sweeps import ChirpRecord
from sionna_radar.tracing.build import EngineInputs
from sionna_radar.tracing.paths import Paths, SampledBeams


@dataclass(frozen=True, kw_only=True)
class Prepared:
    """A survey that is ready to fly, by who needs what.

    scenario: as it was given; local: with all positions in local metres.
    scene: what the radar can see.
    antenna, flight, receiver: the radar, its pulses, and its receiver.
    flown: the trajectory with its nominal height and speed, and what a log gave for it.
    detector, expected_ground: from beat signals to echoes, and what is known of the ground beforehand, if anything.
    angle: finds directions inside the beam, or points in the frames of an array; None for echoes on the beam's axis.
    module: the array with its true errors; None for a radar without.
    bursts: the chirps that are averaged to each pulse of the flight, or the frame that it is; None for one.
    mapper: from points to a DEM.
    custom: what the caller gave in place of parts of the scenario.
    beams: the antenna steered to each beam of an electronic scan.
    ground_extent_m: west, south, east and north of the ground that the beam's axis meets, or an array sees.
    warnings: what was said while it was prepared, such as of repaired meshes.

    Examples
    --------
    >>> prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> len(prepared), prepared.mapper.grid.spacing_m
    (100, 1.0)
    """

    scenario: Scenario
    local: Scenario
    scene: BuiltScene
    antenna: Antenna
    flown: Flight
    flight: PulseSchedule
    receiver: Receiver
    detector: Detector
    expected_ground: ExpectedGround | None
    mapper: Mapper
    ground_extent_m: Extent
    custom: CustomParts = field(default_factory=CustomParts)
    beams: tuple[Antenna, ...] = ()
    angle: AngleEstimator | ArrayEstimator | None = None
    module: MimoArray | None = None
    bursts: Bursts | None = None
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.flight)

    def __repr__(self) -> str:
        grid = self.mapper.grid
        return (
            f"Prepared: {self.scenario.description or 'no description'}\n  {len(self.flight):,} pulses, DEM of "
            f"{grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m"
        )

    @property
    def activity(self) -> str:
        """Name of the progress stage of its observation."""
        return "tracing"

    @property
    def keeps_profiles(self) -> bool:
        """Whether the DEM method uses range profiles around the echoes."""
        return self.mapper.keeps_profiles

    def document(self) -> dict[str, str]:
        """Return the scenario, JSON, from which a worker prepares the survey.

        Raises PluginError for parts given in Python: workers have what a scenario names, and packages registered.
        """
        refuse_for_workers(self.custom.described())
        return {"scenario": self.scenario.model_dump_json()}

    def tally(self) -> Tally:
        """Return a new count of true hits."""
        return Tally(self.truth, self.receiver.chirp)

    def measured(self, index: Int[np.ndarray, " pulse"]) -> Pose:
        """Return the measured poses of pulses by their running numbers."""
        return self.flight.pulses(index).measured

    def engine_inputs(self) -> EngineInputs:
        """Return the inputs of tracing engines."""
        sampled = self.flight.sample(SAMPLED_PULSES)
        position_m, reach_m = sampled.true.position_m, self.receiver.chirp.max_range_m
        return EngineInputs(
            tracing=self.local.tracing,
            scene=self.scene.scene,
            antenna=self.antenna,
            beams=self.beams,
            chirp=self.receiver.chirp,
            seed=self.local.seed,
            caster=self.scene.caster,
            region_m=np.array([position_m.min(axis=0) - reach_m, position_m.max(axis=0) + reach_m]),
            looks=sampled_beams(sampled, self.scene),
        )

    def sensor_inputs(self) -> SensorInputs:
        """Return the inputs of sensors."""
        return SensorInputs(
            engine=self.engine_inputs(),
            receiver=self.receiver,
            detector=self.detector,
            schedule=self.flight,
            expected_ground=self.expected_ground,
            weather=self.local.weather,
            lidar=self.local.lidar,
            angle=self.angle,
            module=self.module,
            bursts=self.bursts,
            custom_engine=self.custom.engine,
        )

    def build_sensor(self) -> Sensor:
        """Return a new sensor of the survey."""
        given = self.sensor_inputs()
        if self.custom.sensor is None:
            return build_sensor(self.local, given)
        sensor = self.custom.sensor(given)
        require(sensor, Sensor, "sensor")
        return sensor

    @cached_property
    def truth(self) -> GroundTruth:
        """The surface that the survey flies over."""
        return GroundTruth(
            built=self.scene,
            buildings=tuple(box_of(table) for table in self.local.buildings),
            grid=self.mapper.grid,
            max_gap_m=self.mapper.max_gap_m,
            antenna=self.antenna,
            beams=self.beams,
        )

    def observe(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Observation:
        """Observe some pulses, by their running numbers, increasing, with the survey's sensor.

        Examples
        --------
        >>> seen = prepare(load_scenario("hills", {"platform.length_m": 10.0})).observe([0, 50])
        >>> seen.paths.delay_s.shape == seen.paths.gain.shape, len(seen.echoes)
        (True, 2)
        """
        return self._own_sensor.observe(self._chosen(index))

    def paths(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Paths:
        """Return the paths of some pulses, sorted by pulse: complex gains, delays s, range rates m/s, hit points m."""
        return self.observe(index).paths

    def beats(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> list[Inexact[np.ndarray, "chirp sample"]]:
        """Return the beat signals of some pulses, V at 1 ohm: an array (chirp, sample) for each sweep of a pulse.

        Raises ScenarioError for a sensor without beat signals.
        """
        beats = self.observe(index).beats
        if beats is None:
            message = f"{self.local.sensor!r} has no beat signals; set sensor = 'radar'"
            raise ScenarioError([Problem("sensor", message)])
        return list(beats)

    def spectra(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> list[ChirpRecord]:
        """Return the first sweep of each of some pulses on its way through the processing.

        That is its beat signal after what the processing takes out of it, the power in each range cell W, the CFAR
        threshold, and the echoes. Raises ScenarioError for a sensor without chirps.
        """
        sensor = self._own_sensor
        if not isinstance(sensor, SensorWithChirps):
            message = f"{self.local.sensor!r} has no chirps; set sensor = 'radar'"
            raise ScenarioError([Problem("sensor", message)])
        return sensor.record_chirps(self._chosen(index))

    def echoes(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Echoes:
        """Return the echoes of some pulses, their ranges corrected for Doppler by the measured velocity.

        The loop of a tracker begins with the first of them.
        """
        pulses, sensor = self._chosen(index), self._own_sensor
        return corrected(sensor, sensor.observe(pulses).echoes, pulses, loop_of(sensor))

    @cached_property
    def _own_sensor(self) -> Sensor:
        return self.build_sensor()

    def _chosen(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Pulses:
        """Return pulses by their running numbers; raises IndexError for one that there is not."""
        chosen = np.asarray(index, dtype=np.int64)
        if (
            chosen.ndim != 1
            or len(chosen) == 0
            or chosen[0] < 0
            or chosen[-1] >= len(self)
            or np.any(np.diff(chosen) < 1)
        ):
            message = f"pulses {list(np.ravel(chosen))[:5]}: give increasing numbers from 0 to {len(self) - 1}"
            raise IndexError(message)
        return self.flight.pulses(chosen)

    def with_navigation(self, navigation: Navigation | None) -> "Prepared":
        """Return the survey with another navigation system; None knows the pose exactly."""
        return replace(self, flight=replace(self.flight, navigation=navigation))


# What surveys of this process share unless another world is given.
LATEST = World()


@on_one_thread
def prepare(scenario: Scenario, parts: CustomParts | None = None, *, world: World | None = None) -> Prepared:
    """Build the scene and the flight of a scenario, and refuse what cannot be flown.

    Parameters
    ----------
    scenario:
        The survey.
    parts:
        What replaces parts of it.
    world:
        What an earlier survey has built, where this one needs the same; takes what this one builds. None: that of the
        surveys of this process.

    Returns
    -------
    Scene, flight, receiver and mapper, ready to be observed.

    Raises
    ------
    ScenarioError
        No pulses, a radar under the terrain, a swath that leaves it, ranges beyond the sampled beat.
    InputFileError
        The elevation file cannot be used.

    Examples
    --------
    >>> prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> survey = run(prepared)
    >>> survey.prepared is prepared
    True
    """
    custom = parts or CustomParts()
    with named_after(scenario.source), LogCapture() as said, stage("preparing", BUILDING_STEPS + 3):
        if isinstance(custom.terrain, str | Path):
            scenario, custom = over_file(scenario, custom.terrain), replace(custom, terrain=None)
        prepared = _prepare(scenario, custom, world or LATEST)
    return replace(prepared, warnings=said.warnings)


def _prepare(scenario: Scenario, custom: CustomParts, shared: World) -> Prepared:
    local = in_local_frame(scenario)
    radar = _radar(local, custom, shared)
    route = custom.flight or _route(scenario, local, radar)
    detector, angle = _processing(local, radar, route, custom)
    advance()
    world = _world(local, route.window_m(radar.chirp.max_range_m), custom, shared)
    flight = _flight(local, radar, route, world, custom)
    advance()
    mapper = _map(local, radar, detector, world, flight, custom)
    receiver = _receiver(local, radar, world, flight)
    if local.sensor == "radar" and angle is None and mapper.beam is not None and maps_by_turning(flight.schedule):
        bias = beam_bias(flight.schedule, world, mapper.beam)
        warn_of_wide_beam(bias, mapper.grid.spacing_m, radar.antenna.beamwidths_rad)
    advance()
    place, expected = world.scene.georeference, local.processing.expected_ground
    return Prepared(
        scenario=scenario,
        local=local,
        scene=world,
        antenna=radar.antenna,
        beams=radar.beams,
        flown=flight.flown,
        flight=flight.schedule,
        receiver=receiver,
        detector=detector,
        expected_ground=build_expected_ground(expected, flight.flown.altitude_m, radar.antenna, mapper.grid, place),
        mapper=mapper,
        custom=custom,
        angle=angle,
        module=radar.module,
        bursts=flight.bursts,
        ground_extent_m=_mapped_extent_m(local, flight),
    )


@dataclass(frozen=True, kw_only=True)
class _Radar:
    """The radar before its receiver, whose noise counts from the echo of the ground."""

    sweeps: tuple[Chirp, ...]
    scan: Scan
    antenna: Antenna
    beams: tuple[Antenna, ...]
    high_pass: HighPass | None
    module: MimoArray | None = None

    @property
    def chirp(self) -> Chirp:
        """The first sweep of a pulse."""
        return self.sweeps[0]


def _radar(local: Scenario, custom: CustomParts, shared: World) -> _Radar:
    """Return the radar; ScenarioError for vegetation and rotors that it cannot show."""
    scan = custom.scan or build_scan(local.radar.scan)
    table = local.radar.antenna
    key = content_key({"antenna": table}) if ANTENNAS.entry(table.kind).origin == PACKAGE else None
    antenna = custom.antenna or shared.once("antenna", key, lambda: build_antenna(table))
    if custom.antenna is None:
        warn_of_frequency(table, local.radar.carrier_hz)
    antenna, sweeps = squinting(table, antenna, build_sweeps(local.radar))
    radar = _Radar(
        sweeps=sweeps,
        scan=scan,
        antenna=antenna,
        beams=beams_of(antenna, scan),
        high_pass=build_high_pass(local.radar.receiver),
        module=_module(local, antenna),
    )
    check_vegetation(local, antenna)
    check_rotors(local, radar.chirp)
    return radar


def _module(local: Scenario, antenna: Antenna) -> MimoArray | None:
    """Return the array of the radar, with its true errors; None for a radar whose first receiver alone is used."""
    if local.sensor == "mimo":
        assert local.radar.array is not None  # the scenario's own check
        return build_array(local.radar.array, build_chirp(local.radar), 1 / local.radar.chirp_rate_hz, local.seed)
    return None if local.processing.angle == "off" else build_receivers(local.radar, antenna)


def _route(scenario: Scenario, local: Scenario, radar: _Radar) -> Route:
    """Return the flight before its ground is known; ScenarioError for one beyond the limits of the radar."""
    route = plan_route(local.platform, lambda: map_frame(scenario.terrain))
    check_limits(local, radar.chirp, route, radar.antenna.beamwidths_rad, radar.scan.incidence_rad)
    return route


def _processing(
    local: Scenario, radar: _Radar, route: Route, custom: CustomParts
) -> tuple[Detector, AngleEstimator | ArrayEstimator | None]:
    """Return the processing of echoes; ScenarioError where the nominal range is beyond its sampled beat."""
    if local.processing.calibration is not None:
        message = "is of recordings; give the errors of a simulated flight as platform.navigation, and leave this out"
        raise ScenarioError([Problem("processing.calibration", message)])
    detector = build_detector(
        local.processing,
        radar.chirp,
        radar.antenna,
        radar.high_pass,
        custom.range_estimator,
        speckle_looks=speckle_looks(local.processing, local.tracing),
        transmit_power_w=transmit_power_w(local.radar),
    )
    if route.altitude_m is not None:
        check_nominal_range(route.altitude_m, radar.scan, radar.chirp, route.duration_s)
    frames = local.radar.array if local.sensor == "mimo" else None
    return detector, build_angle_estimator(local.processing, detector, radar.antenna, radar.module, frames)


def _world(local: Scenario, window_m: Extent, custom: CustomParts, shared: World) -> BuiltScene:
    """Return the scene: terrain, objects and their materials."""
    assert not isinstance(custom.terrain, tuple | str | Path), "a raster, or the scenario's own, by now"
    world = build_scene(local, window_m, custom.terrain, custom.materials, shared)
    check_bounces(local, world)
    return world


@dataclass(frozen=True, kw_only=True)
class _FlightOver:
    """A flight over its ground: its pulses, and where their beams meet the scene."""

    flown: Flight
    schedule: PulseSchedule
    bursts: Bursts | None
    hits: BoresightHits


def _flight(local: Scenario, radar: _Radar, route: Route, world: BuiltScene, custom: CustomParts) -> _FlightOver:
    """Return the flight; ScenarioError where it has no pulses, or its swath leaves the terrain."""
    place = world.scene.georeference
    flown = route.fly(world.ground_m, local.seed, place.origin_m[2] if place else 0.0)
    if route.altitude_m is None:
        check_paths(local, radar.chirp, flown.altitude_m, radar.antenna.beamwidths_rad, radar.scan.incidence_rad)
    errors = local.platform.navigation
    navigation = custom.navigation or build_navigation(errors, flown.trajectory, pulse_rate_hz(local), local.seed)
    if custom.flight is not None:
        schedule: PulseSchedule = custom.flight.schedule(
            flown, radar.scan, place.origin_m[2] if place else 0.0, navigation, errors.lever_arm_m
        )
    else:
        schedule = schedule_pulses(
            flown.trajectory,
            radar.scan,
            pulse_rate_hz(local),
            lever_arm_m=errors.lever_arm_m,
            navigation=navigation,
            stagger=local.radar.stagger,
        )
        if local.sensor == "radar":
            warn_of_repeated_angles(
                radar.scan,
                flown.altitude_m,
                flown.speed_mps,
                pulse_rate_hz(local),
                local.radar.stagger,
                radar.antenna.beamwidths_rad,
            )
    if radar.module is None or local.sensor != "mimo":
        bursts = in_bursts(schedule, local.processing.average.chirps, local.radar.chirp_rate_hz)
    else:
        bursts = Bursts(schedule=schedule, chirps=radar.module.chirps, period_s=radar.module.period_s)
    schedule = schedule if bursts is None else bursts.schedule
    check_pulses(schedule, local)
    hits = boresight_hits(schedule, world)
    check_geometry(hits, world, radar.chirp)
    return _FlightOver(flown=flown, schedule=schedule, bursts=bursts, hits=hits)


def _map(
    local: Scenario, radar: _Radar, detector: Detector, world: BuiltScene, flight: _FlightOver, custom: CustomParts
) -> Mapper:
    """Return the mapper; ScenarioError for a grid that is too large, or a method without the profiles it requires."""
    max_gap_m = local.dem.max_gap_m or _sampling_gap(local, flight.flown, radar.scan)
    mapper = build_mapper(
        local.dem,
        dem_grid(local.dem.spacing_m, _mapped_extent_m(local, flight), max_gap_m, world.scene.georeference),
        max_gap_m,
        # The points of an array lie at single places.
        radar.antenna if local.sensor not in ("lidar", "mimo") else None,
        detector.analyser,
        local.processing.doppler_correction,
        custom.dem_method,
        speckle_memory(local),
        measured_ground=local.measured_ground or isinstance(custom.terrain, Raster),
        ground=local,
    )
    _check_profiles(local, mapper, custom)
    return mapper


def _mapped_extent_m(local: Scenario, flight: _FlightOver) -> Extent:
    """Return the extent of the DEM: the ground that the beam's axis meets, or what an array sees to its sides."""
    extent_m = flight.hits.extent_m
    if local.radar.array is None or local.sensor != "mimo":
        return extent_m
    reach_m = flight.flown.altitude_m * np.tan(np.deg2rad(local.radar.array.half_view_deg))
    pose = flight.schedule.sample(SAMPLED_PULSES).measured
    left = np.abs(pose.R_world_antenna[:, :2, 1]).max(axis=0)
    west, south, east, north = extent_m
    east_m, north_m = reach_m * left
    return (west - east_m, south - north_m, east + east_m, north + north_m)


def _receiver(local: Scenario, radar: _Radar, world: BuiltScene, flight: _FlightOver) -> Receiver:
    """Return the receiver; ScenarioError where nothing refers its noise to an echo."""
    others = build_interference(local.interferers, world.ground_m, radar.beams or (radar.antenna,))
    check_reference(local, world, radar.scan.incidence_rad)
    if local.sensor == "radar":
        hits = flight.hits
        warn_of_folded(radar.sweeps, hits.range_m, hits.range_rate_mps, local.processing.min_range_m)
    warn_of_posting(world.posting_m, flight.hits.range_m, radar.antenna.beamwidths_rad)
    # What `radar.snr_db` counts from: the co-polar echo of level ground, whatever the receiver's polarization.
    ground = as_radar_material(world.scene.materials[world.scene.ground_material]).co_polar
    altitude_m, incidence_rad = flight.flown.altitude_m, radar.scan.incidence_rad
    echo = plane_echo(radar.antenna, ground, radar.chirp.wavelength_m, altitude_m, incidence_rad)
    return Receiver(
        sweeps=radar.sweeps,
        transmit_power_w=transmit_power_w(local.radar),
        noise_power_w=noise_power(local.radar, radar.chirp, echo),
        seed=local.seed,
        high_pass=radar.high_pass,
        chain=build_chain(local.radar, radar.sweeps, radar.high_pass, others),
    )


def _check_profiles(scenario: Scenario, mapper: Mapper, custom: CustomParts) -> None:
    """Refuse a DEM method without the range profiles that it requires; a custom sensor shows what it has in flight."""
    method, name = mapper.method, mapper.name
    if method.profiles not in ("unused", "optional", "required"):
        message = f"DEM method {name!r}: profiles = {method.profiles!r}; give 'unused', 'optional' or 'required'"
        raise PluginError(message)
    if method.profiles != "required" or custom.sensor is not None:
        return
    paired = scenario.sensor == "radar" and scenario.radar.sweep == "triangular"
    if paired or not SENSORS.entry(scenario.sensor).facts.provides_profiles:
        message = f"{name!r} needs range profiles, which this sensor does not have; set dem.method = 'smooth'"
        raise ScenarioError([Problem("dem.method", message)])


def _sampling_gap(scenario: Scenario, flown: Flight, scan: Scan) -> float:
    """Return the widest distance between neighbouring beam centres on level ground, and no less than two cells."""
    rate_hz = pulse_rate_hz(scenario) / (1 + scenario.radar.stagger / 2) / scenario.processing.average.chirps
    spacing_m = scan.spacing_m(flown.altitude_m, flown.speed_mps, rate_hz)
    if not (isinstance(spacing_m, float | int) and 0 <= spacing_m < np.inf):
        message = f"{type(scan).__name__}.spacing_m is {spacing_m!r}; return metres, or set dem.max_gap_m"
        raise PluginError(message)
    return max(2 * scenario.dem.spacing_m, spacing_m)


def pulse_rate_hz(scenario: Scenario) -> float:
    """Return the pulses a second without pauses: chirps, or the frames of an array."""
    array = scenario.radar.array
    return scenario.radar.chirp_rate_hz if array is None or scenario.sensor != "mimo" else array.frame_rate_hz


def sampled_beams(pulses: Pulses, built: BuiltScene) -> SampledBeams:
    """Return the beams of pulses: poses, and boresight ranges to the scene, m."""
    pose = pulses.true
    return SampledBeams(
        position_m=pose.position_m,
        R_world_antenna=pose.R_world_antenna,
        range_m=built.caster.cast(pose.position_m, pose.boresight).distance_m,
        beam=np.zeros(len(pulses), dtype=np.int64) if pulses.beam is None else pulses.beam,
    )
