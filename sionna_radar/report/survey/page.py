"""The page of a survey, `report.html`: its flight, errors, maps, scene and chirps, in one file.

Errors are shown as a table beside the reference paper's, as a distribution, and as a map. Chirps are those of pulses
sampled over the survey, traced again, with their detections.
"""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from sionna_radar.accuracy.breakdown import ErrorClass
from sionna_radar.accuracy.compare import DemError
from sionna_radar.accuracy.uncertainty import INTERVALS_PERCENT, Calibration
from sionna_radar.execution.workers import versions
from sionna_radar.foundation.numerics import decibels, on_one_thread
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.report.drawing import Coordinates, Frame, frame_of
from sionna_radar.report.page.markup import TableCell, document
from sionna_radar.report.page.scene_data import (
    HEIGHT_STEP_M,
    MAX_MAP_CELLS,
    MAX_RELIEF_CELLS,
    Beams,
    Pack,
    cast_beams,
    flown_rows,
    packed_map,
    sigma0_db,
    spread_pulses,
    surroundings,
    thinned,
)
from sionna_radar.report.page.world import (
    MAX_POINTS,
    box_of,
    colour_scales,
    frame_of_page,
    packed_relief,
    packed_track,
    track_of,
)
from sionna_radar.report.survey.summary import crs_name, reference_for, summary
from sionna_radar.report.terminal import number
from sionna_radar.scenario import to_toml
from sionna_radar.survey.result import Survey
from sionna_radar.survey.sensors.sensor import SensorWithChirps
from sionna_radar.survey.sensors.sweeps import ChirpRecord

BINS = 81
# Half-width of a histogram, in NMADs, from which its scale is logarithmic.
HEAVY_TAILS = 10
ERRORS = {
    "RMS": ("rms_m", ".3f"),
    "Mean": ("mean_m", "+.3f"),
    "Std. dev.": ("std_m", ".3f"),
    "NMAD": ("nmad_m", ".3f"),
    "LE68": ("le68_m", ".3f"),
    "LE90": ("le90_m", ".3f"),
    "LE95": ("le95_m", ".3f"),
    "Least": ("min_m", "+.2f"),
    "Greatest": ("max_m", "+.2f"),
}


def _errors(survey: Survey) -> dict[str, Any]:
    """Return the section on errors: beside the paper's, by classes of cells, and against stated ones."""
    named = {
        "lit_error": ("Lit cells", survey.lit_error),
        "off_wall_error": ("Lit cells off walls", survey.off_wall_error),
        "dem_error": ("All filled cells", survey.dem_error),
    }
    paper, breakdown = reference_for(survey.prepared), survey.breakdown
    return {
        "errors": list(ERRORS),
        "error_rows": [
            *(_error_row(key, name, error) for key, (name, error) in named.items() if error is not None),
            *(
                [entry.name, *(number(getattr(entry, key, np.nan), form) for key, form in ERRORS.values()), "-", "-"]
                for entry in paper.rows
            ),
        ],
        "paper": paper.conditions,
        "classes": {
            "Slope of the truth (deg)": _class_rows(breakdown.by_slope),
            "Incidence angle (deg)": _class_rows(breakdown.by_incidence),
            "Distance from walls (m)": _class_rows(breakdown.by_wall_distance or ()),
        },
        "checkpoints": breakdown.checkpoints.statement,
        "intervals": [f"in {p} %" for p in INTERVALS_PERCENT],
        "stated": _stated_rows(survey),
    }


def _error_row(key: str, name: str, error: DemError) -> list[TableCell | str]:
    values = asdict(error)
    cells: list[TableCell | str] = [name]
    for field, form in (*ERRORS.values(), ("count", ",.0f"), ("coverage", ".1%")):
        value = float(values[field])
        cells.append(TableCell(number(value, form), f"{key}.{field}", value if value == value else None))
    return cells


def _class_rows(classes: Sequence[ErrorClass]) -> list[list[str]]:
    return [
        [
            f"{entry.low:g} to {entry.high:g}" if np.isfinite(entry.high) else f"over {entry.low:g}",
            number(entry.rms_m, ".3f"),
            number(entry.mean_m, "+.3f"),
            f"{entry.count:,}",
        ]
        for entry in classes
    ]


