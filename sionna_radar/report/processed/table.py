"""The table of a processed recording, for the terminal."""

import numpy as np
from rich.table import Table

from sionna_radar.foundation.decibel import decibels
from sionna_radar.report.survey.summary import crs_name
from sionna_radar.report.terminal import console, number
from sionna_radar.survey.processed import Processed


def print_processed(processed: Processed) -> None:
    """Print what processing made of a recording."""
    console().print(processed_table(processed))


def processed_table(processed: Processed) -> Table:
    """Return what was recorded, what was found in it, and how well the DEM fits where the truth is known."""
    table = Table(title=f"Recording {processed.source.name}", show_header=False, title_justify="left")
    for name, value in (_recorded(processed) | _mapped(processed)).items():
        table.add_row(name, value)
    return table


def _recorded(processed: Processed) -> dict[str, str]:
    sweep, spectrum = processed.sweeps[0], processed.spectrum
    count = "one sweep" if len(processed.sweeps) == 1 else "two sweeps"
    kind = f"{count} of {sweep.samples:,} {'I/Q' if sweep.sampling == 'iq' else 'real'} samples"
    peak, strongest = spectrum.peak
    floor_db, peak_db = decibels(np.array([spectrum.floor, strongest]))
    return {
        "pulses / echoes": f"{len(processed.time_s):,} / {len(processed.echoes):,}",
        "pulse": kind,
        "sweep": f"{sweep.bandwidth_hz / 1e6:.6g} MHz about {sweep.carrier_hz / 1e9:.6g} GHz, range cells of "
        f"{sweep.range_resolution_m:.4g} m to {sweep.max_range_m:.4g} m",
        "noise floor": f"{floor_db:.1f} dB in a cell; the mean spectrum peaks at {peak_db:.1f} dB, {peak:.2f} m away",
    }


def _mapped(processed: Processed) -> dict[str, str]:
    if processed.dem is None:
        return {"DEM": "none, as the recording has no poses"}
    grid = processed.dem.grid
    rows = {
        "DEM": f"{grid.columns} x {grid.rows} cells of {grid.spacing_m:g} m, {int(processed.dem.filled.sum()):,} filled"
    }
    if processed.comparison is None:
        rows["error"] = "unknown: the recording holds no truth on this grid"
    else:
        lit = processed.comparison.lit_error
        numbers = number(lit.rms_m, ".3f", " m"), number(lit.mean_m, "+.3f", " m"), number(lit.nmad_m, ".3f", " m")
        rows["RMSE of lit cells"] = "{}, bias {}, NMAD {}".format(*numbers)
        rows["coverage"] = f"{lit.coverage:.1%}"
    return rows | {"coordinates": crs_name(processed.georeference), "time": f"{processed.timing_s['total']:.1f} s"}
