"""Results side by side: their tables, and their page."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from sionna_radar.accuracy.reference_check import ReferenceCheck, compare_with_reference
from sionna_radar.foundation.errors import InputFileError
from sionna_radar.foundation.input_file import is_file, shown
from sionna_radar.foundation.raster import Georeference
from sionna_radar.report.coordinates import LOCAL_FRAME, MAP_FRAME
from sionna_radar.report.page.markup import document
from sionna_radar.report.page.scene_data import HEIGHT_STEP_M, Pack, packed_map, thinned
from sionna_radar.report.page.sections import class_rows, colour_scales, frame_of_page, histogram_of, limit_of, span_of
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import NONE, console, print_whole, reference_rows, table_of
from sionna_radar.studies.comparison.results import FLOWN, PROCESSED, folder_names, read_document, read_raster
from sionna_radar.studies.comparison.study import FlownResult, ResultsComparison
from sionna_radar.studies.design import MARKER as DESIGN
from sionna_radar.studies.sweep import MARKER as SWEEP
from sionna_radar.survey.result import cover_masks

MAX_KEYS = 200


def _error(key: str) -> Callable[[FlownResult], float | int | None]:
    return lambda flown: flown.summary["lit_error"][key]


ERRORS = Columns[FlownResult](
    [
        Column(key="name", heading="folder"),
        *(
            Column(key=f"lit_error.{key}", heading=heading, form=form, value=_error(key))
            for key, heading, form in (
                ("rms_m", "RMS", ".3f"),
                ("mean_m", "mean", "+.3f"),
                ("std_m", "std", ".3f"),
                ("nmad_m", "NMAD", ".3f"),
                ("le90_m", "LE90", ".3f"),
                ("count", "cells", ",.0f"),
                ("coverage", "coverage of lit cells", ".1%"),
            )
        ),
    ]
)


def setting_rows(result: ResultsComparison) -> dict[str, list[str]]:
    """Return the differing settings by dotted key, one value per folder; at most `MAX_KEYS`."""
    rows = {
        _value(key): [_value(value) for value in values] for key, values in islice(result.differing.items(), MAX_KEYS)
    }
    hidden = len(result.differing) - len(rows)
    return {**rows, **({f"and {hidden:,} more": [""] * len(result.results)} if hidden else {})}


def _value(value: Any) -> str:
    return value if isinstance(value, str) and len(value) < 60 else shown(value)


def comparison_tables(result: ResultsComparison) -> list[Table]:
    """Return the errors of lit cells, and the differing settings."""
    errors = ERRORS.table("DEM minus truth of lit cells, m", result.results)
    if not result.differing:
        return [errors]
    columns = ["key", *(flown.name for flown in result.results)]
    settings = ([key, *row] for key, row in setting_rows(result).items())
    return [errors, table_of("Settings that differ", columns, settings, left=columns)]


def compare_folder(folder: Path, reference: Path, sigma_m: float, apply_shift: bool) -> ReferenceCheck:
    """Compare the DEM of a folder of results, `dem.tif`, with measured heights; see `compare_with_reference`."""
    crs, dem = read_raster(folder / "dem.tif")
    if crs:
        place = Georeference(crs_wkt=crs, origin_m=(0.0, 0.0, 0.0))
        dem = replace(dem, grid=replace(dem.grid, georeference=place))
    sigma = read_raster(folder / "dem_sigma.tif")[1] if is_file(folder / "dem_sigma.tif") else None
    settings = folder / (PROCESSED if is_file(folder / PROCESSED[0]) else FLOWN)[1]
    of_scenario = is_file(settings) and "terrain" in read_document(settings, "scenario")
    covers = cover_masks(settings if of_scenario else None, dem.grid)
    return compare_with_reference(reference, dem, sigma, sigma_m=sigma_m, apply_shift=apply_shift, covers=covers)


def print_references(folders: Sequence[Path], checks: Sequence[ReferenceCheck]) -> None:
    """Print the DEMs of some folders against the same measured heights, and their errors by classes of cells."""
    columns, texts = ["", *folder_names(folders)], [reference_rows(check) for check in checks]
    rows = ([key, *(values[key] for values in texts)] for key in texts[0])
    console().print(table_of("Against measured heights", columns, rows, left=columns))
    classes = [{} if check.breakdown is None else class_rows(check.breakdown, "reference") for check in checks]
    # A cloud that is a surface on the cells of one folder may be single points on those of another.
    for title in max(classes, key=len):
        named = [{name: f"{rms} of {count}" for name, rms, _, count in by.get(title, [])} for by in classes]
        if keys := dict.fromkeys(name for cells in named for name in cells):
            rows = ([key, *(cells.get(key, NONE) for cells in named)] for key in keys)
            console().print(table_of(f"RMSE (m) by class: {title}", ["", *columns[1:]], rows))


# Largest number of cells of all maps of a page.
MAX_CELLS = 1_600_000
LINES, LINE_POINTS = 41, 400


def comparison_page(result: ResultsComparison) -> str:
    """Return the page of a comparison as HTML."""
    pack = Pack()
    one_map = len({flown.crs for flown in result.results}) == 1
    on_map = one_map and result.results[0].crs
    frame = MAP_FRAME if on_map else LOCAL_FRAME
    maps, notes = _maps(result, pack, frame.height)
    numbers = {
        "frame": frame_of_page(frame),
        "scales": colour_scales(),
        "maps": maps,
        "linked": one_map,
        "profiles": _profiles(result, pack),
        "histogram": histogram_of({f.name: f.error.height_m for f in result.results}),
        "results": [
            {"name": flown.name, "lit_error": flown.summary["lit_error"], "dem_error": flown.summary["dem_error"]}
            for flown in result.results
        ],
    }
    return document(
        "compare.html",
        pack.text(numbers),
        ("maps.js", "chirps.js", "compare.js"),
        package=__package__,
        title=f"{len(result.results)} results side by side",
        names=[flown.name for flown in result.results],
        head=ERRORS.heads,
        rows=ERRORS.cells(result.results, ""),
        settings=[[key, *values] for key, values in setting_rows(result).items()],
        common=result.common,
        notes=notes,
        lines=LINES,
    )


def _maps(result: ResultsComparison, pack: Pack, height: str) -> tuple[list[dict[str, Any]], list[str]]:
    """Return DEM and error maps of each result on scales common to maps of a common area, and notes on omissions."""
    dems = [flown.dem.height_m for flown in result.results]
    limit = limit_of(np.concatenate([flown.error.height_m.ravel() for flown in result.results]))
    error_look = {"low": -limit, "high": limit, "scale": "error", "unit": "DEM minus truth (m)", "hover": "error"}
    maps, notes = [], []
    for flown in result.results:
        low, high = span_of(*(dems if result.common else [flown.dem.height_m]))
        height_look = {"low": low, "high": high, "scale": "height", "unit": height, "hover": "height"}
        thin = thinned(flown.dem.grid, MAX_CELLS // (2 * len(result.results)))
        for name, values, look in (
            ("DEM", flown.dem.height_m, height_look),
            ("error", flown.error.height_m, error_look),
        ):
            packed = packed_map(pack, thin.cells, thin.of(values))
            maps.append({"name": f"{flown.name}: {name}", **look, **packed})
        if thin.note:
            notes.append(f"{flown.name}: {thin.note}.")
    return maps, notes


def _profiles(result: ResultsComparison, pack: Pack) -> dict[str, Any] | None:
    """Return heights and errors along lines from west to east over the area common to all maps."""
    if result.common is None:
        return None
    west, east, south, north = result.common
    inset = 0.02 * (north - south)
    x, y = np.linspace(west, east, LINE_POINTS), np.linspace(south + inset, north - inset, LINES)
    across, along = np.meshgrid(x, y)
    places = np.column_stack([across.ravel(), along.ravel()])

    def lines(flown: FlownResult) -> tuple[dict[str, Any], dict[str, Any]]:
        height, error = (raster.at(places).reshape(across.shape) for raster in (flown.dem, flown.error))
        return pack.rounded(height, HEIGHT_STEP_M), pack.rounded(error, HEIGHT_STEP_M)

    profiles = [lines(flown) for flown in result.results]
    return {
        "x": x.tolist(),
        "y": y.tolist(),
        "names": [flown.name for flown in result.results],
        "height": [height for height, _ in profiles],
        "error": [error for _, error in profiles],
    }


DOCUMENT = StudyDocument[ResultsComparison](
    marker="compare.html",
    suffix="_compared",
    tables=comparison_tables,
    lines=lambda result: [] if result.differing else ["no setting differs"],
    texts={"compare.html": comparison_page},
)


def is_study(folder: Path) -> bool:
    """Return True if a folder holds the results of a sweep or a design."""
    return any(is_file(folder / marker) for marker in (SWEEP, DESIGN))


def print_studies(folders: Sequence[Path]) -> None:
    """Print the settings of sweeps and designs, by their RMS error over lit cells; InputFileError for other folders."""
    from sionna_radar.studies.design.document import OF_LIT_CELLS

    rows = [
        row for folder, name in zip(folders, folder_names(folders), strict=True) for row in _study_rows(folder, name)
    ]
    texts = ["study", "setting", "DEM method", "seeds"]
    ordered = (row for _, row in sorted(rows, key=lambda pair: pair[0]))
    title = "DEM minus truth of lit cells: settings of all studies"
    print_whole(table_of(title, [*texts, "RMS", "LE90", OF_LIT_CELLS], ordered, left=texts))


def _study_rows(folder: Path, name: str) -> list[tuple[float, list[str]]]:
    """Return the settings of a study as rows, with their RMS error, by which they are sorted."""
    if is_file(folder / SWEEP):
        # Loads SciPy's statistics and matplotlib, which folders of `run` need not.
        from sionna_radar.studies.sweep.results import read_sweep

        found = [
            (case.setting, case.scenario.dem.map_method if case.scenario else "", len(case.trials), case.mean)
            for case in read_sweep(folder).cases
            if case.trials
        ]
        return [_study_row(name, *one) for one in found]
    document = read_document(folder / DESIGN)
    try:
        designs = [(d["setting"], d["method"], d["seeds"], dict(d["values"]).__getitem__) for d in document["checked"]]
        return [_study_row(name, *one) for one in designs]
    except (KeyError, TypeError) as error:
        raise InputFileError(
            f"{shown(folder / DESIGN)} is damaged ({error}); give a folder that `sionna-radar design` wrote"
        ) from error


def _study_row(
    name: str, setting: dict[str, Any], method: str, seeds: int, value: Callable[[str], float]
) -> tuple[float, list[str]]:
    from sionna_radar.studies.sweep.settings import label

    rms_m = value("rms_m")
    numbers = [f"{rms_m:.3f}", f"{value('le90_m'):.3f}", f"{value('coverage'):.1%}"]
    return rms_m, [name, label(setting), method, str(seeds), *numbers]
