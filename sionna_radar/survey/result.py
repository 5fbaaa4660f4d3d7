"""Results of a survey, and of the processing of recorded beat signals."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.accuracy.breakdown import Breakdown, break_down
from sionna_radar.accuracy.canopy import CanopyCheck, CanopyReading, check_canopy, read_canopy
from sionna_radar.accuracy.readings import Readings
from sionna_radar.accuracy.reference_check import ReferenceCheck, compare_with_reference
from sionna_radar.accuracy.truth import Comparison
from sionna_radar.accuracy.uncertainty import UncertaintyCheck, check_uncertainty
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.instrument import believed_motion
from sionna_radar.flight.pulses import Pose, PulseSchedule
from sionna_radar.foundation.errors import InputFileError, RadarError
from sionna_radar.foundation.raster import Georeference, Grid, Raster
from sionna_radar.inference.terrain.uncertainty import Uncertainty
from sionna_radar.mapping.mapper import CanopyMap
from sionna_radar.mapping.navigation.refinement import RefinedNavigation
from sionna_radar.mapping.obstacles import ReportedObstacles
from sionna_radar.mapping.points import Points
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario, load_scenario
from sionna_radar.scenario.recorded import RecordedSettings
from sionna_radar.scene.terrains.build import covers_on
from sionna_radar.survey.navigation import WayError, way_error
from sionna_radar.survey.obstacles import ObstacleReport
from sionna_radar.survey.preparation import Prepared
from sionna_radar.survey.readings import survey_readings
from sionna_radar.survey.sensors.sensor import Sensor
from sionna_radar.survey.sensors.sweeps import ChirpRecord
from sionna_radar.survey.strip import on_a_strip
from sionna_radar.survey.swath import MappedGround, mapped_ground

logger = logging.getLogger("sionna_radar")


@dataclass(frozen=True, kw_only=True)
class Saturation:
    """Numbers of pulses and samples of a survey that exceed the full scale of its receiver's converter."""

    saturated_pulses: int
    saturated_samples: int


Result = TypeVar("Result", bound="_ComparedWithReference")


class _ComparedWithReference:
    """The comparison of a result's DEM with measured heights."""

    def with_reference(
        self: "Result", path: str | Path, *, sigma_m: float = 0.0, apply_shift: bool = False
    ) -> "Result":
        """Return the result with `reference`, its DEM against measured heights (`compare_with_reference`)."""
        assert isinstance(self, Survey | Processed)
        if self.dem is None or self.points is None:
            raise InputFileError("the recording has no poses, and so no DEM to compare; omit the reference")
        covers = self.prepared.truth.covers if isinstance(self, Survey) else cover_masks(self.scenario, self.dem.grid)
        check = compare_with_reference(
            path,
            self.dem,
            self.dem_sigma,
            sigma_m=sigma_m,
            apply_shift=apply_shift,
            lit=self.lit if isinstance(self, Survey) else None,
            points=self.points,
            uncertainty=self.uncertainty,
            walls=self.prepared.truth.walls if isinstance(self, Survey) else None,
            covers=covers,
            seed=self.scenario.seed if self.scenario else 0,
        )
        return replace(self, reference=check)


def cover_masks(scenario: Scenario | Path | None, grid: Grid) -> dict[str, Bool[np.ndarray, "row column"]]:
    """Return the cells of a scenario's covers; a warning, and none, where its files cannot be read."""
    try:
        scenario = load_scenario(scenario) if isinstance(scenario, Path) else scenario
        return {} if scenario is None else covers_on(scenario.terrain, grid)
    except RadarError as error:
        logger.warning("errors by land cover are not available: %s", error)
        return {}


