"""A calibration: estimates as JSON, CSV and TOML, maps before and after, figures and page."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from rich.table import Table

from sionna_radar.execution.workers import versions
from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.report.drawing import (
    BLUE,
    ERRORS,
    HEIGHTS,
    ORANGE,
    ReportFigure,
    height_limits,
    save_figures,
    show_raster,
)
from sionna_radar.report.files.contents import Report, strict_json, write_page, write_text
from sionna_radar.report.files.folder import write_folder
from sionna_radar.report.page.markup import TableCell, document
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.terminal import console, print_whole
from sionna_radar.studies.calibration.estimation import TOLD
from sionna_radar.studies.calibration.study import Calibrated, Calibration, Manoeuvre

MARKER = "calibration.json"
HEAD = ("Error", "Unit", "Known before to", "Estimate", "Standard deviation", "Told")
# Residuals are shown up to so many of their median standard deviations, and means over squares of this many cells.
SHOWN, SQUARES = 4.0, 60


def write_calibration(result: Calibration, directory: Path, *, report: Report = Report.PAGE) -> list[Path]:
    """Write the numbers, the tables to paste, the maps, the figures and the page, all or nothing; return the files.

    Raises
    ------
    OutputError
        The directory holds other files, or cannot be written; see `write_folder`.

    """
    return write_folder(directory, MARKER, partial(_write_all, result, report))


def _write_all(result: Calibration, report: Report, directory: Path) -> None:
    write_text(directory / MARKER, strict_json(calibration_document(result)))
    write_text(directory / "errors.csv", _csv(result))
    write_text(directory / "calibration.toml", calibration_toml(result))
    for number, recording in enumerate(result.recordings, start=1):
        for name, dem in zip(("before", "after"), recording.dem, strict=True):
            dem.to_geotiff(directory / f"dem_{name}_{number}.tif")
    save_figures(result, {"residuals": draw_residuals, "dem": draw_maps}, directory / "figures")
    if report is Report.PAGE:
        write_page(directory / "report.html", lambda: calibration_page(result))


def calibration_document(result: Calibration) -> dict[str, Any]:
    """Return the numbers of a calibration, in the units of `UNKNOWNS`."""
    solution = result.solution
    units = _units(solution.names)
    return {
        "recordings": [recording.source.name for recording in result.recordings],
        "reference": None if result.reference is None else result.reference.name,
        "reference_sigma_m": result.reference_sigma_m,
        "reference_displaced": result.displaced,
        "told_below": TOLD,
        "errors": [
            {
                "name": name,
                "unit": UNKNOWNS[name].unit,
                "prior": float(solution.knowledge.prior[k] / units[k]),
                "sigma_before_estimation": float(solution.before.sigma[k] / units[k]),
                "told": bool(solution.told[k]),
                "estimate": float(solution.value[k] / units[k]) if solution.told[k] else None,
                "sigma": float(solution.sigma[k] / units[k]),
            }
            for k, name in enumerate(solution.names)
        ],
        "covariance": (solution.covariance / np.outer(units, units)).tolist(),
        "correlation": solution.knowledge.correlation.tolist(),
        "trade_offs": _trade_offs(result),
        "doppler": list(result.doppler),
        "drift": _drift(result),
        "manoeuvres": [_told_by(manoeuvre) for manoeuvre in result.manoeuvres],
        "variance_factor": solution.scatter,
        "excess_of_stretches": solution.excess,
        "probability_of_excess": solution.surprise,
        "misfit": solution.misfit,
        "model_holds": solution.model_holds,
        "residuals": [_residuals(recording) for recording in result.recordings],
        "warnings": list(result.warnings),
        "versions": versions(),
    }


def _units(names: tuple[str, ...]) -> Float[np.ndarray, " error"]:
    return np.array([UNKNOWNS[name].si for name in names])


def _trade_offs(result: Calibration) -> list[dict[str, float]]:
    unseen = result.solution.before.unseen
    return [{name: value / UNKNOWNS[name].si for name, value in direction.items()} for direction in unseen]


def _drift(result: Calibration) -> list[dict[str, Any]]:
    solution = result.solution
    return [
        {
            "name": name,
            "unit": UNKNOWNS[name].unit,
            "sigma_between_lines": between / UNKNOWNS[name].si,
            "lines": (solution.apart[:, k] / UNKNOWNS[name].si).tolist(),
            "sigma_of_lines": (solution.apart_sigma[:, k] / UNKNOWNS[name].si).tolist(),
        }
        for k, (name, between) in enumerate(solution.drift.between.items())
    ]


def _told_by(manoeuvre: Manoeuvre) -> dict[str, Any]:
    knowledge = manoeuvre.knowledge
    sigma = knowledge.sigma / _units(knowledge.names)
    told = dict(zip(knowledge.names, map(bool, knowledge.told), strict=True))
    return {"name": manoeuvre.name, "sigma": dict(zip(knowledge.names, map(float, sigma), strict=True)), "told": told}


def _residuals(recording: Calibrated) -> dict[str, Any]:
    error = recording.error
    return {
        "recording": recording.source.name,
        "echoes": int(np.isfinite(recording.after_m).sum()),
        "mean_before_m": float(np.nanmean(recording.before_m)),
        "mean_after_m": float(np.nanmean(recording.after_m)),
        "rms_before_m": float(np.sqrt(np.nanmean(recording.before_m**2))),
        "rms_after_m": float(np.sqrt(np.nanmean(recording.after_m**2))),
        "dem_error_before": None if error is None else asdict(error[0]),
        "dem_error_after": None if error is None else asdict(error[1]),
    }


def _csv(result: Calibration) -> str:
    rows = ["name,unit,prior,told,estimate,sigma"]
    for row in calibration_document(result)["errors"]:
        estimate = "" if row["estimate"] is None else f"{row['estimate']:.9g}"
        rows.append(
            f"{row['name']},{row['unit']},{row['prior']:.9g},{str(row['told']).lower()},{estimate},{row['sigma']:.9g}"
        )
    return "\n".join(rows) + "\n"


KEYS = {
    "roll": ("mounting_deg", 0, 1.0),
    "pitch": ("mounting_deg", 1, 1.0),
    "heading": ("mounting_deg", 2, 1.0),
    "squint": ("squint_deg", None, 1.0),
    "lever_nose": ("lever_arm_m", 0, 1.0),
    "lever_right": ("lever_arm_m", 1, 1.0),
    "lever_down": ("lever_arm_m", 2, 1.0),
    "datum_east": ("datum_m", 0, 1.0),
    "datum_north": ("datum_m", 1, 1.0),
    "datum_up": ("datum_m", 2, 1.0),
    "velocity_east": ("velocity_mps", 0, 1.0),
    "velocity_north": ("velocity_mps", 1, 1.0),
    "velocity_up": ("velocity_mps", 2, 1.0),
    "range_bias": ("range_bias_m", None, 1.0),
    "range_scale": ("range_scale_ppm", None, 1.0),
    "time_offset": ("time_offset_s", None, 1e-3),
}
# Of a simulated flight with these errors: keys of platform.navigation.
SIMULATED = {
    "mounting_deg": "boresight_error_deg",
    "lever_arm_m": "lever_arm_error_m",
    "datum_m": "position_constant_m",
    "velocity_mps": "velocity_constant_mps",
    "time_offset_s": "time_offset_s",
}


def calibration_toml(result: Calibration) -> str:
    """Return the told errors as tables: of `process --set-file`, and commented out those of a simulated flight."""
    table: dict[str, Any] = {}
    # The ground's own backscatter has no key.
    for name, (value, sigma) in (each for each in result.errors.items() if each[0] in KEYS):
        key, place, factor = KEYS[name]
        stated = _to_a_share(value * factor, sigma * factor)
        if place is None:
            table[key] = stated
        else:
            table.setdefault(key, [0.0, 0.0, 0.0])[place] = stated
    told = tomli_w.dumps({"processing": {"calibration": table}})
    simulated = {SIMULATED[key]: value for key, value in table.items() if key in SIMULATED}
    flown = tomli_w.dumps({"platform": {"navigation": simulated}})
    held = [name for name, is_told in zip(result.solution.names, result.solution.told, strict=True) if not is_told]
    lines = ["# Errors of the instrument, believed minus true: `sionna-radar process RECORDING --set-file` this file."]
    lines += [f"# Not told by this flight, and left at zero: {', '.join(held)}."] if held else []
    lines += [told.rstrip(), "", "# A simulated flight with these errors has:"]
    lines += [f"# {line}" if line else "#" for line in flown.rstrip().splitlines()]
    return "\n".join(lines) + "\n"


def _to_a_share(value: float, sigma: float) -> float:
    """Return a value rounded to a thousandth of its standard deviation, or finer."""
    return round(value, max(0, 3 - int(np.floor(np.log10(sigma))))) if sigma > 0 else value


# ---------------------------------------------------------------------------------------------------------- figures
def draw_residuals(result: Calibration) -> Figure:
    """Draw the residuals of all echoes on a map and as a histogram, before and after."""
    place, before, after, limit = _gathered(result)
    figure = ReportFigure(figsize=(13.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    for one, values, title in zip(axes, (before, after), ("Before", "After"), strict=False):
        drawn = one.scatter(*place.T, c=values, s=1.5, cmap=ERRORS, norm=Normalize(-limit, limit), rasterized=True)
        one.set(xlabel="East (m)", ylabel="North (m)", title=title)
        one.set_aspect("equal")
    figure.colorbar(drawn, ax=axes[:2], label="Range minus predicted range (m)", extend="both")
    bins = np.linspace(-limit, limit, 81)
    for values, name, colour in ((before, "before", ORANGE), (after, "after", BLUE)):
        label = f"{name}, {_beyond(values, limit):.1%} beyond" if _beyond(values, limit) else name
        axes[2].hist(values, bins, histtype="step", color=colour, label=label, lw=1.4)
    axes[2].set(xlabel="Range minus predicted range (m)", ylabel="Echoes")
    axes[2].legend(frameon=False)
    return figure


def _beyond(values: Float[np.ndarray, " n"], limit: float) -> float:
    """Return the share of residuals that a histogram leaves out."""
    return float(np.mean(np.abs(values) > limit))


def _gathered(
    result: Calibration,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"], Float[np.ndarray, " n"], float]:
    """Return places and residuals of all recordings, and the largest that is shown."""
    columns = [
        (r.place_m[kept], r.before_m[kept], r.after_m[kept], r.sigma_m[kept])
        for r in result.recordings
        for kept in [np.isfinite(r.before_m) & np.isfinite(r.after_m)]
    ]
    place, before, after, sigma = (np.concatenate(column) for column in zip(*columns, strict=True))
    limit = max(SHOWN * float(np.median(sigma)), float(np.quantile(np.abs(before), 0.9)))
    return place, before, after, limit


def draw_maps(result: Calibration) -> Figure:
    """Draw the DEM of the first recording before and after, and their difference."""
    before, after = result.recordings[0].dem
    figure = ReportFigure(figsize=(13.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    scale = Normalize(*height_limits(before, after))
    for one, dem, title in zip(axes, (before, after), ("DEM before", "DEM after"), strict=False):
        show_raster(one, dem, HEIGHTS, scale)
        one.set(title=title, xlabel="East (m)", ylabel="North (m)")
    figure.colorbar(axes[1].images[0], ax=axes[:2], label="Height (m)")
    if before.grid == after.grid:
        change = after.height_m - before.height_m
        most = max(float(np.nanquantile(np.abs(change), 0.99)) if np.isfinite(change).any() else 0.0, 1e-3)
        image = axes[2].imshow(
            change, origin="lower", extent=after.grid.extent_m, cmap=ERRORS, norm=Normalize(-most, most)
        )
        figure.colorbar(image, ax=axes[2], label="After minus before (m)", extend="both")
        axes[2].set(title="Change", xlabel="East (m)", ylabel="North (m)")
    else:
        axes[2].set_axis_off()
    return figure


# ------------------------------------------------------------------------------------------------------------- text
def print_calibration(result: Calibration) -> None:
    """Print what the flight tells, the estimates, and what manoeuvres would add."""
    recorded = ", ".join(r.source.name for r in result.recordings)
    table = Table(title=f"{recorded} over {_ground(result)}", title_justify="left")
    for name in HEAD:
        table.add_column(name.lower(), justify="left" if name in ("Error", "Unit", "Told") else "right")
    for row in calibration_document(result)["errors"]:
        table.add_row(row["name"], row["unit"], *_texts(row).values())
    print_whole(table)
    out = console()
    for text in [*_statements(result), _meaning(result)]:
        out.print(text, soft_wrap=True)
    for recording in result.recordings:
        if recording.error is not None:
            before, after = (error.rms_m for error in recording.error)
            text = f"{recording.source.name}: RMS error of the DEM {before:.3f} m before, {after:.3f} m after"
            out.print(text, soft_wrap=True)
    for warning in result.warnings:
        out.print(f"warning: {warning}", soft_wrap=True)


def _ground(result: Calibration) -> str:
    return "unknown ground" if result.reference is None else result.reference.name


def _texts(row: Mapping[str, Any]) -> dict[str, str]:
    sigma = row["sigma"]
    digits = int(np.clip(1 - np.floor(np.log10(sigma)), 0, 6)) if sigma > 0 else 3
    return {
        "prior": f"{row['prior']:.3g}",
        "estimate": "-" if row["estimate"] is None else f"{row['estimate']:+.{digits}f}",
        "sigma": f"{sigma:.{digits}f}",
        "told": "yes" if row["told"] else "no",
    }


def trade_off_words(result: Calibration) -> list[str]:
    """Return in words which errors leave the echoes as they are, if they err together."""
    words = []
    for direction in _trade_offs(result):
        parts = [f"{name} of {value:+.3g} {UNKNOWNS[name].unit}" for name, value in direction.items()]
        if len(parts) == 1:
            words.append(f"not told: a {parts[0]} changes the echoes too little")
        else:
            words.append(f"not told apart: a {' with a '.join(parts)} changes the echoes too little")
    return words


def _statements(result: Calibration) -> list[str]:
    drifts = []
    for row in _drift(result):
        lines = zip(row["lines"], row["sigma_of_lines"], strict=True)
        apart = ", ".join(f"{value:+.2g} ± {sigma:.2g}" for value, sigma in lines)
        drifts.append(f"{row['name']} of each line apart from that of the flight: {apart} {row['unit']}")
    return [*result.doppler, *drifts, *trade_off_words(result), *_manoeuvre_words(result)]


def _left_out(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], limit: float) -> str:
    shares = f"{_beyond(before, limit):.1%} before and {_beyond(after, limit):.1%} after"
    return f"Of the residuals {shares} are beyond the {limit:.3g} m that the histogram shows."


def _manoeuvre_words(result: Calibration) -> list[str]:
    solution = result.solution
    if solution.told.all() or not result.manoeuvres:
        return []
    held = [name for name, told in zip(solution.names, solution.told, strict=True) if not told]
    words = []
    for manoeuvre in result.manoeuvres:
        told = dict(zip(manoeuvre.knowledge.names, manoeuvre.knowledge.told, strict=True))
        gained = [name for name in held if told[name]]
        if gained:
            words.append(f"{manoeuvre.name} would tell {', '.join(gained)}")
    return words or [f"no single further line would tell {', '.join(held)}"]


def _meaning(result: Calibration) -> str:
    return (
        f"An error, believed minus true, is told if its standard deviation falls below {TOLD:.2f} of the one before. "
        "One that is not stays at zero, and its uncertainty is in the standard deviations of the others. Variances are "
        f"{result.solution.scatter:.2f} times those of the Fisher information, as the scores of stretches of the "
        "flight scatter."
    )


def calibration_page(result: Calibration) -> str:
    """Return the page of a calibration as HTML.

    Raises OutputError if plotly is not installed.
    """
    content = calibration_document(result)
    place, before, after, limit = _gathered(result)
    numbers = {
        "correlation": {"name": list(result.solution.names), "value": content["correlation"]},
        "histogram": _histogram(before, after, limit),
        "map": _squares(place, after, limit),
    }
    names = result.solution.names
    told = [name for name, is_told in zip(names, result.solution.told, strict=True) if is_told]
    command = ["sionna-radar", "calibrate", *(r.source.name for r in result.recordings)]
    command += [] if result.reference is None else ["--reference", result.reference.name]
    changes = [word for key, value in result.overrides.items() for word in ("--set", f"{key}={json.dumps(value)}")]
    return document(
        "calibration.html",
        Pack().text(numbers),
        ("calibration.js",),
        package=__package__,
        title=f"Calibration of {', '.join(r.source.name for r in result.recordings)}",
        warnings=result.warnings,
        tiles=[
            (f"{len(told)} of {len(names)}", "errors told", "by this flight"),
            (f"{sum(r['echoes'] for r in content['residuals']):,}", "echoes", f"over {_ground(result)}"),
            *(
                (f"{r.error[1].rms_m:.3f} m", "RMS of the DEM after", f"{r.error[0].rms_m:.3f} m before")
                for r in result.recordings
                if r.error is not None
            ),
        ],
        head=list(HEAD),
        rows=[
            [
                row["name"],
                row["unit"],
                *(
                    text if key == "told" else TableCell(text, f"errors.{k}.{key}", row[key])
                    for key, text in _texts(row).items()
                ),
            ]
            for k, row in enumerate(content["errors"])
        ],
        statements=[*_statements(result), _left_out(before, after, limit)],
        manoeuvre_head=["One more line", *(f"{name} ({UNKNOWNS[name].unit})" for name in names)],
        manoeuvre_rows=[
            [
                manoeuvre["name"],
                *(
                    TableCell(
                        f"{manoeuvre['sigma'][name]:.3g}", f"manoeuvres.{k}.sigma.{name}", manoeuvre["sigma"][name]
                    )
                    for name in names
                ),
            ]
            for k, manoeuvre in enumerate(content["manoeuvres"])
        ],
        meaning=_meaning(result),
        command=shlex.join([*command, *changes]),
        toml=calibration_toml(result),
    )


def _histogram(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], limit: float) -> dict[str, list[float]]:
    edges = np.linspace(-limit, limit, 81)
    return {
        "residual_m": ((edges[1:] + edges[:-1]) / 2).tolist(),
        **{name: np.histogram(values, edges)[0].tolist() for name, values in (("before", before), ("after", after))},
    }


def _squares(place: Float[np.ndarray, "n 2"], after: Float[np.ndarray, " n"], limit: float) -> dict[str, Any]:
    """Return the mean residual of squares of the ground."""
    low, extent = place.min(axis=0), max(float(np.ptp(place, axis=0).max()), 1e-6)
    column, row = np.minimum((place - low) / extent * SQUARES, SQUARES - 1).astype(np.int64).T
    count, total = np.zeros((SQUARES, SQUARES)), np.zeros((SQUARES, SQUARES))
    np.add.at(count, (row, column), 1.0)
    np.add.at(total, (row, column), after)
    with np.errstate(invalid="ignore"):
        mean = total / np.where(count > 0, count, np.nan)
    cells = [[None if not np.isfinite(value) else float(value) for value in row] for row in mean]
    middles = [(corner + (np.arange(SQUARES) + 0.5) * extent / SQUARES).tolist() for corner in low]
    return {"east_m": middles[0], "north_m": middles[1], "mean_m": cells, "limit_m": limit / 2}
