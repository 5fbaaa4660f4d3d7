"""Range-Doppler maps of frames of chirps from the middle of a flight, with the detections in the last one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.execution.execution import Execution
from sionna_radar.flight.pulses import Pose, Pulses
from sionna_radar.foundation.errors import Problem, ScenarioError
from sionna_radar.foundation.progress import advance, stage
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.radar import refuse_average
from sionna_radar.studies.range_doppler.cfar import SHARED_NOISE, ClutterMap, RingCfar
from sionna_radar.studies.range_doppler.frames import RangeDoppler, RangeDopplerMap
from sionna_radar.studies.range_doppler.movers import Movers, StaggeredRangeDoppler, find_movers, wrapped
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.sensors.radar import Radar

# Guard and training cells on each side of the cell under test, in range rate and in range.
GUARD, TRAINING = 3, 6
# Weight of the latest map in the levels of a clutter map.
WEIGHT = 0.25
# Largest turn of the antenna during a frame, as a share of the beam width.
MAX_TURN = 0.5
# Largest distance of a mover from its target, in cells in either direction.
NEAR_CELLS = 1.0


@dataclass(frozen=True, kw_only=True)
class SeenTarget:
    """A target, by its number in the scenario from 0, in the last frame: true and detected place; NaN if undetected.

    read_m: where its range is read, with the shift of its range rate; range_rate_mps: wrapped into the unambiguous
        interval, as what is detected.
    """

    number: int
    range_m: float
    range_rate_mps: float
    read_m: float
    found_range_m: float
    found_rate_mps: float


@dataclass(frozen=True, kw_only=True)
class Frames:
    """Range-Doppler maps of consecutive frames, and detections in the last one.

    analyser: windows and cells; frames: their number. With `radar.stagger` the maps are folded, and the movers are not.
    last, mean: map of the last frame, and mean of all maps.
    detected: cells of the last frame above the CFAR of their ring; changed: above that of their own earlier levels.
    movers: peaks among the detected cells.
    targets: those of the scenario, in its order.
    smear_cells: change of the range rate of stationary ground in the middle of the beam during a frame, in cells, as
        the radar passes; above one, peaks are low and wide.
    """

    scenario: Scenario
    analyser: RangeDoppler | StaggeredRangeDoppler
    frames: int
    last: RangeDopplerMap
    mean: Float[np.ndarray, "rate bin"]
    detected: Bool[np.ndarray, "rate bin"]
    changed: Bool[np.ndarray, "rate bin"]
    movers: Movers
    targets: tuple[SeenTarget, ...]
    smear_cells: float

    def __repr__(self) -> str:
        detected = sum(bool(np.isfinite(target.found_range_m)) for target in self.targets)
        cells = f"{self.last.chirp.range_resolution_m:.3g} m and {self.analyser.rate_cell_mps:.3g} m/s"
        return (
            f"Frames: {self.frames} of {self.analyser.chirps} chirps, cells of {cells}\n"
            f"  {len(self.movers)} peaks, {detected} of {len(self.targets)} targets among them"
        )


def range_doppler(
    scenario: Scenario, *, chirps: int = 64, frames: int = 8, execution: Execution | None = None
) -> Frames:
    """Return range-Doppler maps from the middle of a flight.

    Parameters
    ----------
    scenario:
        The survey, with `tracing.speckle = "persistent"`: the ground must be coherent from chirp to chirp. Windows,
        padding, the false-alarm rate, and the treatment of leakage and bursts are those of its `processing`; with
        `cfar.kind = "OS"` the ring takes an order statistic, otherwise its mean.
    chirps, frames:
        Chirps per frame, and number of frames.
    execution:
        As for `sionna_radar.run`.

    Returns
    -------
    Maps of power by range and range rate, the cells detected in the last of them, and the movers.

    Raises
    ------
    ScenarioError, InputFileError
        Too few pulses, a beam that turns during a frame, or a scenario that cannot be flown; see `prepare`.

    Examples
    --------
    >>> seen = range_doppler(load_scenario("slar"), chirps=32, frames=2)
    >>> len(seen.targets), seen.last.power.shape
    (3, (64, 512))
    """
    _check_frames(scenario)
    with (execution or Execution()).reported():
        return _run(scenario, chirps, frames)


def _run(scenario: Scenario, chirps: int, frames: int) -> Frames:
    prepared = prepare(scenario)
    analyser = _analyser(prepared, chirps)
    folded = analyser.half if isinstance(analyser, StaggeredRangeDoppler) else analyser
    start = _first(prepared, chirps, frames)
    looks = chirps // folded.chirps
    cfar = _ring(scenario, folded, looks)
    clutter = ClutterMap(weight=WEIGHT, false_alarm_probability=cfar.false_alarm_probability, looks=looks)
    radar = Radar(prepared.sensor_inputs())
    total = np.zeros((len(folded.range_rate_mps), len(folded.range_m)))
    with stage("frames", frames):
        for number in range(frames):
            pulses = prepared.flight.pulses(start + number * chirps + np.arange(chirps))
            beat = radar.beat(pulses)
            last = analyser.map(beat)
            changed = clutter.detected(last.power)
            total += last.power
            advance()
    detected = cfar.detected(last.power)
    movers = find_movers(last, detected)
    if isinstance(analyser, StaggeredRangeDoppler):
        movers = analyser.unfolded(beat, movers)
    middle = pulses.rows(slice(chirps // 2, chirps // 2 + 1))
    return Frames(
        scenario=scenario,
        analyser=analyser,
        frames=frames,
        last=last,
        mean=total / frames,
        detected=detected,
        changed=changed,
        movers=movers,
        targets=_targets(prepared, middle, movers, analyser.highest_rate_mps, folded),
        smear_cells=_smear_cells(prepared, middle.true, folded),
    )


def _analyser(prepared: Prepared, chirps: int) -> RangeDoppler | StaggeredRangeDoppler:
    """Return the windows and transforms of frames; with two intervals every second chirp belongs to one map."""
    radar, processing = prepared.local.radar, prepared.local.processing
    staggered = radar.stagger > 0
    if staggered and chirps % 2:
        raise ScenarioError.of("chirps", f"{chirps} are not pairs of two intervals; give an even number")
    fewest = (2 * (GUARD + TRAINING) + 1) * (2 if staggered else 1)
    if chirps < fewest:
        message = f"{chirps} do not hold the ring of cells that tells the noise around a mover; give at least {fewest}"
        raise ScenarioError.of("chirps", message)
    frames = RangeDoppler(
        chirp=prepared.receiver.chirp,
        chirps=chirps // 2 if staggered else chirps,
        range_window=processing.window,
        rate_window=processing.window,
        zero_padding=processing.zero_padding,
        interval_s=(2 + radar.stagger) / radar.chirp_rate_hz if staggered else None,
        high_pass=prepared.receiver.high_pass,
    )
    return StaggeredRangeDoppler(half=frames, first_s=1 / radar.chirp_rate_hz) if staggered else frames


def _check_frames(scenario: Scenario) -> None:
    refuse_average(scenario.processing, "a frame")
    problems = []
    if scenario.sensor != "radar":
        problems.append(Problem("sensor", f"{scenario.sensor!r} has no chirps; set sensor = 'radar'"))
    if scenario.radar.sweep == "triangular":
        message = "'triangular' has two sweeps for each range rate; set radar.sweep = 'up' or 'down'"
        problems.append(Problem("radar.sweep", message))
    if scenario.tracing.speckle != "persistent":
        message = f"{scenario.tracing.speckle!r} breaks the phase from chirp to chirp; set 'persistent'"
        problems.append(Problem("tracing.speckle", message))
    if problems:
        raise ScenarioError(problems)


def _first(prepared: Prepared, chirps: int, frames: int) -> int:
    """Return the first pulse of frames in the middle of the flight."""
    if frames < 1 or chirps * frames > len(prepared):
        message = f"{frames} frames of {chirps} chirps are not within the flight's {len(prepared):,} pulses; lower it"
        raise ScenarioError.of("frames", message)
    start = (len(prepared) - chirps * frames) // 2
    if prepared.local.radar.stagger > 0:
        start -= start % 2
    for frame in start + np.arange(chirps * frames).reshape(frames, chirps):
        _check_turn(prepared, frame)
        _check_intervals(prepared, frame)
    return start


def _check_turn(prepared: Prepared, frame: Int[np.ndarray, " chirp"]) -> None:
    """Raise ScenarioError for a frame within which the beam turns too far, even if it returns."""
    boresight = prepared.flight.pulses(frame).true.boresight
    turned = float(np.arccos(np.clip(boresight @ boresight[0], -1.0, 1.0)).max())
    if turned > MAX_TURN * min(prepared.instrument.antenna.beamwidths_rad):
        message = (
            f"{len(frame)} turn the beam by {np.rad2deg(turned):.3g} deg, more than half of its width; take fewer, "
            "raise radar.chirp_rate_hz, or set radar.scan.mode = 'fixed'"
        )
        raise ScenarioError.of("chirps", message)


def _check_intervals(prepared: Prepared, frame: Int[np.ndarray, " chirp"]) -> None:
    """Raise ScenarioError for a frame within which the scan pauses."""
    radar = prepared.local.radar
    waits = np.diff(prepared.flight.time_s[frame]) * radar.chirp_rate_hz
    if np.allclose(waits, np.where(frame[:-1] % 2, 1 + radar.stagger, 1.0), atol=1e-6):
        return
    if radar.stagger > 0:
        message = f"{radar.stagger:g}: the scan pauses within the frames; set radar.scan.mode = 'fixed'"
        raise ScenarioError.of("radar.stagger", message)
    message = f"{len(frame)} go on while the scan pauses; take fewer, or set radar.scan.mode = 'fixed'"
    raise ScenarioError.of("chirps", message)


def _smear_cells(prepared: Prepared, middle: Pose, analyser: RangeDoppler) -> float:
    """Return the change of range rate in a frame, in cells: squared speed across the ray over the range."""
    range_m = float(prepared.world.caster.cast(middle.position_m, middle.boresight).distance_m[0])
    across = np.linalg.norm(np.cross(middle.velocity_mps[0], middle.boresight[0]))
    return float(across**2 / range_m * analyser.duration_s / analyser.rate_cell_mps) if np.isfinite(range_m) else 0.0


def _ring(scenario: Scenario, analyser: RangeDoppler, looks: int) -> RingCfar:
    table, correlation = scenario.processing.cfar, analyser.noise_correlation(GUARD + TRAINING + 1)
    if any(np.any(np.abs(lags[GUARD + 1 :]) > SHARED_NOISE) for lags in correlation):
        message = f"{scenario.processing.window!r} shares noise among more than {GUARD} cells of a map; set 'hann'"
        raise ScenarioError.of("processing.window", message)
    return RingCfar(
        kind="OS" if table.kind == "OS" else "CA",
        guard=(GUARD, GUARD),
        training=(TRAINING, TRAINING),
        false_alarm_probability=table.false_alarm_probability,
        rank=table.rank,
        correlation=correlation,
        stride=analyser.zero_padding,
        looks=looks,
    )


def _targets(
    prepared: Prepared, middle: Pulses, movers: Movers, highest_mps: float, analyser: RangeDoppler
) -> tuple[SeenTarget, ...]:
    """Return the scenario's targets, each with the nearest peak within `NEAR_CELLS`.

    A body may return an echo from any of its points.
    """
    targets = []
    for number, target in enumerate(prepared.world.scene.targets):
        place, velocity = np.array(target.position_m), np.zeros(3)
        if target.way is not None:
            place, velocity = (column[0] for column in target.way.at(middle.time_s))
        offset_m = place - middle.true.position_m[0]
        range_m = float(np.linalg.norm(offset_m))
        rate_mps = float((velocity - middle.true.velocity_mps[0]) @ offset_m) / range_m
        reach_m = 0.0 if target.body is None else float(np.linalg.norm(target.body.vertices_m, axis=1).max())
        # Range rates wrap at the ends of the unambiguous interval; ranges are read with the shift of the wrapped ones.
        span, read_m = 2 * highest_mps, range_m + analyser.chirp.doppler_range_s * rate_mps
        rate_mps = float(wrapped(np.array(rate_mps), span))
        off_mps = wrapped(movers.range_rate_mps - rate_mps, span)
        off_m = movers.range_m + analyser.chirp.doppler_range_s * (movers.range_rate_mps - off_mps) - read_m
        distance_cells = np.maximum(
            np.maximum(np.abs(off_m) - reach_m, 0.0) / analyser.chirp.range_resolution_m,
            np.abs(off_mps) / analyser.rate_cell_mps,
        )
        nearest = int(np.argmin(distance_cells)) if len(distance_cells) else -1
        is_detected = nearest >= 0 and bool(distance_cells[nearest] <= NEAR_CELLS)
        targets.append(
            SeenTarget(
                number=number,
                range_m=range_m,
                range_rate_mps=rate_mps,
                read_m=read_m,
                found_range_m=float(movers.range_m[nearest]) if is_detected else float("nan"),
                found_rate_mps=float(movers.range_rate_mps[nearest]) if is_detected else float("nan"),
            )
        )
    return tuple(targets)
