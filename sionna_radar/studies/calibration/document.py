"""A calibration: estimates as JSON, CSV and TOML, maps before and after, figures and page."""

from collections.abc import Mapping
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from jaxtyping import Float
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from sionna_radar.execution.workers import versions
from sionna_radar.flight.instrument import UNKNOWNS
from sionna_radar.mapping.navigation.refinement import MAX_POSTERIOR_RATIO
from sionna_radar.report.colours import BLUE, ERRORS, HEIGHTS, ORANGE
from sionna_radar.report.drawing import ReportFigure, dot_size, show_raster
from sionna_radar.report.page.markup import TableCell, command_line, document
from sionna_radar.report.page.scene_data import Pack
from sionna_radar.report.page.sections import span_of
from sionna_radar.report.study_document import Column, Columns, StudyDocument
from sionna_radar.report.terminal import NONE
from sionna_radar.studies.calibration.estimation import Further
from sionna_radar.studies.calibration.study import Calibrated, Calibration

# Residuals are shown up to so many of their median standard deviations, and means over squares of this many cells.
SHOWN, SQUARES = 4.0, 60


def write_maps(result: Calibration, directory: Path) -> None:
    """Write the DEM of each recording before and after."""
    for count, recording in enumerate(result.recordings, start=1):
        for name, dem in zip(("before", "after"), recording.dem, strict=True):
            dem.to_geotiff(directory / f"dem_{name}_{count}.tif")


def calibration_numbers(result: Calibration) -> dict[str, Any]:
    """Return the numbers of a calibration, in the units of `UNKNOWNS`."""
    solution = result.solution
    units = _units(solution.names)
    return {
        "recordings": [recording.source.name for recording in result.recordings],
        "reference": None if result.reference is None else result.reference.name,
        "reference_sigma_m": result.reference_sigma_m,
        "reference_displaced": result.displaced,
        "told_below": MAX_POSTERIOR_RATIO,
        "errors": _errors(result),
        "covariance": solution.covariance / np.outer(units, units),
        "correlation": solution.posterior.correlation,
        "trade_offs": _trade_offs(result),
        "doppler": result.doppler,
        "drift": _drift(result),
        "manoeuvres": [_with_line(manoeuvre) for manoeuvre in result.manoeuvres],
        "variance_factor": solution.scatter,
        "excess_of_stretches": solution.excess,
        "probability_of_excess": solution.p_value,
        "misfit": solution.reduced_chi2,
        "model_holds": solution.model_holds,
        "residuals": [_residuals(recording) for recording in result.recordings],
        "warnings": result.warnings,
        "versions": versions(),
    }


def _errors(result: Calibration) -> list[dict[str, Any]]:
    """Return prior, estimate and standard deviation of each error; see `ERRORS_OF_INSTRUMENT`."""
    solution = result.solution
    return [
        {
            "name": name,
            "unit": UNKNOWNS[name].unit,
            "prior": solution.posterior.prior[k] / unit,
            "sigma_before_estimation": solution.before.sigma[k] / unit,
            "told": bool(solution.observable[k]),
            "estimate": solution.value[k] / unit if solution.observable[k] else None,
            "sigma": solution.sigma[k] / unit,
        }
        for k, (name, unit) in enumerate(zip(solution.names, _units(solution.names), strict=True))
    ]


def _units(names: tuple[str, ...]) -> Float[np.ndarray, " error"]:
    return np.array([UNKNOWNS[name].si for name in names])


def _trade_offs(result: Calibration) -> list[dict[str, float]]:
    null_space = result.solution.before.null_space
    return [{name: value / UNKNOWNS[name].si for name, value in direction.items()} for direction in null_space]


def _drift(result: Calibration) -> list[dict[str, Any]]:
    solution = result.solution
    return [
        {
            "name": name,
            "unit": UNKNOWNS[name].unit,
            "sigma_between_lines": between / UNKNOWNS[name].si,
            "lines": solution.line_offsets[:, k] / UNKNOWNS[name].si,
            "sigma_of_lines": solution.line_offsets_sigma[:, k] / UNKNOWNS[name].si,
        }
        for k, (name, between) in enumerate(solution.drift.between.items())
    ]


