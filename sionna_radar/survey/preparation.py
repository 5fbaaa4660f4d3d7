"""Preparation of a survey: everything it needs before its first pulse.

The world, the instrument and the plan of the flight are built one after another, and each checks its own subject. Here
they are put together, and checked where they meet.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Inexact, Int

from sionna_radar.accuracy.truth import GroundTruth, Tally
from sionna_radar.detection.angle.array_arrival import ArrayEstimator
from sionna_radar.detection.angle.arrival import AngleEstimator
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Bursts, Navigation, Pose, Pulses, PulseSchedule
from sionna_radar.foundation.build_cache import BuildCache, LogCapture
from sionna_radar.foundation.errors import ScenarioError, named_after
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.mapping.mapper import Mapper
from sionna_radar.radar.equation import plane_echo
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.registry import require
from sionna_radar.scene.build import BUILDING_STEPS, World, box_of, build_world
from sionna_radar.signal.build import build_chain, build_interference, noise_power
from sionna_radar.signal.receiver import Receiver
from sionna_radar.surfaces.radar_material import as_radar_material
from sionna_radar.survey.beam_bias import beam_bias, maps_by_turning, warn_of_wide_beam
from sionna_radar.survey.checks import SAMPLED_PULSES, check_reference, warn_of_folded, warn_of_posting
from sionna_radar.survey.custom_parts import CustomParts, over_file, refuse_for_workers
from sionna_radar.survey.instrument import Instrument, build_instrument
from sionna_radar.survey.map_positions import in_local_frame
from sionna_radar.survey.plan import Plan, build_plan, checked_route
from sionna_radar.survey.sensors.camera import camera
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
    """A survey that is ready to fly.

    scenario: as it was given; local: with all positions in local metres.
    world: what there is to see.
    instrument: the radar and the processing of its echoes.
    plan: the flight over the world, and the map.
    receiver: of the instrument; its noise may count from the echo of the world's ground at the plan's height.
    custom: what the caller gave in place of parts of the scenario.
    warnings: what was said while it was prepared, such as of repaired meshes.

    Examples
    --------
    >>> prepared = prepare(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> len(prepared), prepared.mapper.grid.spacing_m
    (100, 1.0)
    """

    scenario: Scenario
    local: Scenario
    world: World
    instrument: Instrument
    plan: Plan
    receiver: Receiver
    custom: CustomParts = field(default_factory=CustomParts)
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.flight)

    def __repr__(self) -> str:
        grid = self.mapper.grid
        return (
            f"Prepared: {self.scenario.description or 'no description'}\n  {len(self.flight):,} pulses, DEM of "
            f"{grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m"
        )

    def __reduce__(self) -> tuple[Callable[..., "Prepared"], tuple[object, ...]]:
        # Ray casters belong to their process: another one prepares the scenario again.
        return _prepared_again, (self.scenario, self.custom, self.flight.navigation)

    @property
    def flight(self) -> PulseSchedule:
        """The pulses of the plan."""
        return self.plan.flight

    @property
    def bursts(self) -> Bursts | None:
        """The chirps of each pulse of the plan; None for one."""
        return self.plan.bursts

    @property
    def angle(self) -> AngleEstimator | ArrayEstimator | None:
        """Estimator of directions of the instrument; None for echoes on the beam's axis."""
        return self.instrument.angle

    @property
    def mapper(self) -> Mapper:
        """From points to a DEM, as planned."""
        return self.plan.mapper

    @property
    def activity(self) -> str:
        """Name of the progress stage of its observation."""
        return "tracing"

    @property
    def keeps_profiles(self) -> bool:
        """Whether range profiles around the echoes are used: by the DEM method, or to refine the navigation."""
        return self.mapper.keeps_profiles or self.refines_navigation

    @property
    def refines_navigation(self) -> bool:
        """Whether the processing refines the navigation by the echoes."""
        return self.local.processing.navigation == "refined"

    def document(self) -> dict[str, str]:
        """Return the scenario, JSON, from which a worker prepares the survey.

        Raises PluginError for parts given in Python: workers have what a scenario names, and packages registered.
        """
        refuse_for_workers(self.custom.described())
        return {"scenario": self.scenario.model_dump_json()}

    def tally(self) -> Tally:
        """Return a new count of true hits."""
        # A pair of sweeps takes the shift out, and a sensor of one's own may know none.
        shifted = self.local.sensor != "lidar" and len(self.instrument.sweeps) == 1 and self.custom.sensor is None
        chirp = self.receiver.chirp
        return Tally(self.truth, chirp, chirp.doppler_range_s if shifted else 0.0)

    def measured(self, index: Int[np.ndarray, " pulse"]) -> Pose:
        """Return the measured poses of pulses by their running numbers."""
        return self.flight.pulses(index).measured

    def engine_inputs(self) -> EngineInputs:
        """Return the inputs of tracing engines."""
        return engine_inputs(self.local, self.instrument, self.world, self.flight)

    def sensor_inputs(self) -> SensorInputs:
        """Return the inputs of sensors."""
        return SensorInputs(
            engine=self.engine_inputs(),
            receiver=self.receiver,
            detector=self.instrument.detector,
            schedule=self.flight,
            expected_ground=self.plan.expected_ground,
            weather=self.local.weather,
            lidar=self.local.lidar,
            angle=self.instrument.angle,
            module=self.instrument.module,
            bursts=self.plan.bursts,
            custom_engine=self.custom.engine,
        )

    def build_sensor(self, inputs: SensorInputs | None = None) -> Sensor:
        """Return a new sensor of the survey, or of other inputs than its own."""
        given = inputs or self.sensor_inputs()
        if self.custom.sensor is None:
            return build_sensor(self.local, given)
        sensor = self.custom.sensor(given)
        require(sensor, Sensor, "sensor")
        return sensor

    @cached_property
    def truth(self) -> GroundTruth:
        """The surface that the survey flies over."""
        return GroundTruth(
            world=self.world,
            buildings=tuple(box_of(table) for table in self.local.buildings),
            grid=self.mapper.grid,
            max_gap_m=self.mapper.max_gap_m,
            antenna=self.instrument.antenna,
            beams=self.instrument.beams,
            altitude_m=self.plan.flown.altitude_m,
            compared=self.mapper.surface,
        )

    @on_one_thread
    def observe(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Observation:
        """Observe some pulses, by their running numbers, increasing, with the survey's sensor.

        Behind rain the echoes of a pulse are those that its whole scan line makes most probable, which is observed.

        Examples
        --------
        >>> seen = prepare(load_scenario("hills", {"platform.length_m": 10.0})).observe([0, 50])
        >>> seen.paths.delay_s.shape == seen.paths.gain.shape, len(seen.echoes)
        (True, 2)
        """
        pulses = self._chosen(index)
        seen = self._sensor.observe(pulses)
        if not seen.through_volume:
            return seen
        lines = self._sensor.observe(self.flight.pulses(np.concatenate(self.flight.lines_of(pulses.index))))
        profiles = lines.profiles
        if profiles is not None:
            profiles = profiles.rows(np.flatnonzero(np.isin(profiles.pulse, pulses.index)))
        return replace(seen, echoes=lines.echoes.rows(np.isin(lines.echoes.pulse, pulses.index)), profiles=profiles)

    @on_one_thread
    def paths(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Paths:
        """Return the paths of some pulses, sorted by pulse: complex gains, delays s, range rates m/s, hit points m."""
        return self._sensor.observe(self._chosen(index)).paths

    @on_one_thread
    def beats(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> list[Inexact[np.ndarray, "chirp sample"]]:
        """Return the beat signals of some pulses, V at 1 ohm: an array (chirp, sample) for each sweep of a pulse.

        Raises ScenarioError for a sensor without beat signals.
        """
        beats = self._sensor.observe(self._chosen(index)).beats
        if beats is None:
            raise ScenarioError.of("sensor", f"{self.local.sensor!r} has no beat signals; set sensor = 'radar'")
        return list(beats)

    @on_one_thread
    def spectra(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> list[ChirpRecord]:
        """Return the first sweep of each of some pulses on its way through the processing.

        That is its beat signal after what the processing takes out of it, the power in each range cell W, the CFAR
        threshold, and the echoes. Raises ScenarioError for a sensor without chirps.
        """
        sensor = self._sensor
        if not isinstance(sensor, SensorWithChirps):
            raise ScenarioError.of("sensor", f"{self.local.sensor!r} has no chirps; set sensor = 'radar'")
        return sensor.record_chirps(self._chosen(index))

    def echoes(self, index: Int[np.ndarray, " pulse"] | Sequence[int]) -> Echoes:
        """Return the echoes of some pulses, their ranges corrected for Doppler by the measured velocity.

        The loop of a tracker begins with the first of them.
        """
        pulses, sensor = self._chosen(index), self._sensor
        return corrected(sensor, self.observe(index).echoes, pulses, loop_of(sensor))

    @cached_property
    def _sensor(self) -> Sensor:
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
            raise IndexError(f"pulses {list(np.ravel(chosen))[:5]}: give increasing numbers from 0 to {len(self) - 1}")
        return self.flight.pulses(chosen)

    def with_navigation(self, navigation: Navigation | None) -> "Prepared":
        """Return the survey with another navigation system; None knows the pose exactly."""
        return replace(self, plan=replace(self.plan, flight=replace(self.flight, navigation=navigation)))


# What surveys of this process share unless another cache is given.
LATEST = BuildCache()


@on_one_thread
def prepare(scenario: Scenario, parts: CustomParts | None = None, *, cache: BuildCache | None = None) -> Prepared:
    """Build the world, the instrument and the plan of a scenario, and refuse what cannot be flown.

    Parameters
    ----------
    scenario:
        The survey.
    parts:
        What replaces parts of it.
    cache:
        What an earlier survey has built, where this one needs the same; takes what this one builds. None: that of the
        surveys of this process.

    Returns
    -------
    World, instrument, plan and receiver, ready to be observed.

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
        prepared = _prepare(scenario, custom, cache or LATEST)
    return replace(prepared, warnings=said.warnings)


def _prepared_again(scenario: Scenario, custom: CustomParts, navigation: Navigation | None) -> Prepared:
    return prepare(scenario, custom).with_navigation(navigation)


def _prepare(scenario: Scenario, custom: CustomParts, cache: BuildCache) -> Prepared:
    assert not isinstance(custom.terrain, tuple | str | Path), "a raster, or the scenario's own, by now"
    if scenario.sensor == "camera":
        camera()
    local = in_local_frame(scenario)
    instrument = build_instrument(local, custom, cache)
    route = custom.flight or checked_route(local, instrument)
    advance()
    window_m = route.window_m(instrument.chirp.max_range_m)
    world = build_world(local, window_m, custom.terrain, custom.materials, cache)
    plan = build_plan(local, instrument, route, world, custom)
    receiver = build_receiver(local, instrument, world, plan.flown.altitude_m)
    _warn(local, instrument, world, plan)
    advance()
    return Prepared(
        scenario=scenario, local=local, world=world, instrument=instrument, plan=plan, receiver=receiver, custom=custom
    )


def engine_inputs(local: Scenario, instrument: Instrument, world: World, flight: PulseSchedule) -> EngineInputs:
    """Return the inputs of the tracing engines of an instrument that moves through a world."""
    sampled = flight.sample(SAMPLED_PULSES)
    pose, reach_m = sampled.true, instrument.chirp.max_range_m
    looks = SampledBeams(
        position_m=pose.position_m,
        R_world_antenna=pose.R_world_antenna,
        range_m=world.caster.cast(pose.position_m, pose.boresight).distance_m,
        beam=np.zeros(len(sampled), dtype=np.int64) if sampled.beam is None else sampled.beam,
    )
    return EngineInputs(
        tracing=local.tracing,
        scene=world.scene,
        antenna=instrument.antenna,
        beams=instrument.beams,
        chirp=instrument.chirp,
        seed=local.seed,
        caster=world.caster,
        region_m=np.array([pose.position_m.min(axis=0) - reach_m, pose.position_m.max(axis=0) + reach_m]),
        looks=looks,
    )


def build_receiver(local: Scenario, instrument: Instrument, world: World, altitude_m: float) -> Receiver:
    """Return the receiver over the ground; ScenarioError where nothing refers its noise to an echo."""
    others = build_interference(local.interferers, world.ground_m, instrument.beams or (instrument.antenna,))
    # What `radar.snr_db` counts from: the co-polar echo of level ground, whatever the receiver's polarization.
    name, incidence_rad = world.scene.ground_material, instrument.scan.incidence_rad
    ground = as_radar_material(world.scene.materials[name]).co_polar
    check_reference(local, name, ground, incidence_rad)
    echo = plane_echo(instrument.antenna, ground, instrument.chirp.wavelength_m, altitude_m, incidence_rad)
    return Receiver(
        sweeps=instrument.sweeps,
        transmit_power_w=instrument.transmit_power_w,
        noise_power_w=noise_power(local.radar, instrument.chirp, echo),
        seed=local.seed,
        high_pass=instrument.high_pass,
        chain=build_chain(local.radar, instrument.sweeps, instrument.high_pass, others),
    )


def _warn(local: Scenario, instrument: Instrument, world: World, plan: Plan) -> None:
    """Warn of what the instrument cannot show of this world from this flight."""
    widths_rad, hits = instrument.antenna.beamwidths_rad, plan.hits
    if local.sensor == "radar":
        warn_of_folded(instrument.sweeps, hits.range_m, hits.range_rate_mps, local.processing.min_range_m)
    warn_of_posting(world.posting_m, hits.range_m, widths_rad)
    beam = plan.mapper.beam if local.sensor == "radar" and instrument.angle is None else None
    if beam is not None and maps_by_turning(plan.flight):
        warn_of_wide_beam(beam_bias(plan.flight, world, beam), plan.mapper.grid.spacing_m, widths_rad)
