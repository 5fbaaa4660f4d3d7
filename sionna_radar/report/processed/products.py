"""The folder of a processed recording: numbers, settings, echoes, points, rasters and figures."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from sionna_radar.foundation.memory import peak_memory_mb
from sionna_radar.foundation.versions import versions
from sionna_radar.report.coordinates import Coordinates
from sionna_radar.report.folder import costs_json, strict_json, without_nan, write_folder, write_text
from sionna_radar.report.manifest import COSTS
from sionna_radar.report.processed.figures import draw_processed
from sionna_radar.report.rasters import write_geotiff
from sionna_radar.report.survey.point_cloud import write_laz
from sionna_radar.report.survey.points_table import write_points_csv
from sionna_radar.report.survey.products import provenance
from sionna_radar.report.survey.summary import crs_name, georeference
from sionna_radar.survey.processed import Processed

MARKER = "processed.json"
ECHO_COLUMNS = {
    "pulse": "%d",
    "echo": "%d",
    "time_s": "%.6f",
    "range_m": "%.4f",
    "range_sigma_m": "%.4f",
    "snr_db": "%.3f",
    "power": "%.6e",
}
ROWS_AT_ONCE = 20_000


def write_processed(processed: Processed, directory: Path, coordinates: Coordinates = Coordinates.MAP) -> list[Path]:
    """Write what processing made into a directory, completely or not at all, and return the files.

    Points and rasters have the bytes that the survey itself wrote, where the settings are the same.

    Parameters
    ----------
    processed:
        A processed recording.
    directory:
        Where to write; files of an earlier result of `process` are replaced.
    coordinates:
        Those of the figures.

    Raises
    ------
    OutputError
        The directory holds something else, or cannot be written; see `write_folder`.

    """
    return write_folder(directory, MARKER, partial(_write_all, processed, coordinates))


def _write_all(processed: Processed, coordinates: Coordinates, directory: Path) -> None:
    write_text(directory / MARKER, strict_json(_document(processed)))
    write_text(directory / COSTS, costs_json(processed.timing_s, peak_memory_mb()))
    settings = processed.settings.model_dump(mode="json", exclude_none=True)
    write_text(directory / "settings.toml", tomli_w.dumps(settings))
    _write_echoes(directory / "echoes.csv", processed)
    place = processed.georeference
    if processed.points is not None and processed.measured is not None:
        write_laz(directory / "points.laz", processed.points, processed.time_s, processed.measured, place)
        write_points_csv(directory / "points.csv", processed.points, processed.time_s, place)
    height_m = place.origin_m[2] if place else 0.0
    rasters = {"dem": (processed.dem, "DEM height", height_m)}
    if processed.dem_sigma is not None:
        rasters["dem_sigma"] = (processed.dem_sigma, "standard deviation of the DEM height", 0.0)
    if processed.comparison is not None:
        rasters["truth"] = (processed.comparison.truth, "true height", height_m)
        rasters["error"] = (processed.comparison.error, "DEM minus truth", 0.0)
    for name, (raster, description, offset_m) in rasters.items():
        if raster is not None and processed.points is not None:
            made_by = provenance(processed.scenario, processed.points)
            write_geotiff(directory / f"{name}.tif", raster, place, description, offset_m, made_by)
    draw_processed(processed, directory / "figures", coordinates)


def _document(processed: Processed) -> dict[str, Any]:
    sweep, points, comparison = processed.sweeps[0], processed.points, processed.comparison
    document: dict[str, Any] = {
        "recording": processed.source.name,
        "settings": processed.settings.model_dump(mode="json"),
        "warnings": processed.warnings,
        "crs": crs_name(processed.georeference),
        "georeference": georeference(processed.georeference),
        "sweep": {
            "carrier_hz": sweep.carrier_hz,
            "bandwidth_hz": sweep.bandwidth_hz,
            "duration_s": sweep.duration_s,
            "samples": sweep.samples,
            "sampling": sweep.sampling,
            "sweeps": len(processed.sweeps),
            "propagation_mps": sweep.propagation_mps,
            "range_cell_m": sweep.range_resolution_m,
        },
        "pulses": len(processed.time_s),
        "echoes": len(processed.echoes),
        "noise_floor": processed.spectrum.floor,
        "dem_error": asdict(comparison.dem_error) if comparison else None,
        "lit_error": asdict(comparison.lit_error) if comparison else None,
        "points_sha256": points.sha256() if points is not None else None,
        "versions": versions(),
    }
    kept: dict[str, Any] = without_nan(document)
    return kept


def _write_echoes(path: Path, processed: Processed) -> None:
    echoes, line = processed.echoes, ",".join(ECHO_COLUMNS.values()) + "\n"
    columns = (
        echoes.pulse,
        echoes.number,
        processed.time_s[echoes.pulse],
        echoes.range_m,
        echoes.range_sigma_m,
        echoes.snr_db,
        echoes.power,
    )
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(ECHO_COLUMNS) + "\n")
        for start in range(0, len(echoes), ROWS_AT_ONCE):
            rows = np.column_stack([column[start : start + ROWS_AT_ONCE] for column in columns])
            file.writelines(line % tuple(row) for row in rows)
