"""The survey pipeline: prepare, observe, place, map and compare, from a scenario to a DEM and its error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Int

from sionna_radar.accuracy.obstacles import no_looks
from sionna_radar.accuracy.truth import Comparison, TrueHits
from sionna_radar.execution.execution import Execution
from sionna_radar.foundation.errors import named_after
from sionna_radar.foundation.linear_algebra import on_one_thread
from sionna_radar.foundation.memory import HoldsMemory, peak_memory_mb, release_memory
from sionna_radar.foundation.progress import stage
from sionna_radar.foundation.stopwatch import timed, timing
from sionna_radar.mapping.canopy.point_classes import classified
from sionna_radar.mapping.obstacles import ReportedObstacles
from sionna_radar.mapping.points import Points
from sionna_radar.raytracer.backend import release_arrays
from sionna_radar.scenario import Scenario
from sionna_radar.survey.custom_parts import CustomParts
from sionna_radar.survey.navigation import check_refinement, navigation_warnings, refined, with_refined
from sionna_radar.survey.observation import Recorder, SampleType, observe
from sionna_radar.survey.observed_survey import map_observed
from sionna_radar.survey.obstacles import ObstacleReport, held_against_truth, report_obstacles
from sionna_radar.survey.placement import navigation_sigma, place
from sionna_radar.survey.preparation import Prepared, prepare
from sionna_radar.survey.result import Saturation, Survey
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.warnings import survey_warnings

# Above this many echoes, free the memory of the flight before mapping (about 10 ms).
MANY_ECHOES = 5_000


def run(
    scenario: Scenario | Prepared,
    *,
    parts: CustomParts | None = None,
    recordings: Mapping[str, str | Path] | None = None,
    sample_type: SampleType = "float64",
    execution: Execution | None = None,
) -> Survey:
    """Simulate a survey and return its points, its DEM and its error.

    Parameters
    ----------
    scenario:
        A scenario, or a prepared survey, which includes its custom parts.
    parts:
        Custom objects in place of parts of the scenario, such as its antenna or terrain.
    recordings:
        netCDF files to record into, by content: "signals" (beat signals, for `process`), "paths" or "profiles".
        Recording requires a single process.
    sample_type:
        Data type of recorded beat signals; "float64" reproduces the result bit for bit.
    execution:
        Block size, workers, checkpoints and progress, which never change the result.

    Returns
    -------
    The survey; `repr` shows its error in a line.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.
    OutputError
        A recording exists already, or cannot be written.
    PluginError
        A custom part lacks a method, or workers were given custom parts.
    WorkerError
        Workers were lost, or run another version of the package.

    Examples
    --------
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> survey.pulses, survey.warnings
    (100, ())
    """
    if isinstance(scenario, Prepared) and parts is not None:
        raise TypeError("custom parts cannot be given for a prepared survey; give them to `prepare`")
    source = (scenario.scenario if isinstance(scenario, Prepared) else scenario).source
    execution, recorders_of = execution or Execution(), _recorders(recordings, sample_type)
    with named_after(source), execution.reported(), timing() as watch:
        with timed("prepare"):
            prepared = scenario if isinstance(scenario, Prepared) else prepare(scenario, parts)
        with recorders_of(prepared) as kept:
            survey = _survey(prepared, execution, kept)
        return replace(survey, timing_s=watch.seconds(), peak_memory_mb=peak_memory_mb())


def _recorders(
    recordings: Mapping[str, str | Path] | None, sample_type: SampleType
) -> Callable[[Prepared], AbstractContextManager[Sequence[Recorder]]]:
    """Check the recording files, and return a function that opens the recorders of a prepared survey."""
    if not recordings:
        return lambda _: nullcontext(())
    from sionna_radar.survey.recordings.recorder import checked_files, recorders

    files = checked_files({kind: Path(path) for kind, path in recordings.items()})
    return lambda prepared: recorders(files, prepared, sample_type)


@on_one_thread
def _survey(prepared: Prepared, execution: Execution, recorders: Sequence[Recorder]) -> Survey:
    """Observe, place, map and compare."""
    check_refinement(prepared)
    sensor, observed = observe(prepared, execution, recorders)
    navigation = refined(prepared, observed)
    # As it is reported, the flight stays that of the survey; the map is made with what its echoes tell.
    mapped = with_refined(prepared, navigation)
    chirp = sensor.record_chirp(prepared.flight.pulses(np.array([len(prepared) // 2])))
    with stage("mapping"), timed("map"):
        _make_room(sensor, len(observed.echoes))
        points = place(observed.echoes, sensor, mapped.flight)
        estimate = map_observed(mapped, observed, points, execution)
        points = classified(points, estimate)
        reported, member = report_obstacles(points, estimate, prepared.mapper, mapped.measured, len(prepared))
        _make_room(sensor, len(observed.echoes))
    hits = observed.hits
    assert hits is not None  # the truth of a simulation is known
    with timed("compare"):
        comparison = prepared.truth.compare(estimate.dem, points, hits.lit)
        of_navigation = navigation_sigma(
            estimate.dem,
            points,
            mapped.flight,
            prepared.mapper.analyser.chirp,
            prepared.local.processing.doppler_correction,
        )
    for recorder in recorders:
        recorder.finish(comparison)
    limited = prepared.local.sensor == "radar" and prepared.local.radar.receiver.converter.limited
    return Survey(
        **vars(comparison),
        prepared=prepared,
        paths=hits.paths,
        points=points,
        dem=estimate.dem,
        dem_sigma=estimate.sigma,
        canopy=estimate.canopy,
        of_plants=hits.of_plants,
        dem_sigma_navigation=of_navigation,
        uncertainty=estimate.uncertainty,
        chirp=chirp,
        warnings=(
            *survey_warnings(prepared, observed, points, comparison, estimate, of_navigation),
            *navigation_warnings(navigation, prepared.refines_navigation),
        ),
        navigation=navigation,
        sensor=sensor,
        saturation=Saturation(saturated_pulses=observed.saturated_pulses, saturated_samples=observed.saturated_samples)
        if limited
        else None,
        no_echo=hits.silent & comparison.lit & ~estimate.dem.filled,
        obstacles=_obstacles(prepared, reported, member, hits, points, comparison),
    )


def _obstacles(
    prepared: Prepared,
    reported: ReportedObstacles | None,
    member: Int[np.ndarray, " point"],
    hits: TrueHits,
    points: Points,
    comparison: Comparison,
) -> ObstacleReport | None:
    """Return the check of reported obstacles against the true ones; None if there are neither."""
    inventory = prepared.truth.inventory
    if not inventory.obstacles and reported is None:
        return None
    receiver, cell_m2 = prepared.receiver, comparison.error.grid.spacing_m**2
    real = 2 if receiver.chirp.sampling == "real" else 1
    noise = real * receiver.noise_power_w * float(np.sum(prepared.mapper.analyser.window**2))
    # What passes the threshold: of a steady echo in noise about the logarithm of the false-alarm probability.
    threshold = -np.log(prepared.local.processing.cfar.false_alarm_probability)
    start_s, end_s = prepared.flight.trajectory.cruise_s()
    return held_against_truth(
        reported,
        member,
        inventory,
        hits.looks or no_looks(),
        points,
        threshold * noise / receiver.transmit_power_w,
        mapped_m2=float(np.count_nonzero(comparison.lit & comparison.error.filled)) * cell_m2,
        duration_s=end_s - start_s,
    )


def _make_room(sensor: Sensor, echoes: int) -> None:
    """Release memory of the flight before a large map, and of the map before its results are written."""
    if echoes > MANY_ECHOES:
        if isinstance(sensor, HoldsMemory):
            sensor.release_memory()
        release_arrays()
        release_memory()
