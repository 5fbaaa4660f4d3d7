"""A processed recording as files, table and page."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import tomli_w
from rich.table import Table

from sionna_radar.execution.workers import versions
from sionna_radar.foundation.decibels import decibels
from sionna_radar.foundation.memory import peak_memory_mb
from sionna_radar.foundation.raster import Raster
from sionna_radar.foundation.sequences import spread_indices
from sionna_radar.mapping.points import Points
from sionna_radar.radar.chirp import Chirp
from sionna_radar.report.coordinates import Coordinates, Frame, frame_of, map_bounds
from sionna_radar.report.files.contents import COSTS, Figures, costs_json
from sionna_radar.report.files.navigation import write_navigation
from sionna_radar.report.files.points_table import write_csv, write_laz, write_points_csv
from sionna_radar.report.page.markup import command_line
from sionna_radar.report.page.scene_data import MAX_RELIEF_CELLS, Pack, packed_points, points_to_draw, thinned
from sionna_radar.report.page.sections import (
    bounds_of,
    chirps_that_fit,
    errors_section,
    maps_of,
    page_of,
    painted,
    span_of,
)
from sionna_radar.report.study_document import StudyDocument
from sionna_radar.report.survey.navigation import navigation_document, navigation_rows
from sionna_radar.report.survey.obstacles import write_obstacles
from sionna_radar.report.survey.products import rasters_of, write_rasters
from sionna_radar.report.survey.summary import crs_name, georeference
from sionna_radar.report.terminal import number, reference_rows, table_of_values
from sionna_radar.survey.result import Processed

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def processed_document(
    coordinates: Coordinates = Coordinates.MAP, figures: Figures = Figures.NONE
) -> StudyDocument[Processed]:
    """Return the document of a processed recording, with the coordinates of figures and page."""
    return StudyDocument(
        marker="processed.json",
        suffix="_processed",
        numbers=_numbers,
        tables=lambda processed: [processed_table(processed)],
        figures=partial(_figures_of, coordinates) if figures is Figures.PNG else lambda _: {},
        texts={COSTS: lambda processed: costs_json(processed.timing_s, peak_memory_mb()), "settings.toml": _settings},
        files=[
            _write_echoes,
            lambda processed, folder: write_rasters(folder, processed, rasters_of(processed, processed.comparison)),
            _write_obstacles,
            write_navigation,
        ],
        page=partial(recording_page, coordinates=coordinates),
    )


def _figures_of(coordinates: Coordinates, processed: Processed) -> "Mapping[str, Callable[[Processed], Figure]]":
    # matplotlib is slow to load.
    from sionna_radar.report.survey.processed_figures import figures_of

    return figures_of(processed, coordinates)


def _write_echoes(processed: Processed, directory: Path) -> None:
    write_csv(directory / "echoes.csv", len(processed.echoes), partial(_echo_columns, processed))
    place = processed.georeference
    if processed.points is not None and processed.measured is not None:
        write_laz(directory / "points.laz", processed.points, processed.time_s, processed.measured, place)
        write_points_csv(directory / "points.csv", processed.points, processed.time_s, place)


def _write_obstacles(processed: Processed, directory: Path) -> None:
    if processed.obstacles is not None:
        write_obstacles(directory / "obstacles.gpkg", processed.obstacles, processed.georeference)


# Pulses whose chirps are offered, positions of the flight, and cells of the surface in three dimensions.
PULSES, TRACK = 240, 2_000


def recording_page(processed: Processed, coordinates: Coordinates = Coordinates.MAP) -> str:
    """Return the page of a processed recording, with errors and maps if known; OutputError as `survey_page`."""
    frame, pack = frame_of(processed.georeference, coordinates), Pack()
    chirp = processed.chirp
    index = spread_indices(min(PULSES, chirps_that_fit(chirp)) if chirp else 1, len(processed.time_s))
    dem, points, compared = processed.dem, processed.points, processed.comparison
    world: dict[str, Any] | None = None
    maps: list[dict[str, Any]] = []
    notes: list[str] = []
    if dem is not None and points is not None and dem.filled.any():
        maps, notes = maps_of(pack, frame, processed, compared)
        world = _world(processed, dem, points, pack, frame)
    breakdown = processed.breakdown
    errors: dict[str, Any] = {"error_rows": []}
    if compared is not None and breakdown is not None:
        errors = errors_section(compared, breakdown, processed.dem_uncertainty)
    return page_of(
        "recording.html",
        processed,
        compared,
        pack,
        frame,
        pulses=index,
        records=processed.record_chirps(index) if chirp else [],
        maps=maps,
        world=world,
        title=processed.source.name,
        tiles=_tiles(processed),
        flown=_recorded(processed) | _mapped(processed),
        command=command_line(["process", processed.source.name], processed.overrides) + " -o again",
        lidar=False,
        beams=False,
        world_notes=[],
        map_notes=notes,
        settings_title="The resolved settings",
        scenario=_settings(processed),
        **errors,
    )


def _tiles(processed: Processed) -> list[tuple[str, str, str]]:
    """Return the key figures of the page: value, name and remark."""
    tiles = [(f"{len(processed.echoes):,}", "echoes", f"of {len(processed.time_s):,} pulses")]
    if processed.spectrum is not None:
        peak_m, _ = processed.spectrum.peak
        tiles.append((f"{peak_m:.2f} m", "peak of the mean spectrum", "range, not corrected for Doppler"))
    if processed.dem is not None:
        tiles.append(
            (f"{int(processed.dem.filled.sum()):,}", "cells", f"of {processed.dem.grid.spacing_m:g} m, filled")
        )
    if processed.comparison is not None:
        lit = processed.comparison.lit_error
        tiles += [
            (number(lit.rms_m, ".3f", " m"), "RMS error", "of lit cells, DEM minus truth"),
            (number(lit.mean_m, "+.3f", " m"), "mean error", "bias"),
            (f"{lit.coverage:.1%}", "coverage", "of lit cells"),
        ]
    return tiles


def _world(processed: Processed, dem: Raster, points: Points, pack: Pack, frame: Frame) -> dict[str, Any]:
    assert processed.measured is not None
    thin, compared = thinned(dem.grid, MAX_RELIEF_CELLS), processed.comparison
    surfaces = {"DEM": dem} if compared is None else {"True surface": compared.truth, "DEM": dem}
    thinner = {name: Raster(grid=thin.cells, height_m=thin.of(r.height_m)) for name, r in surfaces.items()}
    span = np.array(span_of(*(surface.height_m for surface in thinner.values())))
    world = painted(pack, frame, thinner, None if compared is None else thin.of(compared.error.height_m))
    flown = np.unique(np.linspace(0, len(processed.time_s) - 1, TRACK).astype(np.int64))
    track_m = processed.measured(flown).position_m
    return world | {
        "track": {"position": pack.exact(track_m), "time_s": pack.exact(processed.time_s[flown])},
        "points": packed_points(pack, points, points_to_draw(len(points))),
        "bounds": bounds_of(map_bounds(dem.grid.extent_m, track_m), span, track_m[:, 2]),
    }


def _settings(processed: Processed) -> str:
    return tomli_w.dumps(processed.settings.model_dump(mode="json", exclude_none=True))


def _echo_columns(processed: Processed, rows: slice) -> dict[str, np.ndarray]:
    echoes = processed.echoes
    direction = {}
    if echoes.direction is not None:
        left, up = np.rad2deg(np.arcsin(np.clip(echoes.direction[rows, 1:], -1, 1))).T
        direction = {"left_deg": left, "up_deg": up}
    return {
        "pulse": echoes.pulse[rows],
        "echo": echoes.number[rows],
        "time_s": processed.time_s[echoes.pulse[rows]],
        "range_m": echoes.range_m[rows],
        "range_sigma_m": echoes.range_sigma_m[rows],
        "echo_snr_db": echoes.echo_snr_db[rows],
        "power": echoes.power[rows],
        **direction,
    }


def _numbers(processed: Processed) -> dict[str, Any]:
    points, comparison = processed.points, processed.comparison
    return {
        "recording": processed.source.name,
        "settings": processed.settings,
        "warnings": processed.warnings,
        "crs": crs_name(processed.georeference),
        "georeference": georeference(processed.georeference),
        "sweep": _sweep(processed.sweeps) if processed.sweeps else None,
        "pulses": len(processed.time_s),
        "echoes": len(processed.echoes),
        "noise_floor": processed.spectrum.floor if processed.spectrum else None,
        "dem_error": comparison.dem_error if comparison else None,
        "lit_error": comparison.lit_error if comparison else None,
        "off_wall_error": comparison.off_wall_error if comparison else None,
        "reference": processed.reference.document() if processed.reference else None,
        "navigation": navigation_document(processed.navigation, None) if processed.navigation else None,
        "points_sha256": points.sha256() if points is not None else None,
        "versions": versions(),
    }


def _sweep(sweeps: tuple[Chirp, ...]) -> dict[str, Any]:
    sweep = sweeps[0]
    return {
        "carrier_hz": sweep.carrier_hz,
        "bandwidth_hz": sweep.bandwidth_hz,
        "duration_s": sweep.duration_s,
        "samples": sweep.samples,
        "sampling": sweep.sampling,
        "sweeps": len(sweeps),
        "propagation_mps": sweep.propagation_mps,
        "range_cell_m": sweep.range_resolution_m,
    }


def processed_table(processed: Processed) -> Table:
    """Return the table of a recording: its sweeps, echoes, spectrum and DEM, with errors if the truth is known."""
    return table_of_values(
        f"Recording {processed.source.name}",
        _recorded(processed) | _mapped(processed) | navigation_rows(processed.navigation, None),
    )


def _recorded(processed: Processed) -> dict[str, str]:
    spectrum = processed.spectrum
    if spectrum is None:
        spread = np.quantile(processed.echoes.range_m, [0.0, 0.5, 1.0]) if len(processed.echoes) else [np.nan] * 3
        return {
            "readings": f"{len(processed.echoes):,} of {len(processed.time_s):,}",
            "range": f"{spread[0]:.2f} to {spread[2]:.2f} m, median {spread[1]:.2f} m",
        }
    sweep = processed.sweeps[0]
    count = "one sweep" if len(processed.sweeps) == 1 else "two sweeps"
    if processed.settings.radar.array is not None:
        count = "a frame of sweeps"
    kind = f"{count} of {sweep.samples:,} {'I/Q' if sweep.sampling == 'iq' else 'real'} samples"
    peak, strongest = spectrum.peak
    floor_db, peak_db = decibels(np.array([spectrum.floor, strongest]))
    return {
        "pulses / echoes": f"{len(processed.time_s):,} / {len(processed.echoes):,}",
        "pulse": kind,
        "sweep": f"{sweep.bandwidth_hz / 1e6:.6g} MHz about {sweep.carrier_hz / 1e9:.6g} GHz, range cells of "
        f"{sweep.range_resolution_m:.4g} m to {sweep.max_range_m:.4g} m",
        "noise floor": f"{floor_db:.1f} dB re the recording's unit squared, per range cell; the mean spectrum peaks at "
        f"{peak_db:.1f} dB, at {peak:.2f} m",
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
        off_wall = processed.comparison.off_wall_error
        if off_wall is not None:
            rows["RMSE away from walls"] = number(off_wall.rms_m, ".3f", " m")
        rows["coverage of lit cells"] = f"{lit.coverage:.1%}"
    if processed.reference is not None:
        rows |= reference_rows(processed.reference)
    return rows | {"coordinates": crs_name(processed.georeference), "time": f"{processed.timing_s['total']:.1f} s"}
