"""Echoes and range rates of recordings, from which the errors of an instrument are estimated."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sionna_radar.execution.execution import Execution
from sionna_radar.flight.instrument import BelievedMotion, InstrumentErrors
from sionna_radar.foundation.errors import InputFileError, ScenarioError
from sionna_radar.foundation.input_file import is_file, is_folder, shown
from sionna_radar.foundation.raster import Grid
from sionna_radar.inference.echo.likelihood import mean_ranges
from sionna_radar.mapping.echo_heights import reaching
from sionna_radar.mapping.navigation.echo_errors import RangeProfiles
from sionna_radar.mapping.navigation.range_rates import RangeRates, pulse_pair_rates
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.recorded import RecordedSettings
from sionna_radar.studies.calibration.instrument_echoes import Readings
from sionna_radar.survey.observation import Observed, observe
from sionna_radar.survey.placement import place
from sionna_radar.survey.recording_source import RecordingSource
from sionna_radar.survey.recordings.described import DescribedRanges, DescribedSignals

# What errs in range rates, too.
DOPPLER_ERRORS = ("velocity_east", "velocity_north", "velocity_up", "backscatter_slope")
# Pulses of a frame: odd, so that one is in its middle.
FRAME = 17
# Range rates are unambiguous if so many standard deviations of what is known beforehand, and of a frame, are.
PRIOR_SIGMAS, FRAME_SIGMAS = 4.0, 5.0
FEWEST = 200


def signals_in(path: Path) -> Path:
    """Return the recording of beat signals in a folder of results, or the recording itself."""
    if not is_folder(path):
        return path
    inside = path / "signals.nc"
    if not is_file(inside):
        raise InputFileError(f"{shown(path)}: holds no signals.nc; fly it again with `run --record signals`")
    return inside


@dataclass(frozen=True, kw_only=True)
class Heard:
    """A recording with its detected echoes, and what they say; doppler: see `Calibration`."""

    source: RecordingSource
    observed: Observed
    echoes: RangeProfiles | Readings
    grid: Grid
    doppler: str = ""


def echoes_of(source: RecordingSource, prior: Mapping[str, float] | None = None) -> Heard:
    """Return the echoes of a recording as reported, with Doppler if prior sigmas (SI) of the errors are given."""
    if not source.file.pulses.located:
        raise InputFileError(
            f"{shown(source.path)}: has no poses, from which the errors are estimated; add measured ones"
        )
    if source.settings.processing.calibration is not None:
        raise ScenarioError.of("processing.calibration", "is what is estimated here; leave it out", str(source.path))
    readings = isinstance(source.file, DescribedRanges)
    if len(source.sweeps) > 1 or source.angle is not None:
        message = "a recording of pairs of sweeps or of an array has no whole echoes; give one of single sweeps"
        raise ScenarioError.of("radar.sweep", message, str(source.path))
    wanted = source if readings else replace(source, settings=_with_profiles(source.settings))
    sensor, observed = observe(wanted, Execution())
    points = place(observed.echoes, sensor, source.flight)
    if len(points) < FEWEST:
        raise InputFileError(f"{shown(source.path)}: has {len(points)} echoes; at least {FEWEST} are needed")
    mapper, motion = wanted.mapper_of(points), source.believed()
    if readings:
        first = np.unique(points.pulse, return_index=True)[1]
        own = motion.rows(points.pulse[first])
        echoes: RangeProfiles | Readings = Readings(
            range_m=points.range_m[first],
            sigma_m=np.maximum(points.range_sigma_m[first], 1e-3),
            motion=own,
            reach_m=2 * float(points.range_m.max()),
        )
        return Heard(source=source, observed=observed, echoes=echoes, grid=mapper.grid)
    assert observed.profiles is not None
    own = motion.rows(observed.profiles.pulse)
    sightings = mapper.sightings(observed.profiles, own.pose)
    echo_ranges = mean_ranges(sightings)
    rates, doppler = (None, "") if prior is None else _range_rates(source, motion, sightings.beam.spread, prior)
    reach = sightings.repeated(echo_ranges.range_m)
    whole = RangeProfiles(sightings=sightings, motion=own, reach=reach, rates=rates)
    grid = replace(reaching(mapper.grid, sightings, echo_ranges), georeference=mapper.grid.georeference)
    return Heard(source=source, observed=observed, echoes=whole, grid=grid, doppler=doppler)


def _range_rates(
    source: RecordingSource, motion: BelievedMotion, spread: tuple[float, float], prior: Mapping[str, float]
) -> tuple[RangeRates | None, str]:
    """Return the range rates of frames of successive pulses, if they are unambiguous, and what there is to say."""
    if isinstance(source.file, DescribedSignals) and source.file.powers:
        return None, "Doppler is not used, as powers have no phase"
    (frames, interval_s), pulses = motion.frames(FRAME), source.file.pulses
    if len(frames) == 0:
        return None, f"Doppler is not used: {FRAME} pulses never follow each other in regular intervals"
    ambiguity_mps, middle = source.sweeps[0].wavelength_m / (2 * interval_s), motion.rows(frames[:, FRAME // 2])
    found = pulse_pair_rates(source.detector, lambda own: source.beats(pulses.pulses(own))[0], frames, interval_s)
    rates = RangeRates.of_frames(found, middle, spread, ambiguity_mps)
    change, _ = rates.linearised(InstrumentErrors(), tuple(prior))
    known_mps = float(np.sqrt(np.sum((change * [*prior.values()]) ** 2, axis=1)).max())
    sigma_mps = float(rates.sigma_mps[0])
    said = f"range rates of {len(frames)} frames of {FRAME} pulses"
    if np.isinf(sigma_mps):
        return None, f"Doppler is not used: {said} are too few to tell their variance; fly longer"
    said += f", {sigma_mps:.2g} m/s each"
    if PRIOR_SIGMAS * known_mps + FRAME_SIGMAS * sigma_mps < ambiguity_mps / 2:
        return rates, f"Doppler is used: {said}"
    return None, (
        f"Doppler is not used: {said}, are ambiguous by {ambiguity_mps:.3g} m/s and known to {known_mps:.2g} m/s "
        "beforehand; more chirps a second, a slower scan or a smaller --prior may allow it"
    )


def _with_profiles(settings: Scenario | RecordedSettings) -> Scenario | RecordedSettings:
    """Return settings whose map uses range profiles."""
    dem = settings.dem.model_copy(update={"method": "refined", "method_parameters": None})
    return settings.model_copy(update={"dem": dem})
