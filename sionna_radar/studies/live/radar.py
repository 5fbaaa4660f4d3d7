"""A radar in the loop: stepped from pose to pose, it answers each step with what it heard since the last one.

The schedule, the noise, the speckle and the processing are those of a survey: the poses of `run`, stepped one by one or
several at once, give its points bit for bit. The scenario's own flight is the planned one: the ground within the
radar's range of it is loaded, rain and leakage are looked at along it, and its height is what a signal-to-noise ratio
counts from. The vehicle may fly otherwise.
"""

import gc
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.navigation import InertialErrors
from sionna_radar.flight.pulses import Navigation, Pulses, PulseSchedule, ends_of_lines
from sionna_radar.foundation.errors import PoseError
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.threads import chunks
from sionna_radar.mapping.mapper import Mapper
from sionna_radar.scenario import Scenario
from sionna_radar.studies.live.clock import PulseClock
from sionna_radar.studies.live.frame import Frame, listen
from sionna_radar.studies.live.poses import Numbers, Poses, PoseTrack, ReportedPoses
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.sensor import SensorWithSweeps, loop_of
from sionna_radar.tracing.build import planned_density

# Longest time between two poses that is interpolated over, s.
MAX_GAP_S = 0.5
# Pulses that are observed at once: it bounds the memory of a long step.
AT_ONCE = 512
# Sizes of the steps that a radar is made ready for: Dr.Jit compiles other code for a single one.
WARM_PULSES = (1, 2, 64)