@dataclass(frozen=True, kw_only=True)
class Survey(_ComparedWithReference, Comparison):
    """The result of a survey, with the prepared survey it was made from, and the comparison of its DEM with the truth.

    prepared: scene, flight, receiver and mapper, for further analysis.
    paths: number of traced paths.
    points: the located echoes.
    dem: on the grid of the comparison.
    dem_sigma: standard deviation of each cell of the DEM, as its method states it; uncertainty: of means over
        cells; both None for a method without stated errors.
    dem_sigma_navigation: standard deviation of each cell due to stated navigation errors, which neighbouring cells
    share; None if none are stated.
    chirp: the record of the chirp in the middle of the survey; None for a sensor without chirps.
    timing_s: seconds spent in each stage, and in all under `total`.
    warnings: what degrades the result.
    sensor: kept so that single pulses can be simulated again; None if the survey ran on workers.
    no_echo: empty lit cells illuminated by pulses without any echo, as over calm water.
    saturation: what the converter of the receiver clipped; None without a full scale.
    reference: the DEM against measured heights, from `with_reference`.
    obstacles: what was seen of each obstacle, and what was reported; None where there are none and none are looked for.
    canopy: the plants on the ground; None for a method that knows one surface.
    navigation: errors of the navigation that the echoes tell; None where they are not looked for.
    of_plants: whether plants return most of the power of each point; None without plants.

    Examples
    --------
    >>> survey = run(load_scenario("hills", {"platform.length_m": 10.0}))
    >>> survey.error.height_m.shape == survey.dem.grid.shape
    True
    >>> survey.lit_error.rms_m < 0.2
    True
    """

    prepared: Prepared
    paths: int
    points: Points
    dem: Raster
    chirp: ChirpRecord | None
    timing_s: dict[str, float] = field(default_factory=dict)
    peak_memory_mb: float = float("nan")
    dem_sigma: Raster | None = None
    dem_sigma_navigation: Raster | None = None
    uncertainty: Uncertainty | None = None
    warnings: tuple[str, ...] = ()
    sensor: Sensor | None = None
    no_echo: Bool[np.ndarray, "row column"] | None = None
    saturation: Saturation | None = None
    reference: ReferenceCheck | None = None
    obstacles: ObstacleReport | None = None
    canopy: CanopyMap | None = None
    navigation: RefinedNavigation | None = None
    of_plants: Bool[np.ndarray, " point"] | None = None

    def __getstate__(self) -> dict[str, Any]:
        # Its sensor belongs to the process that flew it.
        return {**self.__dict__, "sensor": None}

    @property
    def scenario(self) -> Scenario:
        """The scenario, as it was given."""
        return self.prepared.scenario

    @property
    def schedule(self) -> PulseSchedule:
        """The pulses."""
        return self.prepared.flight

    @property
    def pulses(self) -> int:
        """Number of simulated pulses."""
        return len(self.prepared.flight)

    @property
    def georeference(self) -> Georeference | None:
        """The place of the local frame on the Earth; None for a survey without one."""
        return self.prepared.world.scene.georeference

    @property
    def replaced(self) -> dict[str, str]:
        """Custom parts by the scenario keys that they replace."""
        return self.prepared.custom.described()

    @cached_property
    def breakdown(self) -> Breakdown:
        """DEM errors by checkpoint, terrain class and view, and their variogram; computed on first use."""
        off_wall, reading = self.off_wall_error, self.canopy_reading
        lit, filled = self.lit_error.count, self.dem_error.count
        return break_down(
            error=self.error,
            truth=self.truth,
            lit=self.lit,
            points=self.points,
            walls=self.prepared.truth.walls,
            seed=self.scenario.seed,
            covered={
                "walls and what is beside them": 0.0 if off_wall is None or lit == 0 else 1 - off_wall.count / lit,
                "plants": 0.0 if reading is None or filled == 0 else reading.count / filled,
            },
            covers=self.prepared.truth.covers,
        )

    @cached_property
    def mapped(self) -> MappedGround:
        """Area and swath that the map fills, and its share of the planned swath; computed on first use."""
        return mapped_ground(self.prepared, self.lit & self.error.filled)

    @cached_property
    def readings(self) -> Readings | None:
        """Readings of a beam that does not scan, where they make no map; computed on first use; None otherwise."""
        maps = self.lit_error.count > 0 and not on_a_strip(self.points, self.dem.grid.spacing_m)
        return None if maps else survey_readings(self.prepared, self.points)

    @cached_property
    def way_error(self) -> WayError | None:
        """Errors of reported and refined poses; computed on first use; None for reported navigation."""
        if self.navigation is None:
            return None
        pulses = self.schedule.pulses(np.arange(self.pulses))
        return way_error(self.navigation, believed_motion(pulses, self.schedule.scan), pulses.true)

    @cached_property
    def canopy_reading(self) -> CanopyReading | None:
        """Height of the DEM within vegetation; computed on first use; None without vegetation."""
        vegetation = self.prepared.world.scene.vegetation
        if vegetation is None:
            return None
        # Over the ground, also where the DEM is of the tops.
        above_m = self.dem.height_m - self.prepared.truth.ground.height_m
        return read_canopy(replace(self.error, height_m=above_m), vegetation.over(self.truth.grid))

    @cached_property
    def canopy_check(self) -> CanopyCheck | None:
        """How well the map tells ground and plants; computed on first use; None for a method that knows one surface."""
        canopy, truth = self.canopy, self.prepared.truth
        if canopy is None:
            return None
        grid, plants = self.dem.grid, self.prepared.world.scene.vegetation
        nothing = np.full(grid.shape, np.nan)
        plants_m, share = (
            (nothing, np.zeros(grid.shape)) if plants is None else (plants.mean_over(grid), plants.fraction_over(grid))
        )
        of_plants = np.zeros(len(self.points), dtype=bool) if self.of_plants is None else self.of_plants
        width_rad = max(self.prepared.instrument.antenna.beamwidths_rad)
        footprint_m = width_rad * float(np.median(self.points.range_m)) if len(self.points) else 0.0
        on = (truth.ground, plants_m, share), self.lit, (self.points, of_plants), footprint_m
        return check_canopy(canopy, *on)

    @cached_property
    def dem_uncertainty(self) -> UncertaintyCheck | None:
        """Comparison of DEM errors with their stated sigma; computed on first use; None if none is stated."""
        if self.dem_sigma is None:
            return None
        return check_uncertainty(self.error, self.dem_sigma, self.truth, self.lit, self.points, self.uncertainty)

    def __repr__(self) -> str:
        lit, description = self.lit_error, self.scenario.description
        lines = [
            f"Survey: {description or 'no description'}",
            f"  {self.pulses:,} pulses, {len(self.points):,} echoes, DEM of {self.dem.grid.columns} x "
            f"{self.dem.grid.rows} cells of {self.dem.grid.spacing_m:g} m",
            f"  lit cells: RMSE {lit.rms_m:.3f} m, bias {lit.mean_m:+.3f} m, coverage {lit.coverage:.1%}"
            if lit.count
            else "  no cell of the DEM is filled where the main beam reached",
        ]
        lines += [f"  {key} replaced by {what}" for key, what in self.replaced.items()]
        return "\n".join(lines + [f"  warning: {warning}" for warning in self.warnings])


