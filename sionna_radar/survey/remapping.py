"""A survey flown once and mapped as often as wanted, each time with another navigation system.

Errors of navigation change nothing that is traced: the echoes are recorded once, and only their Doppler
correction, their location, the DEM and its comparison are done anew.
"""

from dataclasses import dataclass
from functools import lru_cache

from sionna_radar.accuracy.compare import DemError
from sionna_radar.accuracy.truth import GroundTruth
from sionna_radar.flight.pulses import Navigation, build_navigation
from sionna_radar.foundation.kept_parts import KeptParts
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.workers import Workers
from sionna_radar.mapping.points import Points
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.bases import NavigationParameters
from sionna_radar.survey.preparation import CustomParts, Prepared, prepare
from sionna_radar.survey.recording import BLOCK_SIZE, Recording, place
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.shared_flight import ready, record_with

# Poses alone are small; mapping takes many at once.
MAPPED_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class RecordedSurvey:
    """A prepared survey, the sensor that flew it, what it recorded, and the surface it flew over."""

    prepared: Prepared
    sensor: Sensor
    recording: Recording
    truth: GroundTruth

    def points(self, navigation: Navigation | None) -> Points:
        """Return the points as a navigation system places them; None knows the pose exactly."""
        schedule = self.prepared.with_navigation(navigation).flight
        return place(self.recording.echoes, self.sensor, schedule, block_size=MAPPED_AT_ONCE)

    def lit_error(self, navigation: Navigation | None) -> DemError:
        """Return the error of lit cells of the DEM made with a navigation system, by the scenario's own `dem.method`.

        Raises
        ------
        ScenarioError
            The method models whole echoes, and the sensor returns none.

        """
        prepared = self.prepared.with_navigation(navigation)
        made = prepared.mapper.map(self.points(navigation), self.recording.profiles, prepared.measured)
        return self.truth.lit_error(made.dem, self.recording.lit)

    def navigation(self, table: NavigationParameters, seed: int | None = None) -> Navigation | None:
        """Return a navigation system with some errors, on the lever arm of this survey."""
        scenario, schedule = self.prepared.local, self.prepared.flight
        table = table.model_copy(update={"lever_arm_m": schedule.lever_arm_m})
        seed = scenario.seed if seed is None else seed
        return build_navigation(table, schedule.trajectory, scenario.radar.chirp_rate_hz, seed)


def record_survey(
    scenario: Scenario,
    *,
    custom: CustomParts | None = None,
    block_size: int = BLOCK_SIZE,
    progress: Progress = silent,
    parts: KeptParts | None = None,
    workers: Workers | None = None,
) -> RecordedSurvey:
    """Fly a survey and keep what is needed to map it again.

    Parameters
    ----------
    scenario:
        The survey; its own errors of navigation play no part.
    custom, block_size, progress, parts, workers:
        As for `prepare` and `sionna_radar.run`.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    """
    prepared = prepare(scenario, custom, progress)
    sensor, recording = record_with(workers, prepared, block_size=block_size, progress=progress, parts=parts)
    return RecordedSurvey(prepared=prepared, sensor=sensor, recording=recording, truth=prepared.truth())


@lru_cache(maxsize=1)
def recorded_survey(scenario: str, recording: bytes) -> RecordedSurvey:
    """Return a survey that another process has flown, from the JSON text of its scenario and its packed recording."""
    prepared, sensor = ready(scenario)
    return RecordedSurvey(
        prepared=prepared, sensor=sensor, recording=Recording.unpacked(recording), truth=prepared.truth()
    )