def _stated_rows(survey: Survey) -> list[list[str]]:
    """Return the calibration of the map's stated uncertainty; empty without one."""
    check = survey.dem_uncertainty
    if check is None:
        return []
    rows = [["all", *_calibration_row(check.cells)]]
    for title, classes in (
        ("slope of the truth, deg", check.by_slope),
        ("distance from the nearest echo, m", check.by_echo_distance),
    ):
        rows += [
            [f"{title}: {entry.low:g} to {entry.high:g}", *_calibration_row(entry.calibration)] for entry in classes
        ]
    return rows


def _calibration_row(calibration: Calibration) -> list[str]:
    shares = [number(share, ".1%") for share in calibration.coverage.values()]
    spread = [
        number(calibration.nmad_z, ".2f"),
        number(calibration.rms_z, ".2f"),
        number(calibration.sigma_rms_m, ".3f"),
    ]
    return [*shares, *spread, f"{calibration.count:,}"]


def histogram_of(survey: Survey) -> dict[str, Any]:
    """Return the histogram of the error over lit cells, in shares."""
    values = survey.error.within(survey.lit).height_m
    values = values[np.isfinite(values)]
    limit = 1.3 * limit_of(values)
    edges = np.linspace(-limit, limit, BINS + 1)
    share = 100 * np.histogram(values, edges)[0] / max(len(values), 1)
    percent = np.arange(0, 100)
    below = np.percentile(np.abs(values), percent).tolist() if len(values) else []
    lit = survey.lit_error
    marks = [(68.27, lit.le68_m), (90.0, lit.le90_m), (95.0, lit.le95_m)] if len(values) else []
    series = {"name": "lit cells", "share": share.tolist(), "below": below, "marks": marks}
    heavy = limit > HEAVY_TAILS * survey.lit_error.nmad_m > 0
    return {"edges": edges.tolist(), "percent": percent.tolist(), "series": [series], "heavy": bool(heavy)}


def limit_of(values: Float[np.ndarray, "..."]) -> float:
    """Return the 99th percentile of the magnitudes, with a minimum."""
    magnitude = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(magnitude, 99)), 1e-3) if len(magnitude) else 1.0


# Largest number of chirps of a custom sensor that records one at a time.
MAX_ONE_BY_ONE = 40
# Limits of a page's chirps in bytes and in paths traced again: wide beams over fixed scatterers have tens of thousands
# per pulse.
MAX_BYTES, MAX_PATHS = 3_500_000, 200_000
MIN_CHIRPS, AT_ONCE = 12, 256
LEVEL_STEP_DB = 0.1


