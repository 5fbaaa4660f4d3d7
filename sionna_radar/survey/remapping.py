"""A survey flown once and mapped as often as wanted, each time with another navigation system.

Errors of navigation change nothing that is traced: the echoes are recorded once, and only their Doppler
correction, their location, the DEM and its comparison are done anew.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from sionna_radar.accuracy.compare import DemError, difference, summarise
from sionna_radar.flight.navigation import build_navigation
from sionna_radar.flight.pulses import Navigation
from sionna_radar.foundation.progress import Progress, silent
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.navigation import NavigationTable
from sionna_radar.survey.chain import BLOCK_SIZE, Recording, map_points, place, record, true_surface
from sionna_radar.survey.preparation import Preparation, prepare
from sionna_radar.survey.sensors import Sensor, build_sensor

# Poses alone are small; mapping takes many at once.
MAPPED_AT_ONCE = 4096


@dataclass(frozen=True, kw_only=True)
class RecordedSurvey:
    """A prepared survey, the sensor that flew it, what it recorded, and the surface it flew over."""

    ready: Preparation
    sensor: Sensor
    recording: Recording
    truth: Raster

    def points(self, navigation: Navigation | None) -> Points:
        """Return the points as a navigation system places them; None knows the pose exactly."""
        schedule = replace(self.ready.schedule, navigation=navigation)
        return place(self.recording.echoes, self.sensor, schedule, block_size=MAPPED_AT_ONCE)

    def lit_error(self, navigation: Navigation | None) -> DemError:
        """Return the error of lit cells of the DEM made with a navigation system, by the scenario's own `dem.method`.

        Raises
        ------
        ScenarioError
            The method models whole echoes, and the sensor brings none.

        """
        ready = replace(self.ready, schedule=replace(self.ready.schedule, navigation=navigation))
        dem = map_points(self.points(navigation), self.recording.profiles, ready)
        lit = self.recording.lit & self.truth.filled
        return summarise(difference(dem, self.truth).only(lit), lit)

    def navigation(self, table: NavigationTable, seed: int | None = None) -> Navigation | None:
        """Return a navigation system with some errors, on the lever arm of this survey."""
        scenario, schedule = self.ready.scenario, self.ready.schedule
        table = table.model_copy(update={"lever_arm_m": schedule.lever_arm_m})
        seed = scenario.seed if seed is None else seed
        return build_navigation(table, schedule.trajectory, scenario.radar.chirp_rate_hz, seed)


def record_survey(
    scenario: Scenario,
    *,
    block_size: int = BLOCK_SIZE,
    sensor: Callable[[Preparation], Sensor] | None = None,
    progress: Progress = silent,
) -> RecordedSurvey:
    """Fly a survey and keep what is needed to map it again.

    Parameters
    ----------
    scenario:
        The survey; its own errors of navigation play no part.
    block_size, sensor, progress:
        As for `sionna_radar.run`.

    Raises
    ------
    ScenarioError, InputFileError
        The scenario cannot be flown; see `prepare`.

    """
    progress("preparing", 0, 0)
    ready = prepare(scenario)
    progress("preparing", 1, 1)
    carried = (sensor or build_sensor)(ready)
    recording = record(ready, carried, block_size=block_size, progress=progress)
    return RecordedSurvey(ready=ready, sensor=carried, recording=recording, truth=true_surface(ready))