def _with_line(manoeuvre: Further) -> dict[str, Any]:
    posterior = manoeuvre.posterior
    sigma = posterior.sigma / _units(posterior.names)
    observable = dict(zip(posterior.names, map(bool, posterior.observable), strict=True))
    return {"name": manoeuvre.name, "sigma": dict(zip(posterior.names, sigma, strict=True)), "told": observable}


def _residuals(recording: Calibrated) -> dict[str, Any]:
    before, after = recording.error or (None, None)
    return {
        "recording": recording.source.name,
        "echoes": int(np.isfinite(recording.after_m).sum()),
        "mean_before_m": np.nanmean(recording.before_m),
        "mean_after_m": np.nanmean(recording.after_m),
        "rms_before_m": np.sqrt(np.nanmean(recording.before_m**2)),
        "rms_after_m": np.sqrt(np.nanmean(recording.after_m**2)),
        "dem_error_before": before,
        "dem_error_after": after,
    }


def _sigma_digits(row: Mapping[str, Any]) -> int:
    """Return the decimals that two digits of the standard deviation need."""
    return int(np.clip(1 - np.floor(np.log10(row["sigma"])), 0, 6)) if row["sigma"] > 0 else 3


def _estimate(row: Mapping[str, Any]) -> str:
    return NONE if row["estimate"] is None else f"{row['estimate']:+.{_sigma_digits(row)}f}"


