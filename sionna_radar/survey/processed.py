"""What processing made of recorded beat signals."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int

from sionna_radar.accuracy.compare import DemError
from sionna_radar.detection.echoes import Echoes
from sionna_radar.flight.pulses import Pose
from sionna_radar.foundation.brief import Brief
from sionna_radar.foundation.georeference import Georeference
from sionna_radar.foundation.raster import Raster
from sionna_radar.mapping.points import Points
from sionna_radar.radar.chirp import Chirp
from sionna_radar.scenario import Scenario
from sionna_radar.scenario.recorded import RecordedSettings
from sionna_radar.survey.sensors.sweeps import ChirpRecord

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
class DemComparison:
    """A DEM against the truth that a simulated recording holds; see `Survey` for what each is."""

    truth: Raster
    error: Raster
    lit: Bool[np.ndarray, "row column"]
    dem_error: DemError
    lit_error: DemError


@dataclass(frozen=True, kw_only=True)
class Processed(Brief):
    """What processing made of a recording.

    source: the recording.
    scenario: that of a simulated one, as it was processed; None for a real one, whose `settings` are these.
    sweeps: of a pulse. time_s: of each pulse.
    echoes: corrected for Doppler where the velocity is known.
    points, dem, dem_sigma: None where the recording has no poses.
    comparison: None where the truth is not known on this grid.
    spectrum, chirp: of pulses spread over the recording, and of the one in its middle.

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
    settings: Scenario | RecordedSettings
    sweeps: tuple[Chirp, ...]
    time_s: Float[np.ndarray, " pulse"]
    echoes: Echoes
    points: Points | None
    measured: Callable[[Int[np.ndarray, " pulse"]], Pose] | None
    dem: Raster | None
    dem_sigma: Raster | None
    comparison: DemComparison | None
    georeference: Georeference | None
    spectrum: RangeSpectrum
    chirp: ChirpRecord
    timing_s: dict[str, float]
    warnings: tuple[str, ...] = ()

    @property
    def scenario(self) -> Scenario | None:
        """The scenario of a simulated recording."""
        return self.settings if isinstance(self.settings, Scenario) else None

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
