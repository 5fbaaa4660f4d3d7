"""Sections that the pages of surveys, recordings and comparisons share: errors, maps and chirps of a result."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact, Int

from sionna_radar.accuracy.breakdown import Breakdown, ErrorClass
from sionna_radar.accuracy.compare import DemError, nmad
from sionna_radar.accuracy.reference_check import ReferenceCheck
from sionna_radar.accuracy.truth import Comparison
from sionna_radar.accuracy.uncertainty import INTERVALS_PERCENT, Calibration, UncertaintyCheck
from sionna_radar.execution.workers import versions
from sionna_radar.foundation.decibels import decibels
from sionna_radar.foundation.raster import Grid, Raster
from sionna_radar.mapping.points import Points
from sionna_radar.report.colours import ERRORS, HEIGHTS, LEVELS, STOPS
from sionna_radar.report.coordinates import Frame
from sionna_radar.report.page.markup import TableCell, document
from sionna_radar.report.page.scene_data import HEIGHT_STEP_M, MAX_MAP_CELLS, Pack, packed_map, thinned
from sionna_radar.report.terminal import number, reference_rows
from sionna_radar.scenario import Scenario
from sionna_radar.survey.result import Processed, Survey
from sionna_radar.survey.sensors.sweeps import ChirpRecord

BINS = 81
# Half-width of a histogram, in NMADs, from which its scale is logarithmic.
HEAVY_TAILS = 10
STATISTICS = {
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


def colour_scales() -> dict[str, list[list[Any]]]:
    """Return the colour maps of the figures as plotly's lists of stops."""
    return {
        kind: [[number / (len(STOPS[name]) - 1), colour] for number, colour in enumerate(STOPS[name])]
        for kind, name in {"height": HEIGHTS, "error": ERRORS, "level": LEVELS}.items()
    }


def page_of(
    template: str,
    result: Survey | Processed,
    compared: Comparison | None,
    pack: Pack,
    frame: Frame,
    *,
    pulses: Int[np.ndarray, " pulse"],
    records: list[ChirpRecord],
    maps: Sequence[Mapping[str, Any]],
    world: Mapping[str, Any] | None,
    numbers: Mapping[str, Any] = MappingProxyType({}),
    **content: Any,
) -> str:
    """Return the page of a result as HTML: its world, maps, chirps and errors.

    pulses, records: pulses of the world, and chirps of some of them.
    numbers, content: further numbers of the page, and content of the template.
    """
    errors = {} if compared is None else {"lit cells": compared.error.within(compared.lit).height_m}
    whole = {
        "frame": frame_of_page(frame),
        "scales": colour_scales(),
        "chosen": len(pulses) // 2,
        "world": world,
        "maps": maps,
        "chirps": packed_chirps(pack, records, pulses, *units_of(result.scenario)),
        "histogram": histogram_of(errors) if errors else None,
        **numbers,
    }
    return document(
        template,
        pack.text(whole),
        ("world.js", "maps.js", "chirps.js"),
        warnings=result.warnings,
        shapes=[shape["name"] for shape in world["shapes"]] if world else [],
        paints=[paint["name"] for paint in world["paints"]] if world else [],
        pulses=len(pulses),
        maps=[entry["name"] for entry in maps],
        chirps=len(records),
        points_sha256=None if result.points is None else result.points.sha256(),
        versions={name: version or "not installed" for name, version in versions().items()},
        reference=reference_section(result.reference),
        **content,
    )


def painted(
    pack: Pack, frame: Frame, surfaces: Mapping[str, Raster], error_m: Float[np.ndarray, "row column"] | None
) -> dict[str, Any]:
    """Return the surfaces of a world by name, and what they are painted by: height, and the DEM's error if known."""
    (low, high), up = span_of(*(surface.height_m for surface in surfaces.values())), frame.origin_m[2]
    paints: list[dict[str, Any]] = [{"name": "Height (m)", "scale": "height", "low": low + up, "high": high + up}]
    if error_m is not None:
        limit, values = limit_of(error_m), pack.rounded(error_m, HEIGHT_STEP_M)
        paints.append({"name": "Error (m)", "scale": "error", "low": -limit, "high": limit, "z": values})
    shapes = [{"name": name, **packed_map(pack, each.grid, each.height_m)} for name, each in surfaces.items()]
    return {"shapes": shapes, "paints": paints}