ERRORS_OF_INSTRUMENT = Columns[Mapping[str, Any]](
    [
        Column(key="name", heading="error"),
        Column(key="unit", heading="unit"),
        Column(key="prior", heading="prior sigma", form=".3g"),
        Column(key="estimate", heading="estimate", text=_estimate),
        Column(key="sigma", heading="standard deviation", text=lambda row: f"{row['sigma']:.{_sigma_digits(row)}f}"),
        Column(key="told", heading="observable"),
    ]
)
# Keys of processing.calibration, and the errors that they hold. The ground's own backscatter has no key.
KEYS = {
    "mounting_deg": ("roll", "pitch", "heading"),
    "squint_deg": ("squint",),
    "lever_arm_m": ("lever_nose", "lever_right", "lever_down"),
    "range_bias_m": ("range_bias",),
    "range_scale_ppm": ("range_scale",),
    "time_offset_s": ("time_offset",),
    "datum_m": ("datum_east", "datum_north", "datum_up"),
    "velocity_mps": ("velocity_east", "velocity_north", "velocity_up"),
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
    """Return observable errors as tables: of `process --set-file`, and commented out those of a simulated flight."""
    table: dict[str, Any] = {}
    for key, names in KEYS.items():
        if result.errors.keys().isdisjoint(names):
            continue
        unit = 1e-3 if key == "time_offset_s" else 1.0
        value = [_rounded(*(unit * number for number in result.errors.get(name, (0.0, 0.0)))) for name in names]
        table[key] = value if len(names) > 1 else value[0]
    estimated = tomli_w.dumps({"processing": {"calibration": table}})
    simulated = {SIMULATED[key]: value for key, value in table.items() if key in SIMULATED}
    flown = tomli_w.dumps({"platform": {"navigation": simulated}})
    held = list(compress(result.solution.names, ~result.solution.observable))
    lines = ["# Errors of the instrument, believed minus true: `sionna-radar process RECORDING --set-file` this file."]
    lines += [f"# Not observable from this flight, and left at zero: {', '.join(held)}."] if held else []
    lines += [estimated.rstrip(), "", "# A simulated flight with these errors has:"]
    lines += [f"# {line}" if line else "#" for line in flown.rstrip().splitlines()]
    return "\n".join(lines) + "\n"


def _rounded(value: float, sigma: float) -> float:
    """Return a value rounded to a thousandth of its standard deviation, or finer."""
    return round(value, max(0, 3 - int(np.floor(np.log10(sigma))))) if sigma > 0 else value


def draw_residuals(result: Calibration) -> Figure:
    """Draw the residuals of all echoes on a map and as a histogram, before and after."""
    place, before, after, limit = _gathered(result)
    figure = ReportFigure(figsize=(13.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    size = dot_size((3.0, 3.0), len(place)) ** 2
    for one, values, title in zip(axes, (before, after), ("Before", "After"), strict=False):
        drawn = one.scatter(*place.T, c=values, s=size, cmap=ERRORS, norm=Normalize(-limit, limit), rasterized=True)
        one.set_facecolor("0.8")  # a residual of zero is white
        one.set(xlabel="East (m)", ylabel="North (m)", title=title)
        one.set_aspect("equal")
    figure.colorbar(drawn, ax=axes[:2], label="Range minus predicted range (m)", extend="both")
    bins = _edges(len(place), limit)
    for values, name, colour in ((before, "before", ORANGE), (after, "after", BLUE)):
        label = f"{name}, {_beyond(values, limit):.1%} beyond" if _beyond(values, limit) else name
        axes[2].hist(values, bins, histtype="step", color=colour, label=label, lw=1.4)
    axes[2].set(xlabel="Range minus predicted range (m)", ylabel="Echoes")
    axes[2].yaxis.get_major_locator().set_params(integer=True)
    axes[2].legend(frameon=False)
    return figure


def _edges(count: int, limit: float) -> Float[np.ndarray, " edge"]:
    """Return the edges of a histogram's bins, as many as leave its counts readable."""
    return np.linspace(-limit, limit, 1 + int(np.clip(2 * np.sqrt(count), 20, 80)))


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
    scale = Normalize(*span_of(before.height_m, after.height_m))
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


def sentences(result: Calibration) -> list[str]:
    """Return the observable and the unobservable errors, those of the DEM, and the warnings."""
    rms = [
        f"{r.source.name}: RMS error of the DEM {r.error[0].rms_m:.3f} m before, {r.error[1].rms_m:.3f} m after"
        for r in result.recordings
        if r.error is not None
    ]
    return [*_statements(result), _meaning(result), *rms, *(f"warning: {warning}" for warning in result.warnings)]


def _ground(result: Calibration) -> str:
    return "unknown ground" if result.reference is None else result.reference.name


def trade_off_words(result: Calibration) -> list[str]:
    """Return in words which errors leave the echoes as they are, if they err together."""
    words = []
    for direction in _trade_offs(result):
        parts = [f"{name} of {value:+.3g} {UNKNOWNS[name].unit}" for name, value in direction.items()]
        if len(parts) == 1:
            words.append(f"not observable: the data are too insensitive to a {parts[0]}")
        else:
            words.append(f"not separable: the data are too insensitive to a {' with a '.join(parts)}")
    return words


def _statements(result: Calibration) -> list[str]:
    drifts = []
    for row in _drift(result):
        lines = zip(row["lines"], row["sigma_of_lines"], strict=True)
        offsets = ", ".join(f"{value:+.2g} ± {sigma:.2g}" for value, sigma in lines)
        drifts.append(f"{row['name']} of each line relative to that of the flight: {offsets} {row['unit']}")
    return [*result.doppler, *drifts, *trade_off_words(result), *_manoeuvre_words(result)]


def _manoeuvre_words(result: Calibration) -> list[str]:
    solution = result.solution
    if solution.observable.all() or not result.manoeuvres:
        return []
    held = list(compress(solution.names, ~solution.observable))
    words = []
    for manoeuvre in result.manoeuvres:
        observable = set(compress(manoeuvre.posterior.names, manoeuvre.posterior.observable))
        if gained := [name for name in held if name in observable]:
            words.append(f"flying {manoeuvre.name} would make {', '.join(gained)} observable")
    return words or [f"no single further line would make {', '.join(held)} observable"]


def _meaning(result: Calibration) -> str:
    return (
        "An error (believed minus true) counts as observable when its posterior sigma is less than "
        f"{MAX_POSTERIOR_RATIO:.2f} of its prior sigma. One that is not stays at zero, and its uncertainty is in the "
        f"standard deviations of the others. Variances are {result.solution.scatter:.2f} times those of the Fisher "
        "information, scaled by the empirical scatter of the score."
    )


def calibration_page(result: Calibration) -> str:
    """Return the page of a calibration as HTML; raises OutputError if plotly is not installed."""
    content = DOCUMENT.content(result)
    place, before, after, limit = _gathered(result)
    numbers = {
        "correlation": {"name": list(result.solution.names), "value": content["correlation"]},
        "histogram": _histogram(before, after, limit),
        "map": _squares(place, after, limit),
    }
    names = result.solution.names
    left_out = (
        f"Of the residuals {_beyond(before, limit):.1%} before and {_beyond(after, limit):.1%} after are beyond the "
        f"{limit:.3g} m that the histogram shows."
    )
    command = ["calibrate", *(r.source.name for r in result.recordings)]
    command += [] if result.reference is None else ["--reference", result.reference.name]
    return document(
        "calibration.html",
        Pack().text(numbers),
        ("calibration.js",),
        package=__package__,
        title=f"Calibration of {', '.join(r.source.name for r in result.recordings)}",
        warnings=result.warnings,
        tiles=[
            (f"{int(result.solution.observable.sum())} of {len(names)}", "errors observable", "from this flight"),
            (f"{sum(r['echoes'] for r in content['residuals']):,}", "echoes", f"over {_ground(result)}"),
            *(
                (f"{r.error[1].rms_m:.3f} m", "RMS of the DEM after", f"{r.error[0].rms_m:.3f} m before")
                for r in result.recordings
                if r.error is not None
            ),
        ],
        head=ERRORS_OF_INSTRUMENT.heads,
        rows=ERRORS_OF_INSTRUMENT.cells(content["errors"], "errors."),
        statements=[*_statements(result), left_out],
        manoeuvre_head=["One more line", *(f"{name} ({UNKNOWNS[name].unit})" for name in names)],
        manoeuvre_rows=[
            [line["name"], *(TableCell(f"{s:.3g}", f"manoeuvres.{k}.sigma.{n}", s) for n, s in line["sigma"].items())]
            for k, line in enumerate(content["manoeuvres"])
        ],
        meaning=_meaning(result),
        command=command_line(command, result.overrides),
        toml=calibration_toml(result),
    )


def _histogram(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], limit: float) -> dict[str, np.ndarray]:
    edges = _edges(len(before), limit)
    return {
        "residual_m": (edges[1:] + edges[:-1]) / 2,
        **{name: np.histogram(values, edges)[0] for name, values in (("before", before), ("after", after))},
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
    east_m, north_m = (corner + (np.arange(SQUARES) + 0.5) * extent / SQUARES for corner in low)
    return {"east_m": east_m, "north_m": north_m, "mean_m": mean, "limit_m": limit / 2}


DOCUMENT = StudyDocument[Calibration](
    marker="calibration.json",
    suffix="_calibration",
    numbers=calibration_numbers,
    tables=lambda result: [
        ERRORS_OF_INSTRUMENT.table(
            f"{', '.join(r.source.name for r in result.recordings)} over {_ground(result)}", _errors(result)
        )
    ],
    lines=sentences,
    figures=lambda _: {"residuals": draw_residuals, "dem": draw_maps},
    notebook=["residuals"],
    texts={
        "errors.csv": lambda result: ERRORS_OF_INSTRUMENT.csv(
            _errors(result), ["name", "unit", "prior", "told", "estimate", "sigma"], ".9g"
        ),
        "calibration.toml": calibration_toml,
    },
    files=[write_maps],
    page=calibration_page,
)
