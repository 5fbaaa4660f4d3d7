"""The whole chain, from a scenario to a DEM and its error."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Inexact

from sionna_radar.flight.pulses import PulseSchedule
from sionna_radar.mapping.compare import DemError
from sionna_radar.mapping.points import Points
from sionna_radar.raster import Georeference, Raster
from sionna_radar.scenario.models import Scenario


@dataclass(frozen=True, kw_only=True)
class ChirpRecord:
    """One chirp on its way through the processing, kept for a figure.

    beat: samples of the beat signal, sqrt(W); real or complex (I/Q).
    range_m: range axis of the spectrum, not corrected for Doppler.
    power: calibrated power spectrum; threshold: what a cell must exceed; NaN where none is tested.
    echo_range_m, echo_power: the echoes found, on the axis of the spectrum.
    """

    pulse: int
    sample_time_s: Float[np.ndarray, " sample"]
    beat: Inexact[np.ndarray, " sample"]
    range_m: Float[np.ndarray, " cell"]
    power: Float[np.ndarray, " cell"]
    threshold: Float[np.ndarray, " cell"]
    echo_range_m: Float[np.ndarray, " echo"]
    echo_power: Float[np.ndarray, " echo"]


@dataclass(frozen=True, kw_only=True)
class Survey:
    """A finished survey, with the scenario that made it.

    pulses, paths: how many were simulated.
    dem, truth, error: rasters on one grid; error is DEM minus truth.
    chirp: the record of the chirp in the middle of the survey.
    timing_s: seconds spent in each stage, and in all under `total`.
    """

    scenario: Scenario
    schedule: PulseSchedule
    pulses: int
    paths: int
    points: Points
    dem: Raster
    truth: Raster
    error: Raster
    dem_error: DemError
    georeference: Georeference | None
    chirp: ChirpRecord
    timing_s: dict[str, float]
    peak_memory_mb: float