def frame_of_page(frame: Frame) -> dict[str, Any]:
    """Return the offset of local coordinates and the names of the axes."""
    return {"origin": frame.origin_m, "east": frame.east, "north": frame.north, "height": frame.height}


def bounds_of(
    box: tuple[float, float, float, float], *heights_m: Float[np.ndarray, "..."]
) -> list[list[float | np.floating]]:
    """Return the corners of the view of a box (west, east, south, north) that all heights in it fit."""
    (west, east, south, north), known = box, [height[np.isfinite(height)] for height in heights_m]
    low, top = min(h.min() for h in known if h.size), max(h.max() for h in known if h.size)
    pad = 0.04 * (top - low) + 0.1
    return [[west, south, low - pad], [east, north, top + pad]]


# ---------------------------------------------------------------------------------------------------------- errors
def errors_section(
    compared: Comparison,
    breakdown: Breakdown,
    check: UncertaintyCheck | None,
    published: Mapping[str, Mapping[str, float]] = MappingProxyType({}),
    remark: str = "",
) -> dict[str, Any]:
    """Return the section on errors: statistics, classes of cells, and errors against stated ones.

    published: statistics (m) of other authors by name and by field of `DemError`, which `remark` introduces.
    """
    named = {
        "lit_error": ("Lit cells", compared.lit_error),
        "off_wall_error": ("Lit cells off walls", compared.off_wall_error),
        "dem_error": ("All filled cells", compared.dem_error),
    }
    return {
        "errors": list(STATISTICS),
        "error_rows": [
            *(_error_row(key, name, error) for key, (name, error) in named.items() if error is not None),
            *(
                [name, *(number(figures.get(key, np.nan), form) for key, form in STATISTICS.values()), "-", "-"]
                for name, figures in published.items()
            ),
        ],
        "paper": remark,
        "classes": class_rows(breakdown, "truth"),
        "checkpoints": breakdown.checkpoints.statement,
        "intervals": [f"in {p} %" for p in INTERVALS_PERCENT],
        "stated": _stated_rows(check),
    }


def reference_section(check: ReferenceCheck | None) -> dict[str, Any] | None:
    """Return the section on measured heights: shift, statistics, classes of cells, and errors against stated ones."""
    if check is None:
        return None
    whole = check.calibration.cells if isinstance(check.calibration, UncertaintyCheck) else check.calibration
    row = _error_row("reference.statistics", "Checkpoints" if check.error is None else "Cells", check.statistics)
    return {
        "name": check.name,
        "shift": reference_rows(check),
        "errors": list(STATISTICS),
        "rows": [row],
        "classes": {} if check.breakdown is None else class_rows(check.breakdown, "reference"),
        "checkpoints": "" if check.breakdown is None else check.breakdown.checkpoints.statement,
        "intervals": [f"in {p} %" for p in INTERVALS_PERCENT],
        "stated": [] if whole is None else [["all", *_calibration_row(whole)]],
    }


def _error_row(key: str, name: str, error: DemError) -> list[TableCell | str]:
    values = asdict(error)
    cells: list[TableCell | str] = [name]
    for field, form in (*STATISTICS.values(), ("count", ",.0f"), ("coverage", ".1%")):
        value = float(values[field])
        cells.append(TableCell(number(value, form), f"{key}.{field}", value if value == value else None))
    return cells


def class_rows(breakdown: Breakdown, surface: str) -> dict[str, list[list[str]]]:
    """Return the error by classes of a truth or a reference."""
    ranges = {
        f"Slope of the {surface} (deg)": breakdown.by_slope,
        "Incidence angle (deg)": breakdown.by_incidence,
        "Distance from walls (m)": breakdown.by_wall_distance or (),
    }
    named: dict[str, dict[str, ErrorClass | DemError]]
    named = {title: {_span(entry): entry for entry in entries} for title, entries in ranges.items()}
    named["Cover"] = {**(breakdown.by_cover or {})}
    return {
        title: [
            [name, number(entry.rms_m, ".3f"), number(entry.mean_m, "+.3f"), f"{entry.count:,}"]
            for name, entry in entries.items()
        ]
        for title, entries in named.items()
    }