def chirps_of(survey: Survey, index: Int[np.ndarray, " pulse"]) -> Int[np.ndarray, " chirp"]:
    """Return an even subset of pulses whose chirps fit the page's limits of size and time."""
    if survey.chirp is None or len(index) == 0:
        return index[:0]
    beat, cells = survey.chirp.beat, len(survey.chirp.power)
    size = 2 * (len(beat) * (2 if np.iscomplexobj(beat) else 1) + 2 * cells)
    traceable = max(MIN_CHIRPS, MAX_PATHS * survey.pulses // max(survey.paths, 1))
    max_chirps = max(1, min(MAX_BYTES // size, traceable))
    return index[:: -(-len(index) // max_chirps)]


@on_one_thread
def record_chirps(survey: Survey, index: Int[np.ndarray, " pulse"]) -> list[ChirpRecord]:
    """Return the chirp records of some pulses; fewer from a sensor that records one at a time."""
    if len(index) == 0:
        return []
    sensor, flight = survey.sensor or survey.prepared.build_sensor(), survey.prepared.flight
    if isinstance(sensor, SensorWithChirps):
        blocks = np.array_split(index, -(-len(index) // AT_ONCE))
        return [record for block in blocks for record in sensor.record_chirps(flight.pulses(block))]
    stride = -(-len(index) // MAX_ONE_BY_ONE)
    records = (sensor.record_chirp(flight.pulses(index[row : row + 1])) for row in range(0, len(index), stride))
    return [record for record in records if record is not None]


def packed_chirps(
    pack: Pack, records: list[ChirpRecord], rows: Int[np.ndarray, " pulse"], survey: Survey
) -> dict[str, Any] | None:
    """Return chirps for a page; None without any.

    rows: the pulses of the page, which include each record's pulse.
    """
    if not records:
        return None
    beat = np.stack([record.beat for record in records])
    scale = np.maximum(np.abs(beat).max(axis=1), np.finfo(float).tiny)
    exponent = 3 * int(np.floor(np.log10(scale.max()) / 3))
    parts = [beat.real, beat.imag] if np.iscomplexobj(beat) else [beat]
    power = np.stack([record.power for record in records])
    power_db, threshold_db = _levels(power), _levels(np.stack([record.threshold for record in records]))
    echo_db = decibels(np.concatenate([record.echo_power for record in records]))
    levels_db = np.concatenate([power_db[np.isfinite(power_db)], echo_db[np.isfinite(echo_db)], [-300.0]])
    pulses = [record.pulse for record in records]
    relative = survey.scenario.radar.snr_db is not None
    return {
        "pulse": pack.whole(np.array(pulses)),
        "row": pack.whole(np.searchsorted(rows, pulses)),
        "time_ms": pack.exact(1e3 * records[0].sample_time_s),
        "range_m": pack.exact(records[0].range_m),
        "beat": [pack.rounded(part / scale[:, None], 2 / 65_000) for part in parts],
        "beat_scale": pack.exact(scale / 10.0**exponent),
        "beat_label": f"Beat (10<sup>{exponent}</sup> {'of the transmitted' if relative else '√W'})",
        "power": pack.rounded(power_db, LEVEL_STEP_DB),
        "threshold": pack.rounded(threshold_db, LEVEL_STEP_DB),
        "power_label": f"Power ({'dB rel. to transmitted' if relative else 'dBW'})",
        "top_db": float(levels_db.max()),
        "floor_db": float(np.percentile(levels_db, 0.5)) - 5.0,
        "echo_row": pack.whole(np.repeat(np.arange(len(records)), [len(r.echo_power) for r in records])),
        "echo_range_m": pack.exact(np.concatenate([record.echo_range_m for record in records])),
        "echo_db": pack.exact(echo_db),
    }


def _levels(power: Float[np.ndarray, "pulse cell"]) -> Float[np.ndarray, "pulse cell"]:
    """Return powers in dB; NaN at 200 dB or more below the strongest."""
    level = decibels(power.ravel()).reshape(power.shape)
    return np.where(level > np.nanmax(level, initial=-np.inf) - 200.0, level, np.nan)


PULSES = 240
MAX_ECHOES_OF_BEAMS = 4_000
AROUND_CELLS = 12_000


def survey_page(survey: Survey, coordinates: Coordinates = Coordinates.MAP) -> str:
    """Return the page of a survey as HTML.

    Raises OutputError if it would be too large, or plotly is not installed.
    """
    frame, pack = frame_of(survey.georeference, coordinates), Pack()
    index = spread_pulses(survey.pulses, PULSES)
    beams = cast_beams(survey.prepared, index)
    records = record_chirps(survey, chirps_of(survey, index))
    chirps = packed_chirps(pack, records, index, survey)
    thin = thinned(survey.dem.grid, MAX_RELIEF_CELLS)
    truth = Raster(grid=thin.cells, height_m=thin.of(survey.truth.height_m))
    sigma0 = None if survey.scenario.sensor == "lidar" else _backscatter(survey, truth.within(thin.of(survey.lit)))
    maps, notes = _maps(survey, pack, frame, sigma0)
    world, omissions = _world(survey, pack, frame, beams, sigma0)
    numbers = {
        "frame": frame_of_page(frame),
        "scales": colour_scales(),
        "chosen": len(index) // 2,
        "world": world,
        "maps": maps,
        "chirps": chirps,
        "histogram": histogram_of(survey),
        "summary": summary(survey),
    }
    lit = survey.lit_error
    return document(
        "survey.html",
        pack.text(numbers),
        ("world.js", "maps.js", "chirps.js"),
        title=survey.scenario.description or "A survey",
        warnings=survey.warnings,
        tiles=[
            (number(lit.rms_m, ".3f", " m"), "RMS error", "of lit cells, DEM minus truth"),
            (number(lit.mean_m, "+.3f", " m"), "mean error", "bias"),
            (number(lit.le90_m, ".3f", " m"), "LE90", "90th percentile of |error|"),
            (f"{lit.coverage:.1%}", "coverage", "of lit cells"),
            (f"{len(survey.points):,}", "echoes", f"of {survey.pulses:,} pulses"),
            (f"{survey.paths:,}", "paths traced", "in all"),
        ],
        flown=flown_rows(survey.prepared)
        | {"Coordinates": crs_name(survey.georeference)}
        | {f"{key} replaced by": part for key, part in survey.replaced.items()},
        lidar=survey.scenario.sensor == "lidar",
        paints=[paint["name"] for paint in world["paints"]],
        pulses=len(index),
        world_notes=omissions,
        maps=[entry["name"] for entry in maps],
        map_notes=notes,
        chirps=len(records),
        replaced=survey.replaced,
        points_sha256=survey.points.sha256(),
        versions={name: version or "not installed" for name, version in versions().items()},
        scenario=to_toml(survey.scenario),
        **_errors(survey),
    )


def _backscatter(survey: Survey, lit: Raster) -> Raster | None:
    """Return sigma0 of lit cells in dB; None if undefined everywhere."""
    level = sigma0_db(survey.prepared, lit)
    return Raster(grid=lit.grid, height_m=level) if np.isfinite(level).any() else None


def _maps(survey: Survey, pack: Pack, frame: Frame, sigma0: Raster | None) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of a survey, and notes on omissions."""
    thin = thinned(survey.dem.grid, MAX_MAP_CELLS)
    low, high = _span(survey.truth.height_m, survey.dem.height_m)
    limit = limit_of(survey.error.height_m)
    up = frame.origin_m[2]
    heights = {"low": low + up, "high": high + up, "scale": "height", "unit": frame.height, "hover": "height"}
    errors = {"low": -limit, "high": limit, "scale": "error", "unit": "DEM minus truth (m)", "hover": "error"}
    maps = [
        {"name": name, **look, **packed_map(pack, thin.cells, thin.of(values), HEIGHT_STEP_M, frame.origin_m)}
        for name, values, look in (
            ("True surface", survey.truth.height_m + up, heights),
            ("DEM", survey.dem.height_m + up, heights),
            ("Error of the DEM", survey.error.height_m, errors),
        )
    ]
    sigma = survey.dem_sigma
    if sigma is not None and sigma.filled.any():
        look = {"low": 0.0, "high": limit_of(sigma.height_m), "scale": "level", "unit": "Standard deviation (m)"}
        look["hover"] = "stated sigma"
        packed = packed_map(pack, thin.cells, thin.of(sigma.height_m), HEIGHT_STEP_M, frame.origin_m)
        maps.append({"name": "Stated uncertainty of the DEM", **look, **packed})
    if np.isfinite(survey.points.snr_db).any():
        grid, level = _echo_power(survey)
        low, high = _span(level, share=1.0)
        relative = survey.scenario.radar.snr_db is not None
        unit = f"Mean echo power ({'dB' if relative else 'dBW'})"
        look = {"low": low, "high": high, "scale": "level", "unit": unit, "hover": "echo power"}
        name = "Echo power, relative to transmitted" if relative else "Echo power"
        maps.append({"name": name, **look, **packed_map(pack, grid, level, 0.1, frame.origin_m)})
    if sigma0 is not None:
        low, high = _span(sigma0.height_m, share=1.0)
        look = {"low": low, "high": high, "scale": "level", "unit": "sigma0 (dB)", "hover": "sigma0"}
        packed = packed_map(pack, sigma0.grid, sigma0.height_m, 0.1, frame.origin_m)
        maps.append({"name": "Backscatter coefficient of the ground", **look, **packed})
    return maps, [f"Maps: {thin.note}."] if thin.note else []


def _echo_power(survey: Survey) -> tuple[Grid, Float[np.ndarray, "row column"]]:
    """Return the mean echo power in dB on a grid coarse enough for a few echoes per cell."""
    grid, points = survey.dem.grid, survey.points
    area = grid.columns * grid.rows * grid.spacing_m**2
    width_m = float(np.sqrt(4.0 * area / max(len(points), 1)))
    step = max(thinned(grid, MAX_MAP_CELLS).every, round(width_m / grid.spacing_m), 1)
    west, _, south, _ = grid.extent_m
    size = grid.spacing_m * step
    coarse = Grid(
        west_m=west + size / 2,
        south_m=south + size / 2,
        spacing_m=size,
        columns=max(2, -(-grid.columns // step)),
        rows=max(2, -(-grid.rows // step)),
    )
    row, column, inside = coarse.cell_of(points.position_m)
    cell = (row * coarse.columns + column)[inside]
    count = np.bincount(cell, minlength=coarse.columns * coarse.rows)
    power = np.bincount(cell, weights=points.power[inside], minlength=len(count))
    return coarse, decibels(power / np.maximum(count, 1)).reshape(coarse.shape)


def _world(
    survey: Survey, pack: Pack, frame: Frame, beams: Beams, sigma0: Raster | None
) -> tuple[dict[str, Any], list[str]]:
    """Return the three-dimensional view, and notes on omissions."""
    prepared = survey.prepared
    thin = thinned(survey.dem.grid, MAX_RELIEF_CELLS)
    truth, dem = (type(r)(grid=thin.cells, height_m=thin.of(r.height_m)) for r in (survey.truth, survey.dem))
    around = surroundings(prepared.scene.caster, prepared.scene.scene, box_of(prepared), AROUND_CELLS, thin.cells)
    drawn = _thinned_rows(len(survey.points), MAX_POINTS)
    echoes = np.flatnonzero(np.isin(survey.points.pulse, beams.pulses.index))[:MAX_ECHOES_OF_BEAMS]
    track = track_of(prepared.flight)
    low, high = _span(survey.truth.height_m, survey.dem.height_m)
    limit = limit_of(survey.error.height_m)
    up = frame.origin_m[2]
    paints: list[dict[str, Any]] = [
        {"name": "Height (m)", "scale": "height", "low": low + up, "high": high + up},
        {
            "name": "Error (m)",
            "scale": "error",
            "low": -limit,
            "high": limit,
            "z": pack.rounded(thin.of(survey.error.height_m), HEIGHT_STEP_M),
        },
    ]
    if sigma0 is not None:
        bottom, top = _span(sigma0.height_m, share=1.0)
        levels = pack.rounded(sigma0.height_m, 0.1)
        paints.append({"name": "sigma0 (dB)", "scale": "level", "low": bottom, "high": top, "z": levels})
    surfaces = [
        around.height_m[np.isfinite(around.height_m)],
        truth.height_m[truth.filled],
        dem.height_m[dem.filled],
        track[:, 2],
    ]
    bottom, top = min(s.min() for s in surfaces if s.size), max(s.max() for s in surfaces if s.size)
    west, east, south, north = box_of(prepared)
    pad = 0.04 * (top - bottom) + 0.1
    world = {
        "shapes": [packed_relief(pack, truth, "True surface"), packed_relief(pack, dem, "DEM")],
        "paints": paints,
        "around": around.packed(pack),
        "track": packed_track(pack, prepared.flight),
        "points": _packed_points(pack, survey, drawn),
        "echoes": _packed_points(pack, survey, echoes),
        "beams": beams.packed(pack),
        "bounds": [[west, south, bottom - pad], [east, north, top + pad]],
    }
    notes = [f"View in three dimensions: {thin.note}."] if thin.note else []
    if len(drawn) < len(survey.points):
        notes.append(f"View in three dimensions: {len(drawn):,} of {len(survey.points):,} echoes are drawn.")
    return world, notes


def _packed_points(pack: Pack, survey: Survey, rows: Int[np.ndarray, " n"]) -> dict[str, Any]:
    points = survey.points
    return {"position": pack.exact(points.position_m[rows]), "pulse": pack.whole(points.pulse[rows])}


def _thinned_rows(count: int, limit: int) -> Int[np.ndarray, " n"]:
    """Return the rows to draw: all, or a fixed random choice, free of aliasing with the scan."""
    return np.arange(count) if count <= limit else np.sort(np.random.default_rng(0).permutation(count)[:limit])


def _span(*arrays: Float[np.ndarray, "..."], share: float = 0.0) -> tuple[float, float]:
    """Return the lowest and highest of all values without a share (%) at either end; never equal."""
    values = np.concatenate([a[np.isfinite(a)] for a in arrays])
    if not len(values):
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, [share, 100 - share]))
    return (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)