# Share of the ranges that hold noise alone, even where clutter is everywhere.
QUIETEST = 0.2


@dataclass(frozen=True, kw_only=True)
class RangeSpectrum:
    """Power against range, over pulses spread over a recording.

    range_m: range axis, not corrected for Doppler; power is calibrated: a beat of power P peaks at P.
    """

    range_m: Float[np.ndarray, " cell"]
    mean: Float[np.ndarray, " cell"]
    median: Float[np.ndarray, " cell"]

    @property
    def floor(self) -> float:
        """Mean power of the noise in a cell, from the quietest fifth of the ranges.

        The power of noise is exponential, so that its median over pulses is ln 2 times its mean. Clutter may fill four
        fifths of the ranges; from 128 pulses on the scatter of the medians lowers the result by less than half a dB.
        """
        return float(np.quantile(self.median, QUIETEST) / np.log(2))

    @property
    def peak(self) -> tuple[float, float]:
        """Range and power of the strongest cell of the mean."""
        strongest = int(np.argmax(self.mean))
        return float(self.range_m[strongest]), float(self.mean[strongest])


@dataclass(frozen=True, kw_only=True)
class Processed(_ComparedWithReference):
    """The result of processing a recording.

    source, overrides: the recording, and the settings that were changed, by dotted keys.
    scenario: that of a simulated one, as it was processed; None for a real one, whose `settings` are these.
    sweeps: of a pulse; none for ranges that were read before. time_s: of each pulse.
    echoes: corrected for Doppler where the velocity is known.
    points, measured: the located echoes, and the measured poses of pulses; None where the recording has no poses.
    dem, dem_sigma, uncertainty: see `Survey`; None without points.
    comparison: None where the truth is not known on this grid.
    spectrum, chirp: of pulses spread over the recording, and of the one in its middle; None for ranges.
    reference: the DEM against measured heights, from `with_reference`.
    obstacles: those that the processing reports; None where it reports none.
    canopy, navigation: as of `Survey`.
    record_chirps: returns the records of further pulses, read from the recording again.

    Examples
    --------
    >>> scenario = load_scenario("hills", {"platform.length_m": 10.0})
    >>> survey = run(scenario, recordings={"signals": "signals.nc"})
    >>> again = process("signals.nc")
    >>> again.points.sha256() == survey.points.sha256()
    True
    >>> process("signals.nc", {"processing.ranging": "peak"}).points.sha256() == survey.points.sha256()
    False
    """

    source: Path
    overrides: Mapping[str, Any]
    settings: Scenario | RecordedSettings
    sweeps: tuple[Chirp, ...]
    time_s: Float[np.ndarray, " pulse"]
    echoes: Echoes
    points: Points | None
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose] | None
    dem: Raster | None
    dem_sigma: Raster | None
    uncertainty: Uncertainty | None
    comparison: Comparison | None
    georeference: Georeference | None
    spectrum: RangeSpectrum | None
    chirp: ChirpRecord | None
    record_chirps: Callable[[Int[np.ndarray, " pulse"]], list[ChirpRecord]]
    timing_s: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    reference: ReferenceCheck | None = None
    obstacles: ReportedObstacles | None = None
    canopy: CanopyMap | None = None
    navigation: RefinedNavigation | None = None

    @property
    def scenario(self) -> Scenario | None:
        """The scenario of a simulated recording."""
        return self.settings if isinstance(self.settings, Scenario) else None

    @cached_property
    def breakdown(self) -> Breakdown | None:
        """As `Survey.breakdown`, without walls and covers, which no file holds; None where no truth is known."""
        compared = self.comparison
        if compared is None or self.points is None:
            return None
        lit, beside_wall = compared.lit, compared.beside_wall
        near_wall_fraction = (
            0.0 if beside_wall is None or not lit.any() else float((lit & beside_wall).sum() / lit.sum())
        )
        return break_down(
            error=compared.error,
            truth=compared.truth,
            lit=lit,
            points=self.points,
            walls=None,
            seed=self.scenario.seed if self.scenario else 0,
            covered={"walls and what is beside them": near_wall_fraction},
        )

    @cached_property
    def dem_uncertainty(self) -> UncertaintyCheck | None:
        """Comparison of DEM errors with their stated sigma; None if none is stated, or no truth is known."""
        compared = self.comparison
        if compared is None or self.dem_sigma is None or self.points is None:
            return None
        return check_uncertainty(
            compared.error, self.dem_sigma, compared.truth, compared.lit, self.points, self.uncertainty
        )

    def __repr__(self) -> str:
        lines = [f"Processed: {self.source.name}", f"  {len(self.time_s):,} pulses, {len(self.echoes):,} echoes"]
        if self.dem is not None:
            grid = self.dem.grid
            lines[1] += f", DEM of {grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m"
        if self.comparison is not None and self.comparison.lit_error.count:
            lit = self.comparison.lit_error
            lines.append(
                f"  lit cells: RMS error {lit.rms_m:.3f} m, mean {lit.mean_m:+.3f} m, coverage {lit.coverage:.1%}"
            )
        return "\n".join(lines + [f"  warning: {warning}" for warning in self.warnings])