def _span(entry: ErrorClass) -> str:
    return f"{entry.low:g} to {entry.high:g}" if np.isfinite(entry.high) else f"over {entry.low:g}"


def _stated_rows(check: UncertaintyCheck | None) -> list[list[str]]:
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


def histogram_of(errors_m: dict[str, Float[np.ndarray, "..."]]) -> dict[str, Any]:
    """Return the histograms of some errors by name, in shares, with their cumulative shares; NaN is left out."""
    finite = {name: values[np.isfinite(values)] for name, values in errors_m.items()}
    together = np.concatenate(list(finite.values()))
    limit = 1.3 * limit_of(together)
    edges, percent = np.linspace(-limit, limit, BINS + 1), np.arange(100)
    spread = nmad(together) if len(together) else 0.0
    return {
        "edges": edges.tolist(),
        "percent": percent.tolist(),
        "heavy": len(finite) == 1 and limit > HEAVY_TAILS * spread > 0,
        "series": [
            {
                "name": name,
                "share": (100 * np.histogram(values, edges)[0] / max(len(values), 1)).tolist(),
                "below": np.percentile(np.abs(values), percent).tolist() if len(values) else [],
                "marks": [(share, float(np.percentile(np.abs(values), share))) for share in (68.27, 90.0, 95.0)]
                if len(values)
                else [],
            }
            for name, values in finite.items()
        ],
    }


def limit_of(values: Float[np.ndarray, "..."]) -> float:
    """Return the 99th percentile of the magnitudes, with a minimum."""
    magnitude = np.abs(values[np.isfinite(values)])
    return max(float(np.percentile(magnitude, 99)), 1e-3) if len(magnitude) else 1.0


def span_of(*arrays: Float[np.ndarray, "..."], share: float = 0.0) -> tuple[float, float]:
    """Return the lowest and highest of all values without a share (%) at either end; never equal."""
    values = np.concatenate([a[np.isfinite(a)] for a in arrays])
    if not len(values):
        return 0.0, 1.0
    low, high = (float(v) for v in np.percentile(values, [share, 100 - share]))
    return (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)