class Radar:
    """A radar that is stepped: `step` takes poses and returns a `Frame` of what was heard since the last step.

    Parameters
    ----------
    scenario:
        A scenario, or a prepared survey, which includes its custom parts.
    max_gap_s:
        Longest time between two poses that is interpolated over. After a longer one the radar starts anew: nothing is
        transmitted in between, and the frame's `notice` says so.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    Examples
    --------
    >>> radar = Radar(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> level = 0.0, 0.0, 1.5708  # roll, pitch and heading: toward the east
    >>> frame = radar.step(0.0, (-100.0, 0.0, 60.0), level, (10.0, 0.0, 0.0))
    >>> frame = radar.step(0.2, (-98.0, 0.0, 60.0), level, (10.0, 0.0, 0.0))
    >>> len(frame) > 0, frame.points.position_m.shape == (len(frame.echoes), 3), frame.notice
    (True, True, '')
    """

    @on_one_thread
    def __init__(self, scenario: Scenario | Prepared, *, max_gap_s: float = MAX_GAP_S) -> None:
        self.prepared = prepared = scenario if isinstance(scenario, Prepared) else prepare(scenario)
        self.max_gap_s = max_gap_s
        planned, local, instrument = prepared.flight, prepared.local, prepared.instrument
        half_s = 0.0 if prepared.bursts is None else float(prepared.bursts.offset_s[-1])
        averaged = 1 if prepared.bursts is None or instrument.frames is not None else prepared.bursts.chirps
        kept_s = max_gap_s + 2 * half_s + max(0.0, getattr(planned.navigation, "time_offset_s", 0.0))
        self._true, self._reported = (PoseTrack(kept_s, planned.trajectory) for _ in range(2))
        self._schedule = PulseSchedule(
            trajectory=self._true.trajectory,
            scan=planned.scan,
            time_s=np.zeros(0),
            lever_arm_m=planned.lever_arm_m,
            navigation=_without_end(planned.navigation),
        )
        reported = ReportedPoses(self._reported, planned.lever_arm_m)
        self._with_reported = replace(self._schedule, navigation=reported)
        self._clock = PulseClock(
            start_s=planned.trajectory.cruise_s()[0],
            rate_hz=instrument.pulse_rate_hz,
            stagger=local.radar.stagger if instrument.frames is None else 0.0,
            scan=planned.scan,
            averaged=averaged,
            half_s=half_s,
        )
        inputs = prepared.sensor_inputs()
        if prepared.bursts is not None:
            inputs = replace(inputs, bursts=replace(prepared.bursts, schedule=self._schedule))
        self._region_m, self._max_range_m = inputs.engine.region_m, prepared.receiver.chirp.max_range_m
        self.sensor = prepared.build_sensor(inputs)
        # A lidar has no scatterers, and a custom engine its own.
        traced = local.sensor != "lidar" and prepared.custom.engine is None
        self._density = planned_density(inputs.engine) if traced else None
        self._by_line = False
        if isinstance(self.sensor, SensorWithSweeps):
            # Both are looked for along the planned flight, as long as no pose has arrived.
            self._by_line = self.sensor.sweeps.through[0] is not None
            if self.sensor.sweeps.detector.leakage == "subtract":
                _ = self.sensor.sweeps.still
        self._loop = loop_of(self.sensor)
        self._waiting: Pulses | None = None
        self._grounded = False

    @property
    def mapper(self) -> Mapper:
        """From the points of frames to a DEM, as the scenario says; see `LiveMap`."""
        return self.prepared.mapper

    @on_one_thread
    def warm_up(self) -> None:
        """Compile all that later steps need, and take what is there out of the garbage collector's search.

        The pulses are those of the planned flight; call it before the first step. Steps after it neither compile nor
        wait for a full collection.
        """
        loop = self._loop
        for count in WARM_PULSES:
            self._loop = loop_of(self.sensor)
            frame = self._frame(0.0, [self.prepared.flight.sample(count)])
            _ = frame.spectra, frame.readings_m
        self._loop = loop
        gc.collect()
        gc.freeze()

    @on_one_thread
    def step(
        self,
        time_s: Numbers,
        position_m: Numbers,
        attitude: Numbers,
        velocity_mps: Numbers | None = None,
        *,
        turn_rad_s: Numbers | None = None,
        measured: Poses | None = None,
    ) -> Frame:
        """Move the vehicle to a pose, and return what was heard since the last step.

        Parameters
        ----------
        time_s, position_m, attitude, velocity_mps, turn_rad_s:
            Of one pose of the vehicle's navigation system or several, in s, m, rad, m/s and rad/s from the start of the
            flight and in the world frame, as for `Poses.of`. Turn rates matter with a lever arm alone.
        measured:
            What the navigation reports of the motion, at the same or other times; None takes the scenario's navigation
            errors.

        Returns
        -------
        The frame of the pulses that were transmitted along the interpolated poses, after the last step and until this
        one. Of a first step, or after a gap, those at its own time alone.

        Raises
        ------
        PoseError
            Poses that are not finite, of another shape, at a negative time, or not after those before.
        """
        poses = Poses.of(time_s, position_m, attitude, velocity_mps, turn_rad_s, before=self._true.last)
        if poses.time_s[0] < 0:
            message = f"{poses.time_s[0]:.6g} s is before the flight; give the time since its start"
            raise PoseError(f"time_s: {message}")
        if measured is not None:
            if not isinstance(measured, Poses):
                raise PoseError(f"measured: is a {type(measured).__name__}; give `Poses.of(time_s, position_m, ...)`")
            self._reported.append(measured)
        schedule = self._schedule if measured is None else self._with_reported
        gaps = np.flatnonzero(np.diff(poses.time_s) > self.max_gap_s) + 1
        blocks, notices = [], []
        for rows in np.split(np.arange(len(poses)), gaps):
            pulses, notice = self._transmitted(poses.rows(rows), schedule)
            blocks += self._whole_lines(pulses)
            notices.append(notice)
        if measured is not None and (late_s := poses.time_s[-1] - measured.time_s[-1]) > self.max_gap_s:
            notices.append(f"The measured poses end {late_s:.3g} s before this step, and are extrapolated.")
        return self._frame(float(poses.time_s[-1]), blocks, " ".join(filter(None, notices)))

    @on_one_thread
    def flush(self) -> Frame:
        """Return a frame of the pulses that still wait for the end of their scan line; at the end of a flight."""
        waiting, self._waiting = self._waiting, None
        last = self._true.last
        return self._frame(
            float("nan") if last is None else float(last.time_s[0]), [] if waiting is None else [waiting]
        )

    def position_m(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return the position of the vehicle at times since the last steps."""
        return self._true.trajectory.position(time_s)

    def attitude(self, time_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Return roll, pitch and heading of the vehicle, rad, at times since the last steps."""
        return self._true.trajectory.euler(time_s)

    def _transmitted(self, poses: Poses, schedule: PulseSchedule) -> tuple[Pulses, str]:
        """Return the pulses since the last pose, and why there are none if one cannot be at these poses."""
        last, notice = self._true.last, ""
        gap = last is not None and poses.time_s[0] - last.time_s[0] > self.max_gap_s
        if last is None or gap or self._grounded:
            if last is not None and gap:
                notice = (
                    f"{poses.time_s[0] - last.time_s[0]:.3g} s without a pose, more than {self.max_gap_s:g} s: nothing "
                    f"was transmitted until {poses.time_s[0]:.6g} s."
                )
            self._true.restart(poses)
            self._clock.begin(float(poses.time_s[0]))
        else:
            self._true.append(poses)
        where = self._not_over_terrain(poses.position_m)
        # Nothing is interpolated from a place under the ground.
        self._grounded = bool(where)
        if where:
            self._clock.begin(float(np.nextafter(poses.time_s[-1], np.inf)))
            notice = f"{notice} {where} Nothing was transmitted.".lstrip()
        index, time = self._clock.until(float(poses.time_s[-1]))
        return schedule.at(index, time), notice

    def _not_over_terrain(self, position_m: Float[np.ndarray, "pose 3"]) -> str:
        """Return the error message for the first position that is not above the terrain; empty for none."""
        ground_m = self.prepared.world.ground_m(position_m[:, :2])
        wrong = np.flatnonzero(~(position_m[:, 2] > ground_m))
        if len(wrong) == 0:
            return ""
        x, y, z = position_m[wrong[0]]
        if np.isnan(ground_m[wrong[0]]):
            return f"There is no terrain under x = {x:.1f} m, y = {y:.1f} m."
        return f"The vehicle is {ground_m[wrong[0]] - z:.1f} m below the terrain at x = {x:.1f} m, y = {y:.1f} m."

    def _whole_lines(self, pulses: Pulses) -> list[Pulses]:
        """Return pulses to observe, in blocks; where neighbours in a scan line count, pulses wait for its end."""
        if not self._by_line:
            return [pulses.rows(slice(*bounds)) for bounds in chunks(len(pulses), AT_ONCE)]
        if self._waiting is not None:
            pulses = Pulses.concatenate([self._waiting, pulses])
        if len(pulses) == 0:
            return []
        number, scan = self._clock.next_scan()
        scans = None if pulses.scan_number is None or scan is None else np.append(pulses.scan_number, scan)
        end = np.flatnonzero(ends_of_lines(np.append(pulses.index, number), scans)) + 1
        whole = int(end[-1]) if len(end) else 0
        self._waiting = pulses.rows(slice(whole, None)) if whole < len(pulses) else None
        return [pulses.rows(rows) for rows in np.split(np.arange(whole), end[:-1]) if len(rows)]

    def _frame(self, time_s: float, blocks: list[Pulses], notice: str = "") -> Frame:
        frame = listen(
            self.sensor,
            time_s,
            blocks,
            self._schedule.at(np.zeros(0, dtype=np.int64), np.zeros(0)),
            loop=self._loop,
            keep_profiles=self.prepared.keeps_profiles,
            waiting=0 if self._waiting is None else len(self._waiting),
        )
        notices = [notice, self._beyond(frame.pulses, frame.echoes), self._beside(frame.pulses, frame.echoes)]
        return replace(frame, notice=" ".join(filter(None, notices)))

    def _beside(self, pulses: Pulses, echoes: Echoes) -> str:
        """Return the warning of echoes from ground without scatterers, where no planned beam looks; empty for none."""
        if self._density is None or len(echoes) == 0:
            return ""
        row, pose = pulses.row_of(echoes.pulse), pulses.true
        place_m = pose.position_m[row] + echoes.range_m[:, None] * pose.boresight[row]
        beside = len(np.unique(row[self._density.at(place_m[:, :2]) == 0]))
        if beside == 0:
            return ""
        return (
            f"{beside} of {len(pulses)} pulses look beside the footprints of the planned flight, where few rays stand "
            "for the ground: ranges scatter more than stated; plan it there, or set tracing.speckle = 'per_pulse'."
        )

    def _beyond(self, pulses: Pulses, echoes: Echoes) -> str:
        """Return the warning of pulses without an echo that look beyond the loaded ground; empty for none."""
        silent = ~np.isin(pulses.index, echoes.pulse)
        if not silent.any():
            return ""
        pose, floor_m = pulses.true.rows(silent), float(self.prepared.world.scene.bounds_m[0, 2])
        (west, south, _), (east, north, _) = self._region_m
        height_m, down = pose.position_m[:, 2] - floor_m, -pose.boresight[:, 2]
        reach_m = np.where(down > 0, np.minimum(height_m / np.maximum(down, 1e-9), self._max_range_m), 0.0)
        x, y, _ = (pose.position_m + reach_m[:, None] * pose.boresight).T
        beyond = int(np.sum((x < west) | (x > east) | (y < south) | (y > north)))
        if beyond == 0:
            return ""
        area = f"x = {west:.0f} to {east:.0f} m, y = {south:.0f} to {north:.0f} m"
        return f"{beyond} of {len(pulses)} pulses look beyond {area}, the range of the planned flight; plan it wider."


def _without_end(navigation: Navigation | None) -> Navigation | None:
    """Return a navigation system whose errors go on after the planned flight."""
    if not isinstance(navigation, InertialErrors):
        return navigation
    return replace(navigation, span_s=(navigation.span_s[0], np.inf))