# ------------------------------------------------------------------------------------------------------------ maps
def maps_of(
    pack: Pack, frame: Frame, result: Survey | Processed, compared: Comparison | None
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the maps of a DEM, and notes on omissions: truth and error if known, stated sigma and echo power."""
    dem, sigma, points = result.dem, result.dem_sigma, result.points
    assert dem is not None
    assert points is not None
    thin = thinned(dem.grid, MAX_MAP_CELLS)
    truth_m = [] if compared is None else [compared.truth.height_m]
    low, high = span_of(*truth_m, dem.height_m)
    up = frame.origin_m[2]
    heights = {"low": low + up, "high": high + up, "scale": "height", "unit": frame.height, "hover": "height"}
    layers = [("True surface", height_m + up, heights) for height_m in truth_m]
    layers.append(("DEM", dem.height_m + up, heights))
    if compared is not None:
        error_m = compared.error.height_m
        limit = limit_of(error_m)
        look = {"low": -limit, "high": limit, "scale": "error", "unit": "DEM minus truth (m)", "hover": "error"}
        layers.append(("Error of the DEM", error_m, look))
    if sigma is not None and sigma.filled.any():
        look = {"low": 0.0, "high": limit_of(sigma.height_m), "scale": "level", "unit": "Standard deviation (m)"}
        layers.append(("Stated uncertainty of the DEM", sigma.height_m, {**look, "hover": "stated sigma"}))
    if result.canopy is not None:
        plants = {"scale": "level", "low": 0.0}
        height_m, probability = result.canopy.height.height_m, result.canopy.plants.height_m
        top = {"high": limit_of(height_m), "unit": "Height of the plants (m)", "hover": "plants"}
        layers.append(("Height of the plants", height_m, plants | top))
        chance = {"high": 1.0, "unit": "Probability of plants", "hover": "probability"}
        layers.append(("Probability of plants", probability, plants | chance))
    maps = [
        {"name": name, **look, **packed_map(pack, thin.cells, thin.of(values), HEIGHT_STEP_M, frame.origin_m)}
        for name, values, look in layers
    ]
    if np.isfinite(points.echo_snr_db).any():
        grid, level = _echo_power(dem.grid, points)
        unit = f"Mean echo power ({units_of(result.scenario)[1]})"
        maps.append(level_map(pack, frame, grid, level, "Echo power", unit))
    return maps, [f"Maps: {thin.note}."] if thin.note else []


def level_map(
    pack: Pack, frame: Frame, grid: Grid, level_db: Float[np.ndarray, "row column"], name: str, unit: str
) -> dict[str, Any]:
    """Return a map of decibels."""
    low, high = span_of(level_db, share=1.0)
    look = {"low": low, "high": high, "scale": "level", "unit": unit, "hover": name}
    return {"name": name, **look, **packed_map(pack, grid, level_db, 0.1, frame.origin_m)}


def _echo_power(grid: Grid, points: Points) -> tuple[Grid, Float[np.ndarray, "row column"]]:
    """Return the mean echo power in dB on a grid coarse enough for a few echoes per cell."""
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


# ---------------------------------------------------------------------------------------------------------- chirps
# Limit of a page's chirps in bytes.
MAX_CHIRP_BYTES = 3_500_000
LEVEL_STEP_DB = 0.1


def chirps_that_fit(record: ChirpRecord | None) -> int:
    """Return the largest number of chirps like this one in a page; 0 without one."""
    if record is None:
        return 0
    samples = len(record.beat) * (2 if np.iscomplexobj(record.beat) else 1)
    return max(1, MAX_CHIRP_BYTES // (2 * (samples + 2 * len(record.power))))


def exponent_of(beat: Inexact[np.ndarray, "..."]) -> int:
    """Return the power of ten, a multiple of three, that scales a signal to near one."""
    largest = float(np.abs(beat).max(initial=0.0))
    return 3 * int(np.floor(np.log10(largest) / 3)) if largest > 0 else 0


def units_of(scenario: Scenario | None) -> tuple[str, str]:
    """Return the units of beat signals and of powers in decibels; None for a real recording."""
    if scenario is None:
        return "as recorded", "dB of the recording's unit squared"
    if scenario.radar.snr_db is not None:
        return "of the transmitted", "dB rel. to transmitted"
    return "√W", "dBW"


def packed_chirps(
    pack: Pack, records: list[ChirpRecord], rows: Int[np.ndarray, " pulse"], beat_unit: str, power_unit: str
) -> dict[str, Any] | None:
    """Return chirps for a page, with their rows among its pulses, which include theirs; None without any."""
    if not records:
        return None
    beat = np.stack([record.beat for record in records])
    scale = np.maximum(np.abs(beat).max(axis=1), np.finfo(float).tiny)
    exponent = exponent_of(beat)
    parts = [beat.real, beat.imag] if np.iscomplexobj(beat) else [beat]
    power = np.stack([record.power for record in records])
    power_db, threshold_db = _levels(power), _levels(np.stack([record.threshold for record in records]))
    echo_db = decibels(np.concatenate([record.echo_power for record in records]))
    levels_db = np.concatenate([power_db[np.isfinite(power_db)], echo_db[np.isfinite(echo_db)], [-300.0]])
    pulses = [record.pulse for record in records]
    return {
        "pulse": pack.whole(np.array(pulses)),
        "row": pack.whole(np.searchsorted(rows, pulses)),
        "time_ms": pack.exact(1e3 * records[0].sample_time_s),
        "range_m": pack.exact(records[0].range_m),
        "beat": [pack.rounded(part / scale[:, None], 2 / 65_000) for part in parts],
        "beat_scale": pack.exact(scale / 10.0**exponent),
        "beat_label": f"Beat (10<sup>{exponent}</sup> {beat_unit})",
        "power": pack.rounded(power_db, LEVEL_STEP_DB),
        "threshold": pack.rounded(threshold_db, LEVEL_STEP_DB),
        "power_label": f"Power ({power_unit})",
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
